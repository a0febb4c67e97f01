//! Long maps are adjusted window by window, so that memory and time do not depend on how long a video is.
//!
//! Two views far from one another in a video see no common point: what a view says of another is passed on from track
//! to track, and is lost in their noise after a few lengths of a track. So a view's pose relative to its neighbours
//! depends on the views within some hundred of it alone. A *window* of views is adjusted on what these and the views
//! before it see; the views before it are held, and what is behind it is left out, and carried along by the similarity
//! that moved the window's last view. The next window begins half a window later, so that every view is final only
//! when as many views behind it have had their say.
//!
//! What all views have in common, the lens, is not adjusted in windows, where each would have its own. Stretches that
//! share no observation say each by itself what they make of it, and how surely; the mean of these counts, weighed by
//! what they know: with the information I_w = Σ_w⁻¹ of stretch w at the lens θ₀ that all start from, and that of the
//! prior, I_0 about θ_p,
//!
//! ```text
//! θ = θ₀ + (I_0 + Σ_w I_w)⁻¹ (I_0 (θ_p − θ₀) + Σ_w I_w (θ_w − θ₀))
//! ```
//!
//! The weights are those at θ₀, not at θ_w, on whose errors they would depend.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};

use super::adjustment::{self, Freedom, Scope, Stretch};
use super::map::Map;
use super::{Noise, Options, intrinsics_prior};
use crate::bundle::{self, BundleError, IntrinsicsPrior, Problem, Wanted};
use crate::camera::Camera;
use crate::mapper::MapperError;
use crate::math::{Rigid3, Sim3, upper_median};

/// Views of a window: four of the longest tracks.
const WINDOW: usize = 400;
/// Views from one window to the next, and so those that a view waits for before it is final.
pub const STEP: usize = 200;

/// Returns true if a map is adjusted in windows: that of a video of one camera and many views, without loop closures.
pub fn is_long(map: &Map<'_>, options: &Options) -> bool {
    options.ordered && map.cameras.len() == 1 && !map.comes_back && map.num_registered() > options.max_views_at_once
}

/// Adjusts the poses and points of a long map, every view in two windows; returns for every track whether its point
/// took part.
pub fn sweep(map: &mut Map<'_>, scope: &Scope, noise: Noise, options: &Options) -> Result<Vec<bool>, MapperError> {
    let views: Vec<usize> = map.registered().collect();
    let mut adjusted = vec![false; map.tracks.len()];
    for start in (0..views.len()).step_by(STEP) {
        let end = views.len().min(start + WINDOW);
        let (first, last) = (views[start], views[end - 1]);
        let behind = last + 1;
        let stretch = Stretch { views: first..behind, counted: 0..behind, scope: Box::new(scope.clone()) };
        let before = Carrier::new(map, last);
        let taken = adjustment::adjust(map, &Scope::Stretch(stretch), Freedom::Nothing, noise, options)?;
        adjusted.iter_mut().zip(&taken).for_each(|(all, taken)| *all |= taken);
        if end == views.len() {
            break;
        }
        if let Some(carrier) = before {
            carrier.carry(map, &views[end..], &adjusted);
        }
    }
    Ok(adjusted)
}

/// Ranges by which a long map has grown at its ends since it had these views, with as many views before them.
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

/// Stretches of a map that share no observation, on some points in every part of every view; of one that is not long
/// there is one.
pub fn apart(map: &Map<'_>) -> Vec<Stretch> {
    let views: Vec<usize> = map.registered().collect();
    let count = (views.len() / WINDOW).max(1);
    let place = |k: usize| k * views.len() / count;
    let ends = (0..count).map(|k| views[place(k)]..views[place(k + 1) - 1] + 1);
    ends.map(|range| Stretch { views: range.clone(), counted: range, scope: Box::new(Scope::Selected) }).collect()
}

/// A view at the end of a window, as it was, and how deep its points lay.
struct Carrier {
    view: usize,
    cam_from_world: Rigid3,
    depths: Vec<(usize, f64)>,
}

