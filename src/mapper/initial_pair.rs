//! Initial pair of a map: many common points, a large triangulation angle, and neither a plane nor a pure rotation.

use std::collections::BTreeMap;

use nalgebra::Point2;

use super::motion::{self, PairMotion, Survey};
use super::{Intrinsics, KnownIntrinsics, Options};
use crate::camera::Camera;
use crate::features::tracks::{Feature, Track, TrackTable, View};
use crate::geometry::two_view::{self, Correspondences, TwoViewGeometry};
use crate::math::{Rigid3, upper_median};

/// Candidate for the initial pair.
#[derive(Clone, Debug)]
pub struct InitialPair {
    /// Its two views.
    pub views: [usize; 2],
    /// Second camera from first, unit baseline.
    pub cam2_from_cam1: Rigid3,
}

/// Maximum number of views that are paired; those of longer sequences are evenly spaced.
const MAX_VIEWS: usize = 48;
/// Maximum number of views from one paired view to the next, however long the video is: tracks end after 96 views, and
/// views farther apart have no common track.
const MAX_STEP: usize = 24;
/// Median displacement of the common points below which two views count as one: any two-view geometry fits noise.
const MIN_DISPLACEMENT_PX: f64 = 0.5;
/// Maximum number of pairs whose geometry is estimated.
const MAX_ESTIMATED: usize = 60;

/// Candidates for the initial pair, best first, and the survey of the motion of all pairs.
///
/// There is no candidate if no pair has enough common points at a sufficient angle.
pub fn ranked(
    table: &TrackTable,
    cameras: &[Camera],
    known: &KnownIntrinsics,
    options: &Options,
    seed: u64,
) -> (Vec<InitialPair>, Survey) {
    let common = common_tracks(table, step(table.views.len()), usize::MAX, options.min_initial_inliers);
    let mut survey = Survey::default();
    let mut estimated: Vec<(f64, InitialPair)> = promising(table, cameras, common, &mut survey)
        .into_iter()
        .filter_map(|(views, tracks)| {
            let geometry = geometry_of(table, cameras, options, seed, views, &tracks)?;
            let of_views = views.map(|view| table.views[view].camera);
            let intrinsics = known.of_pair(of_views);
            let score = score(&geometry, options) * camera_weight(of_views, intrinsics);
            let pair = InitialPair { views, cam2_from_cam1: geometry.cam2_from_cam1 };
            let motion = motion::classify(&geometry, intrinsics);
            survey.add(motion);
            let usable = motion == PairMotion::General
                && geometry.inliers.len() >= options.min_initial_inliers
                && geometry.median_angle >= options.min_angle_deg.to_radians();
            usable.then_some((score, pair))
        })
        .collect();
    estimated.sort_by(|a, b| b.0.total_cmp(&a.0));
    (distinct(estimated.into_iter().map(|(_, pair)| pair)), survey)
}

/// Score of a candidate.
///
/// Inliers count up to a number that determines the geometry well, angles up to the wanted one. A pair that one
/// homography explains scores a fraction.
fn score(geometry: &TwoViewGeometry, options: &Options) -> f64 {
    // Beyond 300 the angle decides, not the number.
    let inliers = (geometry.inliers.len() as f64).min(300.0).sqrt();
    let angle = geometry.median_angle.to_degrees().min(options.initial_angle_deg);
    inliers * angle * (1.0 - 0.7 * geometry.homography_ratio.min(1.0))
}

/// Weight of a pair by its cameras.
///
/// Guessed focal lengths of two cameras are wrong by different factors. Such a pair scores less than one of a single
/// camera, where a common factor does little harm.
fn camera_weight([first, second]: [usize; 2], intrinsics: Intrinsics) -> f64 {
    // A pair of one camera wins unless it has a quarter of the inliers.
    if first != second && intrinsics.focal >= Intrinsics::GUESSED.focal { 0.5 } else { 1.0 }
}

/// Two views and their common tracks.
type PairTracks = ([usize; 2], Vec<usize>);

/// Number of views from one paired view to the next.
fn step(num_views: usize) -> usize {
    num_views.div_ceil(MAX_VIEWS).clamp(1, MAX_STEP)
}

/// Common tracks of the pairs of every `step`th view that are at most `max_separation` views apart and have enough of
/// them.
pub fn common_tracks(table: &TrackTable, step: usize, max_separation: usize, min_common: usize) -> Vec<PairTracks> {
    let mut common: BTreeMap<[usize; 2], Vec<usize>> = BTreeMap::new();
    for (index, track) in table.tracks.iter().enumerate() {
        let views: Vec<usize> = track.iter().map(|f| f.view as usize).filter(|v| v % step == 0).collect();
        for (i, &a) in views.iter().enumerate() {
            for &b in views[i + 1..].iter().take_while(|b| **b - a <= max_separation) {
                common.entry([a, b]).or_default().push(index);
            }
        }
    }
    common.into_iter().filter(|(_, tracks)| tracks.len() >= min_common).collect()
}

