//! Reading JSON, with errors that say where.

use std::path::Path;

use serde::de::DeserializeOwned;

use super::IoError;
use crate::files;

/// Reads a JSON file as a value.
///
/// # Errors
/// [`IoError::Line`] with line and column if it is not JSON or not of this shape.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T, IoError> {
    let bytes = files::read_text(path).map_err(IoError::system("read", path))?;
    serde_json::from_slice(&bytes).map_err(|e| IoError::Line {
        path: path.to_path_buf(),
        line: e.line(),
        field: format!("column {}", e.column()),
        problem: without_place(&e.to_string()),
    })
}

/// As [`read()`], for a file of another program: the error says what it was taken for.
///
/// # Errors
/// As [`read()`].
pub fn read_model<T: DeserializeOwned>(path: &Path, kind: &str) -> Result<T, IoError> {
    read(path).map_err(|error| match error {
        IoError::Line { path, line, field, problem } => {
            IoError::Line { path, line, field, problem: format!("not valid in {kind}: {problem}") }
        }
        other => other,
    })
}

/// Refuses a file of a version that is not known.
///
/// # Errors
/// [`IoError::Unsupported`].
pub fn check_version(path: &Path, found: u32, known: u32) -> Result<(), IoError> {
    if found == known {
        return Ok(());
    }
    Err(IoError::Unsupported {
        path: path.to_path_buf(),
        what: format!("version {found}"),
        cure: format!("write it as version {known}"),
    })
}

/// serde_json ends its messages with the place, which the error says already.
fn without_place(message: &str) -> String {
    message.rsplit_once(" at line ").map_or(message, |(text, _)| text).to_string()
}
