//! Quantities with their deviations, as people write them: `1.45±0.05`, `1.45+-0.05`, `4.47`.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

/// A positive value and its standard deviation. In files it is a text.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// Its standard deviation; half of the last digit that was written where none was stated.
    pub std: f64,
}

/// Why a text is no [`Measured`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("“{text}”: expected a positive value with an optional standard deviation, such as 1.45±0.05 or 1.45+-0.05")]
pub struct MeasuredError {
    text: String,
}

impl Measured {
    /// A value and its deviation; `None` if either is not positive and finite.
    pub fn new(value: f64, std: f64) -> Option<Self> {
        let is_positive = |x: f64| x.is_finite() && x > 0.0;
        // Tapes and eyes are not better.
        (is_positive(value) && is_positive(std)).then_some(Self { value, std: std.max(1e-4 * value) })
    }

    /// Mean and standard deviation of the logarithm, to first order.
    pub fn log(&self) -> (f64, f64) {
        (self.value.ln(), self.std / self.value)
    }

    /// `self / other` as a logarithm: metres over units is metres per unit.
    pub fn log_ratio(&self, other: &Self) -> (f64, f64) {
        let ((a, a_std), (b, b_std)) = (self.log(), other.log());
        (a - b, a_std.hypot(b_std))
    }
}

impl FromStr for Measured {
    type Err = MeasuredError;

    fn from_str(text: &str) -> Result<Self, MeasuredError> {
        let wrong = || MeasuredError { text: text.to_owned() };
        let (value, std) = parts(text);
        let std = std.map_or_else(|| Some(half_digit(value)), number).ok_or_else(wrong)?;
        Self::new(number(value).ok_or_else(wrong)?, std).ok_or_else(wrong)
    }
}

text_in_files!(Measured, MeasuredError);

/// Parts of a text before and after the sign of a standard deviation.
fn parts(text: &str) -> (&str, Option<&str>) {
    let parts = text.split_once('±').or_else(|| text.split_once("+-")).or_else(|| text.split_once("+/-"));
    parts.map_or((text, None), |(value, std)| (value, Some(std)))
}

fn number(text: &str) -> Option<f64> {
    text.trim().parse().ok().filter(|number: &f64| number.is_finite())
}

impl fmt::Display for Measured {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}±{}", self.value, self.std)
    }
}

/// The time between the clocks of a log and a video: log = video + this. In files it is a text.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct TimeOffset {
    /// Seconds, of either sign.
    pub mean_s: f64,
    /// Standard deviation, seconds.
    pub std_s: f64,
}

/// Why a text is no [`TimeOffset`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("“{text}”: expected seconds with an optional standard deviation, such as 0.7±0.1 or -3")]
pub struct TimeOffsetError {
    text: String,
}

impl FromStr for TimeOffset {
    type Err = TimeOffsetError;

    fn from_str(text: &str) -> Result<Self, TimeOffsetError> {
        let (mean, std) = parts(text);
        // Without one it is the latency of receivers.
        let std_s = std.map_or(Some(0.2), number).filter(|std| *std > 0.0);
        // Clocks are not compared better than to a frame of a fast video.
        let offset = number(mean).zip(std_s).map(|(mean_s, std_s)| Self { mean_s, std_s: std_s.max(1e-3) });
        offset.ok_or_else(|| TimeOffsetError { text: text.to_owned() })
    }
}

impl fmt::Display for TimeOffset {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}±{}", self.mean_s, self.std_s)
    }
}

text_in_files!(TimeOffset, TimeOffsetError);

/// Half of what the last digit represents: 0.005 of “4.47”.
fn half_digit(text: &str) -> f64 {
    let digits = text.trim().split_once('.').map_or(0, |(_, digits)| digits.len());
    0.5 * 10f64.powi(-i32::try_from(digits.min(12)).unwrap_or(12))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn several_notations_are_parsed() {
        let expected = Measured { value: 1.45, std: 0.05 };
        for text in ["1.45±0.05", "1.45+-0.05", " 1.45 +/- 0.05 "] {
            assert_eq!(text.parse(), Ok(expected), "{text}");
        }
        assert_eq!("4.47".parse(), Ok(Measured { value: 4.47, std: 0.005 }));
        assert_eq!("12".parse(), Ok(Measured { value: 12.0, std: 0.5 }));
        assert_eq!(expected.to_string().parse(), Ok(expected));
        for text in ["", "a", "0±1", "-1±1", "1±0", "1±-1", "NaN", "1±inf", "1e999"] {
            assert!(text.parse::<Measured>().unwrap_err().to_string().contains("1.45±0.05"), "{text}");
        }
    }

    #[test]
    fn offsets_have_either_sign_and_a_deviation() {
        assert_eq!("0.7".parse(), Ok(TimeOffset { mean_s: 0.7, std_s: 0.2 }));
        assert_eq!("-3±1.5".parse(), Ok(TimeOffset { mean_s: -3.0, std_s: 1.5 }));
        assert_eq!("-3+-1.5".parse::<TimeOffset>().unwrap().to_string().parse(), "-3±1.5".parse::<TimeOffset>());
        for text in ["", "soon", "1±0", "1±-1", "NaN", "1±inf", "1e999"] {
            assert!(text.parse::<TimeOffset>().unwrap_err().to_string().contains("0.7±0.1"), "{text}");
        }
    }

    #[test]
    fn in_files_they_are_texts() {
        let measured = Measured { value: 1.45, std: 0.05 };
        let text = serde_json::to_string(&measured).unwrap();
        assert_eq!(text, "\"1.45±0.05\"");
        assert_eq!(serde_json::from_str::<Measured>(&text).unwrap(), measured);
        assert!(serde_json::from_str::<Measured>("\"-1\"").is_err() && serde_json::from_str::<Measured>("7").is_err());
    }

    #[test]
    fn a_ratio_has_both_deviations() {
        let metres = Measured { value: 3.0, std: 0.09 };
        let units = Measured { value: 1.5, std: 0.06 };
        let (log, std) = metres.log_ratio(&units);
        assert!((log.exp() - 2.0).abs() < 1e-12 && (std - 0.05).abs() < 1e-12);
    }
}
