//! CSV with a header that names its columns; `docs/telemetry.md` lists the names.
//!
//! Names are compared without regard to case, blanks, `_` and `-`. A unit stands in brackets (`altitude [ft]`,
//! `speed(mph)`) or behind the last `_` (`height_m`, `time_ms`). Columns of other names are not looked at.

use std::path::Path;

use super::coordinate;
use super::error::TelemetryError;
use super::fix::{Angles, ClockKind, Fix, Log, Receiver};
use super::text::{check_length, number, shown};
use super::time;

/// The name in reports.
pub(super) const DIALECT: &str = "csv";

/// Quantity of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Column {
    Longitude,
    Latitude,
    VideoTime,
    Clock,
    GpsHeight,
    RelativeHeight,
    HorizontalStd,
    VerticalStd,
    Speed,
    Receiver,
    Yaw,
    Pitch,
    Roll,
    GimbalYaw,
    GimbalPitch,
    GimbalRoll,
}

/// Names of columns without blanks, `_` and `-`. Where several columns of a file mean the same, the first counts.
const NAMES: [(Column, &[&str]); 16] = [
    (Column::Longitude, &["longitude", "lon", "lng", "long"]),
    (Column::Latitude, &["latitude", "lat"]),
    (Column::VideoTime, &["time", "videotime", "elapsed", "elapsedtime", "t"]),
    (Column::Clock, &["utc", "datetime", "timestamp", "date", "clock", "datetimeutc", "timeutc", "utctime"]),
    (
        Column::GpsHeight,
        &["gpsheight", "altitude", "alt", "ele", "elevation", "altitudeabovesealevel", "absalt", "gpsaltitude"],
    ),
    (
        Column::RelativeHeight,
        &["relativeheight", "height", "relalt", "heightabovetakeoff", "relativealtitude", "barometricheight"],
    ),
    (Column::HorizontalStd, &["horizontalstd", "horizontalaccuracy", "hacc", "accuracy"]),
    (Column::VerticalStd, &["verticalstd", "verticalaccuracy", "vacc"]),
    (Column::Speed, &["speed", "groundspeed", "horizontalspeed"]),
    (Column::Receiver, &["fix", "fixtype", "receiver"]),
    (Column::Yaw, &["yaw", "heading", "compassheading"]),
    (Column::Pitch, &["pitch"]),
    (Column::Roll, &["roll"]),
    (Column::GimbalYaw, &["gimbalyaw", "gimbalheading"]),
    (Column::GimbalPitch, &["gimbalpitch"]),
    (Column::GimbalRoll, &["gimbalroll"]),
];

/// Units and what one of them is in metres, seconds, metres per second or degrees.
const UNITS: [(&str, f64); 21] = [
    ("m", 1.0),
    ("meter", 1.0),
    ("meters", 1.0),
    ("metres", 1.0),
    ("ft", 0.3048),
    ("feet", 0.3048),
    ("km", 1000.0),
    ("s", 1.0),
    ("sec", 1.0),
    ("seconds", 1.0),
    ("ms", 1e-3),
    ("millisecond", 1e-3),
    ("milliseconds", 1e-3),
    ("us", 1e-6),
    ("mps", 1.0),
    ("m/s", 1.0),
    ("km/h", 1.0 / 3.6),
    ("kmh", 1.0 / 3.6),
    ("mph", 0.447_04),
    ("deg", 1.0),
    ("degrees", 1.0),
];

/// A column of the file that is understood.
#[derive(Clone, Copy, Debug)]
struct KnownColumn {
    column: Column,
    index: usize,
    /// Factor from its numbers to meters, seconds, meters per second or degrees.
    unit: f64,
}

/// Returns true if a line can be the header of a table of fixes.
pub(super) fn is_header(line: &str) -> bool {
    let places = places(line.split(delimiter(line)));
    has(&places, Column::Longitude) && has(&places, Column::Latitude)
}

