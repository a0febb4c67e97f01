//! Consistency of registered views with the relative motions of pairs of views.
//!
//! On repeated structure (the windows of a façade, the two sides of a symmetric building) a view can be registered at
//! the wrong copy: enough points agree, and bundle adjustment cannot carry it away. Its true neighbours know better:
//! with them it shares many points that one epipolar geometry explains, but of which the map explains few. Such points
//! may not even be in the map: seen by two views that are wrongly placed, they have no position. Where the map explains
//! less than half of all that two views share, their motion is therefore found from these points alone, and its turn
//! and direction are compared with the map's.
//!
//! A view may also be wrong by less: next to one of many bars, bricks or sills that look alike, a part of a baseline
//! away from its place. Most points still fit to some pixels, and turn and direction are hardly off. So for views in no
//! order every pair is asked again, at the noise of the map: the epipolar geometry that the map gives to the two
//! views must explain half of their common tracks, or half as many as the one that they find by themselves. That is
//! fair to pairs whose motion is uncertain (a plane, a short baseline): what they find explains hardly more than the
//! map's.
//!
//! A pair that contradicts the map speaks against both its views, a pair whose points fit in both speaks for them, each
//! with the number of its points; a view that has more against it than for it is taken out, the worst first, and what
//! it was blamed for is taken back.

use std::collections::BTreeSet;

use super::initial_pair::correspondences;
use super::map::{Map, Slot};
use crate::geometry::two_view::{self, Correspondences, TwoViewGeometry};
use crate::math::Rng;

/// Pairs that are looked at, of those that share most points with a view.
const MAX_PARTNERS: usize = 10;
/// Fewest known points that a pair must have in common to say anything.
const MIN_COMMON: usize = 15;
/// A pair of which the map explains at least this share of the common points agrees with it.
const AGREEING_SHARE: f64 = 0.5;
/// A pair of which the map explains at most this share contradicts it, if one epipolar geometry explains twice as many.
const CONTRADICTING_SHARE: f64 = 0.3;
/// At the noise of the map, its epipolar geometry explains less than this share of what the pair's own one does.
const FINE_SHARE: f64 = 0.5;

/// Verdict of a pair of registered views on the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairVerdict {
    /// The views.
    pub views: [usize; 2],
    /// Points for the map; 0 where the pair contradicts it.
    pub agreeing: usize,
    /// Points against it.
    pub contradicting: usize,
}

/// Up to where positions agree.
#[derive(Clone, Copy, Debug)]
pub struct Thresholds {
    /// Epipolar and reprojection threshold, pixels.
    pub max_error_px: f64,
    /// The same at the noise of the map, pixels; `None` where pairs are not asked for it.
    pub fine_px: Option<f64>,
}

/// The pairs of views that share most points.
pub struct ViewGraph {
    pairs: BTreeSet<[usize; 2]>,
    thresholds: Thresholds,
    seed: u64,
}

impl ViewGraph {
    /// Of all views of a map's table, registered or not.
    pub fn new(map: &Map<'_>, thresholds: Thresholds, seed: u64) -> Self {
        let mut pairs = BTreeSet::new();
        let mut shared = vec![0usize; map.poses.len()];
        for view in 0..map.poses.len() {
            shared.fill(0);
            for feature in map.slots(view).iter().flat_map(|slot| &map.tracks[slot.track as usize]) {
                shared[feature.view as usize] += 1;
            }
            let is_partner = |&other: &usize| other != view && shared[other] >= MIN_COMMON;
            let mut partners: Vec<usize> = (0..shared.len()).filter(is_partner).collect();
            partners.sort_by_key(|&other| (usize::MAX - shared[other], other));
            for other in partners.into_iter().take(MAX_PARTNERS) {
                pairs.insert([view.min(other), view.max(other)]);
            }
        }
        Self { pairs, thresholds, seed }
    }

