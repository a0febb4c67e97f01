//! A length of a vehicle that somebody knows: `1:length=4.47±0.02`.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::{Dimension, Measured};
use crate::scene::ObjectId;

/// A dimension of an object, in metres. In files it is a text.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct KnownLength {
    /// The object.
    pub object: ObjectId,
    /// Known dimension.
    pub dimension: Dimension,
    /// Metres.
    pub length: Measured,
}

/// Why a text is no [`KnownLength`].
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum KnownLengthError {
    /// Another form.
    #[error("“{text}”: expected ID:length=4.47±0.02, with length, width or height and an id of 1 or larger")]
    Form {
        /// Text as written.
        text: String,
    },
    /// A wheel base.
    #[error("wheelbase cannot be measured, since wheels are not detected; give length, width or height")]
    WheelBase,
}

impl FromStr for KnownLength {
    type Err = KnownLengthError;

    fn from_str(text: &str) -> Result<Self, KnownLengthError> {
        let form = || KnownLengthError::Form { text: text.to_owned() };
        let (id, rest) = text.split_once(':').ok_or_else(form)?;
        let (name, length) = rest.split_once('=').ok_or_else(form)?;
        let id: u32 = id.trim().parse().ok().filter(|id| *id > 0).ok_or_else(form)?;
        let dimension = match name.trim() {
            "wheelbase" | "wheel-base" => return Err(KnownLengthError::WheelBase),
            name => Dimension::ALL.into_iter().find(|dimension| dimension.name() == name).ok_or_else(form)?,
        };
        Ok(Self { object: ObjectId(id), dimension, length: length.parse().map_err(|_| form())? })
    }
}

impl fmt::Display for KnownLength {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}={}", self.object, self.dimension.name(), self.length)
    }
}

text_in_files!(KnownLength, KnownLengthError);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_lengths_are_parsed() {
        let found: KnownLength = "2:width=1.83±0.02".parse().unwrap();
        assert_eq!((found.object, found.dimension), (ObjectId(2), Dimension::Width));
        assert_eq!(found.to_string().parse(), Ok(found));
        for text in ["", "4.47", "length=4.47", "0:length=4.47", "1:depth=3", "1:length=-3", "1:length", "a:length=4"] {
            assert!(text.parse::<KnownLength>().unwrap_err().to_string().contains("ID:length=4.47"), "{text}");
        }
        assert_eq!("1:wheelbase=2.6".parse::<KnownLength>(), Err(KnownLengthError::WheelBase));
    }
}
