//! Boxes of groups of points that move together (eq. 10 to 12 of `docs/maths/motion.md`).

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use super::classify::MIN_DEVIATION_PX;
use super::follower::SPACING_PX;
use super::groups::{Scales, TrackLinks, connected, moving_shares, sampled_tracks};
use super::{Evidence, PointTrack, Surroundings, TrackLabel, Verdict};
use crate::math::upper_median;
use crate::scene::Rect;

/// Moving object, in all frames in which its points are tracked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mover {
    /// Its box in each frame, pixels.
    pub boxes: BTreeMap<u32, Rect>,
    /// Evidence of most of its points.
    pub evidence: Evidence,
    /// Confidence, 0 to 1; it increases with the number of points, their strength and the life.
    pub confidence: f64,
    /// Share of the points in the central part of its boxes that are its own, 0 to 1.
    pub purity: f64,
    /// Indices of the tracks of its points, ascending.
    pub tracks: Vec<usize>,
}

impl Mover {
    /// Number of frames in which it has a box.
    pub fn life(&self) -> usize {
        self.boxes.len()
    }
}

/// Minimum number of points of a vehicle.
const MIN_POINTS: usize = 4;
/// Maximum change of the offset of two neighbors in a second, relative to its length.
const MAX_CHANGE: f64 = 0.3;
/// Radius around a point in which the share of moving points is measured, in cells of the follower's grid.
const SUPPORT_RADIUS_CELLS: f64 = 2.0;
/// Minimum share of moving points around a moving point.
const MIN_MOVING_SHARE: f64 = 0.4;
/// Minimum share of the points in the central part of the boxes that belong to the mover.
const MIN_PURITY: f64 = 0.75;
/// Minimum residual of its points against static ones, relative to its size: foliage in the wind and points that slide
/// along an edge stay below.
const MIN_DEVIATION: f64 = 0.25;
/// Minimum side of a box, pixels.
const MIN_SIDE_PX: f64 = 8.0;
/// Minimum confidence of a mover, 0 to 1.
const MIN_CONFIDENCE: f64 = 0.5;

/// Groups moving tracks into movers, in descending order of confidence.
///
/// * `labels` – labels of `tracks`.
///
/// Points that are not classified as moving join a mover if they move with its points and are not on the ground.
pub fn movers(tracks: &[PointTrack], labels: &[TrackLabel], surroundings: &Surroundings) -> Vec<Mover> {
    let scales = Scales::new(surroundings);
    let tracks_by_frame = sampled_tracks(tracks, 0..tracks.len(), scales.stride);
    let moving_shares =
        moving_shares(tracks, labels, &tracks_by_frame, SUPPORT_RADIUS_CELLS * f64::from(SPACING_PX) * scales.pixel);
    let builder = MoverBuilder { tracks, labels, moving_shares, tracks_by_frame, scales };
    let mut found: Vec<Mover> =
        builder.groups().iter().flat_map(|group| builder.movers_of(group, surroundings)).collect();
    found = builder.merged(found, surroundings);
    found.retain(|mover| mover.confidence >= MIN_CONFIDENCE);
    found.sort_by(|a, b| b.confidence.total_cmp(&a.confidence).then(a.tracks.cmp(&b.tracks)));
    found
}

struct MoverBuilder<'a> {
    tracks: &'a [PointTrack],
    labels: &'a [TrackLabel],
    /// Share of moving points near each track.
    moving_shares: Vec<f64>,
    /// Tracks observed in each of the sampled frames.
    tracks_by_frame: BTreeMap<u32, Vec<usize>>,
    scales: Scales,
}

