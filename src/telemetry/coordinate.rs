//! Parsing and validation of longitude and latitude.

use super::fix::Position;
use super::text::{number, resolution, shown};

/// Parses a position from two numbers: decimal degrees, or degrees, minutes and seconds with their signs and a letter
/// (`48°12'30.5"N`).
///
/// # Errors
/// The problem: no number, out of range (with a hint if degrees and minutes were written as one number), or the (0, 0)
/// that receivers write before the first fix.
pub(super) fn position(longitude: &str, latitude: &str) -> Result<Position, String> {
    let (longitude_deg, fine) = angle(longitude).ok_or_else(|| not_a_number("longitude", longitude))?;
    let (latitude_deg, also) = angle(latitude).ok_or_else(|| not_a_number("latitude", latitude))?;
    checked(Position { longitude_deg, latitude_deg, resolution_deg: fine.max(also) })
}

/// Validates a position.
///
/// # Errors
/// As [`position`].
pub(super) fn checked(position: Position) -> Result<Position, String> {
    let Position { longitude_deg, latitude_deg, .. } = position;
    if longitude_deg == 0.0 && latitude_deg == 0.0 {
        return Err("position (0, 0): the receiver had no fix".to_owned());
    }
    in_range("latitude", latitude_deg, 90.0)?;
    in_range("longitude", longitude_deg, 180.0)?;
    Ok(position)
}

fn in_range(what: &str, value_deg: f64, most_deg: f64) -> Result<(), String> {
    if value_deg.abs() <= most_deg {
        return Ok(());
    }
    let degrees = (value_deg.abs() / 100.0).floor();
    let is_joined = degrees <= most_deg && value_deg.abs() - 100.0 * degrees < 60.0;
    let hint = if is_joined { ": degrees and minutes in one number? give decimal degrees" } else { "" };
    Err(format!("{what} {value_deg}: expected −{most_deg} to {most_deg}{hint}"))
}

fn not_a_number(what: &str, text: &str) -> String {
    match text.trim() {
        "" => format!("{what} missing"),
        _ => format!("{what} {}: not an angle", shown(text)),
    }
}

/// Parses an angle in degrees, and the value of its last digit.
fn angle(text: &str) -> Option<(f64, f64)> {
    let text = text.trim();
    let (text, sign) = match text.chars().last()?.to_ascii_uppercase() {
        'N' | 'E' => (&text[..text.len() - 1], 1.0),
        'S' | 'W' => (&text[..text.len() - 1], -1.0),
        _ => (text, 1.0),
    };
    if let Some(value) = number(text) {
        return Some((sign * value, resolution(text)));
    }
    let is_sign = |c: char| matches!(c, '°' | '\'' | '"' | '′' | '″' | '’' | '”' | 'º' | ' ' | '\u{fffd}');
    let parts: Vec<&str> = text.split(is_sign).filter(|part| !part.is_empty()).collect();
    sexagesimal(&parts).map(|(value, fine)| (sign * value, fine))
}

/// Degrees from degrees, minutes and seconds.
fn sexagesimal(parts: &[&str]) -> Option<(f64, f64)> {
    let [degrees, rest @ ..] = parts else { return None };
    let smaller: Vec<f64> = rest.iter().map(|part| number(part)).collect::<Option<_>>()?;
    if rest.is_empty() || rest.len() > 2 || smaller.iter().any(|part| !(0.0..60.0).contains(part)) {
        return None;
    }
    let degrees_value = number(degrees)?;
    let share: f64 = smaller.iter().zip([60.0, 3600.0]).map(|(part, unit)| part / unit).sum();
    let fine = resolution(rest[rest.len() - 1]) / 60f64.powi(rest.len() as i32);
    Some((if degrees.starts_with('-') { degrees_value - share } else { degrees_value + share }, fine))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn degrees(longitude: &str, latitude: &str) -> (f64, f64) {
        let position = position(longitude, latitude).unwrap();
        (position.longitude_deg, position.latitude_deg)
    }

    #[test]
    fn decimal_degrees_and_minutes_and_seconds() {
        assert_eq!(degrees(" 9.5 ", "-48.25"), (9.5, -48.25));
        assert_eq!(degrees("9.5W", "48.25 s"), (-9.5, -48.25));
        let (longitude, latitude) = degrees("9°30'0.0\"E", "-48°12′30.6″");
        assert!((longitude - 9.5).abs() < 1e-12 && (latitude + 48.208_5).abs() < 1e-9, "{longitude} {latitude}");
        assert_eq!(degrees("9 30", "48 15"), (9.5, 48.25));
        assert!((position("9.123456", "48.1").unwrap().resolution_deg - 0.1).abs() < 1e-15);
    }

    #[test]
    fn invalid_positions_are_reported() {
        let said = |longitude, latitude| position(longitude, latitude).unwrap_err();
        assert!(said("0", "0.000").contains("no fix"));
        assert!(said("11.5", "4807.038").contains("degrees and minutes in one number"));
        assert!(said("11.5", "90.5").ends_with("90"), "{}", said("11.5", "90.5"));
        assert_eq!(said("", "1"), "longitude missing");
        assert!(said("1", "NaN").contains("not an angle") && said("1", "1°61'").contains("not an angle"));
        assert!(said("°", "1").contains("not an angle") && said("é", "ü").contains("not an angle"));
    }
}