impl Carrier {
    fn new(map: &Map<'_>, view: usize) -> Option<Self> {
        let cam_from_world = map.poses[view]?;
        let seen = map.visible(view).into_iter().map(|slot| slot.track as usize);
        let depth = |track: usize| Some((track, (cam_from_world * map.point(track)?.position).z));
        Some(Self { view, cam_from_world, depths: seen.filter_map(depth).collect() })
    }

    /// Moves views, and the points that they see and no window has adjusted, as this view has moved.
    fn carry(&self, map: &mut Map<'_>, views: &[usize], adjusted: &[bool]) {
        let Some(new_from_old) = self.moved(map, adjusted) else { return };
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

    /// The similarity that keeps the view's pictures as they are, with the scale of the points that were adjusted.
    fn moved(&self, map: &Map<'_>, adjusted: &[bool]) -> Option<Sim3> {
        let new = map.poses[self.view]?;
        let ratio = |&(track, before): &(usize, f64)| Some((new * map.point(track)?.position).z / before);
        let own = self.depths.iter().filter(|(track, before)| adjusted[*track] && *before > 0.0);
        let scale = upper_median(own.filter_map(ratio).filter(|ratio| *ratio > 0.0).collect()).unwrap_or(1.0);
        let rotation = new.rotation.inverse() * self.cam_from_world.rotation;
        let shift = self.cam_from_world.translation * scale - new.translation;
        Some(Sim3::new(scale, rotation, new.rotation.inverse() * shift))
    }
}

/// Evidence of stretches of a map for the lens.
pub struct LensEvidence {
    camera: usize,
    /// Which of fx, fy, cx, cy, k1, k2 are free.
    free: Vec<usize>,
    /// I = Σ I_w.
    information: DMatrix<f64>,
    /// Σ I_w (θ_w − θ₀).
    pull: DVector<f64>,
}

impl LensEvidence {
    /// Of nothing, about a camera that is free in a problem.
    pub fn none(camera: usize, problem: &Problem) -> Self {
        let block = &problem.cameras[camera];
        let is_free = |k: &usize| block.free[*k] && !(block.tie_focal && *k == 1);
        let free: Vec<usize> = (0..block.free.len()).filter(is_free).collect();
        let n = free.len();
        Self { camera, free, information: DMatrix::zeros(n, n), pull: DVector::zeros(n) }
    }

    /// Standard deviation of the first free one; `None` where it is open.
    pub fn first_deviation(&self) -> Option<f64> {
        let variance = self.information.clone().cholesky()?.inverse()[(0, 0)];
        Some(variance.sqrt()).filter(|deviation| deviation.is_finite())
    }

    /// Adds what a stretch knows where it stands; nothing where it leaves anything open.
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

    /// Adds what is known beforehand.
    fn add_prior(&mut self, prior: &IntrinsicsPrior, here: &[f64]) {
        for (place, &k) in self.free.iter().enumerate() {
            // Of a focal length the prior says the same twice, of fx and of fy.
            let weight = prior.sigma[k].powi(-2) * if k == 0 { 2.0 } else { 1.0 };
            if weight.is_finite() {
                self.information[(place, place)] += weight;
                self.pull[place] += weight * (prior.values[k] - here[k]);
            }
        }
    }

    /// Adds how far from here a stretch sees the lens, if that is one that is built.
    fn add_pull(&mut self, information: DMatrix<f64>, found: &Camera, here: &Camera) {
        if intrinsics_prior::is_plausible(found) {
            let (found, here) = (found.intrinsics(), here.intrinsics());
            let off = DVector::from_iterator(self.free.len(), self.free.iter().map(|&k| found[k] - here[k]));
            self.pull += information * off;
        } else {
            self.information -= information;
        }
    }