/// Reads a text into an empty log.
///
/// # Errors
/// [`TelemetryError::Header`] if a unit of the header is unknown.
pub(super) fn read(text: &str, path: &Path, empty: Log) -> Result<Log, TelemetryError> {
    let header = text.lines().next().unwrap_or_default();
    let delimiter = delimiter(header) as u8;
    if let Some(problem) = unknown_unit(header.split(char::from(delimiter))) {
        return Err(TelemetryError::Header { path: path.to_path_buf(), problem });
    }
    let mut reader = ::csv::ReaderBuilder::new().delimiter(delimiter).flexible(true).from_reader(text.as_bytes());
    let places = reader.headers().map(|names| places(names.iter())).unwrap_or_default();
    let mut log = empty;
    let (mut all_stated, mut any_clock) = (true, false);
    for record in reader.records() {
        let record = match record {
            Ok(record) => record,
            Err(error) => {
                let line = error.position().map_or(0, ::csv::Position::line) as usize;
                log.pass_over(line, format!("row cannot be read ({error})"));
                continue;
            }
        };
        let line = record.position().map_or(0, ::csv::Position::line) as usize;
        match fix(&record, &places, line) {
            Err(reason) => log.pass_over(line, reason),
            Ok((fix, stated)) => {
                any_clock |= fix.clock_s.is_some();
                all_stated &= stated;
                log.push(DIALECT, fix);
            }
        }
    }
    let states_utc = all_stated || normalized(header).contains("utc");
    log.clock = match (any_clock, states_utc) {
        (false, _) => ClockKind::Absent,
        (true, true) => ClockKind::Utc,
        (true, false) => ClockKind::Local,
    };
    Ok(log)
}

fn delimiter(header: &str) -> char {
    let count = |delimiter: &char| header.matches(*delimiter).count();
    [',', ';', '\t'].into_iter().rev().max_by_key(count).unwrap_or(',')
}

fn has(places: &[KnownColumn], column: Column) -> bool {
    places.iter().any(|place| place.column == column)
}

fn normalized(name: &str) -> String {
    let kept = name.chars().filter(|c| !matches!(c, ' ' | '_' | '-' | '"' | '\'' | '\u{feff}'));
    kept.flat_map(char::to_lowercase).collect()
}

/// A name and its unit.
fn split_unit(name: &str) -> (String, Option<String>) {
    let name = name.trim().trim_matches('"');
    if let Some((before, unit)) = name.split_once(['(', '[']) {
        let unit = unit.trim_end_matches([')', ']', ' ', '"']).trim().to_lowercase();
        return (normalized(before), (!unit.is_empty()).then_some(unit));
    }
    let lower = name.to_lowercase();
    for (suffix, unit) in [("_m_s", "m/s"), ("_km_h", "km/h")] {
        if let Some(before) = lower.strip_suffix(suffix) {
            return (normalized(before), Some(unit.to_owned()));
        }
    }
    match lower.rsplit_once('_') {
        Some((before, unit)) if unit_of(unit).is_some() => (normalized(before), Some(unit.to_owned())),
        _ => (normalized(name), None),
    }
}

fn unit_of(unit: &str) -> Option<f64> {
    UNITS.iter().find(|(known, _)| *known == unit).map(|(_, value)| *value)
}

fn column_of(name: &str) -> Option<Column> {
    NAMES.iter().find(|(_, names)| names.contains(&name)).map(|(column, _)| *column)
}

fn places<'a>(names: impl Iterator<Item = &'a str>) -> Vec<KnownColumn> {
    let mut places: Vec<KnownColumn> = Vec::new();
    for (index, name) in names.enumerate() {
        let (name, unit) = split_unit(name);
        let Some(column) = column_of(&name).filter(|&column| !has(&places, column)) else { continue };
        // Units such as “utc” say what the clock shows.
        let unit = unit.as_deref().and_then(unit_of).unwrap_or(1.0);
        places.push(KnownColumn { column, index, unit });
    }
    places
}

