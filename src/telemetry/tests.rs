//! Hostile input: no panic, termination, and problems reported with their line.

use std::path::Path;

use proptest::prelude::*;

use super::fix::Room;
use super::gpmf::made;
use super::*;
use crate::memory::MemoryLimit;
use crate::scene::Timed;

/// One file of each format, written by hand.
const SEEDS: [&str; 14] = [
    "1\n00:00:00,000 --> 00:00:00,033\n<font size=\"36\">SrtCnt : 1, DiffTime : 33ms\n2022-08-07 13:40:40,774,808\n\
     [iso : 100] [latitude: 41.424724] [longitude: 2.234156] [altitude: 117.0] </font>\n\n2\n00:00:00,033 --> \
     00:00:00,066\n2022-08-07 13:40:40,808,164\n[latitude: 41.424725] [longitude: 2.234147] [rel_alt: 1.0 \
     abs_alt: 2.5]\n",
    "1\n00:00:01,000 --> 00:00:02,000\nHOME(149.0251,-20.2532) 2017.08.05 14:11:51\nGPS(149.0251,-20.2533,16) \
     BAROMETER:1.9\nISO:100\n\n2\n00:00:02,000 --> 00:00:03,000\nGPS(149.0251,-20.2533,16) Hb:1.9 Hs:1.9\n",
    "1\n00:00:00,000 --> 00:00:01,000\n2022.06.21 16:06:17\nGPS(36.6146,-6.1120,0.0M) BAROMETER:0.3M\n",
    "1\n00:00:00,000 --> 00:00:01,000\nF/5.6, SS 400, GPS (-58.8, -34.2, 15), HOME (-58.8, -34.2, -57.98m), D 6.7m, \
     H 85.8m, H.S 2.8m/s, V.S 0.0m/s, F.PRY (2.7\u{b0}, -7.0\u{b0}, 110.1\u{b0}), G.PRY (-24.4\u{b0}, \
     0.0\u{b0}, 1.4\u{b0})\n",
    "<?xml version=\"1.0\"?><gpx version=\"1.1\"><trk><trkseg><trkpt lat=\"48.1\" lon=\"9.7\"><ele>5</ele>\
     <time>2024-05-06T07:08:09Z</time></trkpt><trkpt lat=\"48.2\" \
     lon=\"9.8\"><time>2024-05-06T07:08:10+00:00</time></trkpt></trkseg></trk></gpx>",
    "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\n$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,\
     084.4,230394,003.1,W\n",
    "time_s,latitude,longitude,altitude [ft],speed(km/h)\n0.0,48.5,9.25,1000,36\n1.0,48.5001,9.25,1001,37\n",
    "timestamp;lat;lon;\"height_m\"\n2022-08-07T13:40:40Z;48\u{b0}30'0\"N;9.25E;3\n",
    "<kml><gx:Track><altitudeMode>absolute</altitudeMode><when>2024-05-04T13:05:06Z</when><when>2024-05-04T13:05:07Z\
     </when><gx:coord>-34.5 12.2 5</gx:coord><gx:coord>-34.6 12.3 6</gx:coord></gx:Track></kml>",
    "AXXXABC\r\nHFDTE160701\r\nB1101355206343N00006198WA0058700558\r\nB1101365206343N00006199WA0058700558\r\n",
    "FMT, 130, 50, GPS, QBIHBcLLeff, TimeUS,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd\nGPS, 1, 3, 565524000, 2312, \
     12, 0.9, 12.3, -34.5, 220.5, 9.1\n",
    "[Script Info]\nDialogue: 0,0:00:00.00,0:00:01.00,Default,,0,0,0,,HOME(-34.5, 12.3) 2024.5.4 13:05:06\\NGPS(W: \
     -34.5, N: 12.3, 100) ReH:20 \\NISO:100\n",
    "EPSG:4326\n000000.jpg -34.567 12.345 220.0 34.4 -45.0 0.0 1.5 3.0\n000001.jpg -34.568 12.346 220.5\n",
    "sep=,\nCUSTOM.date [local],CUSTOM.updateTime [local],OSD.flyTime,OSD.flyTime [s],OSD.latitude,OSD.longitude,\
     OSD.height [ft]\n5/4/2024,1:05:06.00 PM,0m 0.0s,0.0,12.345,-34.567,65.6\n",
];

fn read_text(bytes: &[u8]) -> Result<Log, TelemetryError> {
    read_bytes(bytes, Path::new("any log"))
}

