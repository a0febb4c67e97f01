//! A frame for several front ends.

use std::cell::OnceCell;
use std::sync::Arc;

use crate::features::FeatureError;
use crate::image::{Pyramid, RgbImage, gray_from_rgb};

/// A frame, and its gray pyramid from the first use on: the points of all vehicles are tracked in the same one.
pub struct Picture<'a> {
    rgb: &'a RgbImage,
    pyramid: OnceCell<(usize, Arc<Pyramid>)>,
}

impl<'a> Picture<'a> {
    /// Of an image.
    pub fn new(rgb: &'a RgbImage) -> Self {
        Self { rgb, pyramid: OnceCell::new() }
    }

    /// The image.
    pub fn rgb(&self) -> &'a RgbImage {
        self.rgb
    }

    /// The gray pyramid with some smaller images. The number of the first call is that of all front ends of a kind;
    /// another one gets a pyramid of its own.
    ///
    /// # Errors
    /// [`FeatureError::OpenCv`] if OpenCV fails.
    pub(super) fn pyramid(&self, num_smaller: usize) -> Result<Arc<Pyramid>, FeatureError> {
        if let Some((_, pyramid)) = self.pyramid.get().filter(|(number, _)| *number == num_smaller) {
            return Ok(pyramid.clone());
        }
        let pyramid = Arc::new(Pyramid::new(gray_from_rgb(self.rgb)?, num_smaller)?);
        self.pyramid.get_or_init(|| (num_smaller, pyramid.clone()));
        Ok(pyramid)
    }
}
