//! Pose outliers: views of a video that are registered far from their neighbors in time.
//!
//! Few points on a narrow patch of surface, as where another vehicle occludes most of the reconstructed one, fit two
//! poses: the right one, and one from the other side. A camera does not jump there and back from one frame to the next.
//! So such views are registered again near the pose interpolated between their neighbors, and unregistered where that
//! fails.

use super::IncrementalMapper;
use crate::mapper::{MapperError, Reason};
use crate::math::upper_median;

/// Displacement over the median one above which a step is a jump.
const MIN_JUMP: f64 = 10.0;
/// Maximum number of views between a jump and the jump back.
const MAX_VIEWS: usize = 10;
/// Minimum share of its observations that a view must keep at the other pose.
const MIN_KEPT: f64 = 0.5;

impl IncrementalMapper<'_> {
    /// Registers the views between a jump and the jump back again.
    pub(super) fn correct_pose_outliers(&mut self) -> Result<(), MapperError> {
        let outliers = if self.options.ordered { self.pose_outliers() } else { Vec::new() };
        if outliers.is_empty() {
            return Ok(());
        }
        let support = self.map.num_observations_of_views();
        self.unregister_views(&outliers);
        for &view in &outliers {
            let visible = self.map.visible(view);
            let found = self.interpolated(view).and_then(|start| self.resect(view, &visible, Some(start)));
            let least = (MIN_KEPT * support[view] as f64).max(self.options.min_resection_inliers as f64);
            match found.filter(|found| found.inliers.len() as f64 >= least) {
                Some(found) => self.set_pose(view, &found, &visible),
                None => self.failed[view] = Some(Reason::NoPose { visible: visible.len(), inliers: 0 }),
            }
            tracing::debug!(
                "{}: pose outlier; corrected: {}",
                self.map.table.views[view].name,
                self.map.poses[view].is_some()
            );
        }
        self.adjust_globally()
    }

    /// Registered views between a jump and the jump back to the trajectory.
    fn pose_outliers(&self) -> Vec<usize> {
        let views: Vec<usize> = self.map.registered().collect();
        let centers: Vec<_> = views.iter().filter_map(|&v| self.map.poses[v].map(|pose| pose.center())).collect();
        let step = |i: usize, j: usize| (centers[j] - centers[i]).norm() / (views[j] - views[i]) as f64;
        let Some(usual) = upper_median((1..views.len()).map(|j| step(j - 1, j)).collect()) else { return Vec::new() };
        let jumps: Vec<usize> = (1..views.len()).filter(|&j| step(j - 1, j) > MIN_JUMP * usual).collect();
        let there_and_back = jumps.windows(2).filter(|pair| {
            let (first, after) = (pair[0], pair[1]);
            after - first <= MAX_VIEWS && step(first - 1, after) <= MIN_JUMP * usual
        });
        there_and_back.flat_map(|pair| views[pair[0]..pair[1]].to_vec()).collect()
    }
}
