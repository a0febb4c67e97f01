//! Initialization of a map from pose priors of all views.
//!
//! Where views are nearly parallel projections, a pair leaves the rotation between its views undetermined, and a map
//! that grows from it is arbitrary. Pose priors, accurate to a few degrees and pixels, determine all points at once,
//! and the adjustment refines both.

use super::IncrementalMapper;
use crate::geometry::triangulation::Limits;
use crate::mapper::MapperError;
use crate::mapper::adjustment::{Freedom, Scope};
use crate::math::Rigid3;

/// Pose priors of views, accurate to a few degrees and pixels.
#[derive(Clone, Debug)]
pub struct PosePriors {
    /// Camera from target, by view.
    pub poses: Vec<Option<Rigid3>>,
    /// Reprojection error that follows from their uncertainty, pixels.
    pub error_px: f64,
}

impl IncrementalMapper<'_> {
    /// Initializes the map from pose priors; returns false if too few points remain after adjustment.
    pub fn initialize_from(&mut self, priors: &PosePriors) -> Result<bool, MapperError> {
        for (view, pose) in priors.poses.iter().enumerate().take(self.map.poses.len()) {
            if self.map.visibility(view).0 >= self.options.min_resection_inliers {
                self.map.poses[view] = *pose;
            }
        }
        self.noise = None;
        let limits = self.limits();
        let mut wide = Limits { max_error_px: limits.max_error_px.max(priors.error_px), ..limits };
        // Triangulation and adjustment alternate.
        for _ in 0..3 {
            self.map.triangulate_all(&wide);
            self.map.update_observations(&wide);
            // Free rotations would follow points that were triangulated from inaccurate poses (bas-relief).
            self.adjust(&Scope::Positions, Freedom::Nothing)?;
            wide.max_error_px = limits.max_error_px.max(0.5 * wide.max_error_px);
        }
        self.map.triangulate_all(&limits);
        self.map.update_observations(&limits);
        self.adjust(&Scope::Coarse, Freedom::Nothing)?;
        self.map.update_observations(&limits);
        self.drop_unsupported_views()?;
        self.adjusted_at = self.map.num_registered();
        Ok(self.map.num_points() >= self.options.min_initial_inliers / 2)
    }
}
