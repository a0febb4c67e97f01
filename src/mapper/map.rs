//! State of a map during reconstruction.

mod joints;
mod rejection;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::ops::Range;

use nalgebra::{Point2, Point3};

use super::{KnownIntrinsics, Noise};
use crate::bundle::Whitening;
use crate::camera::Camera;
use crate::features::tracks::{self, Feature, Track, TrackTable};
use crate::geometry::triangulation::{self, Limits, View};
use crate::math::{RAYLEIGH_MEDIAN, Rigid3, upper_median, widest_angle};
use crate::scene::{CameraId, Image, Observation, Point3d, Point3dId, Reconstruction, TrackElement};

/// Triangulated point of a track.
#[derive(Clone, Debug)]
pub struct MapPoint {
    /// Position in the world.
    pub position: Point3<f64>,
    /// True for each feature of the track that is an observation of the point: its view is registered and it fits.
    pub active: Vec<bool>,
}

/// Features of each view that belong to tracks.
fn slots_of_view(num_views: usize, tracks: &[Track]) -> Vec<Vec<Slot>> {
    let mut counts = vec![0; num_views];
    tracks.iter().flatten().for_each(|feature| counts[feature.view as usize] += 1);
    let mut slots: Vec<Vec<Slot>> = counts.into_iter().map(Vec::with_capacity).collect();
    for (track, features) in (0..).zip(tracks) {
        for (slot, feature) in (0..).zip(features) {
            slots[feature.view as usize].push(Slot { track, slot });
        }
    }
    slots
}

/// Position of a feature in its track.
#[derive(Clone, Copy, Debug)]
pub struct Slot {
    /// Track index.
    pub track: u32,
    /// Index in the track.
    pub slot: u32,
}

/// Poses and points of a reconstruction in progress.
#[derive(Clone)]
pub struct Map<'a> {
    /// Views and tracks to be reconstructed.
    pub table: &'a TrackTable,
    /// Its tracks; a copy if tracks had to be split at gaps.
    pub tracks: Cow<'a, [Track]>,
    /// Intrinsics.
    pub cameras: Vec<Camera>,
    /// Initial intrinsics.
    pub guess: Vec<Camera>,
    /// Prior knowledge of the intrinsics.
    pub known: KnownIntrinsics,
    /// World to camera, by view; `None` where not registered.
    pub poses: Vec<Option<Rigid3>>,
    /// Known points, by track.
    points: Vec<Option<MapPoint>>,
    /// Features of each view that belong to tracks.
    slots_of_view: Vec<Vec<Slot>>,
    /// Number of its features with a known point, by view.
    num_visible: Vec<usize>,
    /// True if there are loop closures, so that views far apart in time share points.
    pub has_loop_closures: bool,
}

impl<'a> Map<'a> {
    /// Map without views, with prior knowledge of the intrinsics.
    pub fn new(table: &'a TrackTable, cameras: &[Camera], known: KnownIntrinsics) -> Self {
        Self {
            cameras: cameras.to_vec(),
            guess: cameras.to_vec(),
            known,
            poses: vec![None; table.views.len()],
            points: vec![None; table.tracks.len()],
            num_visible: vec![0; table.views.len()],
            slots_of_view: slots_of_view(table.views.len(), &table.tracks),
            has_loop_closures: false,
            table,
            tracks: Cow::Borrowed(&table.tracks),
        }
    }

