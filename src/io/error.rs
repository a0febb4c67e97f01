//! Errors of files.

use std::path::{Path, PathBuf};

/// A file that cannot be read or written, or that does not hold what it should; every variant names it.
#[derive(Debug, thiserror::Error)]
pub enum IoError {
    /// The operating system refuses.
    #[error("cannot {action} {}", path.display())]
    System {
        /// Attempted action: `read`, `write`, `replace`, …
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A line of a text file is wrong.
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
    /// A binary file breaks off, or holds an impossible value.
    #[error("{}, byte {offset}: {field}: {problem}", path.display())]
    Byte {
        /// The file.
        path: PathBuf,
        /// Where the field starts.
        offset: usize,
        /// The field at fault.
        field: String,
        /// Problem.
        problem: String,
    },
    /// The file is whole, but its content does not hold together.
    #[error("{}: {problem}", path.display())]
    Content {
        /// The file or folder.
        path: PathBuf,
        /// Problem, with its entry.
        problem: String,
    },
    /// The file is valid, but uses something that this program does not do.
    #[error("{}: {what} is not supported; {cure}", path.display())]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// Unsupported feature.
        what: String,
        /// Remedy.
        cure: String,
    },
    /// A picture of another size than the frame that it belongs to.
    #[error(
        "{}: image of {}×{} pixels, its frame has {}×{}",
        path.display(), found.0, found.1, expected.0, expected.1
    )]
    WrongSize {
        /// The picture.
        path: PathBuf,
        /// Width and height of the frame.
        expected: (u32, u32),
        /// Width and height of the picture.
        found: (u32, u32),
    },
}

impl IoError {
    /// For `map_err`: the system refuses to `action` (read, write, …) the path.
    pub fn system(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::System { action, path, source }
    }

    /// A line of a text file is wrong.
    pub fn line(path: &Path, line: usize, field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::Line { path: path.to_path_buf(), line, field: field.into(), problem: problem.into() }
    }

    /// The content of `path` does not hold together.
    pub fn content(path: &Path, problem: impl Into<String>) -> Self {
        Self::Content { path: path.to_path_buf(), problem: problem.into() }
    }

    /// `path` is valid, but `what` in it is something that this program does not do; `cure` is the remedy.
    pub fn unsupported(path: &Path, what: impl Into<String>, cure: impl Into<String>) -> Self {
        Self::Unsupported { path: path.to_path_buf(), what: what.into(), cure: cure.into() }
    }

    /// Returns true if the file or folder does not exist.
    pub fn is_not_found(&self) -> bool {
        matches!(self, Self::System { source, .. } if source.kind() == std::io::ErrorKind::NotFound)
    }
}