impl MoverBuilder<'_> {
    /// Groups of tracks that move together.
    fn groups(&self) -> Vec<Vec<usize>> {
        let chosen: Vec<usize> = (0..self.tracks.len()).filter(|&k| self.may_belong(k)).collect();
        let links = TrackLinks { tracks: self.tracks, scales: self.scales, max_change: MAX_CHANGE };
        let pairs = links.pairs(&chosen);
        let moving = |k: &usize| self.labels[*k].is_moving() && self.moving_shares[*k] >= MIN_MOVING_SHARE;
        let between_moving: Vec<_> = pairs.iter().copied().filter(|(i, j)| moving(i) && moving(j)).collect();
        let mut groups = connected(&between_moving);
        self.absorb(&mut groups, &pairs);
        groups
    }

    /// Returns true if a track can belong to a mover: it moves, or it is clearly not a ground point.
    fn may_belong(&self, k: usize) -> bool {
        let label = &self.labels[k];
        let is_off_ground = label.deviation_px >= 2.0 * MIN_DEVIATION_PX * self.scales.pixel;
        label.is_moving() || (is_off_ground && label.verdict != Verdict::Fixed)
    }

    /// Mover of a group, or else the movers of its closer parts: a line on the road may connect several vehicles.
    fn movers_of(&self, group: &[usize], surroundings: &Surroundings) -> Vec<Mover> {
        match self.mover(group, surroundings) {
            Some(mover) => vec![mover],
            None => self.parts(group).iter().filter_map(|part| self.mover(part, surroundings)).collect(),
        }
    }

    /// Parts of a group by stricter limits of distance, change of offset, and share of moving points.
    fn parts(&self, group: &[usize]) -> Vec<Vec<usize>> {
        // Factor on the limits of the group.
        const CLOSER: f64 = 0.6;
        let min_share = 1.0 - CLOSER * (1.0 - MIN_MOVING_SHARE);
        let is_core = |k: &usize| self.labels[*k].is_moving() && self.moving_shares[*k] >= min_share;
        let core: Vec<usize> = group.iter().copied().filter(is_core).collect();
        let scales = Scales { reach_px: CLOSER * self.scales.reach_px, ..self.scales };
        let links = TrackLinks { tracks: self.tracks, scales, max_change: CLOSER * MAX_CHANGE };
        connected(&links.pairs(&core))
    }

    /// Adds tracks without a group that are linked to three or more tracks of one group.
    fn absorb(&self, groups: &mut [Vec<usize>], pairs: &[(usize, usize)]) {
        let of: BTreeMap<usize, usize> =
            groups.iter().enumerate().flat_map(|(g, members)| members.iter().map(move |&k| (k, g))).collect();
        let mut links: BTreeMap<usize, BTreeMap<usize, u32>> = BTreeMap::new();
        for &(i, j) in pairs {
            for (free, member) in [(i, j), (j, i)] {
                if let (None, Some(&group)) = (of.get(&free), of.get(&member)) {
                    *links.entry(free).or_default().entry(group).or_default() += 1;
                }
            }
        }
        for (free, counts) in links {
            let best = counts.into_iter().max_by_key(|&(group, count)| (count, std::cmp::Reverse(group)));
            if let Some((group, _)) = best.filter(|&(_, count)| count >= 3) {
                groups[group].push(free);
            }
        }
        groups.iter_mut().for_each(|group| group.sort_unstable());
    }

    /// Mover of a group; `None` if it fails a test of its size, life, motion, purity or visibility.
    fn mover(&self, group: &[usize], surroundings: &Surroundings) -> Option<Mover> {
        let group = &self.without_outliers(group, &mut self.boxes(group, surroundings.size));
        let moving: Vec<&TrackLabel> = group.iter().map(|&k| &self.labels[k]).filter(|l| l.is_moving()).collect();
        let boxes = self.boxes(group, surroundings.size);
        if moving.len() < MIN_POINTS || boxes.len() < self.scales.life as usize {
            return None;
        }
        let deviation_px = upper_quartile(moving.iter().map(|label| label.deviation_px).collect())?;
        let side_px = upper_median(boxes.values().map(|b| b.area_px2().sqrt()).collect())?;
        if side_px < MIN_SIDE_PX || deviation_px < self.min_deviation(side_px) {
            return None;
        }
        let purity = self.purity(group, &boxes);
        if purity < MIN_PURITY {
            return None;
        }
        if self.is_fixed(&GroupTrajectory::new(self.tracks, group)) || !self.is_seen_together(group, &boxes) {
            return None;
        }
        let strength = upper_median(moving.iter().map(|label| label.strength).collect())?;
        let off_line = moving.iter().filter(|l| l.verdict == Verdict::Moving(Evidence::OffItsLine)).count();
        Some(Mover {
            evidence: if 2 * off_line >= moving.len() { Evidence::OffItsLine } else { Evidence::BehindGround },
            confidence: purity * self.confidence(group, boxes.len(), strength),
            purity,
            tracks: group.to_vec(),
            boxes,
        })
    }

    /// Group without points that are never in its boxes, after these are trimmed to exclude static points.
    fn without_outliers(&self, group: &[usize], boxes: &mut BTreeMap<u32, Rect>) -> Vec<usize> {
        let mut inside: BTreeSet<usize> = BTreeSet::new();
        for (&frame, seen) in self.tracks_by_frame.range(range_of(boxes)) {
            let Some(rect) = boxes.get_mut(&frame) else { continue };
            let points = self.points_in(rect, frame, seen, group);
            *rect = trimmed(*rect, &points);
            inside.extend(
                points.iter().filter(|p| p.is_own && rect.contains(p.position[0], p.position[1])).map(|p| p.track),
            );
        }
        let is_sampled =
            |k: &usize| (self.tracks[*k].first.next_multiple_of(self.scales.stride)) < self.tracks[*k].end();
        group.iter().copied().filter(|k| inside.contains(k) || !is_sampled(k)).collect()
    }

    /// Points of a frame in a box: those of the group, and static ones.
    fn points_in(&self, rect: &Rect, frame: u32, seen: &[usize], group: &[usize]) -> Vec<PointInBox> {
        let point = |&track: &usize| {
            let position = self.tracks[track].at(frame).filter(|p| rect.contains(p[0], p[1]))?;
            let is_own = group.binary_search(&track).is_ok();
            let is_static = matches!(self.labels[track].verdict, Verdict::Stationary | Verdict::Floating);
            (is_own || is_static).then_some(PointInBox { track, position, is_own })
        };
        seen.iter().filter_map(point).collect()
    }

    /// Share of the points in the central part of the boxes that belong to the group, without undetermined points.
    fn purity(&self, group: &[usize], boxes: &BTreeMap<u32, Rect>) -> f64 {
        let (mut own, mut all) = (0usize, 0usize);
        for (frame, seen) in self.tracks_by_frame.range(range_of(boxes)) {
            let Some(middle) = boxes.get(frame).map(|rect| rect.grown(-0.12)) else { continue };
            let points = self.points_in(&middle, *frame, seen, group);
            own += points.iter().filter(|p| p.is_own).count();
            all += points.len();
        }
        own as f64 / all.max(1) as f64
    }

    /// Returns true if a group keeps its image position, except for a slow drift, for at least three seconds.
    ///
    /// Reflections in the windshield and the hood do.
    fn is_fixed(&self, trajectory: &GroupTrajectory) -> bool {
        let time_s = trajectory.positions.len() as f64 / f64::from(self.scales.second);
        time_s >= 3.0 && trajectory.excursion() <= self.scales.pixel * time_s
    }

    /// Minimum residual of a mover, which foliage in the wind does not exceed, pixels.
    fn min_deviation(&self, side_px: f64) -> f64 {
        (3.0 * self.scales.pixel).max(MIN_DEVIATION * side_px)
    }

    /// Returns true if enough points of the group are observed together for a whole second (11).
    fn is_seen_together(&self, group: &[usize], boxes: &BTreeMap<u32, Rect>) -> bool {
        let num_frames = self.scales.second.min(self.scales.life);
        range_of(boxes).step_by((self.scales.second / 2).max(1) as usize).any(|from| {
            let is_seen = |track: &PointTrack| track.at(from).is_some() && track.at(from + num_frames - 1).is_some();
            group.iter().filter(|&&k| is_seen(&self.tracks[k])).count() >= MIN_POINTS
        })
    }

    /// Confidence by the number of points at a time, the life, and the strength of the evidence.
    fn confidence(&self, group: &[usize], life: usize, strength: f64) -> f64 {
        let seen: usize = group.iter().map(|&k| self.tracks[k].pixels.len()).sum();
        let at_a_time = seen as f64 / life.max(1) as f64;
        let saturating = |value: f64, typical: f64| 1.0 - (-value / typical).exp();
        let seconds = life as f64 / f64::from(self.scales.second);
        saturating(at_a_time, 6.0) * saturating(seconds, 1.0) * saturating(strength, 5.0)
    }

    /// Box around the points in each frame with three or more of them.
    ///
    /// Points that are tracked only shortly before or after a frame are propagated with the group.
    fn boxes(&self, group: &[usize], size: (u32, u32)) -> BTreeMap<u32, Rect> {
        let trajectory = GroupTrajectory::new(self.tracks, group);
        let window = (self.scales.second / 3).max(1);
        let frames = trajectory.frames().filter(|&frame| trajectory.num_seen(frame) >= 3);
        frames
            .filter_map(|frame| Some((frame, self.box_at(group, &trajectory, frame, window)?.clipped(size.0, size.1))))
            .collect()
    }

    fn box_at(&self, group: &[usize], trajectory: &GroupTrajectory, frame: u32, window: u32) -> Option<Rect> {
        let positions: Vec<[f64; 2]> = group
            .iter()
            .filter_map(|&k| {
                let track = &self.tracks[k];
                let nearest = frame.clamp(track.first, track.end() - 1);
                (nearest.abs_diff(frame) <= window)
                    .then(|| trajectory.propagated(track.at(nearest)?, nearest, frame))
                    .flatten()
            })
            .collect();
        let side = |k: usize| {
            let mut values: Vec<f64> = positions.iter().map(|p| p[k]).collect();
            values.sort_by(f64::total_cmp);
            let cut = values.len() / 50;
            Some((*values.get(cut)?, *values.get(values.len() - 1 - cut)?))
        };
        let margin = 0.5 * f64::from(SPACING_PX) * self.scales.pixel;
        let ((x0, x1), (y0, y1)) = (side(0)?, side(1)?);
        Some(Rect { x0: x0 - margin, y0: y0 - margin, x1: x1 + margin, y1: y1 + margin })
    }

    /// Merges movers that are parts of one object: their boxes touch and keep their offset in common frames.
    fn merged(&self, mut movers: Vec<Mover>, surroundings: &Surroundings) -> Vec<Mover> {
        let mut i = 0;
        while i < movers.len() {
            match (i + 1..movers.len()).find_map(|j| Some((j, self.merged_pair(&movers[i], &movers[j], surroundings)?)))
            {
                Some((j, merged)) => {
                    movers[i] = merged;
                    movers.remove(j);
                    i = 0;
                }
                None => i += 1,
            }
        }
        movers
    }

    /// Mover of the union of two movers, if they are parts of one object.
    fn merged_pair(&self, a: &Mover, b: &Mover, surroundings: &Surroundings) -> Option<Mover> {
        if !self.are_parts_of_one(a, b) {
            return None;
        }
        let tracks: BTreeSet<usize> = a.tracks.iter().chain(&b.tracks).copied().collect();
        let merged = self.mover(&tracks.into_iter().collect::<Vec<_>>(), surroundings);
        merged.filter(|one| one.purity >= a.purity.max(b.purity) - 0.03)
    }

    /// Returns true if the boxes of two movers touch in common frames, and their centers keep their offset.
    fn are_parts_of_one(&self, a: &Mover, b: &Mover) -> bool {
        let common: Vec<(Rect, Rect)> =
            a.boxes.iter().filter_map(|(frame, own)| Some((*own, *b.boxes.get(frame)?))).collect();
        if (common.len() as u32) < self.scales.second.min(self.scales.life) / 2 {
            return false;
        }
        let touch = common.iter().filter(|(p, q)| touches(p, q)).count();
        10 * touch >= 8 * common.len() && self.keep_offset(&common)
    }

    /// Returns true if the centers of two boxes keep their offset, relative to the size of the larger one.
    fn keep_offset(&self, common: &[(Rect, Rect)]) -> bool {
        let offset = |(p, q): &(Rect, Rect)| [p.center()[0] - q.center()[0], p.center()[1] - q.center()[1]];
        let side = |(p, q): &(Rect, Rect)| p.area_px2().max(q.area_px2()).sqrt();
        common.first().is_some_and(|first| {
            common.iter().all(|pair| {
                let (before, after) = (offset(first), offset(pair));
                let change = (after[0] - before[0]).hypot(after[1] - before[1]);
                change <= 2.0 * self.scales.pixel + 0.3 * side(first).min(side(pair))
            })
        })
    }
}

