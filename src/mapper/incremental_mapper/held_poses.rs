//! Triangulation from known, fixed poses: a stationary target observed by the cameras of the background.

use super::IncrementalMapper;
use crate::geometry::triangulation::Limits;
use crate::mapper::MapperError;
use crate::mapper::adjustment::{self, Freedom, Scope};
use crate::math::Rigid3;

impl IncrementalMapper<'_> {
    /// Triangulates all points from known poses, and adjusts the points alone.
    ///
    /// * `poses` – camera from target, by view.
    ///
    /// Returns the inlier ratio of the observations in registered views.
    pub fn triangulate_from(&mut self, poses: &[Option<Rigid3>]) -> Result<f64, MapperError> {
        self.map.poses.copy_from_slice(poses);
        self.noise = None;
        // First with the limits of an unknown noise, then with those of the measured noise.
        for _ in 0..2 {
            let limits = self.limits_for_known_poses();
            self.map.triangulate_all(&limits);
            self.map.update_observations(&limits);
            adjustment::adjust(&mut self.map, &Scope::Points, Freedom::Nothing, self.noise, self.options)?;
            self.noise = self.map.noise();
            self.map.update_observations(&self.limits_for_known_poses());
        }
        self.num_infinite = self.map.reject_infinite_points();
        let num_inliers = self.map.num_observations();
        let is_seen = |view: u32| self.map.poses[view as usize].is_some();
        let num_seen = self.map.tracks.iter().flatten().filter(|feature| is_seen(feature.view)).count();
        Ok(num_inliers as f64 / num_seen.max(1) as f64)
    }

    /// Limits where poses are known to a fraction of a pixel: then a parallax of few pixels determines a depth.
    fn limits_for_known_poses(&self) -> Limits {
        let limits = self.limits();
        Limits { min_angle: 0.2 * limits.min_angle, ..limits }
    }
}
