//! Maps that do not trust what was found again.
//!
//! A point that was lost and found again ties the two parts of a video; a wrong one that many others agree with, such
//! as the rear wheel taken for the front wheel, bends the whole map, which then explains little. So where a map
//! explains little, others are grown from tracks that are cut at their gaps. What was found again joins them once they
//! stand: the points of their longer parts say which are right.

use super::{IncrementalMapper, SubMap};
use crate::features::tracks::{Feature, Track, TrackTable};
use crate::mapper::MapperError;
use crate::math::Sim3;

impl IncrementalMapper<'_> {
    /// Takes over the views of a map of the same pictures, which nothing of this one has to fit, and what of its own
    /// tracks fits them.
    pub fn adopt(&mut self, other: &IncrementalMapper<'_>) -> Result<(), MapperError> {
        self.is_from_known_poses = other.is_from_known_poses;
        self.take_over(&SubMap::of(other), &Sim3::identity(), &[])
    }
}

/// The same with every track cut at its gaps.
pub fn split_at_gaps(table: &TrackTable) -> TrackTable {
    let parts = |track: &Track| -> Vec<Track> {
        track.chunk_by(|a, b| b.view <= a.view + 1).filter(|part| part.len() >= 2).map(<[Feature]>::to_vec).collect()
    };
    TrackTable { views: table.views.clone(), tracks: table.tracks.iter().flat_map(parts).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tracks_are_cut_at_their_gaps_alone() {
        let track = |views: &[u32]| views.iter().map(|&view| Feature { view, feature: 0 }).collect::<Track>();
        let table =
            TrackTable { views: Vec::new(), tracks: vec![track(&[0, 1, 2, 7, 8]), track(&[3, 4]), track(&[0, 5])] };
        let cut = split_at_gaps(&table);
        assert_eq!(cut.tracks, [track(&[0, 1, 2]), track(&[7, 8]), track(&[3, 4])]);
        assert!(table.has_gaps() && !cut.has_gaps());
    }
}
