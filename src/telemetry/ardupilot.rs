//! ArduPilot's log as text (`mavlogdump.py`, Mission Planner): `FMT` lines name the fields of every message.
//!
//! Read: messages `GPS` with `Status` (3 and more is a fix in three dimensions), `GMS` and `GWk` (milliseconds and week
//! of GPS time), `Lat`, `Lng`, `Alt` (above sea level), `Spd`, `HDop`.

use super::coordinate;
use super::fix::{ClockKind, Fix, HeightDatum, Log, Receiver};
use super::text::{check_length, number};
use super::time::DAY_S;

/// Fields of logs without an `FMT` line.
const FIELDS: &str = "TimeUS,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd";

/// GPS time began 3,657 days after 1970, and is ahead of UTC by the 18 leap seconds since (the last one in 2017).
const GPS_EPOCH_S: f64 = 315_964_800.0 - 18.0;

/// Returns true if a line is an ArduPilot message.
pub(super) fn is_message(line: &str) -> bool {
    line.starts_with("FMT, ") || (line.starts_with("GPS, ") && line.split(',').count() > 8)
}

/// Reads a text into an empty log.
pub(super) fn read(text: &str, empty: Log) -> Log {
    let mut log = Log { clock: ClockKind::Utc, height_datum: HeightDatum::SeaLevel, ..empty };
    let mut fields: Vec<String> = FIELDS.split(',').map(str::to_owned).collect();
    for (line, content) in (1..).zip(text.lines()) {
        let mut cells = content.split(',').map(str::trim);
        match cells.next() {
            // FMT, 130, 45, GPS, BIHBcLLeff, Status,TimeMS,...
            Some("FMT") if cells.nth(2) == Some("GPS") => {
                fields = cells.skip(1).map(str::to_owned).collect();
            }
            Some("GPS") => {
                let cells: Vec<&str> = cells.collect();
                match check_length(content).and_then(|()| fix(&fields, &cells, line)) {
                    Err(reason) => log.skip_line(line, reason),
                    Ok(fix) => log.push("ardupilot", fix),
                }
            }
            _ => {}
        }
    }
    log
}

fn fix(fields: &[String], cells: &[&str], line: usize) -> Result<Fix, String> {
    let text = |name: &str| fields.iter().position(|field| field == name).and_then(|at| cells.get(at)).copied();
    let value = |name: &str| text(name).and_then(number);
    let receiver = match value("Status").unwrap_or(3.0) as u32 {
        0 | 1 => return Err("the receiver had no fix".to_owned()),
        4 => Receiver::Differential,
        5 => Receiver::RtkFloat,
        6 => Receiver::RtkFixed,
        _ => Receiver::Plain,
    };
    let position = coordinate::position(text("Lng").unwrap_or_default(), text("Lat").unwrap_or_default())?;
    let of_week = value("GMS").or_else(|| value("TimeMS")).map(|ms| 1e-3 * ms);
    let week = value("GWk").or_else(|| value("Week")).filter(|week| *week > 0.0);
    Ok(Fix {
        clock_s: week.zip(of_week).map(|(week, of_week_s)| GPS_EPOCH_S + week * 7.0 * DAY_S + of_week_s),
        gps_height_m: value("Alt"),
        speed_m_s: value("Spd"),
        ..Fix::at(line, position).received_by(receiver, value("HDop"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::telemetry::time;

    #[test]
    fn format_lines_name_the_fields() {
        let log = read(
            "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\n\
             FMT, 130, 50, GPS, QBIHBcLLeff, TimeUS,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd\n\
             GPS, 1000, 3, 565524000, 2312, 12, 0.9, 12.3450000, -34.5670000, 220.5, 9.1\n\
             GPS, 1200, 1, 565524200, 2312, 12, 0.9, 12.345, -34.567, 220.5, 9.1\nATT, 1, 2\n",
            Log::default(),
        );
        let fix = &log.fixes[0];
        assert_eq!((fix.latitude_deg, fix.gps_height_m, fix.speed_m_s), (12.345, Some(220.5), Some(9.1)));
        assert_eq!(time::spelled(fix.clock_s.unwrap()).unwrap(), "2024-05-04T13:05:06.000");
        assert_eq!((log.fixes.len(), log.num_passed_over), (1, 1));
        assert!(is_message("FMT, 128, 89, FMT, BBnNZ, Type") && !is_message("GPS, 1"));
    }
}
