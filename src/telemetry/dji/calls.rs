//! `HOME(149.0251,-20.2532) 2017.08.05 14:11:51 GPS(149.0253,-20.2534,16) BAROMETER:1.9`: names with numbers in
//! parentheses, and names with numbers after a colon.
//!
//! Older drones write the longitude first and the number of satellites third. Drones that write a height third (with
//! its unit, or with the barometer's height in parentheses too) write the latitude first.

use super::super::coordinate;
use super::super::fix::Fix;
use super::super::text::leading_number;

pub(super) fn is_hb_hs(text: &str) -> bool {
    text.contains("GPS(") && text.contains("Hb:")
}

pub(super) fn is_latitude_first(text: &str) -> bool {
    let third_has_unit =
        || inside(text, "GPS").is_ok_and(|parts| parts.get(2).is_some_and(|third| third.ends_with('M')));
    text.contains("GPS(") && (text.contains("BAROMETER(") || third_has_unit())
}

pub(super) fn is_barometer(text: &str) -> bool {
    text.contains("GPS(") && text.contains("BAROMETER")
}

pub(super) fn read_longitude_first(text: &str, line: usize) -> Result<Fix, String> {
    let parts = inside(text, "GPS")?;
    let [longitude, latitude, ..] = parts[..] else { return Err("GPS() has fewer than two numbers".to_owned()) };
    let fix = Fix::at(line, coordinate::position(longitude, latitude)?);
    Ok(Fix { relative_height_m: barometer_m(text), ..fix })
}

pub(super) fn read_latitude_first(text: &str, line: usize) -> Result<Fix, String> {
    let parts = inside(text, "GPS")?;
    let [latitude, longitude, ..] = parts[..] else { return Err("GPS() has fewer than two numbers".to_owned()) };
    let fix = Fix::at(line, coordinate::position(longitude, latitude)?);
    // A height of exactly 0 in all blocks of a flight up to 88 m means unknown.
    let height_m = parts.get(2).and_then(|third| leading_number(third)).map(|(value, _)| value);
    let gps_height_m = height_m.filter(|&height| height != 0.0);
    Ok(Fix { gps_height_m, relative_height_m: barometer_m(text), ..fix })
}

/// Values in the parentheses after a name, separated by commas.
pub(super) fn inside<'a>(text: &'a str, name: &str) -> Result<Vec<&'a str>, String> {
    let after = text.split_once(name).map(|(_, after)| after.trim_start());
    let inner = after.and_then(|after| after.strip_prefix('(')).and_then(|after| after.split_once(')'));
    // A second parenthesis that opens before the first one closes: the first was truncated.
    let inner = inner.map(|(inner, _)| inner).filter(|inner| !inner.contains('('));
    let inner = inner.ok_or_else(|| format!("{name}(...) missing or truncated"))?;
    Ok(inner.split(',').map(str::trim).collect())
}

/// `BAROMETER:1.9`, `BAROMETER:0.3M`, `BAROMETER(91.2)` or `Hb:1.9`.
fn barometer_m(text: &str) -> Option<f64> {
    let after = text.split_once("BAROMETER").or_else(|| text.split_once("Hb"))?.1;
    leading_number(after.trim_start_matches([':', '(', ' '])).map(|(value, _)| value)
}
