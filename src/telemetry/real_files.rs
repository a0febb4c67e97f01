//! Files written by real drones, some of them damaged. They are not part of this repository: they are in `telemetry/`
//! of the folder `TRACTRIX_DATA`.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use super::*;

/// Name, number of fixes, dialects. A file without fixes is refused.
const EXPECTED: [(&str, usize, &str); 19] = [
    ("air2s.srt", 17, "dji-brackets-altitude"),
    ("broken_empty.SRT", 0, ""),
    ("broken_incomplete.SRT", 19, "dji-gps-barometer"),
    ("broken_incomplete2.SRT", 4, "dji-brackets-altitude"),
    ("cm_Mini5PRO.SRT", 5, "dji-brackets-two-heights"),
    ("cm_air3.SRT", 2, "dji-brackets-two-heights"),
    ("cm_air3S.SRT", 5, "dji-brackets-two-heights"),
    ("cm_avata2.SRT", 2, "dji-gps-latitude-first"),
    ("cm_mini4pro.SRT", 2, "dji-brackets-two-heights"),
    ("matrice_300.srt", 381, "dji-gps-latitude-first"),
    ("mavic_2_style.SRT", 463, "dji-brackets-no-height"),
    ("mavic_air.SRT", 0, ""),
    ("mavic_air2.srt", 25, "dji-brackets-altitude"),
    ("mavic_mini.SRT", 117, "dji-gps-words"),
    ("mavic_pro.SRT", 468, "dji-gps-barometer"),
    ("mix_p4rtk_mavic2pro.srt", 12, "dji-brackets-altitude, dji-gps-words"),
    ("old_format.SRT", 468, "dji-gps-hb-hs"),
    ("p4_rtk.SRT", 55, "dji-gps-words"),
    ("p4p_sample.SRT", 5, "dji-gps-words"),
];

fn folder() -> PathBuf {
    let data = std::env::var_os("TRACTRIX_DATA").expect("TRACTRIX_DATA names the folder of the data");
    Path::new(&data).join("telemetry")
}

/// Prints the table of docs/telemetry.md.
#[test]
#[ignore = "needs files that are not part of this repository: TRACTRIX_DATA"]
fn every_real_file_is_read_or_refused_with_a_reason() {
    let mut table = String::new();
    for (name, num_fixes, dialects) in EXPECTED {
        let found = read(&folder().join(name));
        let log = match found {
            Err(error) => {
                let said = error.to_string();
                assert_eq!(num_fixes, 0, "{said}");
                let _ =
                    writeln!(table, "| {name} | refused: {} | | | | |", said.rsplit(name).next().unwrap_or_default());
                continue;
            }
            Ok(log) => log,
        };
        let summary = log.summary();
        let found = summary.dialects.keys().copied().collect::<Vec<_>>().join(", ");
        assert_eq!((summary.num_fixes, found.as_str()), (num_fixes, dialects), "{name}: {:?}", log.passed_over);
        let _ = writeln!(table, "{}", row(name, &summary));
    }
    println!("{table}");
    let listed = fs::read_dir(folder()).unwrap().count();
    assert_eq!(listed, EXPECTED.len(), "a file is not in the table");
}

fn row(name: &str, summary: &Summary) -> String {
    let range = |range: Option<Range>, digits: usize| {
        range.map_or("–".to_owned(), |Range { least, most }| format!("{least:.digits$} to {most:.digits$}"))
    };
    let dialects: Vec<_> = summary.dialects.keys().copied().collect();
    let passed = summary.passed_over.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ");
    format!(
        "| {name} | {} | {} | {} | {}; {} | {}; {} | {passed} |",
        dialects.join(", "),
        summary.num_fixes,
        range(summary.video_s, 2),
        range(summary.latitude_deg, 6),
        range(summary.longitude_deg, 6),
        range(summary.gps_height_m, 1),
        range(summary.relative_height_m, 1),
    )
}
