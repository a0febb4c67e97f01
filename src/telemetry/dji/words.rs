//! `F/5.6, SS 400, ISO 100, EV 0, GPS (-58.851745, -34.237922, 15), HOME (...), D 698.70m, H 85.80m, H.S 2.88m/s,
//! V.S 0.00m/s, F.PRY (2.7°, -7.0°, 110.1°), G.PRY (-24.4°, 0.0°, 110.4°)`: words and numbers between commas.
//!
//! `GPS` has longitude, latitude and the number of satellites. H is the height above take-off, H.S the horizontal
//! speed; F.PRY and G.PRY are pitch, roll and yaw of the drone and of its gimbal, degrees.

use super::super::coordinate;
use super::super::fix::{Angles, Fix};
use super::super::text::leading_number;
use super::calls::inside;

pub(super) fn recognizes(text: &str) -> bool {
    text.contains("GPS (") && text.contains(", H ")
}

pub(super) fn read(text: &str, line: usize) -> Result<Fix, String> {
    let parts = inside(text, "GPS")?;
    let [longitude, latitude, ..] = parts[..] else { return Err("GPS () has fewer than two numbers".to_owned()) };
    let fix = Fix::at(line, coordinate::position(longitude, latitude)?);
    Ok(Fix {
        relative_height_m: word(text, ", H "),
        speed_m_s: word(text, ", H.S "),
        attitude: angles(text, "F.PRY"),
        gimbal: angles(text, "G.PRY"),
        ..fix
    })
}

/// Number after a word; `None` for “n/a”.
fn word(text: &str, name: &str) -> Option<f64> {
    leading_number(text.split_once(name)?.1).map(|(value, _)| value)
}

fn angles(text: &str, name: &str) -> Option<Angles> {
    let parts = inside(text, name).ok()?;
    let numbers: Vec<f64> = parts.iter().filter_map(|part| Some(leading_number(part)?.0)).collect();
    let [pitch, roll, yaw] = numbers[..] else { return None };
    Some(Angles::from_degrees(yaw, pitch, roll))
}