    /// The lens θ, from θ₀.
    fn lens(self, here: &Camera) -> Option<Camera> {
        let step = self.information.cholesky()?.solve(&self.pull);
        let mut values = here.intrinsics();
        self.free.iter().zip(step.iter()).for_each(|(&k, step)| values[k] += step);
        // One focal length: the second keeps its ratio to the first.
        values[1] = here.focal[1] * values[0] / here.focal[0];
        Some(here.with_intrinsics(values)).filter(intrinsics_prior::is_plausible)
    }
}

/// Moves the lens of a long map's only camera to where its stretches together see it; its views follow with the next
/// sweep.
pub fn refine_lens(map: &mut Map<'_>, freedom: Freedom, noise: Noise, options: &Options) -> Result<(), MapperError> {
    let loss = options.loss(noise);
    let bundle_options =
        bundle::Options { loss, max_iterations: 20, function_tolerance: 1e-5, ..bundle::Options::default() };
    let here = map.cameras[0];
    let mut all: Option<LensEvidence> = None;
    for stretch in apart(map) {
        let mut problem = adjustment::build(map, &Scope::Stretch(stretch), freedom, noise, options);
        problem.priors.intrinsics.clear();
        let evidence = all.get_or_insert_with(|| LensEvidence::none(0, &problem));
        if let Some(information) = evidence.add(&problem, &bundle_options)? {
            bundle::adjust(&mut problem, &bundle_options)?;
            evidence.add_pull(information, &problem.cameras[0].camera, &here);
        }
    }
    let Some(mut evidence) = all.filter(|evidence| !evidence.free.is_empty()) else { return Ok(()) };
    evidence.add_prior(&intrinsics_prior::prior(0, map, noise), &here.intrinsics());
    if let Some(found) = evidence.lens(&here) {
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

    /// Views in a row that all see five points.
    fn table(camera: &Camera, poses: &[Rigid3]) -> TrackTable {
        let points = [[-1.0, 0.5, 6.0], [0.5, -0.4, 7.0], [0.1, 0.2, 8.0], [1.0, 1.0, 9.0], [0.0, -1.0, 6.5]];
        let place = |pose: &Rigid3, point: &[f64; 3]| camera.pixel_from_cam(*pose * Point3::from(*point)).unwrap();
        let view = |(k, pose): (u32, &Rigid3)| View {
            image: ImageId(k + 1),
            name: format!("{k}.jpg"),
            camera: 0,
            pixels: points.iter().map(|point| place(pose, point)).collect(),
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
    fn what_is_behind_a_window_goes_where_its_last_view_goes() {
        let camera = Camera::with_focal(960, 540, 800.0);
        let at = |k: i32| {
            Rigid3::from_rotation_and_center(UnitQuaternion::identity(), Point3::new(0.2 * f64::from(k), 0.0, 0.0))
        };
        let poses: Vec<Rigid3> = (0..6).map(at).collect();
        let table = table(&camera, &poses);
        let mut map = Map::new(&table, &[camera], Intrinsics::GUESSED.into());
        poses.iter().enumerate().for_each(|(view, pose)| map.poses[view] = Some(*pose));
        assert_eq!(map.triangulate_all(&Limits { max_error_px: 1.0, min_angle: 0.001 }), 5);
        let carrier = Carrier::new(&map, 3).unwrap();
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
        carrier.carry(&mut map, &[4, 5], &adjusted);
        for view in 4..6 {
            let (found, wanted) = (map.poses[view].unwrap(), moved.transform_camera(&poses[view]));
            assert!((found.center() - wanted.center()).norm() < 1e-9, "{found:?} {wanted:?}");
        }
        let (found, wanted) = (map.point(4).unwrap().position, expected.point(4).unwrap().position);
        assert!((found - wanted).norm() < 1e-9, "{found} {wanted}");
    }

    #[test]
    fn stretches_share_no_view_and_leave_none_out() {
        let camera = Camera::with_focal(960, 540, 800.0);
        let poses = vec![Rigid3::identity(); 1100];
        let table = table(&camera, &poses);
        let mut map = Map::new(&table, &[camera], Intrinsics::GUESSED.into());
        (0..1100).filter(|view| view % 10 != 3).for_each(|view| map.poses[view] = Some(poses[view]));
        let stretches = apart(&map);
        assert_eq!(stretches.len(), 2);
        assert!(stretches.iter().all(|stretch| stretch.views == stretch.counted));
        assert_eq!((stretches[0].views.start, stretches[1].views.end), (0, 1100));
        assert_eq!(stretches[0].views.end, stretches[1].views.start);
        // Of what a map grew by at both ends, and a part of what was there.
        let ends = ends(&map, &(100..1000));
        assert_eq!((ends[0].start, ends[1].end), (0, 1100));
        assert!(ends[0].end > 300 && ends[1].start < 800, "{ends:?}");
    }
}
