//! Why a run cannot start or go on.

use std::io;
use std::path::{Path, PathBuf};

use crate::checks::OptionError;
use crate::features::FeatureError;
use crate::io::{FolderError, IoError, RunFolder};
use crate::mapper::MapperError;
use crate::memory::TooMuch;
use crate::networks::PerceptionError;
use crate::report::ReportError;
use crate::telemetry::TelemetryError;
use crate::video::VideoError;

/// Result of what a run does.
pub type Result<T, E = PipelineError> = std::result::Result<T, E>;

/// Why a run ends without a result. What concerns single frames or objects is no error: it is counted and reported.
#[derive(Debug, thiserror::Error)]
pub enum PipelineError {
    /// The input.
    #[error(transparent)]
    Video(#[from] VideoError),
    /// Segmentation, flow, tracking.
    #[error(transparent)]
    Perception(#[from] PerceptionError),
    /// Features could not be detected or tracked.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// The mapper refused its input.
    #[error(transparent)]
    Mapper(#[from] MapperError),
    /// The page.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// Telemetry that was named.
    #[error(transparent)]
    Telemetry(#[from] TelemetryError),
    /// A file that is read or written on the way.
    #[error(transparent)]
    Io(#[from] IoError),
    /// The output folder.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// Whoever watches the run has asked it to stop.
    #[error("stopped; the same command resumes")]
    Stopped,
    /// A file of the run's own is damaged.
    #[error(
        "{path}: {reason}; delete {whole}, and the stage that made it runs again",
        path = path.display(), whole = whole_of(path).display()
    )]
    State {
        /// The file.
        path: PathBuf,
        /// Problem.
        reason: String,
    },
    /// A file that the options name cannot be read.
    #[error("{path}: cannot be read: {source}; check the path and its permissions", path = path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The file that `run.json` names is not the one from which the results were made.
    #[error(
        "{path}: not the input of the results in {output}, or changed since the run; nothing was read from it; give \
         the right one with `tractrix export --input FILE`",
        path = path.display(), output = output.display()
    )]
    OtherInput {
        /// The file.
        path: PathBuf,
        /// The output folder.
        output: PathBuf,
    },
    /// The input is more than memory holds.
    #[error(transparent)]
    Memory(#[from] TooMuch),
    /// An option that cannot be worked with.
    #[error(transparent)]
    Option(#[from] OptionError),
    /// The options do not fit to the input.
    #[error("{0}")]
    Options(String),
    /// A thread of live processing.
    #[error("thread cannot be started: {0}")]
    Thread(io::Error),
    /// A line of live processing.
    #[error("result line cannot be written: {0}")]
    Sink(io::Error),
    /// A folder of masks of which none belongs to a frame.
    #[error(
        "{path}: no mask matches a frame; expected PNG files named like the frames, such as '{example}.png', or by \
         frame index",
        path = path.display()
    )]
    NoMasks {
        /// The folder.
        path: PathBuf,
        /// Stem of the first frame's name.
        example: String,
    },
    /// A mask that does not fit its frame.
    #[error(
        "{path}: mask of {found_width}x{found_height} pixels, frames of {width}x{height}{or_source}; give masks at the \
         resolution of the frames, upright",
        path = path.display()
    )]
    MaskSize {
        /// The mask.
        path: PathBuf,
        /// Width of the frames.
        width: u32,
        /// Height of the frames.
        height: u32,
        /// The size before `--max-dimension`, in words, where it differs.
        or_source: String,
        /// Width of the mask.
        found_width: u32,
        /// Height of the mask.
        found_height: u32,
    },
}

impl PipelineError {
    /// Returns true if another process uses the output folder, so that waiting helps.
    pub fn is_busy(&self) -> bool {
        matches!(self, Self::Folder(error) if error.is_busy())
    }

    /// Returns true if the command line is wrong, so that nothing was started.
    pub fn is_wrong_use(&self) -> bool {
        matches!(self, Self::Option(_) | Self::Telemetry(_))
            || matches!(self, Self::Folder(error) if error.is_wrong_use())
    }
}

/// Unit that a stage made together with an intermediate file: a file or folder directly in the run's state.
fn whole_of(path: &Path) -> &Path {
    let is_state = |folder: &Path| folder.file_name().is_some_and(|name| name == RunFolder::STATE);
    path.ancestors().find(|part| part.parent().is_some_and(is_state)).unwrap_or(path)
}
