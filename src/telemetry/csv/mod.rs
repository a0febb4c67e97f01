//! Tables: CSV with a header of column names, and a few without; `docs/telemetry.md` lists the names.
//!
//! Names are compared ignoring case, blanks and punctuation. A unit is in brackets (`altitude [ft]`, `speed(mph)`),
//! after the last `_` (`height_m`, `time_ms`), or in a row below the header. Unknown columns are ignored. The header
//! may follow other lines.

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

/// Maximum number of lines before a header.
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
    // An unknown unit is refused later.
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

/// Table below its header.
struct Table {
    name: &'static str,
    /// Number of lines before its rows.
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
                    log.skip_line(line(error.position()), format!("row cannot be read ({error})"));
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
                Err(reason) => log.skip_line(line, reason),
                Ok((fix, stated)) => {
                    any_clock |= fix.clock_s.is_some();
                    all_stated &= stated;
                    log.push(self.name, fix);
                }
            }
        }
        // Litchi's altitude duplicates its ascent, the height above take-off.
        if log.fixes.iter().all(|fix| fix.gps_height_m == fix.relative_height_m) {
            log.fixes.iter_mut().for_each(|fix| fix.gps_height_m = None);
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
    fn tables_of_flight_loggers_are_read() {
        let log = table(
            "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff(feet),gimbal_heading(degrees),\
             gimbal_pitch(degrees)\n100,2022-08-07 13:40:40,48.5,9.25,100,180,-90\n",
        );
        let first = &log.fixes[0];
        assert_eq!((first.video_s, log.clock), (Some(0.1), ClockKind::Utc));
        assert!((first.relative_height_m.unwrap() - 30.48).abs() < 1e-9);
        assert!((first.gimbal.unwrap().yaw - std::f64::consts::PI).abs() < 1e-12);
        let log = table("latitude,longitude,altitude(feet),ascent(feet)\n48.5,9.25,100,100\n48.5,9.25,101.5,101.5\n");
        assert!(log.fixes[1].gps_height_m.is_none() && log.fixes[1].relative_height_m.is_some_and(|m| m > 30.9));
        let log = table("latitude,longitude,altitude(feet),ascent(feet)\n48.5,9.25,1000,100\n48.5,9.25,1001,101\n");
        assert!(log.fixes[1].gps_height_m.is_some_and(|m| m > 305.0) && log.fixes[1].relative_height_m.is_some());
        let log = table("timestamp;lat;lon\n1659879640;48.5;9.25\n1659879641000;48.5;9.25\n");
        assert_eq!(log.fixes.iter().map(|fix| fix.clock_s.unwrap()).collect::<Vec<_>>(), [1659879640.0, 1659879641.0]);
    }

    #[test]
    fn headers_of_other_programs_are_read() {
        let log = table(
            "sep=,\nCUSTOM.date [local],CUSTOM.updateTime [local],OSD.flyTime,OSD.flyTime [s],OSD.latitude,\
             OSD.longitude,OSD.height [ft],OSD.heightMax [ft],OSD.hSpeed [MPH],\
             OSD.yaw [360]\n5/4/2024,1:05:06.50 PM,0m \
             0.1s,0.1,12.345,-34.567,65.6168,131,20.1,34.4\n",
        );
        let first = &log.fixes[0];
        assert_eq!((first.video_s, first.clock_s, log.clock), (Some(0.1), Some(1_714_827_906.5), ClockKind::Local));
        assert!((first.relative_height_m.unwrap() - 20.0).abs() < 1e-4 && first.line == 3, "{first:?}");
        let log = table(
            "#DroneDeploy\t2.1.0\nSession ID\t0\nDate/Time (UTC)\tElapsed Time (sec)\tAircraft Latitude \
             (Degrees)\tAircraft Longitude (Degrees)\tAircraft Barometric Altitude (ft)\n05/04/2024 13:05:06\t0.5\t\
             12.345\t-34.567\t32.8084\n",
        );
        let first = &log.fixes[0];
        assert_eq!((first.video_s, first.clock_s, log.clock), (Some(0.5), Some(1_714_827_906.0), ClockKind::Utc));
        assert!((first.relative_height_m.unwrap() - 10.0).abs() < 1e-4);
        let log = table(
            "timestamp_utc,gps_latitude,gps_longitude,gps_altitude_ft,home_latitude\n2024-05-04 13:05:06.000 \
                         UTC,12.345,-34.567,1000,1\n",
        );
        assert_eq!((log.fixes[0].latitude_deg, log.clock), (12.345, ClockKind::Utc));
        assert!((log.fixes[0].gps_height_m.unwrap() - 304.8).abs() < 1e-9);
        let log = table(
            "\"cts\",\"date\",\"GPS (Lat.) [deg]\",\"GPS (Long.) [deg]\",\"GPS (Alt.) [m]\"\n100.0,\
                         2024-05-04T13:05:06.100Z,12.345,-34.567,220\n",
        );
        assert_eq!((log.fixes[0].video_s, log.fixes[0].gps_height_m), (Some(0.1), Some(220.0)));
    }

    #[test]
    fn units_commas_and_clocks_of_other_programs_are_read() {
        let log = table("time,lat,lon,hMSL,hAcc\n,(deg),(deg),(ft),(m)\n2024-05-04T13:05:06Z,12.3,-34.5,100,1.5\n");
        assert_eq!((log.fixes.len(), log.num_passed_over, log.fixes[0].horizontal_std_m), (1, 0, 1.5));
        assert!((log.fixes[0].gps_height_m.unwrap() - 30.48).abs() < 1e-9);
        let log = table("time;Latitude;Longitude;Altitude\n0;12,345;-34,567;220,5\n");
        assert_eq!((log.fixes[0].longitude_deg, log.fixes[0].gps_height_m), (-34.567, Some(220.5)));
        let log = table(
            "\"Time (s)\",\"Latitude (°)\",\"Longitude (°)\",\"Height (m)\",\"Vertical Accuracy (°)\"\n\
             1.0E+00,1.2345E+01,-3.4E+01,2.2E+02,3\n",
        );
        assert_eq!((log.fixes[0].latitude_deg, log.fixes[0].vertical_std_m), (12.345, 6.6));
        assert_eq!((log.fixes[0].gps_height_m, log.fixes[0].relative_height_m), (Some(220.0), None));
        let log = table("Id,Time(text),Time(seconds),Latitude,Longitude\n1,0m 0.3s,0.3,12.3,-34.5\n");
        assert_eq!(log.fixes[0].video_s, Some(0.3));
        let log = table(
            "time,seconds_elapsed,longitude,latitude\n1714827906000000000,0.2,-34.5,12.3\n\
                         1714827907000000,1.2,-34.5,12.3\n9714827907000000000,1.2,-34.5,12.3\n",
        );
        assert_eq!(log.fixes.iter().map(|fix| fix.clock_s.unwrap()).collect::<Vec<_>>(), [1714827906.0, 1714827907.0]);
        assert!(log.passed_over[0].reason.contains("after the year 2100"), "{:?}", log.passed_over);
    }

    #[test]
    fn tables_by_image_name_and_without_a_header_are_read() {
        let log = table("#Label,X/Longitude,Y/Latitude,Z/Altitude\nframe_0000.jpg,-34.5,12.3,204\n");
        assert!(log.is_by_name() && log.fixes[0].photograph.as_deref() == Some("frame_0000.jpg"));
        let log =
            table("EPSG:4326\n000000.jpg -34.567 12.345 220.0 34.4 -45.0 0.0 1.5 3.0\n000001.jpg -34.6 12.3 220.5\n");
        assert_eq!((log.fixes.len(), log.fixes[0].latitude_deg, log.fixes[0].vertical_std_m), (2, 12.345, 3.0));
        let log = table("IMG_1.JPG,12.345,-34.567,220\n");
        assert_eq!((log.fixes[0].longitude_deg, log.fixes[0].gps_height_m), (-34.567, Some(220.0)));
        let log = table("$V02\n1714827906,A,12.345,-34.567,3440,900\n1714827907,V,12.3,-34.5,0,0\n");
        assert_eq!((log.fixes.len(), log.num_passed_over, log.clock), (1, 1, ClockKind::Utc));
        assert!(!is_table("1,2.5,3.5\n4,5.5,6.5\n") && !is_table("EPSG:32632\na.jpg 500000.5 5200000.5 100\n"));
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
