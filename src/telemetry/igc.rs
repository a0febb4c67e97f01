//! IGC: flight recorders of gliders and paragliders (FAI, *Technical Specification for GNSS Flight Recorders*).
//!
//! Read: `HFDTE` (date, UTC) and the fixes, `B` records: `B 110135 5206343N 00006198W A 00587 00558`, with time,
//! degrees and thousandths of minutes, validity (`A` for three dimensions), and the barometric and the ellipsoidal
//! height.

use super::coordinate;
use super::fix::{ClockKind, Fix, HeightDatum, Log, Position};
use super::text::check_length;
use super::time::{self, DAY_S};

/// Returns true if a text is an IGC file: a manufacturer's record, and a date or a fix.
pub(super) fn is_igc(text: &str) -> bool {
    text.starts_with('A') && text.lines().take(100).any(|line| line.starts_with("HFDTE") || fix(line, 0).is_ok())
}

/// Reads a text into an empty log.
pub(super) fn read(text: &str, empty: Log) -> Log {
    let mut log = Log { height_datum: HeightDatum::Ellipsoid, ..empty };
    let (mut midnight_s, mut last_s) = (None, 0.0);
    for (line, content) in (1..).zip(text.lines()) {
        if let Some(date) = content.strip_prefix("HFDTE") {
            midnight_s = date_s(date).or(midnight_s);
        } else if content.starts_with('B') {
            match check_length(content).and_then(|()| fix(content, line)) {
                Err(reason) => log.skip_line(line, reason),
                Ok((of_day_s, fix)) => {
                    // A step of half a day backwards is the next day.
                    if of_day_s + 0.5 * DAY_S < last_s {
                        midnight_s = midnight_s.map(|midnight_s| midnight_s + DAY_S);
                    }
                    last_s = of_day_s;
                    log.push("igc", Fix { clock_s: Some(midnight_s.unwrap_or(0.0) + of_day_s), ..fix });
                }
            }
        }
    }
    log.clock = if midnight_s.is_some() { ClockKind::Utc } else { ClockKind::TimeOfDay };
    log
}

/// Midnight of `160701` or `DATE:160701,01` (day, month and year).
fn date_s(text: &str) -> Option<f64> {
    let digits: String = text.chars().filter(char::is_ascii_digit).take(6).collect();
    let part = |at: usize| digits.get(at..at + 2)?.parse::<u32>().ok();
    // Flight recorders have existed since the 1980s.
    let year = part(4)? + if part(4)? < 80 { 2000 } else { 1900 };
    time::civil_s([year, part(2)?, part(0)?, 0, 0, 0], 0.0)
}

/// Time of day and fix of a record.
fn fix(record: &str, line: usize) -> Result<(f64, Fix), String> {
    let number = |from: usize, to: usize| {
        let text = record.get(from..to).filter(|_| record.is_ascii());
        text.and_then(|text| text.trim().parse::<f64>().ok()).ok_or("fix truncated or damaged")
    };
    let letter = |at: usize| record.as_bytes().get(at).copied().unwrap_or_default();
    let of_day_s = 3600.0 * number(1, 3)? + 60.0 * number(3, 5)? + number(5, 7)?;
    let angle = |from: usize, to: usize| Ok::<_, String>(number(from, to)? + number(to, to + 5)? / 60_000.0);
    let sign = |at: usize, minus: u8| if letter(at) == minus { -1.0 } else { 1.0 };
    let (latitude, longitude) = (angle(7, 9)? * sign(14, b'S'), angle(15, 18)? * sign(23, b'W'));
    let position = Position { longitude_deg: longitude, latitude_deg: latitude, resolution_deg: 1.0 / 60_000.0 };
    let is_3d = match letter(24) {
        b'A' => true,
        b'V' => false,
        _ => return Err("fix truncated or damaged".to_owned()),
    };
    // A height of 0 in flight means unknown.
    let height_m = number(30, 35).ok().filter(|height| is_3d && *height != 0.0);
    let fix = Fix { gps_height_m: height_m, ..Fix::at(line, coordinate::checked(position)?) };
    Ok((of_day_s, fix))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fixes_of_two_days_have_dates_and_heights() {
        let text = "AXXXABC FLIGHT:1\r\nHFDTE160701\r\nB2359595206343N00006198WA0058700558\r\n\
                    B0000015206259S00006295EV0059300000\r\nB00000252X\r\nLXXXnote\r\n";
        assert!(is_igc(text) && !is_igc("A first line\nand another\n"));
        let log = read(text, Log::default());
        let first = &log.fixes[0];
        assert!((first.latitude_deg - 52.105_717).abs() < 1e-6 && (first.longitude_deg + 0.1033).abs() < 1e-6);
        assert_eq!((first.gps_height_m, log.fixes[1].gps_height_m, log.num_passed_over), (Some(558.0), None, 1));
        assert_eq!(time::spelled(log.fixes[1].clock_s.unwrap()).unwrap(), "2001-07-17T00:00:01.000");
        assert!(log.fixes[1].latitude_deg < 0.0 && log.clock == ClockKind::Utc);
    }
}
