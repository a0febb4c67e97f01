//! A frame with shared derived data.

use std::cell::OnceCell;
use std::sync::Arc;

use super::{CornerStrength, ImageError, Pyramid, RgbImage, gray_from_rgb};

/// A frame; its gray pyramid and the strength of its corners are computed on first use, and shared: the points of the
/// background, of all vehicles and of motion are tracked in the same one.
pub struct Picture<'a> {
    rgb: &'a RgbImage,
    pyramid: OnceCell<(usize, Arc<Pyramid>)>,
    corners: OnceCell<CornerStrength>,
}

impl<'a> Picture<'a> {
    /// Of an image.
    pub fn new(rgb: &'a RgbImage) -> Self {
        Self { rgb, pyramid: OnceCell::new(), corners: OnceCell::new() }
    }

    /// The image.
    pub fn rgb(&self) -> &'a RgbImage {
        self.rgb
    }

    /// Gray pyramid with `num_smaller` smaller images. The pyramid of the first call is cached; a call with another
    /// number computes a separate one.
    ///
    /// # Errors
    /// [`ImageError::OpenCv`] if OpenCV fails.
    pub fn pyramid(&self, num_smaller: usize) -> Result<Arc<Pyramid>, ImageError> {
        if let Some((_, pyramid)) = self.pyramid.get().filter(|(number, _)| *number == num_smaller) {
            return Ok(pyramid.clone());
        }
        let pyramid = Arc::new(Pyramid::new(gray_from_rgb(self.rgb)?, num_smaller)?);
        self.pyramid.get_or_init(|| (num_smaller, pyramid.clone()));
        Ok(pyramid)
    }

    /// Corner strength of the whole frame.
    ///
    /// * `gray` – the frame in gray.
    pub fn corners(&self, gray: &Pyramid) -> &CornerStrength {
        self.corners.get_or_init(|| CornerStrength::of(gray.picture()))
    }

    /// Corner strength, if already computed.
    pub fn known_corners(&self) -> Option<&CornerStrength> {
        self.corners.get()
    }
}
