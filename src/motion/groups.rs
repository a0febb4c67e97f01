//! Groups of tracks: neighbors that keep their offsets (eq. 10 of `docs/maths/motion.md`).

use std::collections::{BTreeMap, BTreeSet};

use pathfinding::undirected::connected_components::connected_components;

use super::follower::{MAX_SIDE_PX, SPACING_PX};
use super::{PointTrack, Surroundings, TrackLabel, Verdict};

/// Minimum time for which the points of a mover move together, seconds; in a shorter clip, two thirds of it.
const MIN_LIFE_S: f64 = 1.0;
/// Maximum distance of neighbors, in cells of the follower's grid.
const REACH: f64 = 3.5;

/// Lengths in pixels and times in frames of the clip.
#[derive(Clone, Copy, Debug)]
pub(super) struct Scales {
    /// Maximum distance of neighbors, pixels.
    pub reach_px: f64,
    /// Size of a pixel of the working size, in pixels of the frame.
    pub pixel: f64,
    /// Interval between two frames in which neighbors are searched, frames.
    pub stride: u32,
    /// Number of frames per second.
    pub second: u32,
    /// Minimum life of a mover, frames.
    pub life: u32,
}

impl Scales {
    pub fn new(surroundings: &Surroundings) -> Self {
        let longer = f64::from(surroundings.size.0.max(surroundings.size.1));
        let pixel = (longer / f64::from(MAX_SIDE_PX)).max(1.0);
        let times = surroundings.times_s;
        let length_s = times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first).max(1e-9);
        let per_second = times.len().saturating_sub(1) as f64 / length_s;
        let frames = |seconds: f64| (seconds * per_second).round().clamp(1.0, 1e6) as u32;
        let life = frames(MIN_LIFE_S).min((2 * times.len() as u32) / 3);
        Self {
            reach_px: REACH * f64::from(SPACING_PX) * pixel,
            pixel,
            stride: frames(0.15),
            second: frames(1.0).max(2),
            life: life.max(4),
        }
    }
}

/// Tracks observed in each of the sampled frames.
pub(super) fn sampled_tracks(
    tracks: &[PointTrack],
    chosen: impl Iterator<Item = usize>,
    stride: u32,
) -> BTreeMap<u32, Vec<usize>> {
    let mut tracks_by_frame: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for k in chosen {
        let first = tracks[k].first.next_multiple_of(stride);
        for frame in (first..tracks[k].end()).step_by(stride as usize) {
            tracks_by_frame.entry(frame).or_default().push(k);
        }
    }
    tracks_by_frame
}

/// Tracks and positions of points by cell.
type Cells = BTreeMap<(i64, i64), Vec<(usize, [f64; 2])>>;

/// Points of one frame in cells, for the search of neighbors.
pub(super) struct PointGrid {
    reach_px: f64,
    cells: Cells,
}

impl PointGrid {
    /// Grid of the points of the chosen tracks in a frame.
    pub fn new(tracks: &[PointTrack], chosen: &[usize], frame: u32, reach_px: f64) -> Self {
        let mut cells = Cells::new();
        for &k in chosen {
            if let Some(p) = tracks[k].at(frame) {
                cells.entry(p.map(|x| (x / reach_px).floor() as i64).into()).or_default().push((k, p));
            }
        }
        Self { reach_px, cells }
    }

    /// Pairs within reach, the lower index first, without duplicates.
    pub fn pairs(&self) -> Vec<(usize, usize)> {
        let mut pairs = Vec::new();
        for (&(x, y), own) in &self.cells {
            // Half of the neighboring cells, so no pair is found twice.
            for other in [(x, y), (x + 1, y), (x - 1, y + 1), (x, y + 1), (x + 1, y + 1)] {
                let Some(others) = self.cells.get(&other) else { continue };
                for (i, p) in own {
                    let near = others.iter().filter(|(j, q)| (other != (x, y) || i < j) && self.is_near(p, q));
                    pairs.extend(near.map(|(j, _)| (*i.min(j), *i.max(j))));
                }
            }
        }
        pairs
    }

    fn is_near(&self, p: &[f64; 2], q: &[f64; 2]) -> bool {
        (p[0] - q[0]).powi(2) + (p[1] - q[1]).powi(2) <= self.reach_px.powi(2)
    }
}

