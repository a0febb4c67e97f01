//! Views of a video that are registered far from their neighbours in time.
//!
//! Few points on a narrow piece of surface, as where another vehicle hides most of the one that is reconstructed, fit
//! two poses: the right one, and one that sees the piece from the other side. A camera does not leap there and back
//! from one frame to the next, so such views are tried again from between their neighbours, and left out where that
//! fails.

use super::IncrementalMapper;
use crate::mapper::{MapperError, Reason};
use crate::math::upper_median;

/// A step that is so many times the usual one is a leap.
const LEAP: f64 = 10.0;
/// Views that a leap there and back may enclose.
const MOST_VIEWS: usize = 10;
/// Share of its observations that a view must keep at the other pose.
const KEPT: f64 = 0.5;

impl IncrementalMapper<'_> {
    /// Tries views again that lie between a leap there and a leap back.
    pub(super) fn mend_leaps(&mut self) -> Result<(), MapperError> {
        let leapt = if self.options.ordered { self.leapt() } else { Vec::new() };
        if leapt.is_empty() {
            return Ok(());
        }
        let support = self.map.num_observations_of_views();
        self.take_out(&leapt);
        for &view in &leapt {
            let visible = self.map.visible(view);
            let found = self.interpolated(view).and_then(|start| self.resect(view, &visible, Some(start)));
            let least = (KEPT * support[view] as f64).max(self.options.min_resection_inliers as f64);
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

    /// Registered views between a leap away and a leap back to where the path goes on.
    fn leapt(&self) -> Vec<usize> {
        let views: Vec<usize> = self.map.registered().collect();
        let centers: Vec<_> = views.iter().filter_map(|&v| self.map.poses[v].map(|pose| pose.center())).collect();
        let step = |i: usize, j: usize| (centers[j] - centers[i]).norm() / (views[j] - views[i]) as f64;
        let Some(usual) = upper_median((1..views.len()).map(|j| step(j - 1, j)).collect()) else { return Vec::new() };
        let leaps: Vec<usize> = (1..views.len()).filter(|&j| step(j - 1, j) > LEAP * usual).collect();
        let there_and_back = leaps.windows(2).filter(|pair| {
            let (first, after) = (pair[0], pair[1]);
            after - first <= MOST_VIEWS && step(first - 1, after) <= LEAP * usual
        });
        there_and_back.flat_map(|pair| views[pair[0]..pair[1]].to_vec()).collect()
    }
}
