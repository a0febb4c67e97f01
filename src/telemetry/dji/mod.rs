//! Drone subtitle files of DJI and Autel: a registry of dialects, recognized by the content of a block.
//!
//! A drone can write another dialect after an update, and one dialect is written by many drones. The dialect is
//! therefore recognized per block, and a file may change its dialect midway. A new dialect is a row of [`DIALECTS`].

mod brackets;
mod calls;
mod letters;
mod words;

use super::fix::{Fix, Log};
use super::srt::Subtitle;
use super::summary::Range;
use super::time;

/// Subtitle dialect of a drone.
pub(super) struct Dialect {
    /// Its name in reports and documents.
    pub(super) name: &'static str,
    /// Returns true if the text of a block (its lines joined by blanks) is of this dialect.
    pub(super) recognizes: fn(&str) -> bool,
    /// Reads the fix of such a text.
    ///
    /// # Errors
    /// The reason for a missing fix.
    pub(super) read: fn(&str, usize) -> Result<Fix, String>,
}

/// All dialects; the first that recognizes a block reads it.
pub(super) const DIALECTS: [Dialect; 9] = [
    Dialect { name: "autel", recognizes: letters::recognizes, read: letters::read },
    Dialect { name: "dji-brackets-two-heights", recognizes: brackets::has_two_heights, read: brackets::read },
    Dialect { name: "dji-brackets-altitude", recognizes: brackets::has_altitude, read: brackets::read },
    Dialect { name: "dji-brackets-no-height", recognizes: brackets::has_position, read: brackets::read },
    Dialect { name: "dji-brackets-camera-only", recognizes: brackets::is_camera, read: brackets::no_position },
    Dialect { name: "dji-gps-words", recognizes: words::recognizes, read: words::read },
    Dialect { name: "dji-gps-hb-hs", recognizes: calls::is_hb_hs, read: calls::read_longitude_first },
    Dialect { name: "dji-gps-latitude-first", recognizes: calls::is_latitude_first, read: calls::read_latitude_first },
    Dialect { name: "dji-gps-barometer", recognizes: calls::is_barometer, read: calls::read_longitude_first },
];

/// Recognizes the dialect of a text.
pub(super) fn recognize(text: &str) -> Option<&'static Dialect> {
    DIALECTS.iter().find(|dialect| (dialect.recognizes)(text))
}

/// Reads one block into the log.
pub(super) fn read_block(block: &Subtitle, log: &mut Log) {
    let text = block.lines.join(" ");
    if let Some(focal_mm) = brackets::film_focal_mm(&text) {
        log.film_focal_mm = Some(Range::with(log.film_focal_mm, focal_mm));
    }
    match recognize(&text) {
        None if text.is_empty() => log.skip_line(block.line, "block truncated after its time"),
        None => log.skip_line(block.line, "block of unknown dialect, or truncated"),
        Some(dialect) => match (dialect.read)(&text, block.line) {
            Err(reason) => log.skip_line(block.line, reason),
            Ok(fix) => {
                let clock_s = clock_s(&block.lines);
                log.push(dialect.name, Fix { video_s: block.start_s, clock_s, ..fix });
            }
        },
    }
}

