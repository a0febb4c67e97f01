//! Errors of inputs. Every message names the file, and the remedy if there is one.

use std::io;
use std::path::{Path, PathBuf};

use crate::ffi::ffmpeg::FfmpegError;
use crate::files;
use crate::image::ImageError;

/// Rejects anything but regular files: FFmpeg would wait for the writer of a pipe.
///
/// # Errors
/// [`VideoError::Missing`], [`VideoError::Unreadable`].
pub(super) fn regular(path: &Path) -> Result<(), VideoError> {
    files::check(path).map_err(VideoError::unreadable(path))
}

impl VideoError {
    /// Returns the conversion of a system error on reading the path, for `map_err`.
    pub(super) fn unreadable(path: &Path) -> impl Fn(io::Error) -> Self {
        move |source| match source.kind() {
            io::ErrorKind::NotFound => Self::Missing { path: path.to_owned() },
            _ => Self::Unreadable { path: path.to_owned(), source },
        }
    }

    /// Returns true if the machine is at fault, not the input: another run may decode the same frame.
    pub fn is_of_machine(&self) -> bool {
        matches!(self, Self::Thread(_) | Self::Ffmpeg(FfmpegError::Memory))
    }
}

/// Errors of a video or a folder of images.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// The path does not exist.
    #[error("{path}: no such file or folder; check the path", path = path.display())]
    Missing {
        /// The input.
        path: PathBuf,
    },
    /// The operating system refuses to read it.
    #[error("{path}: cannot be read: {source}; check its permissions", path = path.display())]
    Unreadable {
        /// The input.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// A file without content.
    #[error("{path}: empty file; copy or record it again", path = path.display())]
    Empty {
        /// The input.
        path: PathBuf,
    },
    /// No demuxer or decoder accepts the file.
    #[error(
        "{path}: not a video that FFmpeg can read; if players show it, convert it (`ffmpeg -i FILE converted.mp4`), or \
         give a folder of JPEG or PNG images",
        path = path.display()
    )]
    NotAVideo {
        /// The input.
        path: PathBuf,
    },
    /// A list of other files.
    #[error("{path}: playlist ({format}), not a video file; give the video files it names", path = path.display())]
    Playlist {
        /// The input.
        path: PathBuf,
        /// FFmpeg's name of its format.
        format: String,
    },
    /// The requested video track does not exist.
    #[error(
        "{path}: video track {track} does not exist; the file has {count}, counted from 0; give another --video-track, \
         or none",
        path = path.display()
    )]
    NoTrack {
        /// The input.
        path: PathBuf,
        /// Requested track, from 0.
        track: u32,
        /// Number of video tracks.
        count: usize,
    },
    /// An MP4 or MOV file whose index was never written, or is cut off.
    #[error(
        "{path}: recording not finished or file truncated (its index, the moov box, is missing); copy it again, or \
         repair it with a tool that uses an intact reference video from the same camera, such as untrunc",
        path = path.display()
    )]
    NoIndex {
        /// The input.
        path: PathBuf,
    },
    /// A text or telemetry track exceeds the memory limit.
    #[error(
        "{path}: text or telemetry track larger than {limit}, a quarter of the memory limit; raise --memory-limit",
        path = path.display(), limit = crate::memory::in_words(*limit)
    )]
    TextTooLarge {
        /// The input.
        path: PathBuf,
        /// Memory limit, bytes.
        limit: u64,
    },
    /// No video stream.
    #[error("{path}: no video track, {found}; give the video that it belongs to", path = path.display())]
    NoPictures {
        /// The input.
        path: PathBuf,
        /// Kind of file found.
        found: &'static str,
    },
    /// The installed FFmpeg has no decoder for the codec.
    #[error(
        "{path}: no decoder for {coding} in the FFmpeg of this machine; convert the file where there is one (`ffmpeg \
         -i FILE converted.mp4`)",
        path = path.display()
    )]
    NoDecoder {
        /// The input.
        path: PathBuf,
        /// FFmpeg's name of the codec.
        coding: String,
    },
    /// The container is readable, but no frame can be decoded.
    #[error(
        "{path}: no frame could be decoded; the file is damaged or has no images",
        path = path.display()
    )]
    NoFrames {
        /// The input.
        path: PathBuf,
    },
    /// A folder without images.
    #[error("{path}: no readable JPEG or PNG image in the folder: {found}", path = path.display())]
    NoImages {
        /// The input.
        path: PathBuf,
        /// Content found, and the remedy.
        found: String,
    },
    /// The options select no frame.
    #[error(
        "{path}: --start, --end and --every select no frame; the input runs from {first} to {last}",
        path = path.display()
    )]
    NothingChosen {
        /// The input.
        path: PathBuf,
        /// First frame, as text: its time, or its index if no time is known.
        first: String,
        /// The last frame.
        last: String,
    },
    /// Options contradict one another, or one is invalid.
    #[error(transparent)]
    Option(#[from] crate::checks::OptionError),
    /// One frame cannot be decoded.
    #[error("{path}: frame {frame} cannot be decoded: {reason}", path = path.display())]
    Frame {
        /// The file.
        path: PathBuf,
        /// Index in the source.
        frame: u32,
        /// Error of the decoder.
        reason: String,
    },
    /// A frame of another size than the first.
    #[error(
        "{path}: frame {frame} has {found_width}x{found_height} pixels, the first frame {width}x{height}; cut the \
         input where its size changes (--end {frame}f)",
        path = path.display()
    )]
    SizeChanges {
        /// The file.
        path: PathBuf,
        /// Index in the source.
        frame: u32,
        /// Width of the first frame.
        width: u32,
        /// Height of the first frame.
        height: u32,
        /// Width of this frame.
        found_width: u32,
        /// Height of this frame.
        found_height: u32,
    },
    /// An image cannot be resized or converted.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The decoding thread cannot be started.
    #[error("decoding thread cannot be started: {0}; too many threads, or out of memory")]
    Thread(io::Error),
    /// FFmpeg failed for a reason that is not attributed to the input.
    #[error("FFmpeg: {0}")]
    Ffmpeg(#[from] FfmpegError),
}
