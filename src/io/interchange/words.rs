//! Reading of text files whose fields are separated by blanks and line ends alike, with errors that name the position.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use crate::files;
use crate::io::IoError;

/// Text file in memory.
pub struct Text {
    path: PathBuf,
    content: String,
}

/// Position in the text.
pub struct Words<'a> {
    path: &'a Path,
    rest: &'a str,
    /// Line of the word read last, from 1.
    line: usize,
}

impl Text {
    pub fn read_file(path: &Path) -> Result<Self, IoError> {
        let bytes = files::read_text(path).map_err(IoError::system("read", path))?;
        let content = String::from_utf8(bytes).map_err(|_| IoError::content(path, "not a text file (UTF-8)"))?;
        Ok(Self::new(path, content))
    }

    pub fn new(path: &Path, content: String) -> Self {
        Self { path: path.to_path_buf(), content }
    }

    pub fn words(&self) -> Words<'_> {
        Words { path: &self.path, rest: &self.content, line: 1 }
    }

    /// The lines that are neither empty nor comments (`#`), with their numbers from 1.
    pub fn records(&self) -> impl Iterator<Item = (usize, &str)> {
        let lines = self.content.lines().enumerate().map(|(idx, line)| (idx + 1, line.trim()));
        lines.filter(|(_, line)| !line.is_empty() && !line.starts_with('#'))
    }

    /// Creates an error about a line.
    pub fn error(&self, line: usize, field: &str, problem: impl Into<String>) -> IoError {
        IoError::line(&self.path, line, field, problem)
    }
}

impl<'a> Words<'a> {
    /// Creates an error about the word read last.
    pub fn error(&self, field: &str, problem: impl Into<String>) -> IoError {
        IoError::line(self.path, self.line, field, problem)
    }

    pub fn word(&mut self, field: &str) -> Result<&'a str, IoError> {
        let start = self.rest.find(|c: char| !c.is_whitespace()).unwrap_or(self.rest.len());
        let (blank, rest) = self.rest.split_at(start);
        self.line += blank.matches('\n').count();
        let end = rest.find(char::is_whitespace).unwrap_or(rest.len());
        let (word, rest) = rest.split_at(end);
        self.rest = rest;
        if word.is_empty() { Err(self.error(field, "the file ends here")) } else { Ok(word) }
    }

    pub fn number<T: FromStr>(&mut self, field: &str) -> Result<T, IoError> {
        let word = self.word(field)?;
        word.parse().map_err(|_| self.error(field, format!("'{word}' is not a number in the valid range")))
    }

    pub fn finite(&mut self, field: &str) -> Result<f64, IoError> {
        let value: f64 = self.number(field)?;
        if value.is_finite() { Ok(value) } else { Err(self.error(field, "not a finite number")) }
    }

    pub fn finites<const N: usize>(&mut self, field: &str) -> Result<[f64; N], IoError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.finite(field)?;
        }
        Ok(values)
    }

    /// Reads a count of records of at least `min_bytes` each, bounded by the rest of the file.
    pub fn count(&mut self, field: &str, min_bytes: usize) -> Result<usize, IoError> {
        let count: usize = self.number(field)?;
        if count <= self.rest.len() / min_bytes {
            return Ok(count);
        }
        Err(self
            .error(field, format!("{count} entries do not fit in the rest of the file; it is truncated or damaged")))
    }

    /// Returns the rest of the line.
    pub fn rest_of_line(&mut self) -> &'a str {
        let end = self.rest.find('\n').unwrap_or(self.rest.len());
        let (line, rest) = self.rest.split_at(end);
        self.rest = rest;
        line.trim()
    }
}
