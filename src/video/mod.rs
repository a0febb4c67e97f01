//! Frames of a video file or a folder of images, one at a time.
//!
//! A [`Source`] is opened once, [`Source::scan`] lists the frames that the options select, with warnings about the
//! input, and [`Source::frames`] decodes them in the same order. It decodes at most two frames ahead of the caller:
//! memory does not grow with the length of the video. Repeated calls of both give the same frames.
//!
//! Time stamps are the container's, counted from its first frame. Missing or non-increasing ones are rebuilt from the
//! intervals of the preceding frames, with a warning. Images are upright (rotation metadata and EXIF orientation are
//! applied), have square pixels, show one instant (interlaced video), and are no larger than requested. Frames that
//! repeat their predecessor are not listed.
//!
//! Entry point: [`Source::open`]. [`subtitles`] and [`gpmf`](fn@gpmf) read the text and telemetry tracks that some
//! cameras write in addition to the images.

mod cameras;
mod clock;
mod decode;
mod diagnosis;
mod error;
mod exif;
mod fields;
mod file;
mod folder;
mod gpmf;
mod jpeg;
#[cfg(test)]
pub(crate) mod made;
mod mp4;
mod options;
mod prefetch;
mod repeats;
mod shape;
mod source;
mod start;
mod subtitles;
mod survey;
#[cfg(test)]
mod tests;
mod tracks;

pub use cameras::PictureCamera;
pub use error::VideoError;
pub use exif::{CaptureTime, capture_time, focal_px_of_equivalent};
pub use gpmf::{Gpmf, gpmf};
pub use options::{Options, Position, Turning};
pub use prefetch::Frames;
pub use source::{Info, Kind, Scan, Source};
pub use start::stated_start;
pub use subtitles::subtitles;

/// Silences the log output of OpenCV and FFmpeg; errors are returned as [`VideoError`].
///
/// A log level that the user has set for OpenCV in the environment is kept.
pub fn silence_decoders() {
    crate::ffi::environment::set_default(c"OPENCV_LOG_LEVEL", c"SILENT");
    crate::ffi::ffmpeg::silence();
    if std::env::var_os("OPENCV_LOG_LEVEL").is_some_and(|level| level == "SILENT") {
        // The library read the environment when it was loaded, before main. A failure to set the level has no remedy.
        let _ = opencv::core::set_log_level(opencv::core::LogLevel::LOG_LEVEL_SILENT);
    }
}
