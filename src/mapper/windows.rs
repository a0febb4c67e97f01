//! Windowed adjustment of long maps, so that memory and time do not depend on the length of a video.
//!
//! Two views far from one another in a video have no common point: information between them passes from track to track,
//! and is lost in their noise after a few lengths of a track. So a view's pose relative to its neighbors depends only
//! on the views within some hundred of it. A *window* of views is adjusted on the observations of its own and of
//! earlier views. Earlier views are fixed; later ones are excluded, and moved by the similarity that moved the window's
//! last view. The next window begins half a window later, so that every view is final only when as many later views
//! have contributed.
//!
//! The intrinsics, which all views have in common, are not adjusted in windows, where each window would have its own.
//! Segments without common observations estimate them separately, and the mean of the estimates counts, weighted by
//! information: with the information I_w = Σ_w⁻¹ of segment w at the common initial intrinsics θ₀, and that of the
//! prior, I_0 about θ_p,
//!
//! ```text
//! θ = θ₀ + (I_0 + Σ_w I_w)⁻¹ (I_0 (θ_p − θ₀) + Σ_w I_w (θ_w − θ₀))
//! ```
//!
//! The weights are those at θ₀, not at θ_w, on whose errors they would depend.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::adjustment::{self, Freedom, Scope, Segment};
use super::map::Map;
use super::{Noise, Options, intrinsics_prior};
use crate::bundle::{self, BundleError, IntrinsicsPrior, Problem, Wanted};
use crate::camera::Camera;
use crate::mapper::MapperError;
use crate::math::{Rigid3, Sim3, upper_median};

/// Number of views of a window: four lengths of the longest tracks.
const WINDOW: usize = 400;
/// Number of views from one window to the next, and so of later views that contribute before a view is final.
pub const STEP: usize = 200;

/// Returns true if a map is adjusted in windows: that of a video of one camera and many views, without loop closures.
pub fn is_long(map: &Map<'_>, options: &Options) -> bool {
    options.ordered
        && map.cameras.len() == 1
        && !map.has_loop_closures
        && map.num_registered() > options.max_views_at_once
}

/// Adjusts the poses and points of a long map, every view in two windows.
///
/// Returns true for every track whose point was adjusted.
pub fn sweep(map: &mut Map<'_>, scope: &Scope, noise: Noise, options: &Options) -> Result<Vec<bool>, MapperError> {
    let views: Vec<usize> = map.registered().collect();
    let mut adjusted = vec![false; map.tracks.len()];
    for start in (0..views.len()).step_by(STEP) {
        let end = views.len().min(start + WINDOW);
        let (first, last) = (views[start], views[end - 1]);
        let after = last + 1;
        let segment = Segment { views: first..after, counted: 0..after, scope: Box::new(scope.clone()) };
        let boundary = BoundaryView::new(map, last);
        let used = adjustment::adjust(map, &Scope::Segment(segment), Freedom::Nothing, noise, options)?;
        adjusted.iter_mut().zip(&used).for_each(|(all, used)| *all |= used);
        if end == views.len() {
            break;
        }
        if let Some(boundary) = boundary {
            boundary.propagate(map, &views[end..], &adjusted);
        }
    }
    Ok(adjusted)
}

/// Ranges of views by which a long map has grown at its ends, each with [`STEP`] adjacent known views.
///
/// * `known` – range of the views before the growth.
pub fn ends(map: &Map<'_>, known: &Range<usize>) -> Vec<Range<usize>> {
    let views: Vec<usize> = map.registered().collect();
    let num_before = views.partition_point(|view| *view < known.start);
    let num_until = views.partition_point(|view| *view < known.end);
    let mut ends = Vec::new();
    if let Some(end) = views.get(num_before + STEP).filter(|_| num_before > 0) {
        ends.push(views[0]..*end);
    }
    if let Some(last) = views.last().filter(|_| num_until < views.len()) {
        ends.push(views[num_until.saturating_sub(STEP)]..last + 1);
    }
    ends
}

