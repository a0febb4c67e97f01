//! Changes of the focal length in a video: a zoom, a switch of lenses, a crop by an editor.
//!
//! A map has one focal length for all frames of a video. A change of that of the video is absorbed by motion along the
//! line of sight, at residuals that are hardly larger. The two differ: motion displaces near points by more than far
//! ones, a zoom displaces all alike. So the map is adjusted again, with a focal length for every view,
//!
//! ```text
//! f_t = f exp(g_t),
//! ```
//!
//! and g_t − g_0 is compared with its standard deviation. That is small even where the motion does not determine f
//! itself, as in forward motion: the views observe common points. On one plane viewed from above a zoom equals a change
//! of height, and the standard deviation is large.
//!
//! Errors that all views have in common, of distortion and of points that drift with the view, accumulate from view to
//! view. They are covered by [`COMMON_ERROR_FACTOR`], and by a jackknife: the points of the left half and those of the
//! right half of the image must each show the change.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;

use nalgebra::{Point2, UnitQuaternion, Vector3};

use super::adjustment::cell_of;
use crate::bundle::{
    self, BundleError, COMMON_ERROR_FACTOR, CameraBlock, IntrinsicsPrior, Observation, PointBlock, PoseBlock, Problem,
    Wanted,
};
use crate::camera::Camera;
use crate::math::{RAYLEIGH_MEDIAN, Rigid3, RobustLoss, upper_median};
use crate::scene::{FocalChange, Image, ImageId, Point3dId, Reconstruction, TrackElement};

/// Minimum change of ln f that counts: twice the largest on 13 clips without a zoom (5 %, a high drone over a nearly
/// planar scene). Stabilization and focus breathing change the focal length by 1 to 3 %.
const MIN_CHANGE: f64 = 0.1;
/// Number of standard deviations of a significant change.
const SIGNIFICANT: f64 = 3.0;
/// Number of views that are adjusted at once, so that the cost per view does not depend on the length of the video; a
/// change within half as many views is within one window.
const WINDOW: usize = 400;
/// Minimum number of selected points of a view.
const MIN_POINTS: usize = 20;
/// Minimum number of points of a view in one half of the image: ten equations for its seven unknowns.
const MIN_HALF_POINTS: usize = 5;
/// Minimum number of views.
const MIN_VIEWS: usize = 8;
/// Number of views of the running median: single blurred or occluded views do not count.
const MEDIAN_VIEWS: usize = 5;

/// Detects changes of the focal length in a video's map with one camera; none in a map of several cameras.
///
/// * `principal` – the principal point before the adjustment: that of the map absorbs a part of a zoom.
pub fn focal_changes(model: &Reconstruction, principal: [f64; 2]) -> Vec<FocalChange> {
    let Some((id, camera)) = model.cameras.first_key_value().filter(|_| model.cameras.len() == 1) else {
        return Vec::new();
    };
    if !model.can_project(*id) {
        return Vec::new();
    }
    let trusted = Camera { principal, ..*camera };
    let images: Vec<(ImageId, &Image)> = model.images.iter().map(|(id, image)| (*id, image)).collect();
    let mut changes: Vec<FocalChange> = Vec::new();
    for window in windows(images.len()) {
        let found = Window::new(model, [*camera, trusted], &images[window]).change().unwrap_or_else(|error| {
            // Undetermined focal lengths show no change.
            tracing::debug!("focal length of every view: {error}");
            None
        });
        // The same change may be in two windows.
        changes.extend(found.filter(|change| changes.last().is_none_or(|last| change.first >= last.last)));
    }
    changes
}

/// Windows of views, each beginning in the middle of the one before it.
fn windows(num_views: usize) -> Vec<Range<usize>> {
    let starts = (0..num_views.saturating_sub(WINDOW / 2).max(1)).step_by(WINDOW / 2);
    starts.map(|start| start..num_views.min(start + WINDOW)).collect()
}

