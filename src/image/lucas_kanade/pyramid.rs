//! Image pyramid.

use ::image::GrayImage;
use opencv::core::{BORDER_DEFAULT, Mat, Size};

use crate::image::{ImageError, borrowed_gray, gray_from_mat};

/// An image and smaller ones, each half as wide and high as the one before.
///
/// Every second pixel of each, smoothed over 5 × 5 pixels, is one of the next (P. Burt, E. Adelson, 1983). The centers
/// of the first pixels coincide.
#[derive(Clone, Debug)]
pub struct Pyramid {
    levels: Vec<GrayImage>,
}

impl Pyramid {
    /// Pyramid of an image with at most `num_smaller` smaller ones.
    ///
    /// # Errors
    /// [`ImageError::OpenCv`] if OpenCV fails.
    pub fn new(picture: GrayImage, num_smaller: usize) -> Result<Self, ImageError> {
        let mut levels = vec![picture];
        while levels.len() <= num_smaller {
            // An image with a side below 8 pixels has no usable texture.
            let Some(last) = levels.last().filter(|last| last.width().min(last.height()) >= 2 * 8) else {
                break;
            };
            let mut half = Mat::default();
            opencv::imgproc::pyr_down(&borrowed_gray(last)?, &mut half, Size::default(), BORDER_DEFAULT)?;
            levels.push(gray_from_mat(&half)?);
        }
        Ok(Self { levels })
    }

    /// Image at full size.
    pub fn picture(&self) -> &GrayImage {
        &self.levels[0]
    }

    /// Image at full size and at most `num_smaller` smaller ones.
    pub(super) fn up_to(&self, num_smaller: usize) -> &[GrayImage] {
        &self.levels[..self.levels.len().min(num_smaller.saturating_add(1))]
    }
}
