//! Checks of option values, with errors that name the option, and of characters that are shown ([`text`]).
//!
//! A room checks its own options with these and names each by its key. Whoever nests the options of others puts the key
//! before which they stand ([`under`]), so that an error names the whole path in the tree of options.

#[cfg(test)]
pub(crate) mod testing;
pub mod text;

use std::fmt::Debug;
use std::ops::RangeInclusive;

use thiserror::Error;

/// An option that cannot be worked with.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("option {key}: {reason}")]
pub struct OptionError {
    /// Path of keys, separated by dots.
    pub key: String,
    /// Problem of the value.
    pub reason: String,
}

impl OptionError {
    /// Says what is wrong with an option.
    pub fn new(key: impl Into<String>, reason: impl Into<String>) -> Self {
        Self { key: key.into(), reason: reason.into() }
    }
}

/// Result of an option's check.
pub type Checked = Result<(), OptionError>;

/// A value must lie in a range, its ends included; NaN lies in none.
///
/// # Errors
/// [`OptionError`] names both ends.
pub fn within<T: PartialOrd + Debug>(key: &str, value: T, range: RangeInclusive<T>) -> Checked {
    if range.contains(&value) {
        return Ok(());
    }
    let (least, most) = range.into_inner();
    Err(OptionError::new(key, format!("{value:?}: expected {least:?} to {most:?}")))
}

/// A value must not be above another one.
///
/// # Errors
/// [`OptionError`] names both.
pub fn ordered<T: PartialOrd + Debug>((key, value): (&str, T), (other, limit): (&str, T)) -> Checked {
    if value <= limit {
        return Ok(());
    }
    Err(OptionError::new(key, format!("{value:?}: larger than {other} = {limit:?}")))
}

/// A list must name something.
///
/// # Errors
/// [`OptionError`] if it is empty.
pub fn some_of<T>(key: &str, list: &[T]) -> Checked {
    match list {
        [] => Err(OptionError::new(key, "empty list: nothing would be detected")),
        _ => Ok(()),
    }
}

/// The check of options that stand under a key.
///
/// # Errors
/// What was found, with the key before it.
pub fn under(key: &str, checked: Checked) -> Checked {
    checked.map_err(|error| OptionError { key: format!("{key}.{}", error.key), ..error })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_path_the_value_and_the_limits() {
        let inner = within("max_error_px", f64::NAN, 0.1..=10.0);
        let said = under("scale", under("joint", inner)).unwrap_err().to_string();
        assert_eq!(said, "option scale.joint.max_error_px: NaN: expected 0.1 to 10.0");
        assert_eq!(within("n", 3, 3..=3), Ok(()));
        assert!(within("n", 1e300, 0.0..=1.0).unwrap_err().reason.starts_with("1e300: expected"));
    }

    #[test]
    fn pairs_are_in_order() {
        assert_eq!(ordered(("least", 1.0), ("most", 1.0)), Ok(()));
        let said = ordered(("least", 2.0), ("most", 1.0)).unwrap_err().to_string();
        assert_eq!(said, "option least: 2.0: larger than most = 1.0");
        assert!(ordered(("least", f64::NAN), ("most", 1.0)).is_err());
    }

    #[test]
    fn an_empty_list_is_refused() {
        assert!(some_of::<u8>("classes", &[]).is_err());
        assert!(some_of("classes", &["car"]).is_ok());
    }
}
