//! Errors of files.

use std::path::{Path, PathBuf};

/// Error of reading or writing a file, or of its content; every variant names the file.
#[derive(Debug, thiserror::Error)]
pub enum IoError {
    /// Error of the operating system.
    #[error("cannot {action} {}", path.display())]
    System {
        /// Attempted action: `read`, `write`, `replace`, …
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// Reason given by the system.
        source: std::io::Error,
    },
    /// Invalid line of a text file.
    #[error("{}, line {line}: {field}: {problem}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line number, from 1.
        line: usize,
        /// The field at fault.
        field: String,
        /// Problem.
        problem: String,
    },
    /// Truncated binary file, or impossible value in it.
    #[error("{}, byte {offset}: {field}: {problem}", path.display())]
    Byte {
        /// The file.
        path: PathBuf,
        /// Start of the field.
        offset: usize,
        /// The field at fault.
        field: String,
        /// Problem.
        problem: String,
    },
    /// Complete file with inconsistent content.
    #[error("{}: {problem}", path.display())]
    Content {
        /// The file or folder.
        path: PathBuf,
        /// Problem, with its entry.
        problem: String,
    },
    /// Valid file with an unsupported feature.
    #[error("{}: {what} is not supported; {cure}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// Unsupported feature.
        what: String,
        /// Remedy.
        cure: String,
    },
    /// Image of another size than its frame.
    #[error(
        "{}: image of {}×{} pixels, its frame has {}×{}",
        path.display(), found.0, found.1, expected.0, expected.1
    )]
    WrongSize {
        /// The image.
        path: PathBuf,
        /// Width and height of the frame.
        expected: (u32, u32),
        /// Width and height of the image.
        found: (u32, u32),
    },
}

impl IoError {
    /// For `map_err`: the system cannot `action` (read, write, …) the path.
    pub fn system(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::System { action, path, source }
    }

    /// Creates the error of an invalid line of a text file.
    pub fn line(path: &Path, line: usize, field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Line { path: path.to_path_buf(), line, field: field.into(), problem: problem.into() }
    }

    /// Creates the error of inconsistent content of `path`.
    pub fn content(path: &Path, problem: impl Into<String>) -> Self {
        Self::Content { path: path.to_path_buf(), problem: problem.into() }
    }

    /// Creates the error of a valid `path` with an unsupported feature `what`; `cure` is the remedy.
    pub fn unsupported(path: &Path, what: impl Into<String>, cure: impl Into<String>) -> Self {
        Self::Unsupported { path: path.to_path_buf(), what: what.into(), cure: cure.into() }
    }

    /// Returns true if the file or folder does not exist.
    pub fn is_not_found(&self) -> bool {
        matches!(self, Self::System { source, .. } if source.kind() == std::io::ErrorKind::NotFound)
    }
}
