//! `GPS(W: -34.5670, N: 12.3450, 100) ReH:20`: Autel's dialect, with a letter before every angle.
//!
//! Letters and signs are both written: a letter determines the sign of a positive number only.

use super::super::coordinate;
use super::super::fix::Fix;
use super::super::text::leading_number;
use super::calls::inside;

pub(super) fn recognizes(text: &str) -> bool {
    inside(text, "GPS").is_ok_and(|parts| parts.len() > 1 && parts[..2].iter().all(|part| lettered(part).is_some()))
}

pub(super) fn read(text: &str, line: usize) -> Result<Fix, String> {
    let parts = inside(text, "GPS")?;
    let angle = |letters: [char; 2]| {
        let mut lettered = parts.iter().filter_map(|part| lettered(part));
        let (letter, value) = lettered.find(|(letter, _)| letters.contains(letter))?;
        let is_negative = letter == letters[1] && !value.starts_with('-');
        Some(if is_negative { format!("-{value}") } else { value.to_owned() })
    };
    let (longitude, latitude) = (angle(['E', 'W']).unwrap_or_default(), angle(['N', 'S']).unwrap_or_default());
    let height = text.split_once("ReH:").and_then(|(_, after)| leading_number(after));
    let fix = Fix::at(line, coordinate::position(&longitude, &latitude)?);
    Ok(Fix { relative_height_m: height.map(|(height_m, _)| height_m), ..fix })
}

/// Letter and number of `W: -34.5670`.
fn lettered(part: &str) -> Option<(char, &str)> {
    let (letter, value) = part.split_once(':')?;
    let letter = letter.trim().chars().next().filter(|_| letter.trim().len() == 1)?;
    matches!(letter, 'E' | 'W' | 'N' | 'S').then_some((letter, value.trim()))
}
