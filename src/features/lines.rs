//! Straight lines of an image.

use ::image::RgbImage;
use nalgebra::Point2;

use crate::image::{ImageError, gray_from_rgb, line_segments};
use crate::scene::ImageId;

/// Minimum length of a segment, as a share of the longer side of the image: 24 px of 960.
const MIN_LENGTH: f64 = 0.025;

/// Straight lines of an image.
#[derive(Clone, Debug)]
pub struct ImageLines {
    /// The image.
    pub image: ImageId,
    /// Both ends of each segment, pixels.
    pub segments: Vec<[Point2<f64>; 2]>,
}

impl ImageLines {
    /// Detects the line segments of an image.
    ///
    /// # Errors
    /// Those of [`line_segments`].
    pub fn of(picture: &RgbImage, image: ImageId) -> Result<Self, ImageError> {
        let min_length_px = MIN_LENGTH * f64::from(picture.width().max(picture.height()));
        Ok(Self { image, segments: line_segments(&gray_from_rgb(picture)?, min_length_px)? })
    }
}