/// Point in a box.
struct PointInBox {
    track: usize,
    position: [f64; 2],
    is_own: bool,
}

/// Frames from the first box to the last.
fn range_of(boxes: &BTreeMap<u32, Rect>) -> std::ops::RangeInclusive<u32> {
    match (boxes.keys().next(), boxes.keys().next_back()) {
        (Some(first), Some(last)) => *first..=*last,
        _ => 0..=0,
    }
}

/// Box without strips along its sides in which less than a quarter of the points are its own.
fn trimmed(mut rect: Rect, points: &[PointInBox]) -> Rect {
    for _ in 0..12 {
        let (dx, dy) = (0.15 * rect.width(), 0.15 * rect.height());
        let inner = [
            Rect { x0: rect.x0 + dx, ..rect },
            Rect { y0: rect.y0 + dy, ..rect },
            Rect { x1: rect.x1 - dx, ..rect },
            Rect { y1: rect.y1 - dy, ..rect },
        ];
        let in_strip = |rest: &Rect, p: &[f64; 2]| rect.contains(p[0], p[1]) && !rest.contains(p[0], p[1]);
        let is_foreign = |rest: &&Rect| {
            let strip = points.iter().filter(|p| in_strip(rest, &p.position));
            let (own, all) = strip.fold((0, 0), |(own, all), p| (own + u32::from(p.is_own), all + 1));
            all > 0 && f64::from(own) < 0.25 * f64::from(all)
        };
        match inner.iter().find(is_foreign) {
            Some(rest) => rect = *rest,
            None => break,
        }
    }
    rect
}

