//! Tables: CSV with a header that names its columns, and a few without; `docs/telemetry.md` lists the names.
//!
//! Names are compared without regard to case, blanks and punctuation. A unit is in brackets (`altitude [ft]`,
//! `speed(mph)`), behind the last `_` (`height_m`, `time_ms`), or in a row below the header. Columns of other names are
//! ignored. The header may come after other lines.

mod columns;
mod headerless;
mod row;

pub(super) use headerless::is_projected;

use std::path::Path;

use super::error::TelemetryError;
use super::fix::{ClockKind, Log};
use columns::{Column, KnownColumn, columns, normalized, units_row};

/// The name in reports.
pub(super) const DIALECT: &str = "csv";

/// Lines of notes that may go before a header.
const MAX_PREAMBLE: usize = 50;

/// Returns true if a text is a table of fixes.
pub(super) fn is_table(text: &str) -> bool {
    header(text).is_some() || headerless::recognize(text).is_some()
}

/// Number of lines before the header, and the header.
fn header(text: &str) -> Option<(usize, &str)> {
    text.lines().enumerate().take(MAX_PREAMBLE).find(|(_, line)| is_header(line))
}

/// Returns true if a line can be the header of a table of fixes.
fn is_header(line: &str) -> bool {
    // A unit that is not known is refused later.
    let (has, is_place) =
        (|column| columns::has(line.split(delimiter(line)), column), [Column::Longitude, Column::Latitude]);
    is_place.into_iter().all(has)
}

/// Reads a text into an empty log.
///
/// # Errors
/// [`TelemetryError::Header`] if a unit of the header is unknown.
pub(super) fn read(text: &str, path: &Path, empty: Log) -> Result<Log, TelemetryError> {
    let bare = headerless::recognize(text).filter(|_| header(text).is_none());
    let (name, num_before, names, delimiter) = match (bare, header(text)) {
        (Some((dialect, before)), _) => (dialect.name, before, dialect.header, dialect.delimiter),
        (None, Some((before, line))) => (DIALECT, before + 1, line, delimiter(line) as u8),
        (None, None) => (DIALECT, 0, "", b','),
    };
    let separator = if bare.is_some() { ',' } else { char::from(delimiter) };
    let known = columns(names.split(separator)).map_err(|problem| TelemetryError::Header {
        path: path.to_path_buf(),
        line: num_before,
        problem,
    })?;
    let rows = text.split_inclusive('\n').take(num_before).map(str::len).sum();
    let mut log = empty;
    let table = Table { name, first_line: num_before, delimiter, known, is_utc: normalized(names).contains("utc") };
    table.read(&text[rows..], &mut log);
    Ok(log)
}

/// A table below its header.
struct Table {
    name: &'static str,
    /// Lines before its rows.
    first_line: usize,
    delimiter: u8,
    known: Vec<KnownColumn>,
    /// True if the header states universal time.
    is_utc: bool,
}

impl Table {
    fn read(mut self, rows: &str, log: &mut Log) {
        let mut reader = ::csv::ReaderBuilder::new();
        let reader = reader.delimiter(self.delimiter).flexible(true).has_headers(false);
        let (mut all_stated, mut any_clock, mut is_first) = (true, false, true);
        for record in reader.from_reader(rows.as_bytes()).records() {
            let line =
                |position: Option<&::csv::Position>| position.map_or(0, |at| at.line() as usize) + self.first_line;
            let record = match record {
                Ok(record) => record,
                Err(error) => {
                    log.pass_over(line(error.position()), format!("row cannot be read ({error})"));
                    continue;
                }
            };
            if std::mem::take(&mut is_first)
                && let Some(units) = units_row(record.iter())
            {
                self.take_units(&units);
                continue;
            }
            let line = line(record.position());
            match row::fix(&record, &self.known, self.delimiter != b',', line) {
                Err(reason) => log.pass_over(line, reason),
                Ok((fix, stated)) => {
                    any_clock |= fix.clock_s.is_some();
                    all_stated &= stated;
                    log.push(self.name, fix);
                }
            }
        }
        log.clock = match (any_clock, all_stated || self.is_utc) {
            (false, _) => ClockKind::Absent,
            (true, true) => ClockKind::Utc,
            (true, false) => ClockKind::Local,
        };
    }

    /// Takes the units of a row below the header; times of day are texts.
    fn take_units(&mut self, units: &[Option<f64>]) {
        for known in &mut self.known {
            if let Some(Some(unit)) = units.get(known.index) {
                known.unit = *unit;
            }
        }
    }
}

fn delimiter(header: &str) -> char {
    let count = |delimiter: &char| header.matches(*delimiter).count();
    [',', ';', '\t'].into_iter().rev().max_by_key(count).unwrap_or(',')
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::telemetry::fix::Log;

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
