//! Offset of a local clock from universal time.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Local time minus universal time: `+02:00`, `-03:30`, `Z`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct UtcOffset {
    minutes: i32,
}

/// A text that is no [`UtcOffset`].
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("\u{201c}{text}\u{201d}: expected an offset from UTC, such as +02:00, -03:30 or Z")]
pub struct UtcOffsetError {
    text: String,
}

impl UtcOffset {
    /// Seconds by which the local clock is ahead.
    pub fn seconds(self) -> f64 {
        60.0 * f64::from(self.minutes)
    }
}

impl FromStr for UtcOffset {
    type Err = UtcOffsetError;

    fn from_str(text: &str) -> Result<Self, UtcOffsetError> {
        // Clocks of the world are at most 14 hours ahead of universal time, and 12 behind it.
        let minutes = minutes(text.trim()).filter(|minutes| (-12 * 60..=14 * 60).contains(minutes));
        minutes.map(|minutes| Self { minutes }).ok_or_else(|| UtcOffsetError { text: text.to_owned() })
    }
}

fn minutes(text: &str) -> Option<i32> {
    if text == "Z" {
        return Some(0);
    }
    let (sign, rest) = match text.strip_prefix(['-', '\u{2212}']) {
        Some(rest) => (-1, rest),
        None => (1, text.strip_prefix('+')?),
    };
    let (hours, minutes) = rest.split_once(':').unwrap_or((rest, "00"));
    let number = |digits: &str| {
        let is_number = digits.len() <= 2 && digits.bytes().all(|byte| byte.is_ascii_digit());
        is_number.then(|| digits.parse::<i32>().ok()).flatten()
    };
    let minutes = number(minutes).filter(|minutes| *minutes < 60)?;
    Some(sign * (60 * number(hours)? + minutes))
}

impl fmt::Display for UtcOffset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let sign = if self.minutes < 0 { '-' } else { '+' };
        let minutes = self.minutes.abs();
        write!(f, "{sign}{:02}:{:02}", minutes / 60, minutes % 60)
    }
}

text_in_files!(UtcOffset, UtcOffsetError);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_are_read_and_written_back() {
        for (text, seconds) in
            [("+02:00", 7200.0), ("-03:30", -12_600.0), ("Z", 0.0), ("+5", 18_000.0), ("-00:15", -900.0)]
        {
            let offset: UtcOffset = text.parse().unwrap();
            assert_eq!((offset.seconds(), offset.to_string().parse()), (seconds, Ok(offset)), "{text}");
        }
        for wrong in ["", "2", "02:00", "+2:60", "+15:00", "-13", "+1:2:3", "+a", "+\u{0663}", "++2"] {
            let said = wrong.parse::<UtcOffset>().unwrap_err().to_string();
            assert!(said.contains("+02:00"), "{said}");
        }
    }
}
