//! Consistency of registered views with the relative motions of pairs of views.
//!
//! On repeated structure (the windows of a façade, the two sides of a symmetric building) a view can be registered at
//! the wrong copy: enough points are inliers, and bundle adjustment cannot correct it. With its true neighbors it
//! shares many points that one epipolar geometry explains, but of which the map explains few. Such points may not even
//! be in the map: from two views with wrong poses they cannot be triangulated. Where the map explains less than half of
//! all points that two views share, their relative pose is therefore estimated from these points alone, and its
//! rotation and direction are compared with those of the map.
//!
//! The pose of a view may also be wrong by less: by a part of a baseline, at one of many similar bars, bricks or sills.
//! Most points still fit to some pixels, and rotation and direction hardly differ. So for unordered views every pair is
//! tested again, at the noise of the map: the epipolar geometry of the map must explain half of their common tracks, or
//! half as many as the one that is estimated from them. Pairs with uncertain motion (a plane, a short baseline) pass
//! this test: their own estimate explains hardly more than the map does.
//!
//! A pair that contradicts the map is evidence against both its views, a pair whose points fit in both is evidence for
//! them, each with the number of its points. A view with more evidence against than for it is removed, the worst first,
//! and the verdicts of its pairs are withdrawn.

use std::collections::BTreeSet;

use super::initial_pair::correspondences;
use super::map::{Map, Slot};
use crate::geometry::two_view::{self, Correspondences, TwoViewGeometry};
use crate::math::Rng;

/// Maximum number of tested pairs of a view, those that share the most points.
const MAX_PARTNERS: usize = 10;
/// Minimum number of common points of a pair for a verdict.
const MIN_COMMON: usize = 15;
/// Minimum share of the common points that the map explains of a pair that agrees with it.
const AGREEING_SHARE: f64 = 0.5;
/// Share of the known common points below which a pair contradicts the map, if one epipolar geometry explains twice as
/// many as the map does.
const CONTRADICTING_SHARE: f64 = 0.3;
/// Ratio of the inliers of the map's epipolar geometry to those of the pair's own below which the pair contradicts the
/// map, at the noise of the map.
const FINE_SHARE: f64 = 0.5;

/// Verdict of a pair of registered views on the map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PairVerdict {
    /// The views.
    pub views: [usize; 2],
    /// Number of points for the map; 0 where the pair contradicts it.
    pub agreeing: usize,
    /// Number of points against it.
    pub contradicting: usize,
}

/// Thresholds of agreement between a pair and the map.
#[derive(Clone, Copy, Debug)]
pub struct Thresholds {
    /// Epipolar and reprojection threshold, pixels.
    pub max_error_px: f64,
    /// Threshold at the noise of the map, pixels; `None` where pairs are not tested at it.
    pub fine_px: Option<f64>,
}

/// Pairs of views that share the most points.
pub struct ViewGraph {
    pairs: BTreeSet<[usize; 2]>,
    thresholds: Thresholds,
    seed: u64,
}

impl ViewGraph {
    /// Graph of all views of a map's table, registered or not.
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
    pub fn verdicts(&self, map: &Map<'_>, of: Option<usize>) -> Vec<PairVerdict> {
        let wanted = |views: &[usize; 2]| {
            of.is_none_or(|view| views.contains(&view)) && views.iter().all(|&v| map.poses[v].is_some())
        };
        self.pairs
            .iter()
            .filter(|views| wanted(views))
            .filter_map(|views| {
                let common = common(map, *views);
                let both = [self.verdict(map, *views, &common), self.fine_verdict(map, *views, &common)];
                // Evidence against the map takes precedence over evidence for it.
                both.into_iter().flatten().max_by_key(|verdict| (verdict.contradicting, verdict.agreeing))
            })
            .collect()
    }

    /// Compares the inliers of the map's epipolar geometry with those of the pair's own, at the noise of the map.
    fn fine_verdict(&self, map: &Map<'_>, views: [usize; 2], common: &[usize]) -> Option<PairVerdict> {
        let (first, second) = (map.poses[views[0]]?, map.poses[views[1]]?);
        let (pairs, max_error, mut rng) = self.pair(map, views, common, self.thresholds.fine_px?);
        let explained = two_view::num_explained(&pairs, &(second * first.inverse()), max_error)?;
        if explained as f64 >= FINE_SHARE * common.len() as f64 {
            return Some(PairVerdict { views, agreeing: explained, contradicting: 0 });
        }
        let own = two_view::verify(&pairs, max_error, &mut rng).len();
        let contradicts = own >= MIN_COMMON && (explained as f64) < FINE_SHARE * own as f64;
        contradicts.then_some(PairVerdict { views, agreeing: 0, contradicting: own - explained })
    }

