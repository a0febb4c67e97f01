//! Errors of the output folder.

use std::io;
use std::path::{Path, PathBuf};

use crate::io::IoError;

/// Reason for not writing into a folder.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// Foreign folder.
    #[error(
        "{}: not empty and not made by {program} (contains {examples}); nothing was changed; give a new or empty \
         folder with --output",
        path.display()
    )]
    NotOwn {
        /// The folder.
        path: PathBuf,
        /// Command that creates such folders.
        program: &'static str,
        /// Examples of its content.
        examples: String,
    },
    /// Foreign files in places of results.
    #[error(
        "{}: {examples} would be overwritten; nothing was changed; move it away or give another --output",
        path.display()
    )]
    InTheWay {
        /// The folder.
        path: PathBuf,
        /// Examples of these files.
        examples: String,
    },
    /// A link inside the folder.
    #[error(
        "{}: {link} is a link, and results are never written through links; nothing was changed; remove the link or \
         give another --output",
        path.display()
    )]
    Link {
        /// The folder.
        path: PathBuf,
        /// The link, relative to it.
        link: String,
    },
    /// Results of another input.
    #[error(
        "{}: contains the results of another input ({}); nothing was changed; give another --output, or --overwrite to \
         replace them",
        path.display(), input.display()
    )]
    OtherInput {
        /// The folder.
        path: PathBuf,
        /// The input whose results are there.
        input: PathBuf,
    },
    /// Input in a place of results.
    #[error(
        "{flag} {}: inside the output folder, where results are written; copy it elsewhere first, or give another \
         --output",
        input.display()
    )]
    OwnInput {
        /// Name of the input's flag.
        flag: String,
        /// The input.
        input: PathBuf,
    },
    /// Single file in a place of a run's results.
    #[error(
        "{}: inside the results folder {}; nothing was changed; give a path outside that folder",
        path.display(), folder.display()
    )]
    PlaceOfResults {
        /// The file.
        path: PathBuf,
        /// The folder of results.
        folder: PathBuf,
    },
    /// Existing single file.
    #[error(
        "{}: exists; nothing was changed; give another name, or --overwrite to replace it",
        path.display()
    )]
    Exists {
        /// The file.
        path: PathBuf,
    },
    /// Another process uses the folder.
    #[error("{}: in use by another tractrix process; wait for it or give another --output", path.display())]
    Busy {
        /// The folder.
        path: PathBuf,
    },
    /// Error of the operating system.
    #[error("{}: not writable: {source}; {}", path.display(), cure(source))]
    System {
        /// The folder or file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// A file cannot be written.
    #[error(transparent)]
    Io(#[from] IoError),
}

fn cure(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "free some space, or give a folder on another disk with --output"
        }
        _ => "give another folder with --output or change its permissions",
    }
}

impl FolderError {
    /// For `map_err`: error of the operating system for the path.
    pub(super) fn system(path: &Path) -> impl Fn(io::Error) -> Self {
        move |source| Self::System { path: path.to_owned(), source }
    }

    /// Returns true if waiting helps: another process uses the folder.
    pub fn is_busy(&self) -> bool {
        matches!(self, Self::Busy { .. })
    }

    /// Returns true if the command line is wrong, so that nothing was started.
    pub fn is_wrong_use(&self) -> bool {
        !matches!(self, Self::Busy { .. } | Self::System { .. } | Self::Io(_))
    }
}