/// Selects the pairs with the largest product of common points and median displacement.
///
/// Common points count up to a sufficient number. The displacement represents the baseline until the geometry is known.
/// Pairs without displacement are only counted.
fn promising(table: &TrackTable, cameras: &[Camera], common: Vec<PairTracks>, survey: &mut Survey) -> Vec<PairTracks> {
    let mut rate = |(views, tracks): PairTracks| {
        let median = median_displacement(table, cameras, &tracks, views)?;
        let count = (tracks.len() as f64).min(400.0);
        if median < MIN_DISPLACEMENT_PX {
            survey.add(PairMotion::Stationary);
            return None;
        }
        Some((count.sqrt() * median.sqrt(), (views, tracks)))
    };
    let mut rated: Vec<(f64, PairTracks)> = common.into_iter().filter_map(&mut rate).collect();
    rated.sort_by(|a, b| b.0.total_cmp(&a.0));
    // Every other candidate from the whole list, so that one kind of pair (far apart, few points) does not fill it.
    let step = (rated.len() / MAX_ESTIMATED).max(1);
    let head = MAX_ESTIMATED / 2;
    let (front, rest): (Vec<_>, Vec<_>) = rated.into_iter().enumerate().partition(|(i, _)| *i < head);
    let spread = rest.into_iter().filter(|(i, _)| i % step == 0).take(MAX_ESTIMATED - head);
    front.into_iter().chain(spread).map(|(_, (_, pair))| pair).collect()
}

/// Returns true if the common tracks of two views have no displacement, or there are none.
pub fn has_no_displacement(table: &TrackTable, cameras: &[Camera], tracks: &[usize], views: [usize; 2]) -> bool {
    median_displacement(table, cameras, tracks, views).is_none_or(|median| median < MIN_DISPLACEMENT_PX)
}

/// Median displacement of common tracks, pixels of the first camera.
fn median_displacement(table: &TrackTable, cameras: &[Camera], tracks: &[usize], views: [usize; 2]) -> Option<f64> {
    let [first, second] = views.map(|view| table.views[view].camera);
    let displacement = |&track: &usize| {
        let [a, b] = pixels_in(&table.views, &table.tracks[track], views)?;
        if first == second {
            return Some((a - b).norm());
        }
        let (a, b) = (cameras[first].normalized_from_pixel(a), cameras[second].normalized_from_pixel(b));
        Some(cameras[first].mean_focal() * (a - b).norm())
    };
    upper_median(tracks.iter().filter_map(displacement).collect())
}

/// Two-view geometry of some common tracks.
pub fn geometry_of(
    table: &TrackTable,
    cameras: &[Camera],
    options: &Options,
    seed: u64,
    views: [usize; 2],
    tracks: &[usize],
) -> Option<TwoViewGeometry> {
    let (pairs, mean_focal) = correspondences(&table.views, &table.tracks, cameras, views, tracks);
    two_view::estimate(&pairs, options.max_pose_error_px / mean_focal, &mut two_view::pair_rng(seed, views))
}

/// Positions of common tracks in two views, and the geometric mean of the focal lengths.
pub fn correspondences(
    views: &[View],
    tracks: &[Track],
    cameras: &[Camera],
    pair: [usize; 2],
    common: &[usize],
) -> (Correspondences, f64) {
    let cameras = pair.map(|view| &cameras[views[view].camera]);
    let pixels = common.iter().filter_map(|&track| pixels_in(views, &tracks[track], pair));
    (Correspondences::new(cameras, pixels), two_view::mean_focal(cameras))
}

/// Positions of a track in two views.
fn pixels_in(views: &[View], track: &[Feature], pair: [usize; 2]) -> Option<[Point2<f64>; 2]> {
    let pixel = |view: usize| {
        let feature = track.iter().find(|f| f.view as usize == view)?;
        Some(views[view].pixels[feature.feature as usize])
    };
    Some([pixel(pair[0])?, pixel(pair[1])?])
}

/// Reorders pairs: first the best of every neighborhood, best first, then all others.
///
/// Two pairs are neighbors if both their first and their second views are less than a sixth of all views apart.
pub fn diversified(pairs: Vec<InitialPair>, num_views: usize) -> Vec<InitialPair> {
    let least = num_views.div_ceil(6);
    let mut far: Vec<InitialPair> = Vec::new();
    let mut near = Vec::new();
    for pair in pairs {
        let is_near = |other: &InitialPair| (0..2).all(|side| other.views[side].abs_diff(pair.views[side]) < least);
        if far.iter().any(is_near) { near.push(pair) } else { far.push(pair) }
    }
    far.append(&mut near);
    far
}

/// Removes pairs with a better one within two views on both sides: a second attempt should differ.
fn distinct(pairs: impl Iterator<Item = InitialPair>) -> Vec<InitialPair> {
    let mut kept: Vec<InitialPair> = Vec::new();
    for pair in pairs {
        let near = |other: &InitialPair| (0..2).all(|side| other.views[side].abs_diff(pair.views[side]) <= 2);
        if !kept.iter().any(near) {
            kept.push(pair);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::ImageId;

    #[test]
    fn the_second_attempt_uses_another_pair() {
        let pair = |views| InitialPair { views, cam2_from_cam1: Rigid3::identity() };
        let best_first = [[10, 20], [12, 22], [10, 30], [40, 50], [41, 49]];
        let order = diversified(best_first.map(pair).to_vec(), 60);
        assert_eq!(
            order.iter().map(|p| p.views).collect::<Vec<_>>(),
            [[10, 20], [10, 30], [40, 50], [12, 22], [41, 49]]
        );
        assert_eq!(distinct(best_first.map(pair).into_iter()).len(), 3);
    }

    #[test]
    fn a_video_of_any_length_has_pairs() {
        let view = |k: u32| View {
            image: ImageId(k),
            name: String::new(),
            camera: 0,
            pixels: Vec::new(),
            rgb: Vec::new(),
            whitening: Vec::new(),
        };
        let track = |first: u32| (first..first + 80).map(|view| Feature { view, feature: 0 }).collect();
        let table = TrackTable { views: (0..6000).map(view).collect(), tracks: (0..5900).map(track).collect() };
        let pairs = common_tracks(&table, step(6000), usize::MAX, 50);
        assert!(pairs.len() > 200 && pairs.iter().all(|([a, b], tracks)| b - a < 80 && tracks.len() >= 50));
    }
}
