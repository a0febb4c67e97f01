//! Fix from a row of a table.

use super::super::coordinate;
use super::super::fix::{Angles, Fix, Receiver};
use super::super::text::{check_length, number, shown};
use super::super::time;
use super::columns::{Column, KnownColumn};
use crate::scene::clock_in_seconds;

/// Reads the fix of a row; the flag is false if its clock has no stated zone.
///
/// * `has_commas` – true if cells are not separated by commas, so that a comma can be a decimal separator.
///
/// # Errors
/// The problem of the row.
pub(super) fn fix(
    record: &::csv::StringRecord,
    known: &[KnownColumn],
    has_commas: bool,
    line: usize,
) -> Result<(Fix, bool), String> {
    record.iter().try_for_each(check_length)?;
    let row = Row { record, known, has_commas };
    let position = coordinate::position(&row.decimal(Column::Longitude), &row.decimal(Column::Latitude))?;
    let receiver = receiver(row.text(Column::Receiver))?;
    let fix = Fix::at(line, position).received_by(receiver, None);
    let (video_s, clock) = row.times()?;
    let angles = |[yaw, pitch, roll]: [Column; 3]| {
        let roll = row.value(roll).unwrap_or(0.0);
        Some(Angles::from_degrees(row.value(yaw)?, row.value(pitch)?, roll))
    };
    let std = |column, usual: f64| row.value(column).filter(|&std| std > 0.0).unwrap_or(usual);
    let image = row.text(Column::Image);
    let fix = Fix {
        photograph: (!image.is_empty()).then(|| image.to_owned()),
        video_s,
        clock_s: clock.map(|(clock_s, _)| clock_s),
        gps_height_m: row.value(Column::GpsHeight),
        relative_height_m: row.value(Column::RelativeHeight),
        horizontal_std_m: std(Column::HorizontalStd, fix.horizontal_std_m),
        vertical_std_m: std(Column::VerticalStd, fix.vertical_std_m),
        speed_m_s: row.value(Column::Speed),
        attitude: angles([Column::Yaw, Column::Pitch, Column::Roll]),
        gimbal: angles([Column::GimbalYaw, Column::GimbalPitch, Column::GimbalRoll]),
        ..fix
    };
    Ok((fix, clock.is_none_or(|(_, stated)| stated)))
}

/// A row with its columns.
struct Row<'a> {
    record: &'a ::csv::StringRecord,
    known: &'a [KnownColumn],
    has_commas: bool,
}

/// Minimum of seconds after 1970 (1973); smaller numbers are times in a video.
const MIN_CLOCK_S: f64 = 1e8;

/// Maximum clock, 2100-01-01: a larger value is another quantity, or damaged.
const MAX_CLOCK_S: f64 = 4_102_444_800.0;

/// Time in the video, and time on the clock with true if its zone is known.
type Times = (Option<f64>, Option<(f64, bool)>);

impl Row<'_> {
    fn text(&self, column: Column) -> &str {
        let known = self.known.iter().find(|known| known.column == column);
        known.and_then(|known| self.record.get(known.index)).unwrap_or_default().trim()
    }

    /// Number as text, with a decimal point.
    fn decimal(&self, column: Column) -> String {
        let text = self.text(column);
        let is_comma = self.has_commas && !text.contains('.') && text.matches(',').count() == 1;
        if is_comma { text.replace(',', ".") } else { text.to_owned() }
    }

    fn value(&self, column: Column) -> Option<f64> {
        let unit = self.known.iter().find(|known| known.column == column)?.unit;
        Some(number(&self.decimal(column))? * unit)
    }

    fn times(&self) -> Result<Times, String> {
        let (time, clock) = (self.text(Column::VideoTime), self.text(Column::Clock));
        // “time” and “timestamp” may have either.
        let is_video = |column| self.value(column).filter(|time_s| *time_s < MIN_CLOCK_S);
        let video_s = is_video(Column::VideoTime).or_else(|| is_video(Column::Clock));
        let of_day = [Column::TimeOfDay, Column::VideoTime].map(|column| self.text(column));
        let of_day = of_day.into_iter().find(|text| text.contains(':')).unwrap_or_default();
        let found = match clock_of(clock)? {
            Some(found) => Some(found),
            None if of_day.is_empty() => clock_of(time)?,
            None => time::spelled_in_table_s(&format!("{clock} {of_day}")).or_else(|| clock_of(time).ok()?),
        };
        let written = if time.is_empty() { clock } else { time };
        match (video_s, found) {
            (None, None) if !written.is_empty() => Err(format!("time {}: invalid", shown(written))),
            found => Ok(found),
        }
    }
}

/// Clock stated in a cell.
fn clock_of(text: &str) -> Result<Option<(f64, bool)>, String> {
    let Some(value) = number(text) else { return Ok(time::spelled_in_table_s(text)) };
    match (value >= MIN_CLOCK_S).then(|| clock_in_seconds(value)) {
        Some(clock_s) if clock_s > MAX_CLOCK_S => Err(format!("time {}: after the year 2100", shown(text))),
        clock_s => Ok(clock_s.map(|clock_s| (clock_s, true))),
    }
}

fn receiver(text: &str) -> Result<Receiver, String> {
    match text.to_ascii_lowercase().as_str() {
        "" | "a" | "plain" | "2d" | "3d" | "gps" | "single" | "1" => Ok(Receiver::Plain),
        "dgps" | "sbas" | "differential" | "2" => Ok(Receiver::Differential),
        "rtk" | "fixed" | "rtk-fixed" | "4" | "50" => Ok(Receiver::RtkFixed),
        "float" | "rtk-float" | "5" | "34" => Ok(Receiver::RtkFloat),
        "none" | "0" | "v" => Err("the receiver had no fix".to_owned()),
        _ => Ok(Receiver::Plain),
    }
}
