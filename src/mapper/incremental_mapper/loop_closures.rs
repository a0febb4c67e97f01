//! Places that come back in a long video.
//!
//! A map drifts while it grows, mostly in scale, so that points that are found again after a long time project next to
//! where they are seen, and do not count as observations. Here they count for once, under the robust loss, and
//! everything is adjusted: that draws the ends of the loop together. What still does not fit then is taken out again,
//! like any observation.

use super::IncrementalMapper;
use crate::mapper::MapperError;
use crate::mapper::adjustment::Scope;

/// Distance of a joint's ends, as a share of the picture's longer side: what lies farther apart is another place.
const WIDEST: f64 = 0.1;
/// Fewer open joints are outliers.
const FEW: usize = 20;

impl IncrementalMapper<'_> {
    /// Draws together what the drift of a growing map has left open, and takes tracks apart that do not fit where they
    /// were found again.
    pub(super) fn close_loops(&mut self) -> Result<(), MapperError> {
        if !self.options.ordered {
            return Ok(());
        }
        let longest_px = self.map.cameras.iter().map(|c| c.width.max(c.height)).max().unwrap_or(0);
        // The adjusted map shows which joints are still open.
        for _ in 0..2 {
            let open = self.map.open_joints(WIDEST * f64::from(longest_px), self.options.max_track_views);
            tracing::debug!("{} observations of re-detected points are outliers", open.len());
            if open.len() < FEW {
                break;
            }
            self.noise = None;
            self.map.activate(open);
            self.adjust(&Scope::Everything, self.freedom)?;
            self.map.update_observations(&self.limits());
        }
        self.map.update_observations(&self.limits());
        let num_apart = self.map.take_joints_apart();
        self.map.look_for_places_that_come_back(self.options.max_track_views);
        tracing::debug!("{num_apart} tracks end at their re-detection");
        Ok(())
    }
}