/// Message for the first unknown unit.
fn unknown_unit<'a>(mut names: impl Iterator<Item = &'a str>) -> Option<String> {
    names.find_map(|full| {
        let (name, unit) = split_unit(full);
        let unit = unit.filter(|unit| unit_of(unit).is_none())?;
        let column = column_of(&name)?;
        let is_text = matches!(column, Column::Clock | Column::Receiver);
        (!is_text).then(|| {
            let known = UNITS.map(|(unit, _)| unit).join(", ");
            format!("column {}: unknown unit {}; expected {known}", shown(full), shown(&unit))
        })
    })
}

/// The fix in a row, and whether its clock states its zone.
fn fix(record: &::csv::StringRecord, places: &[KnownColumn], line: usize) -> Result<(Fix, bool), String> {
    record.iter().try_for_each(check_length)?;
    let text = |column: Column| {
        let place = places.iter().find(|place| place.column == column)?;
        record.get(place.index).map(str::trim).filter(|text| !text.is_empty()).map(|text| (text, place.unit))
    };
    let value = |column: Column| text(column).and_then(|(text, unit)| Some(number(text)? * unit));
    let written = |column: Column| text(column).map_or("", |(text, _)| text);
    let position = coordinate::position(written(Column::Longitude), written(Column::Latitude))?;
    let receiver = receiver(written(Column::Receiver))?;
    let fix = Fix::at(line, position).received_by(receiver, None);
    let (video_s, clock) = times(&text, &value)?;
    let angles = |[yaw, pitch, roll]: [Column; 3]| {
        Some(Angles::from_degrees(value(yaw)?, value(pitch)?, value(roll).unwrap_or(0.0)))
    };
    let std = |column, usual: f64| value(column).filter(|&std| std > 0.0).unwrap_or(usual);
    let fix = Fix {
        video_s,
        clock_s: clock.map(|(clock_s, _)| clock_s),
        gps_height_m: value(Column::GpsHeight),
        relative_height_m: value(Column::RelativeHeight),
        horizontal_std_m: std(Column::HorizontalStd, fix.horizontal_std_m),
        vertical_std_m: std(Column::VerticalStd, fix.vertical_std_m),
        speed_m_s: value(Column::Speed),
        attitude: angles([Column::Yaw, Column::Pitch, Column::Roll]),
        gimbal: angles([Column::GimbalYaw, Column::GimbalPitch, Column::GimbalRoll]),
        ..fix
    };
    Ok((fix, clock.is_none_or(|(_, stated)| stated)))
}

/// Numbers above this are seconds after 1970 and no time in a video: it is 1973.
const LEAST_CLOCK_S: f64 = 1e8;
/// Numbers above this are milliseconds after 1970: as seconds it were the year 5138.
const LEAST_CLOCK_MS: f64 = 1e11;

/// Time in the video, and time on the clock with whether its zone is known.
type Times = (Option<f64>, Option<(f64, bool)>);

fn times<'a>(
    text: &impl Fn(Column) -> Option<(&'a str, f64)>,
    value: &impl Fn(Column) -> Option<f64>,
) -> Result<Times, String> {
    let clock = |column: Column| {
        let (text, _) = text(column)?;
        match number(text) {
            Some(ms) if ms >= LEAST_CLOCK_MS => Some((ms * 1e-3, true)),
            Some(seconds) if seconds >= LEAST_CLOCK_S => Some((seconds, true)),
            Some(_) => None,
            None => time::iso_s(text),
        }
    };
    let video_s = value(Column::VideoTime).filter(|&time_s| time_s < LEAST_CLOCK_S);
    // “time” and “timestamp” may hold either.
    let clock_read = clock(Column::Clock).or_else(|| clock(Column::VideoTime));
    let video_s = video_s.or_else(|| value(Column::Clock).filter(|&time_s| time_s < LEAST_CLOCK_S));
    let is_written = text(Column::VideoTime).or_else(|| text(Column::Clock));
    match (video_s, clock_read, is_written) {
        (None, None, Some((written, _))) => Err(format!("time {}: invalid", shown(written))),
        (video_s, clock, _) => Ok((video_s, clock)),
    }
}