/// Share of moving points among those near each track, over its life, including the track itself.
///
/// A single moving point among static ones is a tracking error.
///
/// * `tracks_by_frame` – all tracks in the sampled frames.
pub(super) fn moving_shares(
    tracks: &[PointTrack],
    labels: &[TrackLabel],
    tracks_by_frame: &BTreeMap<u32, Vec<usize>>,
    reach_px: f64,
) -> Vec<f64> {
    let mut counts = vec![[0.0; 2]; tracks.len()];
    for (frame, seen) in tracks_by_frame {
        for (i, j) in PointGrid::new(tracks, seen, *frame, reach_px).pairs() {
            count(&mut counts[i], &labels[j]);
            count(&mut counts[j], &labels[i]);
        }
    }
    counts.into_iter().map(|[moving, stationary]| (moving + 1.0) / (moving + stationary + 1.0)).collect()
}

fn count([moving, stationary]: &mut [f64; 2], label: &TrackLabel) {
    match label.verdict {
        Verdict::Moving(_) => *moving += 1.0,
        Verdict::Stationary => *stationary += 1.0,
        // It may be a part of an approaching vehicle.
        Verdict::Floating => *stationary += 0.5,
        Verdict::Fixed | Verdict::Undetermined => {}
    }
}

/// Tracks, with the criteria by which they are linked.
pub(super) struct TrackLinks<'a> {
    pub tracks: &'a [PointTrack],
    pub scales: Scales,
    pub max_change: f64,
}

impl TrackLinks<'_> {
    /// Pairs of the chosen tracks that are neighbors in several frames and keep their offsets, ascending.
    pub fn pairs(&self, chosen: &[usize]) -> Vec<(usize, usize)> {
        let mut num_common: BTreeMap<(usize, usize), u32> = BTreeMap::new();
        for (frame, seen) in sampled_tracks(self.tracks, chosen.iter().copied(), self.scales.stride) {
            for pair in PointGrid::new(self.tracks, &seen, frame, self.scales.reach_px).pairs() {
                *num_common.entry(pair).or_default() += 1;
            }
        }
        num_common
            .into_iter()
            .filter(|&(pair, count)| count >= 2 && self.keep_offset(pair))
            .map(|(pair, _)| pair)
            .collect()
    }

    /// Returns true if the offset of two tracks changes little within any second.
    fn keep_offset(&self, (i, j): (usize, usize)) -> bool {
        let (a, b) = (&self.tracks[i], &self.tracks[j]);
        let (first, end) = (a.first.max(b.first), a.end().min(b.end()));
        let common = end.saturating_sub(first);
        if common < 4 {
            return false;
        }
        let lag = self.scales.second.min(common - 1);
        let offset = |frame: u32| {
            let (p, q) = (a.at(frame).unwrap_or_default(), b.at(frame).unwrap_or_default());
            [p[0] - q[0], p[1] - q[1]]
        };
        (first..end - lag).step_by(self.scales.stride as usize).all(|frame| {
            let (before, after) = (offset(frame), offset(frame + lag));
            // Not `hypot`, which takes ten times as long to avoid overflows that pixels cannot cause.
            let length = |[x, y]: [f64; 2]| (x * x + y * y).sqrt();
            let change = length([after[0] - before[0], after[1] - before[1]]);
            change <= 1.5 * self.scales.pixel + self.max_change * length(before)
        })
    }
}

/// Groups of at least two nodes connected by edges of triangles; each ascending, in the order of their first nodes.
pub(super) fn connected(pairs: &[(usize, usize)]) -> Vec<Vec<usize>> {
    let mut neighbors: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    for &(i, j) in pairs {
        neighbors.entry(i).or_default().insert(j);
        neighbors.entry(j).or_default().insert(i);
    }
    let neighbors = &neighbors;
    // A single accidental edge connects no groups.
    let in_triangles = |node: &usize| {
        let own = &neighbors[node];
        own.iter().copied().filter(move |other| !own.is_disjoint(&neighbors[other]))
    };
    let nodes: Vec<usize> = neighbors.keys().copied().collect();
    let groups = connected_components(&nodes, in_triangles).into_iter().filter(|group| group.len() > 1);
    let mut groups: Vec<Vec<usize>> =
        groups.map(|group| group.into_iter().collect::<BTreeSet<_>>().into_iter().collect()).collect();
    groups.sort_unstable();
    groups
}
