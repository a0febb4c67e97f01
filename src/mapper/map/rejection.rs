//! Points that have no finite position or projection.
//!
//! Bundle adjustment projects through the center of a camera. The cost of a point that passes a camera, as points near
//! the line of motion do, stays finite, and its final position may be behind a camera that observes it. A point whose
//! rays become parallel moves to infinity. Neither has a meaningful reprojection error.

use super::Map;
use crate::math::{Rigid3, widest_angle};

/// Minimum parallax of a point, radians: a thousandth of a pixel at a focal length of 1000 px, which no measurement
/// distinguishes from infinity.
const MIN_PARALLAX: f64 = 1e-6;

impl Map<'_> {
    /// Rejects points behind a camera that observes them, at infinity, or not finite; returns their number.
    pub fn reject_infinite_points(&mut self) -> usize {
        let is_infinite = |track: &usize| self.points[*track].is_some() && !self.has_finite_errors(*track);
        let infinite: Vec<usize> = (0..self.points.len()).filter(is_infinite).collect();
        infinite.iter().for_each(|&track| self.set_point(track, None));
        infinite.len()
    }

    fn has_finite_errors(&self, track: usize) -> bool {
        let Some(point) = &self.points[track] else { return false };
        let centers = self.observations(track).filter_map(|(slot, ..)| self.pose_at(track, slot).map(Rigid3::center));
        self.errors_sq(track).all(f64::is_finite) && widest_angle(point.position, centers) >= MIN_PARALLAX
    }
}
