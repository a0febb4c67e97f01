//! Loop closures of a long video.
//!
//! A map drifts while it grows, mostly in scale. Points that are re-detected after a long time therefore project away
//! from their features, which are no observations of them. Here these features become observations, under the robust
//! loss, and the whole map is adjusted: this closes the loop. Observations that still do not fit are rejected like any
//! other.

use super::IncrementalMapper;
use crate::mapper::MapperError;
use crate::mapper::adjustment::Scope;

/// Maximum reprojection error at an open loop closure, as a share of the image's longer side: beyond it the points
/// differ.
const MAX_ERROR_SHARE: f64 = 0.1;
/// Minimum number of features at open loop closures: fewer are outliers.
const MIN_OPEN: usize = 20;

impl IncrementalMapper<'_> {
    /// Closes loops that the drift of a growing map has left open, and splits tracks at wrong re-detections.
    pub(super) fn close_loops(&mut self) -> Result<(), MapperError> {
        if !self.options.ordered {
            return Ok(());
        }
        let longest_px = self.map.cameras.iter().map(|c| c.width.max(c.height)).max().unwrap_or(0);
        // The adjusted map shows which loops are still open.
        for _ in 0..2 {
            let open =
                self.map.open_loop_closures(MAX_ERROR_SHARE * f64::from(longest_px), self.options.max_track_views);
            tracing::debug!("{} observations of re-detected points are outliers", open.len());
            if open.len() < MIN_OPEN {
                break;
            }
            self.noise = None;
            self.map.activate(open);
            self.adjust(&Scope::Everything, self.freedom)?;
            self.map.update_observations(&self.limits());
        }
        self.map.update_observations(&self.limits());
        let num_apart = self.map.split_wrong_redetections();
        self.map.detect_loop_closures(self.options.max_track_views);
        tracing::debug!("{num_apart} tracks end at their re-detection");
        Ok(())
    }
}
