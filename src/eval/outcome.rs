//! A figure that may be unavailable.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A figure, or why there is none. In JSON, `"status"` is `"ok"` or `"unavailable"`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "status", rename_all = "kebab-case")]
pub enum Outcome<T> {
    /// It could be computed.
    Ok(T),
    /// It could not.
    Unavailable {
        /// Why.
        reason: String,
    },
}

impl<T> Outcome<T> {
    /// As a `Result`, the reason as its error.
    pub fn as_ref(&self) -> Result<&T, &str> {
        match self {
            Self::Ok(value) => Ok(value),
            Self::Unavailable { reason } => Err(reason),
        }
    }
}

impl<T> From<Result<T, String>> for Outcome<T> {
    fn from(result: Result<T, String>) -> Self {
        match result {
            Ok(value) => Self::Ok(value),
            Err(reason) => Self::Unavailable { reason },
        }
    }
}
