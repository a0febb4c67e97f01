//! `[latitude: 48.1] [longitude: 9.2] [rel_alt: 12.5 abs_alt: 402.1] [gb_yaw: 90.0 gb_pitch: -45.0 gb_roll: 0.0]`:
//! names and values in brackets, with or without a blank before the colon, several to a bracket in newer firmware.
//!
//! `rel_alt` is relative to the take-off point and `abs_alt` to sea level at standard pressure (DJI's Onboard SDK calls
//! it fusion altitude). `altitude` alone is a height above take-off: in some files it is below the terrain height.

use super::super::coordinate;
use super::super::fix::{Angles, Fix};
use super::super::text::number;

pub(super) fn has_two_heights(text: &str) -> bool {
    has_position(text) && text.contains("rel_alt")
}

pub(super) fn has_altitude(text: &str) -> bool {
    has_position(text) && text.contains("[altitude")
}

pub(super) fn has_position(text: &str) -> bool {
    text.contains("[latitude")
}

/// Exposure without a position: no satellites, or the pilot disabled positions.
pub(super) fn is_camera(text: &str) -> bool {
    text.contains("[iso")
}

pub(super) fn no_position(text: &str, _: usize) -> Result<Fix, String> {
    Err(match breaks_off(text) {
        true => "block truncated before its position".to_owned(),
        false => "block with camera settings only, no position".to_owned(),
    })
}

fn breaks_off(text: &str) -> bool {
    text.rfind('[') > text.rfind(']')
}

pub(super) fn read(text: &str, line: usize) -> Result<Fix, String> {
    let values = values(text);
    let value = |name: &str| values.iter().find(|(known, _)| *known == name).map(|(_, value)| *value);
    // Older firmware misspells it.
    let longitude = value("longitude").or_else(|| value("longtitude"));
    let missing = |what: &str| match breaks_off(text) {
        true => format!("block truncated in its {what}"),
        false => format!("{what} missing in the block"),
    };
    let longitude = longitude.ok_or_else(|| missing("longitude"))?;
    let latitude = value("latitude").ok_or_else(|| missing("latitude"))?;
    let fix = Fix::at(line, coordinate::position(longitude, latitude)?);
    let height = |name: &str| value(name).and_then(number);
    Ok(Fix {
        gps_height_m: height("abs_alt"),
        relative_height_m: height("rel_alt").or_else(|| height("altitude")),
        gimbal: angles(&value, ["gb_yaw", "gb_pitch", "gb_roll"]),
        attitude: angles(&value, ["drone_yaw", "drone_pitch", "drone_roll"]),
        ..fix
    })
}

/// 35 mm equivalent focal length, millimeters: 24.00 in newer firmware, 240 for the same in older firmware, which
/// writes no decimals.
pub(super) fn film_focal_mm(text: &str) -> Option<f64> {
    let (_, value) = values(text).into_iter().find(|(name, _)| *name == "focal_len")?;
    let focal_mm = if value.contains('.') { number(value)? } else { number(value)? / 10.0 };
    (focal_mm > 0.0).then_some(focal_mm)
}

fn angles<'a>(value: &impl Fn(&str) -> Option<&'a str>, names: [&str; 3]) -> Option<Angles> {
    let [yaw, pitch, roll] = names.map(|name| value(name).and_then(number));
    Some(Angles::from_degrees(yaw?, pitch?, roll?))
}

/// Names and values inside complete brackets.
fn values(text: &str) -> Vec<(&str, &str)> {
    let mut values = Vec::new();
    for (group, _) in text.split('[').skip(1).filter_map(|group| group.split_once(']')) {
        let mut words = group.split([' ', ':', ',']).filter(|word| !word.is_empty());
        while let (Some(name), Some(value)) = (words.next(), words.next()) {
            values.push((name, value));
        }
    }
    values
}
