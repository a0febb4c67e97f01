//! Maps that do not trust what was found again.
//!
//! A point that was lost and found again ties the two parts of a video; a wrong one that many others agree with, such
//! as the rear wheel taken for the front wheel, bends the whole map, which then explains little. So where a map
//! explains little, another one is grown from tracks that are cut at their gaps. What was found again joins it once it
//! stands: the points of its longer parts say which are right.

use super::{Growth, SubMap};
use crate::math::Sim3;
use crate::sfm::SfmError;
use crate::sfm::tracks::{Feature, Track, TrackTable};

/// A map that explains a smaller share of the observations is not trusted: with right tracks, maps of rendered vehicles
/// explain 0.93 and more, and one that was bent by wheels of which the wrong ones were joined 0.2.
const POOR_SHARE: f64 = 0.5;

impl Growth<'_> {
    /// Whether the map explains little of what was followed.
    pub fn is_poor(&self) -> bool {
        let share = self.num_explained() / self.map.table.num_observations().max(1) as f64;
        tracing::debug!("{share:.2} of the observations are explained");
        share < POOR_SHARE
    }

    /// Takes over the views of a map of the same pictures, which nothing of this one has to fit, and what of its own
    /// tracks fits them.
    pub fn adopt(&mut self, other: &SubMap) -> Result<(), SfmError> {
        self.take_over(other, &Sim3::identity(), &[])
    }
}

/// The same with every track cut at its gaps; `None` where no track has one.
pub fn without_joints(table: &TrackTable) -> Option<TrackTable> {
    let is_joint = |pair: &[Feature]| pair[1].view > pair[0].view + 1;
    if !table.tracks.iter().any(|track| track.windows(2).any(is_joint)) {
        return None;
    }
    let parts = |track: &Track| -> Vec<Track> {
        track.chunk_by(|a, b| b.view <= a.view + 1).filter(|part| part.len() >= 2).map(<[Feature]>::to_vec).collect()
    };
    Some(TrackTable { views: table.views.clone(), tracks: table.tracks.iter().flat_map(parts).collect() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tracks_are_cut_at_their_gaps_alone() {
        let track = |views: &[u32]| views.iter().map(|&view| Feature { view, feature: 0 }).collect::<Track>();
        let table =
            TrackTable { views: Vec::new(), tracks: vec![track(&[0, 1, 2, 7, 8]), track(&[3, 4]), track(&[0, 5])] };
        let cut = without_joints(&table).unwrap();
        assert_eq!(cut.tracks, [track(&[0, 1, 2]), track(&[7, 8]), track(&[3, 4])]);
        assert!(without_joints(&cut).is_none());
    }
}
