//! The HTML report: `report.html`, one file that needs no network.
//!
//! [`Data`] holds the results of a run, in the types of [`crate::scene`]; [`render`] turns it into the page. The page
//! is made of `page/report.html` (a template that escapes all its input: file names are hostile),
//! `page/style.css`, `page/page.js` (time, strip, charts) and `page/view3d.js` (the 3D view, on three.js from
//! `third_party/three`). A content security policy inside the page lets run no script but these and load nothing from
//! outside.
//!
//! Everything that grows with the video is thinned to a budget: images of the strip ([`strip_frames`]), points and
//! frames of the 3D view, points of the charts. The page reports omissions.

mod bars;
pub mod benchmark;
mod chart;
pub mod comparison;
mod data;
mod evaluation;
mod measure;
mod metres;
mod motion;
mod overlay;
mod page;
mod pictures;
mod plan;
mod scene;
mod summary;
mod svg;
mod ticks;
mod timeline;
mod travel;
mod verdict;
mod view;
mod words;

#[cfg(test)]
mod testing;

pub use data::{Data, Fact, Missing, Model, Object, Part, Stage};
pub use metres::metres_in_words;
pub use overlay::{Label, Thumbnail, object_colour, overlay, strip_frames};
pub use page::render;
pub use pictures::{Film, PictureMaker, Pictures};
pub use travel::{estimate, ground_track_facts, travel_facts};
pub use verdict::Verdict;

use std::path::PathBuf;

use crate::ffi::ffmpeg::FfmpegError;

/// Errors of the report.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// The file cannot be written.
    #[error("report {}: cannot be written: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// An image of the strip cannot be encoded.
    #[error("image of frame {frame}: cannot be encoded: {source}")]
    Picture {
        /// Index of the frame.
        frame: u32,
        /// Why.
        source: image::ImageError,
    },
    /// OpenCV refuses to shrink an image.
    #[error("image of the report: cannot be shrunk: {0}")]
    Shrink(#[from] crate::image::ImageError),
    /// The film of the page cannot be written.
    #[error("film of the report: cannot be written: {0}")]
    Film(FfmpegError),
    /// The page's template does not match its data: a bug of the program.
    #[error("report template failed: {0}")]
    Template(#[from] minijinja::Error),
    /// A chart cannot be laid out.
    #[error("chart: cannot be laid out: {0}")]
    Chart(String),
}