/// Checks the properties of every log, for any format.
fn check(log: &Log) {
    assert!(!log.fixes.is_empty());
    for fix in &log.fixes {
        assert!(fix.longitude_deg.abs() <= 180.0 && fix.latitude_deg.abs() <= 90.0, "{fix:?}");
        let numbers = [fix.video_s, fix.clock_s, fix.gps_height_m, fix.relative_height_m, fix.speed_m_s];
        assert!(numbers.into_iter().flatten().all(f64::is_finite), "{fix:?}");
        assert!(fix.horizontal_std_m > 0.0 && fix.vertical_std_m > 0.0 && fix.resolution_deg > 0.0, "{fix:?}");
    }
    let summary = log.summary();
    let json = serde_json::to_string(&summary).unwrap();
    let said = format!("{json}{}", summary.as_text());
    // JSON has no representation of non-finite numbers.
    assert!(!said.contains("NaN") && !said.contains(" inf"), "{said}");
}

#[test]
fn every_seed_is_parsed() {
    for (seed, expected) in SEEDS.iter().zip([2, 2, 1, 1, 2, 1, 2, 1, 2, 2, 1, 1, 2, 1]) {
        let log = read_text(seed.as_bytes()).unwrap();
        check(&log);
        assert_eq!((log.fixes.len(), log.num_passed_over), (expected, 0), "{seed}: {log:?}");
    }
}

#[test]
fn a_log_without_duration_has_no_rate() {
    let log = read_text(
        b"1\n00:00:00,000 --> 00:00:00,033\n[latitude: 41.424724] [longitude: 2.234156]\n\n2\n00:00:00,1e-320 --> \
          00:00:02,000\n[latitude: 41.424725] [longitude: 2.234147]\n",
    )
    .unwrap();
    check(&log);
    assert_eq!((log.fixes.len(), log.summary().rate_hz), (2, None));
}

#[test]
fn a_truncated_file_is_read_up_to_its_end() {
    for seed in SEEDS {
        let whole = read_text(seed.as_bytes()).unwrap().fixes.len();
        for end in 0..seed.len() {
            if let Ok(log) = read_text(&seed.as_bytes()[..end]) {
                check(&log);
                assert!(log.fixes.len() <= whole, "{end}: {seed}");
            }
        }
    }
}

#[test]
fn logs_of_other_programs_are_refused_with_the_converter() {
    let said = |bytes: &[u8]| read_text(bytes).unwrap_err().to_string();
    assert!(said(b"\x0e\x10\x43\x08\0\0\0\0.FIT\0\0").contains("gpsbabel -i garmin_fit"));
    assert!(said(b"<?xml?><TrainingCenterDatabase/>").contains("gpsbabel -i gtrnctr"));
    assert!(said(b"$PMGNTRK,4322.061,N,07948.473,W,00116,M,173949,A,,020602*67\n").contains("gpsbabel -i magellan"));
    assert!(said(b"PK\x03\x04doc.kml").contains("unpack"));
    assert!(said(b"ULog\x01\x12\x35\x01").contains("ulog2csv"));
    assert!(said(&[0xa3, 0x95, 0x80, 0x80]).contains("mavlogdump.py"));
    assert!(said(b"EPSG:32632\na.jpg 500000.0 5200000.0 100\n").contains("gdaltransform"));
}

#[test]
fn other_files_are_refused_with_a_remedy() {
    let said = |bytes: &[u8]| read_text(bytes).unwrap_err().to_string();
    assert!(said(b"").contains("empty") && said(b" \r\n\n").contains("empty"));
    assert!(said(b"hello").contains("docs/telemetry.md"));
    assert!(said(&[0, 159, 146, 150]).contains("docs/telemetry.md"));
    let camera_only = "1\n00:00:00,000 --> 00:00:00,039\n[iso : 100] [shutter : 1/240.0] [ct : 5627] </font>\n";
    assert!(said(camera_only.as_bytes()).contains("line 3: block with camera settings only"));
    assert!(said(b"lat,lon\n0,0\n").contains("line 2: position (0, 0)"));
    assert!(said(&[0xff, 0xd8, 0xff, 0xe1]).contains("photograph"));
    assert!(read(Path::new("no such file")).unwrap_err().to_string().contains("no such file"));
}

#[test]
fn tracks_in_another_order_are_sorted_and_zeros_at_the_end_of_numbers_count() {
    let point = |second: usize, longitude: &str| {
        format!("<trkpt lat='4.512345' lon='{longitude}'><time>2024-05-04T13:05:{second:02}Z</time></trkpt>")
    };
    let newest_first = [point(9, "9.123456"), point(8, "9.12"), point(7, "9.123455")].concat();
    let log = read_text(format!("<gpx>{newest_first}</gpx>").as_bytes()).unwrap();
    assert_eq!(log.fixes.iter().map(|fix| fix.clock_s.unwrap() % 60.0).collect::<Vec<_>>(), [7.0, 8.0, 9.0]);
    assert!(log.fixes.iter().all(|fix| (fix.resolution_deg - 1e-6).abs() < 1e-12), "{log:?}");
}

