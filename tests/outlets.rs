//! One run, and its figures in every outlet: terminal, page, `run --json`, `trajectories.json`, tables and `summary`.

mod common;

use std::fmt::Write as _;
use std::fs;

use common::{Place, drive, json, outcome, tractrix};
use serde_json::Value;
use tractrix::math::rounding::with_std;

const NUM_FRAMES: u32 = 24;

/// Runs the drive at 12 frames per second; gives what went to stdout.
fn run(place: &Place, more: &[&str]) -> String {
    let path = |name: &str| place.path(name).display().to_string();
    let mut command = tractrix();
    command.args(["run", &path("images"), "--output", &path("out"), "--masks", &path("masks")]);
    command.args(["--ground-masks", &path("ground"), "--intrinsics", &drive::intrinsics()]);
    command.args(["--fps", "12", "--threads", "1"]).args(more);
    let (code, stdout, stderr) = outcome(&mut command);
    assert_eq!(code, 0, "{stderr}");
    stdout
}

/// First row of a table, by column.
fn first_row(text: &str) -> impl Fn(&str) -> String + use<> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let columns = reader.headers().unwrap().clone();
    let row = reader.records().next().unwrap().unwrap();
    move |column: &str| row[columns.iter().position(|name| name == column).unwrap_or_else(|| panic!("{column}"))].into()
}

fn export(place: &Place, formats: &str) {
    let out = place.path("out").display().to_string();
    let (code, _, stderr) = outcome(tractrix().args(["export", &out, "--format", formats]));
    assert_eq!(code, 0, "{stderr}");
}

#[test]
fn every_outlet_has_the_same_figures() {
    let place = Place::new(NUM_FRAMES);
    let height = ["--camera-height", "5.5±0.05"];
    let with_json = [&height[..], &["--json"][..]].concat();
    let by_json: Value = serde_json::from_str(&run(&place, &with_json)).unwrap();
    let terminal = run(&place, &height);
    let file = json(&place.path("out/trajectories.json"));
    // The templates escape slashes.
    let page = fs::read_to_string(place.path("out/report.html")).unwrap().replace("&#x2f;", "/");
    export(&place, "csv,trajectories-v2");
    let table = first_row(&fs::read_to_string(place.path("out/export/vehicles.csv")).unwrap());
    let (code, text, _) = outcome(tractrix().args(["summary", &place.path("out").display().to_string()]));
    assert_eq!(code, 0);
    let summary = first_row(&text);

    let (vehicle, object) = (&file["objects"][0], &by_json["objects"][0]);
    for (key, column, unit, factor) in [
        ("path_m", "path", "m", 1.0),
        ("displacement_m", "displacement", "m", 1.0),
        ("mean_speed_m_s", "mean_speed", "km/h", 3.6),
        ("max_speed_m_s", "max_speed", "km/h", 3.6),
    ] {
        let of = |value: &Value| (value["value"].as_f64().unwrap(), value["std"].as_f64().unwrap());
        let (value, std) = of(&vehicle["travel"][key]);
        assert!(std > 0.0 && std.is_finite(), "{key}");
        assert_eq!(of(&object[key]), (value, std), "run --json {key}");
        let ending = key.strip_prefix(column).unwrap();
        for (row, whose) in [(&table as &dyn Fn(&str) -> String, "vehicles.csv"), (&summary, "summary")] {
            assert_eq!(row(key), format!("{value:.4}"), "{whose} {key}");
            assert_eq!(row(&format!("{column}_std{ending}")), format!("{std:.4}"), "{whose} {key}");
        }
        let said = format!("{} {unit}", with_std(factor * value, factor * std));
        assert!(terminal.contains(&said), "{key}: {said} in\n{terminal}");
        assert!(page.contains(&said), "{key}: {said} on the page");
    }
    for key in ["length_m", "width_m", "height_m"] {
        assert_eq!(object[key], vehicle["dimensions"][key], "{key}");
    }
    let state = vehicle["verdict"]["state"].as_str().unwrap();
    assert!(["good", "fair", "doubtful", "rejected"].contains(&state), "{state}");
    assert_eq!((object["verdict"].as_str(), table("verdict").as_str()), (Some(state), state));
    assert!(terminal.contains(&format!("     {state}. ")), "{terminal}");
    assert!(page.contains(&format!("Explanation\">{state}</a>")), "the badge");
    assert!(vehicle["frames"][0].get("speed").is_none() && vehicle["frames"][0]["speed_m_s"].is_number());
    let old = json(&place.path("out/export/trajectories-v2.json"));
    assert!(old["version"] == 2 && old["objects"][0]["frames"][0].as_object().unwrap()["speed"].is_null());
}

#[test]
fn dates_of_a_log_without_a_zone_are_local_until_it_is_given() {
    let place = Place::new(NUM_FRAMES);
    let mut text = String::new();
    for i in 0..20u32 {
        let (start, end) = (100 * i, 100 * i + 100);
        let [from, to] = [start, end].map(|ms| format!("00:00:{:02},{:03}", ms / 1000, ms % 1000));
        let clock = format!("2024-05-14 10:12:{:02}.{:03}", 30 + start / 1000, start % 1000);
        let place = format!("[latitude: 47.30{i:04}] [longitude: 8.500000] [rel_alt: 3.5 abs_alt: 402.1]");
        writeln!(text, "{}\n{from} --> {to}\n{clock}\n{place}\n", i + 1).unwrap();
    }
    let log = place.path("log.srt");
    fs::write(&log, text).unwrap();
    let log = log.display().to_string();
    let first_date = || {
        export(&place, "csv");
        first_row(&fs::read_to_string(place.path("out/export/trajectories.csv")).unwrap())("date")
    };
    run(&place, &["--telemetry", &log]);
    assert_eq!(first_date(), "2024-05-14T10:12:30");
    run(&place, &["--telemetry", &log, "--utc-offset", "+02:00"]);
    assert_eq!(first_date(), "2024-05-14T08:12:30Z");
}