fn receiver(text: &str) -> Result<Receiver, String> {
    match text.to_ascii_lowercase().as_str() {
        "" | "plain" | "2d" | "3d" | "gps" | "single" | "1" => Ok(Receiver::Plain),
        "dgps" | "sbas" | "differential" | "2" => Ok(Receiver::Differential),
        "rtk" | "fixed" | "rtk-fixed" | "4" | "50" => Ok(Receiver::RtkFixed),
        "float" | "rtk-float" | "5" | "34" => Ok(Receiver::RtkFloat),
        "none" | "0" => Err("the receiver had no fix".to_owned()),
        _ => Ok(Receiver::Plain),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> Log {
        read(text, Path::new("a.csv"), Log::default()).unwrap()
    }

    #[test]
    fn names_and_units_of_the_header_decide() {
        let log = table(
            "Time_ms,LAT,Lng,Altitude [ft],height_m,speed(km/h),hAcc,fix\n1500,48.5,9.25,1000,12.5,36,0.5,rtk\n\
             2500,48.5,9.25,,,,,\n",
        );
        let first = &log.fixes[0];
        assert_eq!((first.video_s, first.longitude_deg, first.latitude_deg), (Some(1.5), 9.25, 48.5));
        assert!((first.gps_height_m.unwrap() - 304.8).abs() < 1e-9);
        assert_eq!((first.relative_height_m, first.speed_m_s), (Some(12.5), Some(10.0)));
        assert_eq!((first.horizontal_std_m, first.vertical_std_m, first.line), (0.5, 0.04, 2));
        assert_eq!((log.fixes[1].gps_height_m, log.fixes[1].horizontal_std_m), (None, 3.4));
        assert_eq!(log.clock, ClockKind::Absent);
    }

    #[test]
    fn what_flight_loggers_write() {
        let log = table(
            "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(feet),gimbal_heading(degrees),\
             gimbal_pitch(degrees)\n100,2022-08-07 13:40:40,48.5,9.25,100,180,-90\n",
        );
        let first = &log.fixes[0];
        assert_eq!((first.video_s, log.clock), (Some(0.1), ClockKind::Utc));
        assert!((first.relative_height_m.unwrap() - 30.48).abs() < 1e-9);
        assert!((first.gimbal.unwrap().yaw - std::f64::consts::PI).abs() < 1e-12);
        let log = table("timestamp;lat;lon\n1659879640;48.5;9.25\n1659879641000;48.5;9.25\n");
        assert_eq!(log.fixes.iter().map(|fix| fix.clock_s.unwrap()).collect::<Vec<_>>(), [1659879640.0, 1659879641.0]);
    }

    #[test]
    fn bad_rows_are_named_and_bad_units_refused() {
        let log = table("time_s,lat,lon\n0,4807.038,11.5\nx,48.5,11.5\n2,48.5\n3,0,0\n4,48.5,11.5\n");
        assert_eq!(log.fixes.len(), 1);
        let lines: Vec<usize> = log.passed_over.iter().map(|passed| passed.line).collect();
        assert_eq!(lines, [2, 3, 4, 5]);
        assert!(log.passed_over[0].reason.contains("degrees and minutes"), "{:?}", log.passed_over);
        let error = read("lat,lon,height [fathoms]\n", Path::new("a.csv"), Log::default()).unwrap_err().to_string();
        assert!(error.contains("a.csv, line 1") && error.contains("fathoms") && error.contains("feet"), "{error}");
        assert!(is_header("lat;lon") && !is_header("latitudes,lon") && !is_header("1,2,3"));
    }
}
