//! Maps that start from poses of all views at once.
//!
//! Where views are nearly parallel projections of what they see, a pair of them leaves open how far it turned from one
//! to the other, and what grows from it is chance. Poses that are known otherwise, to a few degrees and pixels, tell
//! all points at once where they are, and the adjustment does the rest.

use super::IncrementalMapper;
use crate::geometry::triangulation::Limits;
use crate::mapper::MapperError;
use crate::mapper::adjustment::{Freedom, Scope};
use crate::math::Rigid3;

/// Poses of views beforehand, right to a few degrees and pixels.
#[derive(Clone, Debug)]
pub struct PosePriors {
    /// Camera from target, by view.
    pub poses: Vec<Option<Rigid3>>,
    /// Error of a point's image position that follows from their uncertainty, pixels.
    pub error_px: f64,
}

impl IncrementalMapper<'_> {
    /// Starts from poses of many views; `false` where too few points hold after adjustment.
    pub fn start_from(&mut self, known: &PosePriors) -> Result<bool, MapperError> {
        for (view, pose) in known.poses.iter().enumerate().take(self.map.poses.len()) {
            if self.map.visibility(view).0 >= self.options.min_resection_inliers {
                self.map.poses[view] = *pose;
            }
        }
        self.noise = None;
        let limits = self.limits();
        let mut wide = Limits { max_error_px: limits.max_error_px.max(known.error_px), ..limits };
        // Triangulation and adjustment in turns.
        for _ in 0..3 {
            self.map.triangulate_all(&wide);
            self.map.update_observations(&wide);
            // Cameras that are free to turn would follow points that were triangulated from rough poses (bas-relief).
            self.adjust(&Scope::Positions, Freedom::Nothing)?;
            wide.max_error_px = limits.max_error_px.max(0.5 * wide.max_error_px);
        }
        self.map.triangulate_all(&limits);
        self.map.update_observations(&limits);
        self.adjust(&Scope::Roughly, Freedom::Nothing)?;
        self.map.update_observations(&limits);
        self.drop_unsupported_views()?;
        self.adjusted_at = self.map.num_registered();
        Ok(self.map.num_points() >= self.options.min_initial_inliers / 2)
    }
}