/// Points that take part.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Part {
    All,
    Left,
    Right,
}

/// Views that are adjusted at once, and the points that take part.
struct Window<'a> {
    model: &'a Reconstruction,
    map_camera: Camera,
    camera: Camera,
    views: Vec<(ImageId, &'a Image)>,
    points: BTreeSet<Point3dId>,
}

/// Selects the longest tracks in every part of every one of some images of a camera.
pub(super) fn longest_tracks<'a>(
    model: &Reconstruction,
    camera: &Camera,
    images: impl Iterator<Item = &'a Image>,
) -> BTreeSet<Point3dId> {
    let mut points = BTreeSet::new();
    for image in images {
        let mut cells: BTreeMap<usize, Vec<(bool, usize, Point3dId)>> = BTreeMap::new();
        for (seen, id) in image.observations.iter().filter_map(|seen| Some((seen, seen.point?))) {
            let Some(length) = model.points.get(&id).map(|point| point.track.len()) else { continue };
            // Two views fit a point at any depth and focal length.
            if length >= 3 {
                let cell = cells.entry(cell_of(seen.pixel, camera)).or_default();
                cell.push((!points.contains(&id), usize::MAX - length, id));
            }
        }
        for mut cell in cells.into_values() {
            cell.sort_unstable();
            points.extend(cell.into_iter().take(2).map(|(.., id)| id));
        }
    }
    points
}

/// Problem of some images of the first camera and the points that at least two of them observe, without cameras.
///
/// * `takes_part` – filter of points by their observations, each with the index of its image and the pixel.
pub(super) fn problem_of(
    model: &Reconstruction,
    images: &[(ImageId, &Image)],
    points: &BTreeSet<Point3dId>,
    takes_part: impl Fn(&[(u32, Point2<f64>)]) -> bool,
) -> Problem {
    let index_of: BTreeMap<ImageId, u32> = images.iter().map(|(id, _)| *id).zip(0..).collect();
    let pose =
        |(_, image): &(ImageId, &Image)| PoseBlock { cam_from_world: image.cam_from_world, camera: 0, fixed: false };
    let mut problem = Problem { poses: images.iter().map(pose).collect(), ..Problem::default() };
    for point in points.iter().filter_map(|id| model.points.get(id)) {
        let observed = |element: &TrackElement| {
            let index = *index_of.get(&element.image)?;
            let observations = &images[index as usize].1.observations;
            Some((index, observations.get(element.observation_idx as usize)?.pixel))
        };
        let seen: Vec<(u32, Point2<f64>)> = point.track.iter().filter_map(observed).collect();
        if seen.len() >= 2 && takes_part(&seen) {
            let index = problem.points.len() as u32;
            problem.points.push(PointBlock { position: point.position, fixed: false });
            problem.observations.extend(seen.into_iter().map(|(view, pixel)| Observation::new(view, index, pixel)));
        }
    }
    problem
}

/// ln f of every view, its standard deviation relative to that of the first view, and its number of points.
struct FocalLengths {
    log: Vec<f64>,
    std: Vec<f64>,
    num_points: Vec<usize>,
}

