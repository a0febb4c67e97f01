//! NMEA 0183, as receivers and dash cameras write it: `$GPRMC,…*hh`.
//!
//! Read: GGA (position, height above sea level and geoid height above the ellipsoid, kind of fix, dilution), RMC
//! (position, date, speed), GST (standard deviations), ZDA (date). Sentences of one time form one fix. A sentence may
//! start anywhere in its line; its checksum must be right if there is one. Angles are degrees and minutes in one
//! number, `ddmm.mmmm`.

use super::coordinate;
use super::fix::{ClockKind, Fix, HeightDatum, Log, Position, Receiver};
use super::text::{KNOT_M_S, check_length, number, resolution};
use super::time::{self, DAY_S};

/// Values of the sentences of one time.
#[derive(Default)]
struct Epoch {
    line: usize,
    time_s: f64,
    position: Option<Position>,
    height_m: Option<f64>,
    speed_m_s: Option<f64>,
    receiver: Option<Receiver>,
    dilution: Option<f64>,
    std_m: Option<(f64, f64)>,
}

struct Reading {
    log: Log,
    epoch: Option<Epoch>,
    /// Midnight before the epoch, seconds after 1970; `None` before the first date.
    midnight_s: Option<f64>,
    /// True while every height comes with a geoid height, so that it is above the ellipsoid.
    all_ellipsoidal: bool,
}

/// Reads a text into an empty log.
pub(super) fn read(text: &str, empty: Log) -> Log {
    let log = Log { height_datum: HeightDatum::Ellipsoid, ..empty };
    let mut reading = Reading { log, epoch: None, midnight_s: None, all_ellipsoidal: true };
    for (line, content) in (1..).zip(text.lines()) {
        let understood = check_length(content).and_then(|()| reading.sentence(line, content));
        if let Err(reason) = understood {
            reading.log.skip_line(line, reason);
        }
    }
    reading.flush();
    reading.finish()
}

/// Returns true if a line has a sentence.
pub(super) fn is_sentence(line: &str) -> bool {
    body(line).is_some_and(|body| body.len() > 6 && body.as_bytes()[5] == b',' && body.is_char_boundary(5))
}

/// Text between the dollar sign and the end.
fn body(line: &str) -> Option<&str> {
    let (_, after) = line.split_once('$')?;
    after.starts_with(['G', 'B', 'Q']).then_some(after.trim_end())
}

/// Fields of a sentence whose checksum is right or absent.
fn fields(line: &str) -> Result<Option<Vec<&str>>, String> {
    let Some(body) = body(line) else { return Ok(None) };
    let Some((content, sum)) = body.split_once('*') else { return Ok(Some(body.split(',').collect())) };
    let stated = sum.get(..2).and_then(|sum| u8::from_str_radix(sum, 16).ok());
    let found = content.bytes().fold(0, |sum, byte| sum ^ byte);
    match stated {
        Some(stated) if stated == found => Ok(Some(content.split(',').collect())),
        _ => Err(format!("checksum is not {found:02X}: the sentence is damaged or truncated")),
    }
}