    /// Verdicts of pairs of registered views; only of those of one view, where it is given.
    pub fn opinions(&self, map: &Map<'_>, of: Option<usize>) -> Vec<PairVerdict> {
        let wanted = |views: &[usize; 2]| {
            of.is_none_or(|view| views.contains(&view)) && views.iter().all(|&v| map.poses[v].is_some())
        };
        self.pairs
            .iter()
            .filter(|views| wanted(views))
            .filter_map(|views| {
                let common = common(map, *views);
                let said = [self.opinion(map, *views, &common), self.fine_opinion(map, *views, &common)];
                // What speaks against the map goes before what speaks for it.
                said.into_iter().flatten().max_by_key(|opinion| (opinion.contradicting, opinion.agreeing))
            })
            .collect()
    }

    /// Compares the epipolar geometry of the map with the one that two views have by themselves, by the tracks that
    /// each explains at the map's noise.
    fn fine_opinion(&self, map: &Map<'_>, views: [usize; 2], common: &[usize]) -> Option<PairVerdict> {
        let (first, second) = (map.poses[views[0]]?, map.poses[views[1]]?);
        let (pairs, max_error, mut rng) = self.pair(map, views, common, self.thresholds.fine_px?);
        let explained = two_view::num_explained(&pairs, &(second * first.inverse()), max_error)?;
        if explained as f64 >= FINE_SHARE * common.len() as f64 {
            return Some(PairVerdict { views, agreeing: explained, contradicting: 0 });
        }
        let by_itself = two_view::verify(&pairs, max_error, &mut rng).len();
        let contradicts = by_itself >= MIN_COMMON && (explained as f64) < FINE_SHARE * by_itself as f64;
        contradicts.then_some(PairVerdict { views, agreeing: 0, contradicting: by_itself - explained })
    }

    fn opinion(&self, map: &Map<'_>, views: [usize; 2], common: &[usize]) -> Option<PairVerdict> {
        let max_error_px = self.thresholds.max_error_px;
        let known: Vec<usize> = common.iter().copied().filter(|&t| map.point(t).is_some()).collect();
        let fits = known.iter().filter(|&&t| views.iter().all(|&v| self.fits(map, t, v))).count();
        let is_share = |share: f64, of: &[usize]| fits as f64 >= share * of.len() as f64;
        let agrees = Some(PairVerdict { views, agreeing: fits, contradicting: 0 });
        let needed = MIN_COMMON.max(2 * fits);
        let contradicts =
            |points: usize| (points >= needed).then_some(PairVerdict { views, agreeing: 0, contradicting: points });
        if known.len() >= MIN_COMMON && is_share(AGREEING_SHARE, common) {
            return agrees;
        }
        if known.len() >= MIN_COMMON && !is_share(CONTRADICTING_SHARE, &known) {
            let (pairs, max_error, mut rng) = self.pair(map, views, &known, max_error_px);
            return contradicts(two_view::verify(&pairs, max_error, &mut rng).len());
        }
        let (pairs, max_error, mut rng) = self.pair(map, views, common, max_error_px);
        let by_itself = two_view::estimate_with(&pairs, max_error, needed, &mut rng);
        if let Some(found) = by_itself.filter(|found| contradicted_by(map, views, found)) {
            return contradicts(found.inliers.len());
        }
        agrees.filter(|_| known.len() >= MIN_COMMON && is_share(AGREEING_SHARE, &known))
    }

    fn fits(&self, map: &Map<'_>, track: usize, view: usize) -> bool {
        let (Some(point), Some(pose)) = (map.point(track), &map.poses[view]) else { return false };
        let Some(feature) = map.tracks[track].iter().find(|f| f.view as usize == view) else { return false };
        map.camera_of(view)
            .pixel_from_cam(*pose * point.position)
            .is_some_and(|pixel| (pixel - map.table.pixel(*feature)).norm() <= self.thresholds.max_error_px)
    }