impl<'a> Window<'a> {
    fn new(model: &'a Reconstruction, cameras: [Camera; 2], views: &[(ImageId, &'a Image)]) -> Self {
        let [map_camera, camera] = cameras;
        let points = longest_tracks(model, &camera, views.iter().map(|(_, image)| *image));
        let mut window = Self { model, map_camera, camera, views: views.to_vec(), points };
        let Self { views, points, .. } = &mut window;
        let num_selected =
            |image: &Image| image.observations.iter().filter(|o| o.point.is_some_and(|p| points.contains(&p))).count();
        views.retain(|(_, image)| num_selected(image) >= MIN_POINTS);
        window
    }

    fn change(&self) -> Result<Option<FocalChange>, BundleError> {
        if self.views.len() < MIN_VIEWS {
            return Ok(None);
        }
        let whole = self.focal_lengths(Part::All)?;
        let change = whole.relative_to_first();
        let common = |t: usize| COMMON_ERROR_FACTOR * whole.std[t];
        let is_significant = |t: usize, std: f64| change[t].abs() > MIN_CHANGE.max(SIGNIFICANT * std);
        // A focal length that is not positive has no logarithm.
        let is_determined = change.iter().all(|log| log.is_finite());
        if !is_determined || !(0..change.len()).any(|t| is_significant(t, common(t))) {
            return Ok(None);
        }
        let [left, right] = [self.focal_lengths(Part::Left)?, self.focal_lengths(Part::Right)?];
        let is_seen =
            |t: usize| [&left, &right].iter().all(|half| half.num_points[0].min(half.num_points[t]) >= MIN_HALF_POINTS);
        let (by_left, by_right) = (left.relative_to_first(), right.relative_to_first());
        let halves = |t: usize| {
            let off = 0.5 * (by_left[t] - by_right[t]).abs();
            if is_seen(t) && off.is_finite() { off } else { f64::INFINITY }
        };
        if !(0..change.len()).any(|t| is_significant(t, common(t).hypot(halves(t)))) {
            return Ok(None);
        }
        let frame = |t: usize| self.views[t].0.frame();
        let ([first, last], largest) = span(&change);
        Ok(Some(FocalChange { first: frame(first), last: frame(last), factor: largest.exp() }))
    }

    /// Adjusts everything with a focal length for every view.
    fn focal_lengths(&self, part: Part) -> Result<FocalLengths, BundleError> {
        let mut problem = self.problem(part);
        let focal = self.camera.focal;
        // The residuals of the first round are those of the map.
        for _ in 0..2 {
            let sigma_px = noise(&problem);
            problem.priors.intrinsics =
                (0..problem.cameras.len()).map(|camera| prior(camera, &self.camera, sigma_px)).collect();
            bundle::adjust(&mut problem, &options(sigma_px))?;
        }
        let log = problem.cameras.iter().map(|block| (block.camera.focal[0] / focal[0]).ln()).collect();
        let mut std = vec![0.0; self.views.len()];
        if part == Part::All {
            let sigma_px = noise(&problem);
            problem.cameras[0].free = CameraBlock::fixed(self.camera).free;
            let wanted = Wanted { cameras: (1..self.views.len()).collect(), ..Wanted::default() };
            let found = bundle::covariances(&problem, &options(sigma_px), &wanted)?;
            for (t, covariance) in (1..).zip(found.cameras) {
                std[t] = sigma_px * covariance[(0, 0)].sqrt() / problem.cameras[t].camera.focal[0];
            }
        }
        let mut num_points = vec![0; self.views.len()];
        problem.observations.iter().for_each(|o| num_points[o.pose as usize] += 1);
        Ok(FocalLengths { log, std, num_points })
    }

    fn problem(&self, part: Part) -> Problem {
        let free = [true, true, false, false, false, false];
        let block = CameraBlock { camera: self.camera, free, tie_focal: true };
        // With a principal point other than the map's, a rotated view observes nearly the same.
        let middle = Camera::prior(self.camera.width, self.camera.height).principal.into();
        let [old, new] = [&self.map_camera, &self.camera].map(|camera| camera.ray_from_pixel(middle));
        let turn = UnitQuaternion::rotation_between(&old, &new).unwrap_or_default();
        let turn = Rigid3::new(turn, Vector3::zeros());
        let takes_part = |seen: &[(u32, Point2<f64>)]| {
            let middle = seen.iter().map(|(_, pixel)| pixel.x).sum::<f64>() / seen.len() as f64;
            let is_left = middle < 0.5 * f64::from(self.camera.width);
            part == Part::All || (part == Part::Left) == is_left
        };
        let mut problem = problem_of(self.model, &self.views, &self.points, takes_part);
        problem.cameras = vec![block; self.views.len()];
        for (camera, pose) in problem.poses.iter_mut().enumerate() {
            (pose.cam_from_world, pose.camera) = (turn * pose.cam_from_world, camera);
        }
        problem
    }
}

