//! Incremental registration of views, from an initial pair or from pose priors.

use std::ops::Range;

mod finish;
mod held_poses;
mod loop_closures;
mod new_camera;
mod pose_outliers;
mod pose_priors;

use super::adjustment::{self, Freedom, Scope, Segment};
use super::initial_pair::InitialPair;
use super::map::{Map, Slot};
use super::motion::{self, ModelWeakness};
use super::{MapperError, Noise, Options, Reason, Report, focal_length, windows};
use crate::geometry::resection::{self, PixelsAndPoints, Resection};
use crate::geometry::triangulation::Limits;
use crate::math::{Rigid3, seeded_rng};
pub use pose_priors::PosePriors;

/// Relative standard deviation of a focal length beyond which it counts as poorly determined.
const MAX_FOCAL_STD: f64 = 0.01;
/// Relative growth of the number of views that triggers a global bundle adjustment.
const GLOBAL_GROWTH: f64 = 1.3;

/// Map in progress and the state of its registration.
#[derive(Clone)]
pub struct IncrementalMapper<'a> {
    map: Map<'a>,
    options: &'a Options,
    seed: u64,
    noise: Noise,
    /// Parameters that global adjustments change.
    freedom: Freedom,
    /// True once the free intrinsics are chosen by the motion.
    intrinsics_chosen: bool,
    /// Reason for which the last attempt to register a view failed, by view.
    failed: Vec<Option<Reason>>,
    /// Standard deviation of ln f by camera, where it was estimated.
    focal_deviations: Vec<Option<f64>>,
    /// True if final adjustments have unregistered views.
    has_unregistered: bool,
    /// Number of registered views at the last global adjustment.
    adjusted_at: usize,
    /// Range of these views.
    adjusted_views: Range<usize>,
    /// Number of points that were rejected after the last adjustments, behind a camera or at infinity.
    num_infinite: usize,
}

impl<'a> IncrementalMapper<'a> {
    /// Mapper of a map without registered views.
    pub fn new(mut map: Map<'a>, options: &'a Options, seed: u64) -> Self {
        map.detect_loop_closures(options.max_track_views);
        Self {
            freedom: Freedom::initial(&map),
            focal_deviations: vec![None; map.cameras.len()],
            failed: vec![None; map.poses.len()],
            map,
            options,
            seed,
            noise: None,
            intrinsics_chosen: false,
            has_unregistered: false,
            adjusted_at: 0,
            adjusted_views: 0..0,
            num_infinite: 0,
        }
    }

    /// Initializes the map from a pair; returns false if too few points remain after adjustment.
    pub fn initialize(&mut self, pair: &InitialPair) -> Result<bool, MapperError> {
        self.map.poses[pair.views[0]] = Some(Rigid3::identity());
        self.map.poses[pair.views[1]] = Some(pair.cam2_from_cam1);
        let limits = self.limits();
        self.map.triangulate_features_of(pair.views[0], &limits);
        // Two views do not determine intrinsics: they are fixed here.
        self.adjust(&Scope::Everything, Freedom::Nothing)?;
        self.map.update_observations(&limits);
        self.adjusted_at = 2;
        // Half of the required inliers: the others were outliers or have no angle.
        Ok(self.map.num_points() >= self.options.min_initial_inliers / 2)
    }

    /// Registers views until none succeeds any more; `watch` receives their number.
    pub fn grow(&mut self, watch: &mut dyn FnMut(usize)) -> Result<(), MapperError> {
        loop {
            while let Some(view) = self.next_view() {
                if self.register(view) {
                    self.update_after(view)?;
                    watch(self.map.num_registered());
                }
            }
            // All views with enough points were tried: a global adjustment may add points for another round.
            let before = self.map.num_registered();
            if before > self.adjusted_at {
                self.adjust_growth()?;
            }
            if self.map.num_registered() == before && self.next_view().is_none() {
                return Ok(());
            }
        }
    }

    /// Number of observations that the map explains; see [`Map::num_explained`].
    pub fn num_explained(&self) -> f64 {
        self.map.num_explained(self.options.max_error_px)
    }

    /// Number of registered views.
    pub fn num_registered(&self) -> usize {
        self.map.num_registered()
    }