impl Reading {
    fn sentence(&mut self, line: usize, content: &str) -> Result<(), String> {
        let Some(fields) = fields(content)? else { return Ok(()) };
        let field = |i: usize| fields.get(i).copied().unwrap_or_default();
        match field(0).get(2..) {
            Some("GGA") => self.gga(line, &field),
            Some("RMC") => self.rmc(line, &field),
            Some("GST") => self.gst(line, &field),
            Some("ZDA") => {
                self.epoch(line, field(1))?;
                self.take_date(number(field(4)), number(field(3)), number(field(2)));
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn gga<'a>(&mut self, line: usize, field: &impl Fn(usize) -> &'a str) -> Result<(), String> {
        let receiver = match field(6) {
            "" | "0" => return Err("the receiver had no fix".to_owned()),
            "2" => Receiver::Differential,
            "4" => Receiver::RtkFixed,
            "5" => Receiver::RtkFloat,
            "6" => return Err("dead reckoning, not a fix".to_owned()),
            "8" => return Err("simulated position".to_owned()),
            _ => Receiver::Plain,
        };
        let position = position([field(4), field(5)], [field(2), field(3)])?;
        let above_sea = number(field(9));
        let sea = number(field(11));
        self.all_ellipsoidal &= sea.is_some() || above_sea.is_none();
        let epoch = self.epoch(line, field(1))?;
        epoch.position = Some(position);
        epoch.height_m = above_sea.map(|height| height + sea.unwrap_or(0.0));
        epoch.receiver = Some(receiver);
        epoch.dilution = number(field(8));
        Ok(())
    }

    fn rmc<'a>(&mut self, line: usize, field: &impl Fn(usize) -> &'a str) -> Result<(), String> {
        if field(2) == "V" {
            return Err("the receiver had no fix".to_owned());
        }
        let position = position([field(5), field(6)], [field(3), field(4)])?;
        let date = field(9);
        let part = |range| date.get(range).and_then(number);
        let epoch = self.epoch(line, field(1))?;
        // With some receivers GGA has more digits, never fewer.
        epoch.position = epoch.position.or(Some(position));
        epoch.speed_m_s = number(field(7)).map(|knots| knots * KNOT_M_S);
        self.take_date(part(4..6).map(|year| 2000.0 + year), part(2..4), part(0..2));
        Ok(())
    }

    fn gst<'a>(&mut self, line: usize, field: &impl Fn(usize) -> &'a str) -> Result<(), String> {
        let [latitude, longitude, height] = [6, 7, 8].map(|i| number(field(i)).filter(|&std| std > 0.0));
        let horizontal = latitude.zip(longitude).map(|(a, b)| a.max(b));
        self.epoch(line, field(1))?.std_m = horizontal.zip(height);
        Ok(())
    }

    /// Returns the epoch of a time of day, `hhmmss.ss`; an epoch of another time is finished first.
    fn epoch(&mut self, line: usize, time: &str) -> Result<&mut Epoch, String> {
        let time_s = time_of_day_s(time).ok_or("sentence without a time")?;
        let last_s = self.epoch.as_ref().map(|epoch| epoch.time_s);
        if last_s != Some(time_s) {
            self.flush();
            let past_midnight = last_s.is_some_and(|last| last - time_s > 0.5 * DAY_S);
            if let Some(midnight_s) = self.midnight_s.as_mut().filter(|_| past_midnight) {
                *midnight_s += DAY_S;
            }
        }
        Ok(self.epoch.get_or_insert_with(|| Epoch { line, time_s, ..Epoch::default() }))
    }

    fn take_date(&mut self, year: Option<f64>, month: Option<f64>, day: Option<f64>) {
        let whole = |value: Option<f64>| value.map(|value| value as u32);
        let (Some(year), Some(month), Some(day)) = (whole(year), whole(month), whole(day)) else { return };
        self.midnight_s = time::civil_s([year, month, day, 0, 0, 0], 0.0).or(self.midnight_s);
    }

    fn flush(&mut self) {
        let Some(epoch) = self.epoch.take() else { return };
        let Some(position) = epoch.position else { return };
        let fix = Fix::at(epoch.line, position).received_by(epoch.receiver.unwrap_or(Receiver::Plain), epoch.dilution);
        let (horizontal_std_m, vertical_std_m) = epoch.std_m.unwrap_or((fix.horizontal_std_m, fix.vertical_std_m));
        self.log.push(
            "nmea",
            Fix {
                clock_s: Some(self.midnight_s.unwrap_or(0.0) + epoch.time_s),
                gps_height_m: epoch.height_m,
                speed_m_s: epoch.speed_m_s,
                horizontal_std_m,
                vertical_std_m,
                ..fix
            },
        );
    }

    fn finish(self) -> Log {
        let mut log = self.log;
        log.clock = if self.midnight_s.is_some() { ClockKind::Utc } else { ClockKind::TimeOfDay };
        if let Some(midnight_s) = self.midnight_s {
            // Fixes before the first date are assigned to its day.
            let dated = log.fixes.iter().filter_map(|fix| fix.clock_s).find(|&clock_s| clock_s >= DAY_S);
            let first_midnight_s = dated.map_or(midnight_s, |clock_s| (clock_s / DAY_S).floor() * DAY_S);
            let undated =
                log.fixes.iter_mut().filter_map(|fix| fix.clock_s.as_mut()).filter(|clock_s| **clock_s < DAY_S);
            undated.for_each(|clock_s| *clock_s += first_midnight_s);
        }
        if !self.all_ellipsoidal {
            log.height_datum = HeightDatum::Unstated;
        }
        log
    }
}

