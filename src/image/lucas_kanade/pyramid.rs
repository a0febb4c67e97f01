//! A picture at several sizes.

use ::image::GrayImage;
use opencv::core::{BORDER_DEFAULT, Mat, Size};

use crate::image::{ImageError, borrowed_gray, gray_from_mat};

/// A picture and smaller ones, each half as wide and high as the one before. Every second pixel of each, smoothed over
/// 5 × 5 pixels, is one of the next (P. Burt, E. Adelson, 1983): the first pixels have their centres at the same place.
#[derive(Clone, Debug)]
pub struct Pyramid {
    levels: Vec<GrayImage>,
}

impl Pyramid {
    /// Of a picture with at most so many smaller ones above it.
    ///
    /// # Errors
    /// [`ImageError::OpenCv`] if OpenCV fails.
    pub fn new(picture: GrayImage, num_smaller: usize) -> Result<Self, ImageError> {
        let mut levels = vec![picture];
        while levels.len() <= num_smaller {
            // A picture with a side below 8 pixels shows nothing.
            let Some(last) = levels.last().filter(|last| last.width().min(last.height()) >= 2 * 8) else {
                break;
            };
            let mut half = Mat::default();
            opencv::imgproc::pyr_down(&borrowed_gray(last)?, &mut half, Size::default(), BORDER_DEFAULT)?;
            levels.push(gray_from_mat(&half)?);
        }
        Ok(Self { levels })
    }

    /// The picture itself.
    pub fn picture(&self) -> &GrayImage {
        &self.levels[0]
    }

    /// The picture and the smaller ones, at most so many of these.
    pub(super) fn up_to(&self, num_smaller: usize) -> &[GrayImage] {
        &self.levels[..self.levels.len().min(num_smaller.saturating_add(1))]
    }
}
