//! A positive quantity with its deviation, as people write it: `1.45±0.05`, `1.45+-0.05`, `4.47`.

use std::fmt;
use std::str::FromStr;

/// A positive value and its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// The value.
    pub value: f64,
    /// Its standard deviation; half of the last digit that was written where none was stated.
    pub std: f64,
}

/// Why a text is no [`Measured`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("“{text}” is no positive value with a deviation; write it as 1.45±0.05 or 1.45+-0.05")]
pub struct MeasuredError {
    text: String,
}

/// A value cannot be known better than this share of it: tapes and eyes.
const LEAST_SHARE: f64 = 1e-4;

impl Measured {
    /// A value and its deviation; `None` if either is not positive and finite.
    pub fn new(value: f64, std: f64) -> Option<Self> {
        let is_positive = |x: f64| x.is_finite() && x > 0.0;
        (is_positive(value) && is_positive(std)).then_some(Self { value, std: std.max(LEAST_SHARE * value) })
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
        let parts = text.split_once('±').or_else(|| text.split_once("+-")).or_else(|| text.split_once("+/-"));
        let (value, std) = match parts {
            Some((value, std)) => (value, Some(std)),
            None => (text, None),
        };
        let number = |text: &str| text.trim().parse::<f64>().map_err(|_| wrong());
        let std = std.map_or_else(|| Ok(half_digit(value)), number)?;
        Self::new(number(value)?, std).ok_or_else(wrong)
    }
}

impl fmt::Display for Measured {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}±{}", self.value, self.std)
    }
}

/// Half of what the last digit stands for: 0.005 of “4.47”.
fn half_digit(text: &str) -> f64 {
    let digits = text.trim().split_once('.').map_or(0, |(_, digits)| digits.len());
    0.5 * 10f64.powi(-i32::try_from(digits.min(12)).unwrap_or(12))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn people_write_it_in_several_ways() {
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
    fn a_ratio_has_both_deviations() {
        let metres = Measured { value: 3.0, std: 0.09 };
        let units = Measured { value: 1.5, std: 0.06 };
        let (log, std) = metres.log_ratio(&units);
        assert!((log.exp() - 2.0).abs() < 1e-12 && (std - 0.05).abs() < 1e-12);
    }
}
