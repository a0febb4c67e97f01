//! Reading of JSON with errors that have line and column; JSON schemas of files.

use std::path::Path;

use schemars::generate::SchemaSettings;
use schemars::transform::{RecursiveTransform, Transform};
use schemars::{JsonSchema, Schema};
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::IoError;
use crate::files;

/// Reads a JSON file as a value.
///
/// # Errors
/// [`IoError::Line`] with line and column if it is not JSON or has another structure.
pub fn read<T: DeserializeOwned>(path: &Path) -> Result<T, IoError> {
    let bytes = files::read_text(path).map_err(IoError::system("read", path))?;
    serde_json::from_slice(&bytes).map_err(|e| error(path, &e, without_place(&e.to_string())))
}

/// Error at a position in a JSON file.
pub(super) fn error(path: &Path, place: &serde_json::Error, problem: impl Into<String>) -> IoError {
    IoError::line(path, place.line(), format!("column {}", place.column()), problem)
}

/// As [`read()`], for a file of another program: the error names the expected format.
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

/// Refuses a file of an unknown version.
///
/// # Errors
/// [`IoError::Unsupported`].
pub fn check_version(path: &Path, found: u32, known: u32) -> Result<(), IoError> {
    if found == known {
        return Ok(());
    }
    Err(IoError::unsupported(path, format!("version {found}"), format!("write it as version {known}")))
}

/// JSON schema (draft 2020-12) of the values of a type as they are written, from its definition and documentation.
pub fn schema_of<T: JsonSchema>() -> Schema {
    let generator = SchemaSettings::draft2020_12().for_serialize().into_generator();
    let mut schema = generator.into_root_schema_for::<T>();
    RecursiveTransform(without_rust).transform(&mut schema);
    schema
}

/// Removes the links and names of Rust's documentation from a description.
fn without_rust(schema: &mut Schema) {
    if let Some(Value::String(text)) = schema.get_mut("description") {
        *text = plain(text);
    }
}

fn plain(text: &str) -> String {
    let mut parts = text.split("`](");
    let mut plain = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        // The target of a link ends with the parenthesis.
        plain += "`";
        plain += part.split_once(')').map_or(part, |(_, rest)| rest);
    }
    plain.replace("[`", "`").replace("`]", "`").replace("`None`", "null").replace('\n', " ")
}

/// Removes the position at the end of a serde_json message, which the error already has.
fn without_place(message: &str) -> String {
    message.rsplit_once(" at line ").map_or(message, |(text, _)| text).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn descriptions_are_without_rust() {
        assert_eq!(
            plain("At [`CLEAR`](super::CLEAR) or [`more`]; `None` where\nunknown"),
            "At `CLEAR` or `more`; null where unknown"
        );
    }
}