#[test]
fn a_megabyte_on_one_line_costs_that_line() {
    let long = "9".repeat(1 << 20);
    let log = read_text(format!("{}\n3\n{long}\n", SEEDS[1]).as_bytes()).unwrap();
    assert_eq!(log.fixes.len(), 2);
    assert!(log.passed_over[0].line > 9 && log.passed_over[0].reason.contains("1048576"), "{:?}", log.passed_over);
    let log = read_text(format!("{}2.0,{long},1\n", SEEDS[6]).as_bytes()).unwrap();
    assert!(log.passed_over[0].line == 4 && log.passed_over[0].reason.contains("1048576"), "{:?}", log.passed_over);
    let log = read_text(format!("{}{long}\n", SEEDS[5]).as_bytes()).unwrap();
    assert_eq!((log.fixes.len(), log.num_passed_over), (1, 1));
}

#[test]
fn reasons_do_not_fill_the_memory() {
    let mut text = SEEDS[6].to_owned();
    (0..10_000).for_each(|_| text.push_str("x,y,z\n"));
    let log = read_text(text.as_bytes()).unwrap();
    assert_eq!((log.num_passed_over, log.passed_over.len()), (10_000, 100));
}

#[test]
fn positions_do_not_fill_the_memory() {
    let folder = tempfile::tempdir().unwrap();
    let limit: MemoryLimit = "64MiB".parse().unwrap();
    let most = Room::within(limit).most;
    assert!(most < 100_000, "{most}");
    let csv = |number| "time_s,latitude,longitude\n".to_owned() + &"0,4,9\n".repeat(number);
    let gpx = |number| format!("<gpx><trk>{}</trk></gpx>", "<trkpt lat='4' lon='9'/>".repeat(number));
    let sentence = |k: usize| {
        let (hours, minutes, seconds) = (k / 3600, k / 60 % 60, k % 60);
        format!("$GPGGA,{hours:02}{minutes:02}{seconds:02},4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,\n")
    };
    let nmea = |number| (0..number).map(sentence).collect::<String>();
    let srt = |number| "00:00:00,000 --> 00:00:01,000\nGPS(36.6146,-6.1120,0.0M) BAROMETER:0.3M\n\n".repeat(number);
    let formats: [&dyn Fn(usize) -> String; 4] = [&csv, &gpx, &nmea, &srt];
    for (k, text) in formats.into_iter().enumerate() {
        let path = folder.path().join(k.to_string());
        std::fs::write(&path, text(most + 1)).unwrap();
        let error = read_within(&path, limit).unwrap_err();
        assert!(
            matches!(&error, TelemetryError::TooMany { .. }) && error.to_string().contains("--memory-limit"),
            "{error}"
        );
        assert!(read_within(&path, MemoryLimit::of_machine()).is_ok(), "{k}");
    }
    std::fs::write(folder.path().join("large"), csv(4 << 20)).unwrap();
    let error = read_within(&folder.path().join("large"), limit).unwrap_err();
    assert!(matches!(error, TelemetryError::TooLarge { .. }), "{error}");
}

#[test]
fn camera_telemetry_respects_the_memory_limit_and_reports_missing_data() {
    let limit: MemoryLimit = "64MiB".parse().unwrap();
    let path = Path::new("a.mp4");
    let refused = |seconds: &[Vec<u8>]| read_gpmf(&made::payloads(seconds), &[], path, limit).unwrap_err().to_string();
    // Gravity samples are as small as six bytes.
    let gravity = made::entry(b"GRAV", b's', 6, &[0, 1].repeat(3 * 65_000));
    let streams = [made::nest(b"STRM", &[]), [b"STRM\0\xff\xff\xff".to_vec(), gravity].concat()];
    let second = [b"DEVC\0\xff\xff\xff".to_vec(), streams.concat()].concat();
    assert!(refused(&[second.clone(), second]).contains("raise --memory-limit"));
    assert_eq!(refused(&[made::hero(0, 0)]), "a.mp4: GPMF without any position; line 1: the receiver had no fix");
    assert_eq!(refused(&[]), "a.mp4: GPMF without any position");
    let cut = [b"DEVC".to_vec(), vec![0; 4]].concat();
    assert!(read_text(&cut).unwrap_err().to_string().contains("GPMF without any position"));
    let said = read_text(&made::max(0)).unwrap().summary().as_text();
    assert!(said.contains("gpmf-gps5 (2)") && said.contains("1.000 to 2.000 ms"), "{said}");
}

