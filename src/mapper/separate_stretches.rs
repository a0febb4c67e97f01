//! Stretches of a video that hang together, and that nothing ties to the map.

use super::map::Map;

/// Fewer views are no stretch.
const MIN_VIEWS: usize = 4;

/// By view: the first and the last view of the stretch that it belongs to, for views that are not registered. From each
/// view of a stretch to the next at least `min_common` points live.
pub fn stretches(map: &Map<'_>, min_common: usize) -> Vec<Option<[usize; 2]>> {
    let num_views = map.poses.len();
    let mut common = vec![0usize; num_views];
    for track in map.table.tracks.iter() {
        track
            .windows(2)
            .filter(|pair| pair[1].view == pair[0].view + 1)
            .for_each(|pair| common[pair[1].view as usize] += 1);
    }
    let is_open = |view: usize| map.poses[view].is_none();
    let mut out = vec![None; num_views];
    let mut first = 0;
    for view in 0..num_views {
        let goes_on = view + 1 < num_views && is_open(view + 1) && common[view + 1] >= min_common;
        if is_open(view) && goes_on {
            continue;
        }
        if is_open(view) && view + 1 - first >= MIN_VIEWS {
            out[first..=view].fill(Some([first, view]));
        }
        first = view + 1;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::tracks::{Feature, Track, TrackTable, View};
    use crate::math::Rigid3;
    use crate::scene::ImageId;

    fn view(k: u32) -> View {
        View {
            image: ImageId(k + 1),
            name: String::new(),
            camera: 0,
            pixels: Vec::new(),
            rgb: Vec::new(),
            whitening: Vec::new(),
        }
    }

    fn track(views: std::ops::Range<u32>) -> Track {
        views.map(|view| Feature { view, feature: 0 }).collect()
    }

    #[test]
    fn a_stretch_ends_where_its_points_end_or_the_map_begins() {
        let tracks = [vec![track(0..6); 8], vec![track(6..9); 8], vec![track(9..16); 8]].concat();
        let table = TrackTable { views: (0..16).map(view).collect(), tracks };
        let mut map = Map::new(&table, &[]);
        (14..16).for_each(|view| map.poses[view] = Some(Rigid3::identity()));
        let found = stretches(&map, 7);
        assert_eq!(found[0], Some([0, 5]));
        // Three views are no stretch.
        assert_eq!(found[5..10], [Some([0, 5]), None, None, None, Some([9, 13])]);
        assert_eq!(found[13..], [Some([9, 13]), None, None]);
        assert!(stretches(&map, 9).iter().all(Option::is_none));
    }
}
