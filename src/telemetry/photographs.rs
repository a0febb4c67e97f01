//! GPS data in photographs (EXIF 2.3, section 4.6.6).
//!
//! Read: position, altitude and its reference, date and time (UTC), `GPSHPositioningError`, `GPSSpeed`,
//! `GPSDifferential`.

use std::io::Cursor;
use std::path::PathBuf;

use exif::{Exif, In, Rational, Tag, Value};

use super::bytes::bytes_of;
use super::coordinate;
use super::error::TelemetryError;
use super::fix::{ClockKind, Fix, HeightDatum, Log, Position, Receiver};
use super::text::{KNOT_M_S, MPH_M_S};
use super::time;
use crate::memory::MemoryLimit;

/// The name in reports.
pub(super) const DIALECT: &str = "exif";

/// Reads the GPS data of photographs in the given order, whatever their clocks; `line` of a fix is the number of its
/// photograph, from 1.
///
/// # Errors
/// [`TelemetryError::NoFix`] if none of them has a position; problems of single photographs are in the log.
pub fn read_photographs(paths: &[PathBuf]) -> Result<Log, TelemetryError> {
    let mut log = empty();
    for (number, path) in (1..).zip(paths) {
        let bytes = bytes_of(path, MemoryLimit::of_machine()).map_err(|error| error.to_string());
        match bytes.and_then(|bytes| fix(&bytes, number)) {
            Err(reason) => log.skip_line(number, format!("{}: {reason}", path.display())),
            Ok(fix) => {
                let photograph = path.file_name().map(|name| name.to_string_lossy().into_owned());
                log.push(DIALECT, Fix { photograph, ..fix });
            }
        }
    }
    if log.fixes.is_empty() {
        let (path, first) = (paths.first().cloned().unwrap_or_default(), log.passed_over.into_iter().next());
        let first = first.map(|passed| passed.reason);
        return Err(TelemetryError::NoFix { path, what: "photographs".to_owned(), first });
    }
    if log.fixes.iter().all(|fix| fix.clock_s.is_none()) {
        log.clock = ClockKind::Absent;
    }
    Ok(log)
}

fn empty() -> Log {
    Log { clock: ClockKind::Utc, height_datum: HeightDatum::SeaLevel, ..Log::default() }
}

/// Reads the log of one photograph from its bytes.
pub(super) fn read_one(bytes: &[u8]) -> Log {
    let mut log = empty();
    match fix(bytes, 1) {
        Ok(fix) => log.push(DIALECT, fix),
        Err(reason) => log.skip_line(1, reason),
    }
    log
}

fn fix(bytes: &[u8], line: usize) -> Result<Fix, String> {
    let exif = exif::Reader::new().continue_on_error(true).read_from_container(&mut Cursor::new(bytes));
    // Many cameras write blocks with a flaw somewhere: the readable fields are used.
    let exif = exif.or_else(|error| error.distill_partial_result(|_| {}));
    let exif = exif.map_err(|error| format!("no readable EXIF data ({error})"))?;
    let (longitude_deg, fine) = angle(&exif, Tag::GPSLongitude, Tag::GPSLongitudeRef).ok_or_else(|| missing(bytes))?;
    let (latitude_deg, also) = angle(&exif, Tag::GPSLatitude, Tag::GPSLatitudeRef).ok_or_else(|| missing(bytes))?;
    let position = coordinate::checked(Position { longitude_deg, latitude_deg, resolution_deg: fine.max(also) })?;
    let receiver = match exif.get_field(Tag::GPSDifferential, In::PRIMARY).and_then(|field| field.value.get_uint(0)) {
        Some(1) => Receiver::Differential,
        _ => Receiver::Plain,
    };
    let fix = Fix::at(line, position).received_by(receiver, None);
    // The error is the radius of a circle, thus of both directions together.
    let stated = rational(&exif, Tag::GPSHPositioningError).filter(|&error| error > 0.0);
    Ok(Fix {
        clock_s: clock_s(&exif),
        gps_height_m: height_m(&exif),
        speed_m_s: speed_m_s(&exif),
        horizontal_std_m: stated.map_or(fix.horizontal_std_m, |error| error / std::f64::consts::SQRT_2),
        ..fix
    })
}

/// Reason for a missing position in the EXIF data: some programs and drones write it as XMP only.
fn missing(bytes: &[u8]) -> String {
    // XMP is in the first segments.
    let mut names = bytes[..bytes.len().min(1 << 18)].windows(b"GPSLatitude".len());
    let is_in_xmp = names.any(|name| name.eq_ignore_ascii_case(b"GPSLatitude"));
    let xmp = ", but one in XMP; copy it into the EXIF data (exiftool's xmp2gps.args)";
    format!("no GPS position{}", if is_in_xmp { xmp } else { "" })
}

fn rationals(exif: &Exif, tag: Tag) -> Option<&[Rational]> {
    match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(values) => Some(values),
        _ => None,
    }
}

fn rational(exif: &Exif, tag: Tag) -> Option<f64> {
    Some(rationals(exif, tag)?.first()?.to_f64()).filter(|value| value.is_finite())
}

