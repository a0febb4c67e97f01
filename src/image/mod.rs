//! Pixel buffers, and their conversion to and from OpenCV.
//!
//! Frames are [`RgbImage`] and [`GrayImage`] of the `image` crate, whose rows are contiguous. Callers of OpenCV convert
//! them to a `Mat` and back by this module. The `mat_*` functions copy: the `Mat` owns its pixels. [`borrowed_gray`]
//! and [`borrowed_rgb`] do not copy, and borrow from their source.
//!
//! Channel order is red, green, blue in both libraries unless a name contains `bgr`.

mod canvas;
mod corners;
mod degrade;
mod line_segments;
mod lucas_kanade;
mod opencv_mat;
mod picture;
mod resize;

use std::num::TryFromIntError;

pub use self::canvas::{Canvas, Plate};
pub use self::corners::CornerStrength;
pub use self::degrade::{blurred, noisy};
pub use self::line_segments::line_segments;
pub use self::lucas_kanade::{LucasKanade, Pyramid, Returned, TrackedPoint};
pub use self::opencv_mat::{borrowed_gray, borrowed_rgb, gray_from_mat, mat_from_gray, mat_from_rgb, rgb_from_mat};
pub use self::picture::Picture;
pub use self::resize::{gray_from_rgb, resize_gray, resize_rgb, resize_rgb_quickly, scale_to_fit, warp_gray, warp_rgb};
pub use ::image::{GrayImage, RgbImage};

/// Errors of pixel buffers.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// OpenCV failed; its message names the failed check.
    #[error("OpenCV: {0}")]
    OpenCv(#[from] opencv::Error),
    /// A side is beyond what OpenCV can index.
    #[error("image side {0}: larger than 2^31 - 1 pixels")]
    Side(#[from] TryFromIntError),
    /// The size of a buffer does not match width, height and channels.
    #[error("pixel buffer of {found} values does not match {width}x{height} with {channels} channel(s)")]
    BufferSize {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Values per pixel.
        channels: u32,
        /// Values in the buffer.
        found: usize,
    },
    /// A matrix holds another pixel type than the target.
    #[error("OpenCV matrix of type {found} cannot be converted to an image of type {expected}")]
    PixelType {
        /// OpenCV's number of the expected type.
        expected: i32,
        /// OpenCV's number of the actual type.
        found: i32,
    },
}

/// Index into a non-empty row, mirrored at its ends.
#[inline(always)]
fn mirrored(index: i64, len: usize) -> usize {
    let last = len as i64 - 1;
    let index = index.abs();
    (if index > last { 2 * last - index } else { index }).clamp(0, last) as usize
}