/// Segments of a map without common observations, on a sample of points; a map that is not long is one segment.
pub fn disjoint_segments(map: &Map<'_>) -> Vec<Segment> {
    let views: Vec<usize> = map.registered().collect();
    let count = (views.len() / WINDOW).max(1);
    let index = |k: usize| k * views.len() / count;
    let ends = (0..count).map(|k| views[index(k)]..views[index(k + 1) - 1] + 1);
    ends.map(|range| Segment { views: range.clone(), counted: range, scope: Box::new(Scope::Selected) }).collect()
}

/// Last view of a window before its adjustment: its pose and the depths of its points.
struct BoundaryView {
    view: usize,
    cam_from_world: Rigid3,
    depths: Vec<(usize, f64)>,
}

impl BoundaryView {
    fn new(map: &Map<'_>, view: usize) -> Option<Self> {
        let cam_from_world = map.poses[view]?;
        let seen = map.visible(view).into_iter().map(|slot| slot.track as usize);
        let depth = |track: usize| Some((track, (cam_from_world * map.point(track)?.position).z));
        Some(Self { view, cam_from_world, depths: seen.filter_map(depth).collect() })
    }

    /// Moves later views, and their points that no window has adjusted, as the boundary view has moved.
    fn propagate(&self, map: &mut Map<'_>, views: &[usize], adjusted: &[bool]) {
        let Some(new_from_old) = self.similarity(map, adjusted) else { return };
        for &view in views {
            if let Some(pose) = &mut map.poses[view] {
                *pose = new_from_old.transform_camera(pose);
            }
        }
        for track in (0..adjusted.len()).filter(|&track| !adjusted[track]) {
            let reaches = map.tracks[track].last().is_some_and(|seen| seen.view as usize > self.view);
            if let Some(position) = map.point(track).filter(|_| reaches).map(|point| point.position) {
                map.move_point(track, new_from_old * position);
            }
        }
    }

    /// Similarity that preserves the projections in the view, with the scale of the adjusted points.
    fn similarity(&self, map: &Map<'_>, adjusted: &[bool]) -> Option<Sim3> {
        let new = map.poses[self.view]?;
        let ratio = |&(track, before): &(usize, f64)| Some((new * map.point(track)?.position).z / before);
        let own = self.depths.iter().filter(|(track, before)| adjusted[*track] && *before > 0.0);
        let scale = upper_median(own.filter_map(ratio).filter(|ratio| *ratio > 0.0).collect()).unwrap_or(1.0);
        let rotation = new.rotation.inverse() * self.cam_from_world.rotation;
        let shift = self.cam_from_world.translation * scale - new.translation;
        Some(Sim3::new(scale, rotation, new.rotation.inverse() * shift))
    }
}

/// Evidence of the segments of a map for the intrinsics.
pub struct IntrinsicsEvidence {
    camera: usize,
    /// Free parameters among fx, fy, cx, cy, k1, k2, as indices.
    free: Vec<usize>,
    /// I = Σ I_w.
    information: DMatrix<f64>,
    /// Σ I_w (θ_w − θ₀).
    pull: DVector<f64>,
}

impl IntrinsicsEvidence {
    /// No evidence, for a camera that is free in a problem.
    pub fn none(camera: usize, problem: &Problem) -> Self {
        let block = &problem.cameras[camera];
        let is_free = |k: &usize| block.free[*k] && !(block.tie_focal && *k == 1);
        let free: Vec<usize> = (0..block.free.len()).filter(is_free).collect();
        let n = free.len();
        Self { camera, free, information: DMatrix::zeros(n, n), pull: DVector::zeros(n) }
    }

    /// Standard deviation of the first free parameter; `None` if it is undetermined.
    pub fn first_std(&self) -> Option<f64> {
        let variance = self.information.clone().cholesky()?.inverse()[(0, 0)];
        Some(variance.sqrt()).filter(|deviation| deviation.is_finite())
    }