/// Date and time of a block: at the start of a line, or before `HOME(...)`.
fn clock_s(lines: &[&str]) -> Option<f64> {
    lines.iter().find_map(|line| {
        let after_home = line.starts_with("HOME").then(|| line.split_once(')')).flatten().map(|(_, after)| after);
        time::spelled_s(after_home.unwrap_or(line))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fix(lines: &[&str]) -> (Fix, &'static str) {
        let mut log = Log::default();
        let block = Subtitle { line: 3, start_s: Some(1.5), lines: lines.to_vec() };
        read_block(&block, &mut log);
        assert_eq!(log.num_passed_over, 0, "{:?}", log.passed_over);
        let fix = log.fixes.remove(0);
        (fix.clone(), fix.dialect)
    }

    fn reason(lines: &[&str]) -> String {
        let mut log = Log::default();
        read_block(&Subtitle { line: 3, start_s: None, lines: lines.to_vec() }, &mut log);
        assert!(log.fixes.is_empty(), "{:?}", log.fixes);
        log.passed_over.remove(0).reason
    }

    fn place(fix: &Fix) -> (f64, f64, Option<f64>, Option<f64>) {
        (fix.longitude_deg, fix.latitude_deg, fix.gps_height_m, fix.relative_height_m)
    }

    #[test]
    fn brackets_with_two_heights_and_a_gimbal() {
        let (found, dialect) = fix(&[
            "<font size=\"28\">FrameCnt: 9, DiffTime: 16ms",
            "2025-03-04 10:20:30.250",
            "[iso: 100] [shutter: 1/640.0] [latitude: 48.100001] [longitude: -9.250002] [rel_alt: 12.500 abs_alt: \
             402.125] [gb_yaw: 90.0 gb_pitch: -45.0 gb_roll: 0.0] [ct: 5500] </font>",
        ]);
        assert_eq!(dialect, "dji-brackets-two-heights");
        assert_eq!(place(&found), (-9.250002, 48.100001, Some(402.125), Some(12.5)));
        assert_eq!((found.line, found.video_s), (3, Some(1.5)));
        assert_eq!(time::spelled(found.clock_s.unwrap()).unwrap(), "2025-03-04T10:20:30.250");
        assert!((found.gimbal.unwrap().yaw - 90f64.to_radians()).abs() < 1e-12);
        assert!((found.gimbal.unwrap().pitch + 45f64.to_radians()).abs() < 1e-12);
        assert!((found.resolution_deg - 1e-6).abs() < 1e-18);
    }

    #[test]
    fn brackets_with_one_altitude_and_a_misspelt_longitude() {
        let (found, dialect) = fix(&[
            "<font size=\"36\">SrtCnt : 1, DiffTime : 33ms",
            "2021-02-03 04:05:06,789,123",
            "[iso : 100] [latitude : -34.5] [longtitude : -57.25] [altitude: 74.725998] </font>",
        ]);
        assert_eq!(dialect, "dji-brackets-altitude");
        assert_eq!(place(&found), (-57.25, -34.5, None, Some(74.725998)));
    }

    #[test]
    fn focal_lengths_are_those_of_film() {
        let read = |blocks: &[&str]| {
            let mut log = Log::default();
            blocks
                .iter()
                .for_each(|text| read_block(&Subtitle { line: 3, start_s: None, lines: vec![text] }, &mut log));
            log.film_focal_mm.map(|Range { least, most }| (least, most))
        };
        let place = "[latitude: 48.1] [longitude: 9.2]";
        for (text, expected) in [("[focal_len: 24.00]", 24.0), ("[focal_len : 240]", 24.0), ("[focal_len: 162]", 16.2)]
        {
            assert_eq!(read(&[&format!("[iso: 100] {text} {place}")]), Some((expected, expected)), "{text}");
        }
        let zoomed = [format!("[focal_len: 24.00] {place}"), "[iso: 100] [focal_len: 48.00]".to_owned()];
        assert_eq!(read(&zoomed.each_ref().map(String::as_str)), Some((24.0, 48.0)));
        for text in ["[focal_len: 0.00]", "[focal_len: ]", "[iso: 100]", "[focal_len: nan]", "[focal_len: -24.00]"] {
            assert_eq!(read(&[text]), None, "{text}");
        }
    }

    #[test]
    fn brackets_without_a_height() {
        let (found, dialect) =
            fix(&["2017.08.05 14:11:51,393,525,393,525", "[latitude : -20.25] [longtitude : 149.02] [iso : 100]"]);
        assert_eq!((dialect, place(&found)), ("dji-brackets-no-height", (149.02, -20.25, None, None)));
        assert!((found.clock_s.unwrap() % 60.0 - 51.393_525).abs() < 1e-5);
    }

    #[test]
    fn home_gps_and_barometer_with_the_longitude_first() {
        let (found, dialect) = fix(&[
            "HOME(149.0251,-20.2532) 2017.08.05 14:11:51",
            "GPS(149.0253,-20.2534,16) BAROMETER:1.9",
            "ISO:100 Shutter:60 EV: Fnum:2.2",
        ]);
        assert_eq!((dialect, place(&found)), ("dji-gps-barometer", (149.0253, -20.2534, None, Some(1.9))));
        assert_eq!(time::spelled(found.clock_s.unwrap()).unwrap(), "2017-08-05T14:11:51.000");
    }

    #[test]
    fn hb_and_hs_are_heights_by_air_pressure_and_by_sound() {
        let (found, dialect) = fix(&["HOME(1.5,2.5) 2017.8.5 14:11:51", "GPS(1.25,2.75,16) Hb:1.9 Hs:1.7"]);
        assert_eq!((dialect, place(&found)), ("dji-gps-hb-hs", (1.25, 2.75, None, Some(1.9))));
    }

    #[test]
    fn the_latitude_comes_first_where_the_third_number_is_a_height() {
        let (found, dialect) = fix(&["2022.06.21 16:06:17", "GPS(36.6146,-6.1120,0.0M) BAROMETER:0.3M"]);
        assert_eq!((dialect, place(&found)), ("dji-gps-latitude-first", (-6.112, 36.6146, None, Some(0.3))));
        let (found, dialect) = fix(&["GPS(39.5,116.25,69.800) BAROMETER(91.2) HOME(39.5,116.25)"]);
        assert_eq!((dialect, place(&found)), ("dji-gps-latitude-first", (116.25, 39.5, Some(69.8), Some(91.2))));
    }

    #[test]
    fn letters_give_the_signs_that_numbers_lack() {
        let found = |gps: &str| {
            let (found, dialect) = fix(&["HOME(-34.5, 12.3) 2024.5.4 13:05:06", &format!("{gps} ReH:20 ")]);
            assert_eq!((dialect, found.clock_s.is_some()), ("autel", true));
            place(&found)
        };
        let expected = (-34.567, 12.345, None, Some(20.0));
        assert_eq!(found("GPS(W: -34.567, N: 12.345, 100)"), expected);
        assert_eq!(found("GPS(N: 12.345, W: 34.567, 100)"), expected);
        assert!(reason(&["GPS(N: 12.345, N: 34.567, 100)"]).contains("longitude missing"));
    }

    #[test]
    fn words_with_speeds_and_attitudes() {
        let (found, dialect) = fix(&[
            "F/5.6, SS 400, ISO 100, EV 0, GPS (-58.851745, -34.237922, 15), HOME (-58.847509, -34.232707, -57.98m), \
             D 698.70m, H 85.80m, H.S 2.88m/s, V.S 0.00m/s, F.PRY (2.7°, -7.0°, 110.1°), G.PRY (-24.4°, 0.0°, 110.4°)",
        ]);
        assert_eq!((dialect, place(&found)), ("dji-gps-words", (-58.851745, -34.237922, None, Some(85.8))));
        assert_eq!(found.speed_m_s, Some(2.88));
        assert!((found.gimbal.unwrap().yaw - 110.4f64.to_radians()).abs() < 1e-12);
        assert!((found.attitude.unwrap().roll + 7f64.to_radians()).abs() < 1e-12);
        let (found, _) =
            fix(&["F/2.8, SS 30.15, ISO 260, EV -1.7, GPS (-121.7458, 48.0771, 17), D 221.21m, H 200.70m, \
                                H.S n/a, V.S n/a"]);
        assert_eq!((found.speed_m_s, found.relative_height_m, found.gimbal), (None, Some(200.7), None));
    }

    #[test]
    fn blocks_without_a_fix_have_a_reason() {
        assert!(reason(&["2018-02-19 08:04:51,265,847", "[iso : 100] [ct : 5627]"]).contains("camera settings only"));
        assert!(reason(&["[latitude: 0.000000] [longitude: 0.000000] [rel_alt: 0 abs_alt: 0]"]).contains("(0, 0)"));
        assert!(reason(&["[iso : 100] [latitude: 1.5] [longit"]).contains("longitude"));
        assert!(reason(&["[latitude: 1.5] [longitude: 9.123"]).contains("truncated"));
        assert!(reason(&["GPS(149.0253,-20.25"]).contains("unknown dialect"));
        assert!(reason(&["GPS(149.0253,-20.25 BAROMETER:1.9"]).contains("GPS"));
        assert!(reason(&[]).contains("truncated"));
        assert!(reason(&["hello"]).contains("unknown dialect"));
    }
}