fn time_of_day_s(text: &str) -> Option<f64> {
    let [hours, minutes, seconds] = [text.get(0..2)?, text.get(2..4)?, text.get(4..)?].map(number);
    let (hours, minutes, seconds) = (hours?, minutes?, seconds?);
    let in_range = (0.0..24.0).contains(&hours) && (0.0..60.0).contains(&minutes) && (0.0..61.0).contains(&seconds);
    in_range.then_some(hours * 3600.0 + minutes * 60.0 + seconds)
}

/// Longitude and latitude from `dddmm.mmmm` and their letters.
fn position(longitude: [&str; 2], latitude: [&str; 2]) -> Result<Position, String> {
    let angle = |what: &str, [text, letter]: [&str; 2]| {
        let joined = number(text).filter(|&value| value >= 0.0).ok_or_else(|| format!("{what} missing"))?;
        let degrees = (joined / 100.0).floor();
        let minutes = joined - 100.0 * degrees;
        let sign = if matches!(letter, "S" | "W") { -1.0 } else { 1.0 };
        match minutes < 60.0 {
            true => Ok(sign * (degrees + minutes / 60.0)),
            false => Err(format!("{what} {text}: {minutes:.1} minutes of 60; expected degrees and minutes")),
        }
    };
    let resolution_deg = resolution(longitude[0]).max(resolution(latitude[0])) / 60.0;
    let (longitude_deg, latitude_deg) = (angle("longitude", longitude)?, angle("latitude", latitude)?);
    coordinate::checked(Position { longitude_deg, latitude_deg, resolution_deg })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log_of(text: &str) -> Log {
        read(text, Log::default())
    }

    const LOG: &str = "$GPGGA,235959.00,4807.0380,N,01131.0000,W,4,08,0.9,545.4,M,46.9,M,,\n\
        $GPRMC,235959.00,A,4807.0380,N,01131.0000,W,010.0,084.4,230394,003.1,W\n\
        $GPGST,235959.00,1.0,2.0,1.0,0.0,0.3,0.4,0.7\n\
        [cam 7] $GPGGA,000000.50,4807.0390,N,01131.0000,W,1,08,2.0,545.5,M,46.9,M,,*00\n\
        $GPGGA,000000.50,4807.0390,N,01131.0000,W,1,08,2.0,545.5,M,46.9,M,,\n\
        $GPGSV,3,1,11,03\nnot a sentence\n$GPRMC,000001.00,V,,,,,,,,,\n\
        $GNGGA,000002.00,4867.0,N,01131.0,W,1,8,1,1,M,1,M,,\n";

    #[test]
    fn sentences_of_one_time_make_one_fix() {
        let log = log_of(LOG);
        assert_eq!((log.fixes.len(), log.num_passed_over), (2, 3), "{log:?}");
        let [first, second] = &log.fixes[..] else { panic!("two fixes") };
        assert!((first.latitude_deg - (48.0 + 7.038 / 60.0)).abs() < 1e-12);
        assert!((first.longitude_deg + (11.0 + 31.0 / 60.0)).abs() < 1e-12);
        assert_eq!((first.gps_height_m, first.horizontal_std_m, first.vertical_std_m), (Some(592.3), 0.4, 0.7));
        assert!((first.speed_m_s.unwrap() - 5.14444).abs() < 1e-9);
        // The day changes between the two.
        assert!((second.clock_s.unwrap() - first.clock_s.unwrap() - 1.5).abs() < 1e-6);
        assert_eq!(time::spelled(second.clock_s.unwrap()).unwrap(), "2094-03-24T00:00:00.500");
        assert_eq!((second.horizontal_std_m, log.clock), (6.8, ClockKind::Utc));
        let reasons: Vec<_> = log.passed_over.iter().map(|passed| (passed.line, passed.reason.as_str())).collect();
        assert!(reasons[0].0 == 4 && reasons[0].1.contains("checksum"), "{reasons:?}");
        assert!(reasons[1].0 == 8 && reasons[1].1.contains("no fix"), "{reasons:?}");
        assert!(reasons[2].0 == 9 && reasons[2].1.contains("minutes"), "{reasons:?}");
    }

    #[test]
    fn check_sums_are_checked() {
        let good = "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47";
        assert_eq!(log_of(good).fixes.len(), 1);
        assert_eq!(log_of(&good.replace("4807", "4808")).num_passed_over, 1);
        assert_eq!(log_of(good).clock, ClockKind::TimeOfDay);
        assert!(is_sentence(good) && !is_sentence("$GPé,") && !is_sentence("a,b"));
    }
}