    /// The map itself.
    #[cfg(test)]
    pub fn map(&self) -> &Map<'a> {
        &self.map
    }

    /// The map and the report on every view.
    pub fn into_result(self) -> (Map<'a>, Report) {
        let failure = |view: usize| self.map.poses[view].is_none().then(|| self.reason(view));
        let views = Report::of_views(&self.map.table.views, failure);
        let report = Report {
            views,
            num_points: self.map.num_points(),
            num_observations: self.map.num_observations(),
            num_infinite_points: self.num_infinite,
            focal_deviations: self.focal_deviations.clone(),
            remarks: self.focal_remark().into_iter().chain(motion::remarks_on(&self.map)).collect(),
            ..Report::default()
        };
        (self.map, report)
    }

    /// Remark if the focal length is not known to a percent.
    fn focal_remark(&self) -> Option<ModelWeakness> {
        let std =
            self.focal_deviations[focal_length::leading_camera(&self.map)?].filter(|found| *found > MAX_FOCAL_STD)?;
        Some(ModelWeakness::LooseFocalLength { percent: 100.0 * std })
    }

    fn adjust(&mut self, scope: &Scope, intrinsics: Freedom) -> Result<Vec<bool>, MapperError> {
        if self.is_long() && !matches!(scope, Scope::Local(_)) {
            if intrinsics != Freedom::Nothing {
                windows::refine_intrinsics(&mut self.map, intrinsics, self.noise, self.options)?;
            }
            return windows::sweep(&mut self.map, scope, self.noise, self.options);
        }
        adjustment::adjust(&mut self.map, scope, intrinsics, self.noise, self.options)
    }

    fn is_long(&self) -> bool {
        windows::is_long(&self.map, self.options)
    }

    fn limits(&self) -> Limits {
        self.options.limits(self.noise)
    }

    /// Unregistered view with the most known points; a failed view is tried again once it has a fifth more.
    fn next_view(&self) -> Option<usize> {
        let ready = |&view: &usize| {
            let (_, visible) = self.map.visibility(view);
            let retry = match self.failed[view] {
                None => true,
                // A fifth more points is new evidence; a few are not.
                Some(Reason::NoPose { visible: before, .. }) => visible as f64 > 1.2 * before as f64,
                Some(_) => false,
            };
            self.map.poses[view].is_none() && visible >= self.options.min_resection_inliers && retry
        };
        (0..self.map.poses.len()).filter(ready).max_by_key(|&view| (self.map.visibility(view).1, usize::MAX - view))
    }

    fn register(&mut self, view: usize) -> bool {
        if self.num_views_of_uncertain_camera(view) == Some(0) {
            return self.register_with_focal(view);
        }
        let visible = self.map.visible(view);
        let neighbor = self.nearest_registered(view);
        let from_neighbor = neighbor.and_then(|pose| self.resect(view, &visible, Some(pose)));
        let found =
            from_neighbor.filter(|r| self.is_enough(r, visible.len())).or_else(|| self.resect(view, &visible, None));
        self.accept(view, &visible, found)
    }

    /// Estimates the pose of a view from some of its features with known points.
    ///
    /// It starts near `start`, otherwise from random samples.
    fn resect(&self, view: usize, slots: &[Slot], start: Option<Rigid3>) -> Option<Resection> {
        let (pixels, points) = self.map.pixels_and_points(slots);
        let data = PixelsAndPoints { camera: self.map.camera_of(view), pixels: &pixels, points: &points };
        let max_error_px = self.options.max_pose_error_px;
        match start {
            Some(pose) => resection::refine_from(&data, &pose, max_error_px),
            None => resection::estimate(&data, max_error_px, &mut seeded_rng(self.seed, view as u64)),
        }
    }

    fn accept(&mut self, view: usize, visible: &[Slot], found: Option<Resection>) -> bool {
        let inliers = found.as_ref().map_or(0, |r| r.inliers.len());
        match found.filter(|r| self.is_enough(r, visible.len())) {
            Some(resection) => {
                self.set_pose(view, &resection, visible);
                true
            }
            None => {
                self.failed[view] = Some(Reason::NoPose { visible: visible.len(), inliers });
                false
            }
        }
    }

    /// Registers a view, with the inliers of its pose as observations.
    fn set_pose(&mut self, view: usize, found: &Resection, slots: &[Slot]) {
        self.map.poses[view] = Some(found.cam_from_world);
        self.map.activate(found.inliers.iter().map(|&i| slots[i]));
        self.failed[view] = None;
    }

    fn is_enough(&self, resection: &Resection, num_visible: usize) -> bool {
        let inliers = resection.inliers.len();
        inliers >= self.options.min_resection_inliers
            && inliers as f64 >= self.options.min_inlier_ratio * num_visible as f64
    }

    /// Pose of the previous or next view, if it is registered.
    fn nearest_registered(&self, view: usize) -> Option<Rigid3> {
        if !self.options.ordered {
            return None;
        }
        let neighbor = |v: Option<usize>| v.and_then(|v| self.map.poses.get(v).copied().flatten());
        neighbor(view.checked_sub(1)).or_else(|| neighbor(Some(view + 1)))
    }

    /// Updates the map after a registration: new points, and a local or, after enough growth, a global adjustment.
    fn update_after(&mut self, view: usize) -> Result<(), MapperError> {
        let limits = self.limits();
        self.map.triangulate_features_of(view, &limits);
        let is_first_of_camera = || self.map.cameras.len() > 1 && self.num_views_of_uncertain_camera(view) == Some(1);
        if self.has_grown() || is_first_of_camera() {
            return self.adjust_growth();
        }
        self.adjust(&Scope::Local(view), Freedom::Nothing)?;
        Ok(())
    }

    fn has_grown(&self) -> bool {
        let (before, now) = (self.adjusted_at, self.map.num_registered());
        now as f64 >= GLOBAL_GROWTH * before as f64 || (now >= before + windows::STEP && self.is_long())
    }

    /// Adjusts the whole map; of a long map, the views by which it has grown.
    fn adjust_growth(&mut self) -> Result<(), MapperError> {
        if !self.is_long() || self.adjusted_views.is_empty() {
            return self.adjust_globally();
        }
        let limits = self.limits();
        for views in windows::ends(&self.map, &self.adjusted_views) {
            // The neighboring views are fixed.
            let scope = Box::new(Scope::Selected);
            let scope = Scope::Segment(Segment { views: views.clone(), counted: 0..usize::MAX, scope });
            let used = adjustment::adjust(&mut self.map, &scope, Freedom::Nothing, self.noise, self.options)?;
            self.map.update_points_of(views, &limits, &used);
        }
        self.note_adjusted();
        Ok(())
    }

    fn note_adjusted(&mut self) {
        self.adjusted_at = self.map.num_registered();
        let (first, last) = (self.map.registered().next(), self.map.registered().last());
        self.adjusted_views = first.unwrap_or(0)..last.map_or(0, |last| last + 1);
    }

    fn adjust_globally(&mut self) -> Result<(), MapperError> {
        let limits = self.limits();
        let used = self.adjust(&Scope::Selected, self.freedom)?;
        self.map.retriangulate(&limits, &used);
        self.map.triangulate_all(&limits);
        self.map.update_observations(&limits);
        self.note_adjusted();
        Ok(())
    }

    /// Pose interpolated between the nearest registered views before and after; `None` at the ends.
    fn interpolated(&self, view: usize) -> Option<Rigid3> {
        // A third of a second at 30 frames per second: beyond, motion is no longer linear.
        const MAX_GAP: usize = 10;
        let before = (view.saturating_sub(MAX_GAP)..view).rev().find(|&v| self.map.poses[v].is_some())?;
        let last = self.map.poses.len().min(view + MAX_GAP);
        let after = (view + 1..last).find(|&v| self.map.poses[v].is_some())?;
        let (a, b) = (self.map.poses[before]?, self.map.poses[after]?);
        let t = (view - before) as f64 / (after - before) as f64;
        let rotation = a.rotation.try_slerp(&b.rotation, t, 1e-9)?;
        let center = a.center() + (b.center() - a.center()) * t;
        Some(Rigid3::from_rotation_and_center(rotation, center))
    }

    /// Reason that a view is not registered.
    fn reason(&self, view: usize) -> Reason {
        let features = self.map.table.views[view].pixels.len();
        let (in_tracks, visible) = self.map.visibility(view);
        match &self.failed[view] {
            _ if features == 0 => Reason::NoFeatures,
            _ if in_tracks == 0 => Reason::NoMatches { features },
            Some(reason) => reason.clone(),
            None => Reason::TooFewPoints { visible, needed: self.options.min_resection_inliers },
        }
    }
}