/// Upper quartile.
fn upper_quartile(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() * 3 / 4).copied()
}

/// Returns true if two slightly grown boxes overlap by more than 0.15 of the smaller one.
fn touches(a: &Rect, b: &Rect) -> bool {
    let smaller = a.area_px2().min(b.area_px2());
    a.grown(0.08).intersection(&b.grown(0.08)).area_px2() > 0.15 * smaller
}

/// Image trajectory of a group: the sum of the median steps of its points.
struct GroupTrajectory {
    first: u32,
    positions: Vec<[f64; 2]>,
    seen: Vec<u32>,
}

impl GroupTrajectory {
    fn new(tracks: &[PointTrack], group: &[usize]) -> Self {
        let first = group.iter().map(|&k| tracks[k].first).min().unwrap_or(0);
        let end = group.iter().map(|&k| tracks[k].end()).max().unwrap_or(first);
        let (mut positions, mut seen) = (Vec::new(), Vec::new());
        let mut at = [0.0; 2];
        for frame in first..end {
            let steps: Vec<[f64; 2]> = group.iter().filter_map(|&k| step(&tracks[k], frame)).collect();
            let median = |k: usize| upper_median(steps.iter().map(|s| s[k]).collect()).unwrap_or(0.0);
            at = [at[0] + median(0), at[1] + median(1)];
            positions.push(at);
            seen.push(group.iter().filter(|&&k| tracks[k].at(frame).is_some()).count() as u32);
        }
        Self { first, positions, seen }
    }