    /// The cameras whose intrinsics are adjusted, ascending.
    pub fn unknown_cameras(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.cameras.len()).filter(|&camera| !self.known.of(camera).is_fixed())
    }

    /// Number of registered views, by camera.
    pub fn num_views_of_cameras(&self) -> Vec<usize> {
        let mut counts = vec![0; self.cameras.len()];
        self.registered().for_each(|view| counts[self.table.views[view].camera] += 1);
        counts
    }

    /// Number of features of registered views with a known point, by camera.
    pub fn num_points_of_cameras(&self) -> Vec<usize> {
        let mut counts = vec![0; self.cameras.len()];
        self.registered().for_each(|view| counts[self.table.views[view].camera] += self.num_visible[view]);
        counts
    }

    /// Number of registered views.
    pub fn num_registered(&self) -> usize {
        self.poses.iter().flatten().count()
    }

    /// Registered views, ascending.
    pub fn registered(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.poses.len()).filter(|&view| self.poses[view].is_some())
    }

    /// Number of known points.
    pub fn num_points(&self) -> usize {
        self.points.iter().flatten().count()
    }

    /// The point of a track, if known.
    pub fn point(&self, track: usize) -> Option<&MapPoint> {
        self.points[track].as_ref()
    }

    /// Moves a known point.
    pub fn move_point(&mut self, track: usize, position: Point3<f64>) {
        if let Some(point) = &mut self.points[track] {
            point.position = position;
        }
    }

    /// Numbers of a view's features that belong to tracks, and of those with a known point.
    pub fn visibility(&self, view: usize) -> (usize, usize) {
        (self.slots_of_view[view].len(), self.num_visible[view])
    }

    /// Features of a view that belong to tracks, ascending by track.
    pub fn slots(&self, view: usize) -> &[Slot] {
        &self.slots_of_view[view]
    }

    /// Features of a view whose points are known.
    pub fn visible(&self, view: usize) -> Vec<Slot> {
        self.slots_of_view[view].iter().copied().filter(|s| self.points[s.track as usize].is_some()).collect()
    }

    /// View and position of a feature of a track.
    pub fn feature(&self, track: usize, slot: usize) -> (usize, Point2<f64>) {
        let feature = self.tracks[track][slot];
        (feature.view as usize, self.table.pixel(feature))
    }

    /// The intrinsics of a view.
    pub fn camera_of(&self, view: usize) -> &Camera {
        &self.cameras[self.table.views[view].camera]
    }

    /// Pixels and points of some features of a view, for resection.
    pub fn pixels_and_points(&self, slots: &[Slot]) -> (Vec<Point2<f64>>, Vec<Point3<f64>>) {
        slots
            .iter()
            .filter_map(|s| {
                let point = self.points[s.track as usize].as_ref()?;
                Some((self.feature(s.track as usize, s.slot as usize).1, point.position))
            })
            .unzip()
    }

    /// Marks features as observations of their points.
    pub fn activate(&mut self, slots: impl IntoIterator<Item = Slot>) {
        self.mark(slots, true);
    }

    /// Unregisters a view and removes all its observations.
    pub fn unregister(&mut self, view: usize) {
        self.poses[view] = None;
        self.mark(self.slots_of_view[view].clone(), false);
    }

    fn mark(&mut self, slots: impl IntoIterator<Item = Slot>, is_active: bool) {
        for s in slots {
            if let Some(point) = &mut self.points[s.track as usize] {
                point.active[s.slot as usize] = is_active;
            }
        }
    }

    /// Triangulates the unknown points of the features of a view; returns the number of new points.
    pub fn triangulate_features_of(&mut self, view: usize, limits: &Limits) -> usize {
        let unknown: Vec<usize> = self.slots_of_view[view]
            .iter()
            .map(|s| s.track as usize)
            .filter(|&track| self.points[track].is_none())
            .collect();
        unknown.into_iter().filter(|&track| self.triangulate(track, limits)).count()
    }

    /// Triangulates every unknown point; returns the number of new points.
    pub fn triangulate_all(&mut self, limits: &Limits) -> usize {
        (0..self.points.len()).filter(|&t| self.points[t].is_none() && self.triangulate(t, limits)).count()
    }

    fn triangulate(&mut self, track: usize, limits: &Limits) -> bool {
        let num_slots = self.tracks[track].len();
        let (slots, views): (Vec<usize>, Vec<View<'_>>) =
            (0..num_slots).filter_map(|slot| Some((slot, self.view_at(track, slot)?))).unzip();
        if slots.len() < 2 {
            return false;
        }
        let Some(found) = triangulation::triangulate(&views, limits) else { return false };
        let mut active = vec![false; num_slots];
        slots.iter().zip(found.inliers).for_each(|(&slot, inlier)| active[slot] = inlier);
        self.set_point(track, Some(MapPoint { position: found.position, active }));
        true
    }

    /// Triangulates known points again, except those for which `keep` is true, which were adjusted already.
    ///
    /// Points whose triangulation fails are dropped.
    pub fn retriangulate(&mut self, limits: &Limits, keep: &[bool]) {
        for track in 0..self.points.len() {
            if self.points[track].is_some() && !keep[track] {
                self.set_point(track, None);
                self.triangulate(track, limits);
            }
        }
    }

    /// Updates the observations of all known points; returns the number of changed observations.
    ///
    /// Features of registered views that fit are added, and observations that do not fit are removed. Points with fewer
    /// than two observations, or without a sufficient angle, are dropped.
    pub fn update_observations(&mut self, limits: &Limits) -> usize {
        (0..self.points.len()).map(|track| self.update_point(track, limits)).sum()
    }

    /// Updates the observations of one point; returns the number of changed ones.
    fn update_point(&mut self, track: usize, limits: &Limits) -> usize {
        let max_sq = limits.max_error_px * limits.max_error_px;
        let Some(point) = &self.points[track] else { return 0 };
        let position = point.position;
        let fits = |slot: usize| self.view_at(track, slot).is_some_and(|v| v.error_sq(position) <= max_sq);
        let active: Vec<bool> = (0..point.active.len()).map(fits).collect();
        let changed = active.iter().zip(&point.active).filter(|(a, b)| a != b).count();
        let centers = (0..active.len())
            .filter(|&slot| active[slot])
            .filter_map(|slot| self.pose_at(track, slot).map(Rigid3::center));
        let enough = active.iter().filter(|&&a| a).count() >= 2;
        if enough && widest_angle(position, centers) >= limits.min_angle {
            self.points[track] = Some(MapPoint { position, active });
        } else {
            self.set_point(track, None);
        }
        changed
    }

    /// Triangulates the points of some views again, and updates their observations.
    ///
    /// Points for which `keep` is true were adjusted already and keep their position.
    pub fn update_points_of(&mut self, views: Range<usize>, limits: &Limits, keep: &[bool]) {
        let mut tracks: Vec<usize> =
            self.slots_of_view[views].iter().flatten().map(|slot| slot.track as usize).collect();
        tracks.sort_unstable();
        tracks.dedup();
        for track in tracks {
            if !keep[track] {
                self.set_point(track, None);
                self.triangulate(track, limits);
            }
            self.update_point(track, limits);
        }
    }

    /// Detects loop closures: more points re-detected after over `gap` views than wrong matches explain.
    pub fn detect_loop_closures(&mut self, gap: usize) {
        let is_far = |pair: &[Feature]| (pair[1].view - pair[0].view) as usize > gap;
        // Wrong matches cause up to this number of re-detections.
        self.has_loop_closures = self.tracks.iter().filter(|track| track.windows(2).any(is_far)).nth(20).is_some();
    }

    fn set_point(&mut self, track: usize, point: Option<MapPoint>) {
        let (before, after) = (self.points[track].is_some(), point.is_some());
        self.points[track] = point;
        if before != after {
            for feature in &self.tracks[track] {
                let count = &mut self.num_visible[feature.view as usize];
                *count = if after { *count + 1 } else { *count - 1 };
            }
        }
    }

    fn pose_at(&self, track: usize, slot: usize) -> Option<&Rigid3> {
        self.poses[self.tracks[track][slot].view as usize].as_ref()
    }

    fn view_at(&self, track: usize, slot: usize) -> Option<View<'_>> {
        let cam_from_world = self.pose_at(track, slot)?;
        let (view, pixel) = self.feature(track, slot);
        let whitening = self.table.whitening(self.tracks[track][slot]);
        Some(View { camera: self.camera_of(view), cam_from_world, pixel, whitening })
    }

    /// Squared reprojection errors of the observations of a known point, whitened.
    fn errors_sq(&self, track: usize) -> impl Iterator<Item = f64> + '_ {
        let point = self.points[track].as_ref();
        self.observations(track)
            .filter_map(move |(slot, ..)| Some(self.view_at(track, slot)?.error_sq(point?.position)))
    }

    /// Observations of a known point: slot, view and pixel.
    pub fn observations(&self, track: usize) -> impl Iterator<Item = (usize, usize, Point2<f64>)> + '_ {
        let active = self.points[track].iter().flat_map(|p| p.active.iter().enumerate());
        active.filter(|(_, active)| **active).map(move |(slot, _)| {
            let (view, pixel) = self.feature(track, slot);
            (slot, view, pixel)
        })
    }

    /// Number of observations of all known points.
    pub fn num_observations(&self) -> usize {
        (0..self.points.len()).map(|track| self.observations(track).count()).sum()
    }

    /// Number of observations of known points, by view.
    pub fn num_observations_of_views(&self) -> Vec<usize> {
        let mut counts = vec![0; self.poses.len()];
        let all = (0..self.points.len()).flat_map(|track| self.observations(track));
        all.for_each(|(_, view, _)| counts[view] += 1);
        counts
    }

    /// Soft number of inliers among all observations.
    ///
    /// Each counts from 1, where it fits exactly, to 0 at `max_error` (in units of the whitening) or where its point or
    /// view is unknown.
    pub fn num_explained(&self, max_error: f64) -> f64 {
        let explained = |error_sq: f64| 1.0 - (error_sq / max_error.powi(2)).min(1.0);
        (0..self.points.len()).map(|track| self.errors_sq(track).map(explained).sum::<f64>()).sum()
    }

    /// Robust noise of the observations: the median reprojection error as the standard deviation of a coordinate.
    ///
    /// Under Gaussian noise the median of the error is a Rayleigh median, 1.177 σ. Of long videos an evenly spaced
    /// sample of the tracks suffices.
    pub fn noise(&self) -> Noise {
        // A median of 20,000 tracks is accurate to a hundredth.
        let errors: Vec<f64> = (0..self.points.len())
            .step_by((self.points.len() / 20_000).max(1))
            .flat_map(|track| self.errors_sq(track).map(f64::sqrt))
            .collect();
        upper_median(errors).map(|median| median / RAYLEIGH_MEDIAN)
    }

    /// Result of the reconstruction, without the views.
    pub fn into_points(mut self) -> MapPoints {
        self.slots_of_view = Vec::new();
        let cameras = self.cameras.iter().enumerate().map(|(i, c)| (camera_id(i), *c)).collect();
        let mut points = BTreeMap::new();
        for track in 0..self.points.len() {
            if let Some(point) = self.colmap_point(track) {
                points.insert(Point3dId(points.len() as u64 + 1), point);
            }
            self.points[track] = None;
        }
        MapPoints { cameras, poses: self.poses, points }
    }

    fn colmap_point(&self, track: usize) -> Option<Point3d> {
        let position = self.points[track].as_ref()?.position;
        let mut elements = Vec::new();
        let (mut rgb_sum, mut error_sum) = ([0u32; 3], 0.0);
        for (slot, view, _) in self.observations(track) {
            let feature = self.tracks[track][slot];
            let source = &self.table.views[view];
            elements.push(TrackElement { image: source.image, observation_idx: feature.feature });
            for (sum, c) in rgb_sum.iter_mut().zip(source.rgb[feature.feature as usize]) {
                *sum += u32::from(c);
            }
            error_sum +=
                View { whitening: Whitening::IDENTITY, ..self.view_at(track, slot)? }.error_sq(position).sqrt();
        }
        let n = elements.len();
        let rgb = rgb_sum.map(|sum| (sum / (n as u32).max(1)) as u8);
        (n >= 2).then(|| Point3d { position, rgb, error_px: error_sum / n as f64, track: elements })
    }
}

fn camera_id(camera: usize) -> CameraId {
    CameraId(camera as u32 + 1)
}

/// A map without its views.
pub struct MapPoints {
    cameras: BTreeMap<CameraId, Camera>,
    poses: Vec<Option<Rigid3>>,
    points: BTreeMap<Point3dId, Point3d>,
}

impl MapPoints {
    /// Reconstruction with the views of the map, each of which may be freed once its features are taken over.
    pub fn with_views(self, views: impl Iterator<Item = tracks::View>) -> Reconstruction {
        let mut images = BTreeMap::new();
        for (pose, view) in self.poses.iter().zip(views) {
            let Some(cam_from_world) = *pose else { continue };
            let observations = view.pixels.iter().map(|&pixel| Observation { pixel, point: None }).collect();
            let image = Image { name: view.name, camera: camera_id(view.camera), cam_from_world, observations };
            images.insert(view.image, image);
        }
        for (&id, point) in &self.points {
            for element in &point.track {
                if let Some(image) = images.get_mut(&element.image) {
                    image.observations[element.observation_idx as usize].point = Some(id);
                }
            }
        }
        Reconstruction { cameras: self.cameras, images, points: self.points, ..Reconstruction::default() }
    }
}