    fn verdict(&self, map: &Map<'_>, views: [usize; 2], common: &[usize]) -> Option<PairVerdict> {
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
        let own = two_view::estimate_with(&pairs, max_error, needed, &mut rng);
        if let Some(found) = own.filter(|found| contradicted_by(map, views, found)) {
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

    /// Correspondences of two views, the threshold in their units, and a random number generator.
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

/// Common tracks of two views.
///
/// They are computed when needed: those of all pairs of a long video would take as much memory as its tracks.
fn common(map: &Map<'_>, [a, b]: [usize; 2]) -> Vec<usize> {
    let seen_by_b = |slot: &&Slot| map.slots(b).binary_search_by_key(&slot.track, |other| other.track).is_ok();
    map.slots(a).iter().filter(seen_by_b).map(|slot| slot.track as usize).collect()
}

/// Returns true if the relative pose of two views alone differs from that of the map.
///
/// It differs in its rotation, or in its direction where the triangulation angle determines it. On a plane, where two
/// motions explain the same points, there is no verdict.
fn contradicted_by(map: &Map<'_>, [a, b]: [usize; 2], found: &TwoViewGeometry) -> bool {
    let (Some(first), Some(second)) = (map.poses[a], map.poses[b]) else { return false };
    let in_map = second * first.inverse();
    let turn_deg = in_map.rotation.angle_to(&found.cam2_from_cam1.rotation).to_degrees();
    let direction_deg = in_map.translation.angle(&found.cam2_from_cam1.translation).to_degrees();
    // A homography explains most matches: the direction of motion is then ambiguous.
    let is_planar = found.homography_ratio > 0.8;
    // Well above the errors of two-view rotations with the required inliers.
    !is_planar && (turn_deg > 3.0 || (found.median_angle.to_degrees() >= 2.0 && direction_deg > 25.0))
}

/// Number of points for and against a view.
pub fn balance(verdicts: &[PairVerdict], view: usize) -> (usize, usize) {
    let own = verdicts.iter().filter(|o| o.views.contains(&view));
    own.fold((0, 0), |(agreeing, against), o| (agreeing + o.agreeing, against + o.contradicting))
}

/// Views with more points against than for them, the worst first; verdicts of pairs with a worse view do not count.
pub fn contradicted(mut verdicts: Vec<PairVerdict>) -> Vec<usize> {
    let mut out = Vec::new();
    loop {
        let mut views: Vec<usize> = verdicts.iter().flat_map(|o| o.views).collect();
        views.sort_unstable();
        views.dedup();
        let share = |view: usize| {
            let (agreeing, against) = balance(&verdicts, view);
            against as f64 / (agreeing + against).max(1) as f64
        };
        // The first of equals, so that the result does not depend on anything else.
        let worst = views.into_iter().rev().max_by(|&a, &b| share(a).total_cmp(&share(b)));
        match worst.filter(|&view| share(view) > 0.5) {
            Some(view) => {
                verdicts.retain(|o| !o.views.contains(&view));
                out.push(view);
            }
            None => return out,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdict(a: usize, b: usize, agreeing: usize, contradicting: usize) -> PairVerdict {
        PairVerdict { views: [a, b], agreeing, contradicting }
    }

    #[test]
    fn only_the_contradicted_view_is_removed() {
        let verdicts = vec![
            verdict(0, 1, 200, 0),
            verdict(1, 2, 200, 0),
            verdict(3, 4, 180, 0),
            // View 5 agrees with 0 and contradicts its neighbors; 2 has no pair but with 1 and 5.
            verdict(0, 5, 60, 0),
            verdict(3, 5, 0, 150),
            verdict(4, 5, 0, 150),
            verdict(2, 5, 0, 250),
        ];
        assert_eq!(balance(&verdicts, 5), (60, 550));
        assert_eq!(contradicted(verdicts), [5]);
        assert!(contradicted(vec![verdict(0, 1, 20, 0), verdict(1, 2, 0, 15)]).contains(&2));
        assert!(contradicted(Vec::new()).is_empty());
    }
}