    /// Adds the information of a segment at its present state and returns it; `None` if a parameter is undetermined.
    pub fn add(&mut self, problem: &Problem, options: &bundle::Options) -> Result<Option<DMatrix<f64>>, MapperError> {
        let wanted = Wanted { cameras: vec![self.camera], ..Wanted::default() };
        let found = match bundle::covariances(problem, options, &wanted) {
            Ok(found) => found,
            Err(BundleError::Singular { .. } | BundleError::NoCovariance { .. }) => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        let n = self.free.len();
        let own = DMatrix::from_fn(n, n, |r, c| found.cameras[0][(self.free[r], self.free[c])]);
        let Some(information) = own.cholesky().map(|factor| factor.inverse()) else { return Ok(None) };
        self.information += &information;
        Ok(Some(information))
    }

    /// Adds the prior.
    fn add_prior(&mut self, prior: &IntrinsicsPrior, here: &[f64]) {
        for (row, &k) in self.free.iter().enumerate() {
            // The prior holds the focal length twice, as fx and as fy.
            let weight = prior.sigma[k].powi(-2) * if k == 0 { 2.0 } else { 1.0 };
            if weight.is_finite() {
                self.information[(row, row)] += weight;
                self.pull[row] += weight * (prior.values[k] - here[k]);
            }
        }
    }

    /// Adds the change of the intrinsics by a segment; removes its information if they are implausible.
    fn add_pull(&mut self, information: DMatrix<f64>, found: &Camera, here: &Camera) {
        if intrinsics_prior::is_plausible(found) {
            let (found, here) = (found.intrinsics(), here.intrinsics());
            let off = DVector::from_iterator(self.free.len(), self.free.iter().map(|&k| found[k] - here[k]));
            self.pull += information * off;
        } else {
            self.information -= information;
        }
    }

    /// Intrinsics θ, from θ₀; `None` if they are undetermined or implausible.
    fn solution(self, here: &Camera) -> Option<Camera> {
        let step = self.information.cholesky()?.solve(&self.pull);
        let mut values = here.intrinsics();
        self.free.iter().zip(step.iter()).for_each(|(&k, step)| values[k] += step);
        // One focal length: the second keeps its ratio to the first.
        values[1] = here.focal[1] * values[0] / here.focal[0];
        Some(here.with_intrinsics(values)).filter(intrinsics_prior::is_plausible)
    }
}

/// Refines the intrinsics of a long map's only camera from its segments.
///
/// The poses follow with the next sweep.
pub fn refine_intrinsics(
    map: &mut Map<'_>,
    freedom: Freedom,
    noise: Noise,
    options: &Options,
) -> Result<(), MapperError> {
    let loss = options.loss(noise);
    let bundle_options =
        bundle::Options { loss, max_iterations: 20, function_tolerance: 1e-5, ..bundle::Options::default() };
    let here = map.cameras[0];
    let mut all: Option<IntrinsicsEvidence> = None;
    for segment in disjoint_segments(map) {
        let mut problem = adjustment::build(map, &Scope::Segment(segment), freedom, noise, options);
        problem.priors.intrinsics.clear();
        let evidence = all.get_or_insert_with(|| IntrinsicsEvidence::none(0, &problem));
        if let Some(information) = evidence.add(&problem, &bundle_options)? {
            bundle::adjust(&mut problem, &bundle_options)?;
            evidence.add_pull(information, &problem.cameras[0].camera, &here);
        }
    }
    let Some(mut evidence) = all.filter(|evidence| !evidence.free.is_empty()) else { return Ok(()) };
    evidence.add_prior(&intrinsics_prior::prior(0, map, noise), &here.intrinsics());
    if let Some(found) = evidence.solution(&here) {
        tracing::debug!("focal length {:.3} → {:.3} px", here.mean_focal(), found.mean_focal());
        map.cameras[0] = found;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, UnitQuaternion, Vector3};

    use super::*;
    use crate::features::tracks::{Feature, TrackTable, View};
    use crate::geometry::triangulation::Limits;
    use crate::mapper::Intrinsics;
    use crate::scene::ImageId;

    /// Views in a row that all observe five points.
    fn table(camera: &Camera, poses: &[Rigid3]) -> TrackTable {
        let points = [[-1.0, 0.5, 6.0], [0.5, -0.4, 7.0], [0.1, 0.2, 8.0], [1.0, 1.0, 9.0], [0.0, -1.0, 6.5]];
        let project = |pose: &Rigid3, point: &[f64; 3]| camera.pixel_from_cam(*pose * Point3::from(*point)).unwrap();
        let view = |(k, pose): (u32, &Rigid3)| View {
            image: ImageId(k + 1),
            name: format!("{k}.jpg"),
            camera: 0,
            pixels: points.iter().map(|point| project(pose, point)).collect(),
            rgb: vec![[0; 3]; points.len()],
            whitening: Vec::new(),
        };
        let track = |feature: u32| (0..poses.len() as u32).map(|view| Feature { view, feature }).collect();
        TrackTable {
            views: (0..).zip(poses).map(view).collect(),
            tracks: (0..points.len() as u32).map(track).collect(),
        }
    }

    #[test]
    fn later_views_follow_the_last_view_of_a_window() {
        let camera = Camera::with_focal(960, 540, 800.0);
        let at = |k: i32| {
            Rigid3::from_rotation_and_center(UnitQuaternion::identity(), Point3::new(0.2 * f64::from(k), 0.0, 0.0))
        };
        let poses: Vec<Rigid3> = (0..6).map(at).collect();
        let table = table(&camera, &poses);
        let mut map = Map::new(&table, &[camera], Intrinsics::GUESSED.into());
        poses.iter().enumerate().for_each(|(view, pose)| map.poses[view] = Some(*pose));
        assert_eq!(map.triangulate_all(&Limits { max_error_px: 1.0, min_angle: 0.001 }), 5);
        let boundary = BoundaryView::new(&map, 3).unwrap();
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.1, -0.2, 0.3));
        let moved = Sim3::new(1.7, turn, Vector3::new(3.0, -1.0, 2.0));
        // The window moves its views and four of the points.
        (0..4).for_each(|view| map.poses[view] = Some(moved.transform_camera(&poses[view])));
        let mut expected = map.clone();
        let adjusted = [true, true, true, true, false];
        for track in 0..5 {
            let position = moved * map.point(track).unwrap().position;
            expected.move_point(track, position);
            if adjusted[track] {
                map.move_point(track, position);
            }
        }
        boundary.propagate(&mut map, &[4, 5], &adjusted);
        for view in 4..6 {
            let (found, wanted) = (map.poses[view].unwrap(), moved.transform_camera(&poses[view]));
            assert!((found.center() - wanted.center()).norm() < 1e-9, "{found:?} {wanted:?}");
        }
        let (found, wanted) = (map.point(4).unwrap().position, expected.point(4).unwrap().position);
        assert!((found - wanted).norm() < 1e-9, "{found} {wanted}");
    }

    #[test]
    fn segments_share_no_view_and_cover_all() {
        let camera = Camera::with_focal(960, 540, 800.0);
        let poses = vec![Rigid3::identity(); 1100];
        let table = table(&camera, &poses);
        let mut map = Map::new(&table, &[camera], Intrinsics::GUESSED.into());
        (0..1100).filter(|view| view % 10 != 3).for_each(|view| map.poses[view] = Some(poses[view]));
        let segments = disjoint_segments(&map);
        assert_eq!(segments.len(), 2);
        assert!(segments.iter().all(|segment| segment.views == segment.counted));
        assert_eq!((segments[0].views.start, segments[1].views.end), (0, 1100));
        assert_eq!(segments[0].views.end, segments[1].views.start);
        // The growth at both ends, with a part of the earlier views.
        let ends = ends(&map, &(100..1000));
        assert_eq!((ends[0].start, ends[1].end), (0, 1100));
        assert!(ends[0].end > 300 && ends[1].start < 800, "{ends:?}");
    }
}
