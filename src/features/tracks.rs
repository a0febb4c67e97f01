//! Tracks: features of the same point in several views.

use std::collections::BTreeMap;

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use crate::bundle::Whitening;
use crate::scene::{Frame, ImageId};

/// Features of one image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Its id in the reconstruction.
    pub image: ImageId,
    /// Its file name.
    pub name: String,
    /// Index of its intrinsics.
    pub camera: usize,
    /// Feature positions, pixels, first pixel center at (0.5, 0.5).
    pub pixels: Vec<Point2<f64>>,
    /// Colors at the features.
    pub rgb: Vec<[u8; 3]>,
    /// Whitening of each feature's position error, relative to one another; empty if all are alike.
    pub whitening: Vec<Whitening>,
}

impl View {
    /// A view of a frame without features.
    pub fn new(frame: &Frame, camera: usize) -> Self {
        let (pixels, rgb, whitening) = (Vec::new(), Vec::new(), Vec::new());
        Self { image: frame.id.into(), name: frame.name.clone(), camera, pixels, rgb, whitening }
    }

    /// Whitening of a feature's position error.
    pub fn whitening_of(&self, feature: u32) -> Whitening {
        self.whitening.get(feature as usize).copied().unwrap_or(Whitening::IDENTITY)
    }
}

/// A feature of a view, by index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Feature {
    /// Index in [`TrackTable::views`].
    pub view: u32,
    /// Index in [`View::pixels`].
    pub feature: u32,
}

/// Features of the same point: at most one per view, ascending by view.
pub type Track = Vec<Feature>;

/// All views and tracks of one target: the input of reconstruction.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TrackTable {
    /// In time order for a video.
    pub views: Vec<View>,
    /// In order of their first feature.
    pub tracks: Vec<Track>,
}

impl TrackTable {
    /// Number of features of all tracks.
    pub fn num_observations(&self) -> usize {
        self.tracks.iter().map(Vec::len).sum()
    }

    /// Whitening of a feature's position error.
    pub fn whitening(&self, feature: Feature) -> Whitening {
        self.views[feature.view as usize].whitening_of(feature.feature)
    }

    /// Position of a feature.
    pub fn pixel(&self, feature: Feature) -> Point2<f64> {
        self.views[feature.view as usize].pixels[feature.feature as usize]
    }
}

/// Verified matches between the features of two views.
#[derive(Clone, Debug, PartialEq)]
pub struct PairMatches {
    /// The two views.
    pub views: [u32; 2],
    /// Feature indices in both.
    pub matches: Vec<[u32; 2]>,
}

/// Links pairwise matches to tracks (connected components).
///
/// A component with two features of one view is inconsistent in that view: these features are removed, the rest of the
/// component stays. Components with fewer than `min_length` views are dropped.
pub fn tracks_from_matches(num_features: &[usize], pairs: &[PairMatches], min_length: usize) -> Vec<Track> {
    let offsets: Vec<usize> = num_features.iter().scan(0, |end, n| Some(std::mem::replace(end, *end + n))).collect();
    let mut parents: Vec<u32> = (0..num_features.iter().sum::<usize>() as u32).collect();
    for pair in pairs {
        for m in &pair.matches {
            let node = |side: usize| (offsets[pair.views[side] as usize] + m[side] as usize) as u32;
            let (a, b) = (root(&mut parents, node(0)), root(&mut parents, node(1)));
            // The smaller index stays the root, so that the result does not depend on the order of the pairs.
            parents[a.max(b) as usize] = a.min(b);
        }
    }
    let mut components: BTreeMap<u32, Track> = BTreeMap::new();
    for (view, (&offset, &n)) in offsets.iter().zip(num_features).enumerate() {
        for feature in 0..n {
            let component = root(&mut parents, (offset + feature) as u32);
            let feature = Feature { view: view as u32, feature: feature as u32 };
            components.entry(component).or_default().push(feature);
        }
    }
    components.into_values().map(without_conflicts).filter(|track| track.len() >= min_length.max(2)).collect()
}

fn root(parents: &mut [u32], mut node: u32) -> u32 {
    while parents[node as usize] != node {
        let grandparent = parents[parents[node as usize] as usize];
        parents[node as usize] = grandparent;
        node = grandparent;
    }
    node
}

fn without_conflicts(component: Track) -> Track {
    component.chunk_by(|a, b| a.view == b.view).filter(|group| group.len() == 1).map(|group| group[0]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(a: u32, b: u32, matches: &[[u32; 2]]) -> PairMatches {
        PairMatches { views: [a, b], matches: matches.to_vec() }
    }

    fn flat(tracks: &[Track]) -> Vec<Vec<(u32, u32)>> {
        tracks.iter().map(|t| t.iter().map(|f| (f.view, f.feature)).collect()).collect()
    }

    #[test]
    fn matches_chain_into_tracks() {
        let pairs = [pair(0, 1, &[[0, 1], [1, 0]]), pair(1, 2, &[[1, 2]])];
        let tracks = tracks_from_matches(&[2, 2, 3], &pairs, 2);
        assert_eq!(flat(&tracks), [vec![(0, 0), (1, 1), (2, 2)], vec![(0, 1), (1, 0)]]);
        assert_eq!(tracks_from_matches(&[2, 2, 3], &pairs, 3).len(), 1);
    }

    #[test]
    fn inconsistent_views_are_removed_from_a_track() {
        // View 1's features 0 and 1 are both connected to view 0's feature 0, one of them through view 2.
        let pairs = [pair(0, 1, &[[0, 0]]), pair(1, 2, &[[1, 0]]), pair(0, 2, &[[0, 0]])];
        assert_eq!(flat(&tracks_from_matches(&[1, 2, 1], &pairs, 2)), [vec![(0, 0), (2, 0)]]);
    }
}
