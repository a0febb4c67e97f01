//! Point that is being tracked.

use nalgebra::{Matrix2, Point2, Vector2};

use crate::bundle::Whitening;
use crate::features::patch::{Aligned, Patch, Warp};
use crate::image::GrayImage;

/// Point that is being tracked.
pub struct TrackedPoint {
    pub track: usize,
    pub patch: Patch,
    pub warp: Warp,
    pub whitening: Whitening,
    /// Displacement in the last step; `None` where it was not tracked.
    pub step: Option<Vector2<f32>>,
    /// Number of views in which it is still tracked; `None` for as long as it is visible.
    pub views_left: Option<usize>,
}

impl TrackedPoint {
    /// Predicted position, by the last step.
    pub fn predicted(&self) -> Option<Point2<f32>> {
        Some(self.warp.center + self.step?)
    }

    /// Aligns the patch near a prediction; `None` if the patch is not visible there.
    pub fn aligned(&self, predicted: Point2<f32>, gray: &GrayImage, min_correlation: f32) -> Option<Aligned> {
        let found = self.patch.align(gray, &Warp { shape: self.warp.shape, center: predicted })?;
        // Lucas–Kanade is accurate to a fraction of a pixel; farther away is another structure.
        let is_near = (found.warp.center - predicted).norm() <= 2.0;
        (is_near && found.correlation >= min_correlation).then_some(found)
    }

    /// Moves to an alignment in the next view.
    pub fn update(&mut self, found: &Aligned) {
        self.step = Some(found.warp.center - self.warp.center);
        self.warp = found.warp;
        self.whitening = whitening(found.covariance);
    }
}

/// Whitening of a position with this covariance (see [`Patch::covariance`]), relative to that of a good corner.
///
/// On rendered video the errors against the truth are 0.05 px times these relative standard deviations, from 0.5 to 20.
pub fn whitening(covariance: Matrix2<f32>) -> Whitening {
    // Standard deviation of the position of a good corner, pixels: that of the measurement above.
    const TYPICAL_PX: f64 = 0.05;
    Whitening::from_covariance(covariance.cast::<f64>() / (TYPICAL_PX * TYPICAL_PX), 0.5, 20.0)
}
