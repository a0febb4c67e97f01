//! Errors of exports.

use std::path::PathBuf;

use crate::ffi::ffmpeg::FfmpegError;
use crate::image::ImageError;
use crate::io::{FolderError, IoError};
use crate::video::VideoError;

/// Error of an export.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// Access to a file failed.
    #[error(transparent)]
    Io(#[from] IoError),
    /// The target folder is unusable.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// Access to the input's images failed.
    #[error(transparent)]
    Video(#[from] VideoError),
    /// An image cannot be processed.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The folder has no result.
    #[error("{}: not an output folder of `tractrix run` or `tractrix sfm` with a result", path.display())]
    NoResult {
        /// The folder.
        path: PathBuf,
    },
    /// Meters or times are not known.
    #[error(
        "{wanted}: no speeds in m/s; run again with a source of meters, such as --camera-height, and --fps for \
         a folder of images"
    )]
    NoMeters {
        /// Command or format that needs them.
        wanted: String,
    },
    /// Universal time is not known.
    #[error(
        "--format cot: no dates in universal time; run again with --utc-offset \u{b1}HH:MM if the log's clock has no \
         zone, or with a log that has dates"
    )]
    NoUtc,
    /// The results, or the formats, do not allow it.
    #[error("{0}")]
    Obstacle(String),
    /// The input cannot be read.
    #[error(
        "images required but not available: {reason}; if the video or folder was moved, give its path with --input"
    )]
    NoPictures {
        /// Why.
        reason: String,
    },
    /// The input does not match the results.
    #[error(
        "{}: does not match the video of these results ({problem}); give the right video or folder with --input",
        path.display()
    )]
    OtherInput {
        /// The input.
        path: PathBuf,
        /// Mismatch.
        problem: String,
    },
    /// The video cannot be encoded.
    #[error("{}: encoding failed: {source}", path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// Why.
        source: FfmpegError,
    },
    /// Data too large for the format.
    #[error("{}: {problem}", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// What.
        problem: String,
    },
}
