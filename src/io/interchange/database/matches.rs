//! Matched features of two images.

use std::collections::{BTreeMap, BTreeSet};

use super::View;
use crate::scene::{ImageId, TrackElement};

/// Feature indices of either image, by the images' ids in ascending order.
pub type Matches = BTreeMap<[ImageId; 2], Vec<[u32; 2]>>;

/// All pairs of features within tracks, ascending. If a feature would have two matches in one image, the first track is
/// used.
pub fn of_tracks(views: &BTreeMap<ImageId, &View>, tracks: &[Vec<TrackElement>]) -> Matches {
    let mut found: BTreeMap<[ImageId; 2], OneToOne> = BTreeMap::new();
    for track in tracks {
        let mut elements: Vec<_> = track.iter().filter(|element| is_feature(views, element)).collect();
        elements.sort();
        for (k, first) in elements.iter().enumerate() {
            for second in elements[k + 1..].iter().filter(|second| second.image != first.image) {
                let pair = found.entry([first.image, second.image]).or_default();
                pair.add([first.observation_idx, second.observation_idx]);
            }
        }
    }
    found
        .into_iter()
        .map(|(pair, matches)| (pair, matches.first_to_second.into_iter().map(Into::into).collect()))
        .collect()
}

fn is_feature(views: &BTreeMap<ImageId, &View>, element: &TrackElement) -> bool {
    views.get(&element.image).is_some_and(|view| (element.observation_idx as usize) < view.pixels.len())
}

#[derive(Default)]
struct OneToOne {
    first_to_second: BTreeMap<u32, u32>,
    second: BTreeSet<u32>,
}

impl OneToOne {
    fn add(&mut self, [a, b]: [u32; 2]) {
        if !self.first_to_second.contains_key(&a) && self.second.insert(b) {
            self.first_to_second.insert(a, b);
        }
    }
}
