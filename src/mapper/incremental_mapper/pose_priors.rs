//! Maps that start from poses of all views at once, and how well a map agrees with such.
//!
//! Where views are nearly parallel projections of what they see, a pair of them leaves open how far it turned from one
//! to the other, and what grows from it is chance. Poses that are known otherwise, to a few degrees and pixels, tell
//! all points at once where they are, and the adjustment does the rest.

use nalgebra::UnitQuaternion;

use super::IncrementalMapper;
use crate::geometry::triangulation::Limits;
use crate::mapper::MapperError;
use crate::mapper::Noise;
use crate::mapper::adjustment::{Freedom, Scope};
use crate::math::{Rigid3, median};

/// Radians by which the views of a map may be turned from what is known, so that it is worth half of what it explains.
const TURN: f64 = 0.2;

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
        // Triangulation and adjustment in turns.
        const ROUNDS: usize = 3;
        self.is_from_known_poses = true;
        for (view, pose) in known.poses.iter().enumerate().take(self.map.poses.len()) {
            if self.map.visibility(view).0 >= self.options.min_resection_inliers {
                self.map.poses[view] = *pose;
            }
        }
        self.noise = Noise::Unknown;
        let limits = self.limits();
        let mut wide = Limits { max_error_px: limits.max_error_px.max(known.error_px), ..limits };
        for _ in 0..ROUNDS {
            self.map.triangulate_all(&wide);
            self.map.update_observations(&wide);
            // The adjustments that follow run to their end; these only tell which observations are wrong.
            self.adjust(&Scope::Roughly, Freedom::Nothing)?;
            wide.max_error_px = limits.max_error_px.max(0.5 * wide.max_error_px);
        }
        self.map.triangulate_all(&limits);
        self.map.update_observations(&limits);
        self.drop_unsupported_views()?;
        self.adjusted_at = self.map.num_registered();
        Ok(self.map.num_points() >= self.options.min_initial_inliers / 2)
    }

    /// Agreement of the rotations between the views with the pose priors: 1 where they are equal, less the more they
    /// differ.
    pub fn agreement(&self, known: &PosePriors) -> f64 {
        let off = self.turned_from(known).unwrap_or(0.0);
        tracing::debug!("rotation relative to pose priors: {:.1} deg", off.to_degrees());
        1.0 / (1.0 + (off / TURN).powi(2))
    }

    /// Median angle by which views are turned from what is known, but for the turn that all have in common, radians;
    /// `None` without common views.
    fn turned_from(&self, known: &PosePriors) -> Option<f64> {
        // Bounds the cost, quadratic in the number.
        const MOST_CENTERS: usize = 50;
        let turn = |view: usize| {
            let (pose, known) = (self.map.poses[view].as_ref()?, known.poses.get(view)?.as_ref()?);
            Some(pose.rotation.inverse() * known.rotation)
        };
        let turns: Vec<UnitQuaternion<f64>> = self.map.registered().filter_map(turn).collect();
        let step = turns.len().div_ceil(MOST_CENTERS).max(1);
        let spread = |center: &UnitQuaternion<f64>| median(turns.iter().map(|turn| turn.angle_to(center)).collect());
        turns.iter().step_by(step).filter_map(spread).reduce(f64::min)
    }
}