    /// Range of the positions, the larger of both directions, pixels.
    fn excursion(&self) -> f64 {
        let spread = |k: usize| {
            let values = || self.positions.iter().map(|p| p[k]);
            values().fold(f64::MIN, f64::max) - values().fold(f64::MAX, f64::min)
        };
        spread(0).max(spread(1))
    }

    fn frames(&self) -> std::ops::Range<u32> {
        self.first..self.first + self.positions.len() as u32
    }

    fn num_seen(&self, frame: u32) -> u32 {
        frame.checked_sub(self.first).and_then(|k| self.seen.get(k as usize)).copied().unwrap_or(0)
    }

    /// Propagates a point from one frame to another with the motion of the group.
    fn propagated(&self, position: [f64; 2], from: u32, to: u32) -> Option<[f64; 2]> {
        let at = |frame: u32| self.positions.get(frame.checked_sub(self.first)? as usize);
        let (a, b) = (at(from)?, at(to)?);
        Some([position[0] + b[0] - a[0], position[1] + b[1] - a[1]])
    }
}

/// Displacement of a track from the previous frame.
fn step(track: &PointTrack, frame: u32) -> Option<[f64; 2]> {
    let (before, now) = (track.at(frame.checked_sub(1)?)?, track.at(frame)?);
    Some([now[0] - before[0], now[1] - before[1]])
}