    /// Tracks that two views have in common, a threshold in their units, and random numbers.
    fn pair(
        &self,
        map: &Map<'_>,
        views: [usize; 2],
        common: &[usize],
        max_error_px: f64,
    ) -> (Correspondences, f64, Rng) {
        let (pairs, mean_focal) = correspondences(&map.table.views, &map.tracks, &map.cameras, views, common);
        (pairs, max_error_px / mean_focal, two_view::pair_rng(self.seed, views))
    }
}

/// Tracks that two views have in common. They are looked up when they are needed: those of all pairs of a long video
/// would take as much memory as its tracks.
fn common(map: &Map<'_>, [a, b]: [usize; 2]) -> Vec<usize> {
    let seen_by_b = |slot: &&Slot| map.slots(b).binary_search_by_key(&slot.track, |other| other.track).is_ok();
    map.slots(a).iter().filter(seen_by_b).map(|slot| slot.track as usize).collect()
}

/// Returns true if the relative motion that two views have by themselves differs from that of the map: in its rotation,
/// or in its direction where the triangulation angle determines it. On a plane, where two motions explain the same
/// points, there is no verdict.
fn contradicted_by(map: &Map<'_>, [a, b]: [usize; 2], found: &TwoViewGeometry) -> bool {
    let (Some(first), Some(second)) = (map.poses[a], map.poses[b]) else { return false };
    let in_map = second * first.inverse();
    let turn_deg = in_map.rotation.angle_to(&found.cam2_from_cam1.rotation).to_degrees();
    let direction_deg = in_map.translation.angle(&found.cam2_from_cam1.translation).to_degrees();
    // A homography explains most matches: the direction of motion is then ambiguous.
    let is_planar = found.homography_ratio > 0.8;
    // Well above what two-view rotations err by with the required inliers.
    !is_planar && (turn_deg > 3.0 || (found.median_angle.to_degrees() >= 2.0 && direction_deg > 25.0))
}

/// Points for and against a view.
pub fn balance(opinions: &[PairVerdict], view: usize) -> (usize, usize) {
    let own = opinions.iter().filter(|o| o.views.contains(&view));
    own.fold((0, 0), |(agreeing, against), o| (agreeing + o.agreeing, against + o.contradicting))
}

/// The views that have more against them than for them, the worst first; opinions of pairs with a worse view do not
/// count.
pub fn contradicted(mut opinions: Vec<PairVerdict>) -> Vec<usize> {
    let mut out = Vec::new();
    loop {
        let mut views: Vec<usize> = opinions.iter().flat_map(|o| o.views).collect();
        views.sort_unstable();
        views.dedup();
        let share = |view: usize| {
            let (agreeing, against) = balance(&opinions, view);
            against as f64 / (agreeing + against).max(1) as f64
        };
        // The first of equals, so that the result does not depend on anything else.
        let worst = views.into_iter().rev().max_by(|&a, &b| share(a).total_cmp(&share(b)));
        match worst.filter(|&view| share(view) > 0.5) {
            Some(view) => {
                opinions.retain(|o| !o.views.contains(&view));
                out.push(view);
            }
            None => return out,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn opinion(a: usize, b: usize, agreeing: usize, contradicting: usize) -> PairVerdict {
        PairVerdict { views: [a, b], agreeing, contradicting }
    }

    #[test]
    fn the_view_that_most_speak_against_is_named_and_its_accusers_are_not() {
        let opinions = vec![
            opinion(0, 1, 200, 0),
            opinion(1, 2, 200, 0),
            opinion(3, 4, 180, 0),
            // View 5 agrees with 0 and contradicts those round it; 2 has nobody else but 1.
            opinion(0, 5, 60, 0),
            opinion(3, 5, 0, 150),
            opinion(4, 5, 0, 150),
            opinion(2, 5, 0, 250),
        ];
        assert_eq!(balance(&opinions, 5), (60, 550));
        assert_eq!(contradicted(opinions), [5]);
        assert!(contradicted(vec![opinion(0, 1, 20, 0), opinion(1, 2, 0, 15)]).contains(&2));
        assert!(contradicted(Vec::new()).is_empty());
    }
}