fn letters(exif: &Exif, tag: Tag) -> Option<String> {
    match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Ascii(texts) => Some(String::from_utf8_lossy(texts.first()?).trim().to_owned()),
        _ => None,
    }
}

/// Degrees, minutes and seconds as one angle, and the value of the last digit.
fn angle(exif: &Exif, tag: Tag, reference: Tag) -> Option<(f64, f64)> {
    let parts = rationals(exif, tag)?;
    let units = [1.0, 60.0, 3600.0];
    let value: f64 = parts.iter().zip(units).map(|(part, unit)| part.to_f64() / unit).sum();
    // Finest resolution of the parts: seconds in tenths, or minutes with many digits and no seconds.
    let finest = parts
        .iter()
        .zip(units)
        .filter(|(part, _)| part.num != 0)
        .map(|(part, unit)| 1.0 / (f64::from(part.denom) * unit));
    let sign = if letters(exif, reference)?.starts_with(['S', 'W']) { -1.0 } else { 1.0 };
    value.is_finite().then_some((sign * value, finest.fold(1.0, f64::min)))
}

fn height_m(exif: &Exif) -> Option<f64> {
    let height = rational(exif, Tag::GPSAltitude)?;
    let below = exif.get_field(Tag::GPSAltitudeRef, In::PRIMARY).and_then(|field| field.value.get_uint(0)) == Some(1);
    Some(if below { -height } else { height })
}

fn speed_m_s(exif: &Exif) -> Option<f64> {
    let unit = match letters(exif, Tag::GPSSpeedRef)?.as_str() {
        "K" => 1.0 / 3.6,
        "M" => MPH_M_S,
        "N" => KNOT_M_S,
        _ => return None,
    };
    Some(rational(exif, Tag::GPSSpeed)? * unit)
}

fn clock_s(exif: &Exif) -> Option<f64> {
    let date = letters(exif, Tag::GPSDateStamp)?.replace(':', "-");
    let midnight_s = time::spelled_s(&format!("{date} 00:00:00"))?;
    let parts = rationals(exif, Tag::GPSTimeStamp)?;
    let of_day: f64 = parts.iter().zip([3600.0, 60.0, 1.0]).map(|(part, unit)| part.to_f64() * unit).sum();
    of_day.is_finite().then_some(midnight_s + of_day)
}

#[cfg(test)]
mod tests {
    use exif::Field;
    use exif::experimental::Writer;

    use super::*;

    fn rational(values: &[(u32, u32)]) -> Value {
        Value::Rational(values.iter().map(|&(num, denom)| Rational { num, denom }).collect())
    }

    fn text(text: &str) -> Value {
        Value::Ascii(vec![text.as_bytes().to_vec()])
    }

    /// A TIFF file with these fields.
    fn photograph(fields: &[(Tag, Value)]) -> Vec<u8> {
        let fields: Vec<Field> =
            fields.iter().map(|(tag, value)| Field { tag: *tag, ifd_num: In::PRIMARY, value: value.clone() }).collect();
        let mut writer = Writer::new();
        fields.iter().for_each(|field| writer.push_field(field));
        let mut bytes = Cursor::new(Vec::new());
        writer.write(&mut bytes, true).unwrap();
        bytes.into_inner()
    }

    fn position() -> Vec<(Tag, Value)> {
        vec![
            (Tag::GPSLatitudeRef, text("N")),
            (Tag::GPSLatitude, rational(&[(46, 1), (50, 1), (333_855, 10_000)])),
            (Tag::GPSLongitudeRef, text("W")),
            (Tag::GPSLongitude, rational(&[(91, 1), (59, 1), (404_156, 10_000)])),
            (Tag::GPSAltitude, rational(&[(198_309, 1000)])),
        ]
    }

    #[test]
    fn position_height_and_time() {
        let mut fields = position();
        fields.push((Tag::GPSDateStamp, text("2016:06:23")));
        fields.push((Tag::GPSTimeStamp, rational(&[(16, 1), (31, 1), (595, 10)])));
        let log = read_one(&photograph(&fields));
        let fix = &log.fixes[0];
        assert!(
            (fix.latitude_deg - 46.842_607_083_333).abs() < 1e-9 && (fix.longitude_deg + 91.994_559_888).abs() < 1e-8
        );
        assert_eq!((fix.gps_height_m, fix.relative_height_m), (Some(198.309), None));
        assert_eq!(time::spelled(fix.clock_s.unwrap()).unwrap(), "2016-06-23T16:31:59.500");
        assert!((fix.resolution_deg - 1e-4 / 3600.0).abs() < 1e-15);
    }

    #[test]
    fn photographs_without_a_position_are_named() {
        let reason = |bytes: &[u8]| read_one(bytes).passed_over.remove(0).reason;
        assert!(reason(&photograph(&position()[..2])).contains("no GPS position"));
        assert!(reason(b"II*\0").contains("no readable EXIF"));
        let in_xmp = [photograph(&position()[..2]), b"<x drone-dji:GpsLatitude='1'/>".to_vec()].concat();
        assert!(reason(&in_xmp).contains("xmp2gps"));
        let mut damaged = position();
        damaged[1] = (Tag::GPSLatitude, rational(&[(46, 0)]));
        assert!(reason(&photograph(&damaged)).contains("no GPS position"));
    }
}
