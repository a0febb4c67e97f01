//! Frames out of a video file or a folder of images, one at a time.
//!
//! A [`Source`] is opened once, [`Source::scan`] lists the frames that the options choose (with what was wrong with the
//! input, in words), and [`Source::frames`] decodes them in the same order, two ahead of the caller and never more:
//! memory does not grow with the length of the video. Both may be called again; they give the same frames every time.
//!
//! Time stamps are the container's, counted from its first picture. Those that are missing or do not rise are rebuilt
//! from the pace of the frames before, with a warning. Pictures come upright (rotation metadata and EXIF orientation
//! are applied), with square pixels, of one instant (interlaced video), and no larger than asked for. Frames that
//! repeat the one before are not listed.
//!
//! Entry point: [`Source::open`]. [`subtitles`] and [`gpmf`](fn@gpmf) read the text and telemetry tracks that some
//! cameras write next to the pictures.

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
pub use exif::{Taken, focal_px_of_equivalent, taken};
pub use gpmf::{Gpmf, gpmf};
pub use options::{Options, Position, Turning};
pub use prefetch::Frames;
pub use source::{Info, Kind, Scan, Source};
pub use start::stated_start;
pub use subtitles::subtitles;

/// Silences what OpenCV and FFmpeg print by themselves; what is wrong comes back as a [`VideoError`]. A level that the
/// user set for OpenCV in the environment is left alone.
pub fn silence_decoders() {
    crate::ffi::environment::set_default(c"OPENCV_LOG_LEVEL", c"SILENT");
    crate::ffi::ffmpeg::silence();
    if std::env::var_os("OPENCV_LOG_LEVEL").is_some_and(|level| level == "SILENT") {
        // The library read the environment when it was loaded, before main. Without an effect there is nothing to mend.
        let _ = opencv::core::set_log_level(opencv::core::LogLevel::LOG_LEVEL_SILENT);
    }
}