impl FocalLengths {
    /// ln f of every view relative to the first ones, as a running median.
    fn relative_to_first(&self) -> Vec<f64> {
        let median_round = |t: usize| {
            let round =
                self.log[t.saturating_sub(MEDIAN_VIEWS / 2)..self.log.len().min(t + MEDIAN_VIEWS / 2 + 1)].to_vec();
            upper_median(round).unwrap_or_default()
        };
        let smooth: Vec<f64> = (0..self.log.len()).map(median_round).collect();
        smooth.iter().map(|log| log - smooth[0]).collect()
    }
}

/// Robust standard deviation of a pixel coordinate: the median residual as that of a Gaussian.
pub(super) fn noise(problem: &Problem) -> f64 {
    // Minimum noise, pixels: less is rounding.
    const LEAST_PX: f64 = 1e-3;
    let median = upper_median(problem.errors_px().collect());
    median.map_or(LEAST_PX, |median| (median / RAYLEIGH_MEDIAN).max(LEAST_PX))
}

pub(super) fn options(sigma_px: f64) -> bundle::Options {
    // Two standard deviations, as in the mapper.
    let loss = RobustLoss::SoftL1 { scale: 2.0 * sigma_px };
    // A zoom and a motion that represents it differ little in cost.
    bundle::Options { loss, function_tolerance: 1e-7, max_iterations: 100, ..bundle::Options::default() }
}

/// Prior that keeps a focal length near that of the map where the observations leave it undetermined.
///
/// Two standard deviations are from 0.45 to 2.2 times the focal length, which no zoom lens of a phone, a drone or a
/// dash camera exceeds within a clip.
fn prior(camera: usize, intrinsics: &Camera, sigma_px: f64) -> IntrinsicsPrior {
    let mut sigma = [f64::INFINITY; 6];
    for (sigma, focal) in sigma.iter_mut().zip(intrinsics.focal) {
        // Half of ln 2.2. It counts once for fx and once for fy, in units of observations with common errors.
        *sigma = std::f64::consts::SQRT_2 * 0.4 * focal / (COMMON_ERROR_FACTOR * sigma_px);
    }
    IntrinsicsPrior { camera, values: intrinsics.intrinsics(), sigma }
}

/// Interval in which a series changes, and the size of the change.
///
/// With forward motion a steady zoom and a steady change of speed differ little, so that a series may drift from its
/// beginning to its end. A change within a much shorter time after removal of the drift takes precedence.
fn span(change: &[f64]) -> ([usize; 2], f64) {
    let rate = upper_median(change.windows(2).map(|pair| pair[1] - pair[0]).collect()).unwrap_or_default();
    let without_drift: Vec<f64> = (0..).zip(change).map(|(t, log)| log - rate * f64::from(t)).collect();
    let (whole, part) = (between_levels(change), between_levels(&without_drift));
    let length = |([first, last], _): ([usize; 2], f64)| last - first;
    if part.1.abs() > MIN_CHANGE && 2 * length(part) < length(whole) { part } else { whole }
}

/// Interval from the last view at the first level of a series to the first view that stays at the last level.
///
/// Also returns the largest change within it.
fn between_levels(change: &[f64]) -> ([usize; 2], f64) {
    let largest = change.iter().copied().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap_or_default();
    // Levels drift by a part of the change.
    let tolerance = (0.25 * MIN_CHANGE).max(0.1 * largest.abs());
    let end = change.len() - 1;
    let last_level = change[end];
    let first = change.iter().position(|c| c.abs() > tolerance).map_or(0, |left| left.saturating_sub(1));
    let last = change.iter().rposition(|c| (c - last_level).abs() > tolerance).map_or(end, |away| away + 1);
    ([first.min(last), last.max(first)], largest)
}

#[cfg(test)]
mod tests;