#[test]
fn a_clock_that_jumps_costs_the_fixes_that_it_dates_wrong() {
    let rows = ["2.0,48.5,9.2,1,1", "900.0,48.5,9.2,1,1", "3.0,48.5,9.2,1,1", "4.0,48.5,9.2,1,1"];
    let log = read_text(format!("{}{}\n", SEEDS[6], rows.join("\n")).as_bytes()).unwrap();
    assert_eq!(log.fixes.iter().map(|fix| fix.video_s.unwrap()).collect::<Vec<_>>(), [0.0, 1.0, 2.0, 3.0, 4.0]);
    assert!(log.passed_over[0].line == 5 && log.passed_over[0].reason.contains("clock"), "{:?}", log.passed_over);
}

#[test]
fn the_track_of_a_video_reads_like_its_file() {
    let text = SEEDS[0];
    let mut entries = Vec::new();
    srt::blocks(text, |block| {
        let block = block.unwrap();
        let (start_s, end_s) = (block.start_s.unwrap(), f64::NAN);
        entries.push(Timed { start_s, end_s, content: block.lines.join("\r\n ") });
    });
    let mut from_track = read_subtitles(&entries, Path::new("a.mp4")).unwrap();
    let from_file = read_text(text.as_bytes()).unwrap();
    for (number, (of_track, of_file)) in (1..).zip(from_track.fixes.iter_mut().zip(&from_file.fixes)) {
        assert_eq!(std::mem::replace(&mut of_track.line, of_file.line), number);
    }
    assert_eq!(from_track, from_file);
    let error = read_subtitles(&[], Path::new("a.mp4")).unwrap_err().to_string();
    assert!(error.contains("a.mp4"), "{error}");
}

#[test]
fn positions_in_another_encoding_are_read() {
    let utf16: Vec<u8> = [0xff, 0xfe].into_iter().chain(SEEDS[3].encode_utf16().flat_map(u16::to_le_bytes)).collect();
    assert_eq!(read_text(&utf16).unwrap().fixes, read_text(SEEDS[3].as_bytes()).unwrap().fixes);
    let latin: Vec<u8> = SEEDS[3].chars().map(|c| c as u8).collect();
    assert_eq!(read_text(&latin).unwrap().fixes, read_text(SEEDS[3].as_bytes()).unwrap().fixes);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 400, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn damaged_files_never_panic(
        which in 0..SEEDS.len(),
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..4u8), 1..12),
    ) {
        let mut bytes = SEEDS[which].as_bytes().to_vec();
        for (at, byte, change) in changes {
            let at = at.index(bytes.len().max(1)).min(bytes.len());
            match change {
                0 if at < bytes.len() => bytes[at] = byte,
                1 if at < bytes.len() => { bytes.remove(at); }
                2 => bytes.insert(at, byte),
                _ => { let copy = bytes[..at].to_vec(); bytes.extend(copy.into_iter().rev().take(40).rev()); }
            }
        }
        if let Ok(log) = read_text(&bytes) {
            check(&log);
        }
    }

    #[test]
    fn damaged_telemetry_of_a_camera_never_panics(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>(), 0..4u8), 1..12),
        span in (any::<f32>(), any::<f32>()),
    ) {
        let mut seconds = [made::max(0), made::hero(1, 3), made::max(2), made::settings()];
        for (at, byte, change) in changes {
            let which = at.index(seconds.len());
            let bytes = &mut seconds[which];
            let at = at.index(bytes.len().max(1)).min(bytes.len());
            match change {
                0 if at < bytes.len() => bytes[at] = byte,
                1 => bytes.truncate(at),
                2 => bytes.insert(at, byte),
                _ => { let copy = bytes[at..].to_vec(); bytes.extend(copy); }
            }
        }
        let [.., settings] = &seconds;
        let mut payloads = made::payloads(&seconds[..3]);
        (payloads[1].start_s, payloads[1].end_s) = (f64::from(span.0), f64::from(span.1));
        let path = Path::new("any video");
        let of_track = read_gpmf(&payloads, settings, path, MemoryLimit::of_machine());
        [of_track, read_text(&seconds.concat())].iter().flatten().for_each(check);
    }

    #[test]
    fn numbers_of_any_size_never_panic(which in 0..SEEDS.len(), numbers in prop::collection::vec(any::<f64>(), 1..8)) {
        let mut numbers = numbers.into_iter().cycle();
        let mut text = String::new();
        for (i, part) in SEEDS[which].split(char::is_numeric).enumerate() {
            text.push_str(part);
            // Replaces every third number.
            let number = numbers.next().filter(|_| i % 3 == 0);
            text.push_str(&number.map_or("1".to_owned(), |number| number.to_string()));
        }
        if let Ok(log) = read_text(text.as_bytes()) {
            check(&log);
        }
    }
}
