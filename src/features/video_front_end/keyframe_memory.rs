//! Re-detection: the appearance of earlier views, in which lost points are searched.
//!
//! Some views are kept as keyframes: their SIFT features, and small patches of their points. A view becomes a keyframe
//! if few of its points are those of the last keyframe, or if hardly any point of the previous view is still tracked;
//! then the previous view becomes one, too. It is compared with earlier keyframes, and lost points are tracked on from
//! where they are re-detected ([`super::redetection`]): after they were behind a pole, after another vehicle occluded
//! them, on a vehicle that left the image, or at a position to which the camera returns (loop closure).

use std::collections::BTreeSet;
use std::sync::Arc;

use nalgebra::Point2;

use super::affine_views::AffineViews;
use super::keyframe::{FEW_POINTS, Keyframe};
use super::redetection::{self, CurrentView};
use super::tracked_point::TrackedPoint;
use super::{FeatureError, VideoOptions};
use crate::camera::Camera;
use crate::features::matching::{MatchOptions, match_features, match_strongest};
use crate::features::rootsift::Features;
use crate::image::{GrayImage, Pyramid};
use crate::scene::Mask;

/// Share of the previous view's points that are still tracked below which the link to it is broken.
const BROKEN_LINK: f64 = 0.3;
/// Share of common points below which the link to the last keyframe is weak.
const WEAK_LINK: f64 = 0.3;
/// Maximum number of keyframes kept; beyond it every other one is dropped, which bounds cost and memory.
const MAX_KEYFRAMES: usize = 256;
/// Number of recent keyframes with which a view is compared: of the latest, and as many of the latest rich ones.
const NUM_COMPARED: usize = 8;
/// Number of compared keyframes in which points are re-detected, those with the most matches.
const NUM_SEARCHED: usize = 2;
/// Share of the points of the richest recent keyframe from which a view is rich.
const RICH_SHARE: f64 = 0.5;
/// Number of rich keyframes, the latest, of which affine views are synthesized.
const NUM_SYNTHESIZED: usize = 3;
/// Age of a keyframe, in keyframes with itself, at which its affine views (nine sets of features) are dropped: this
/// bounds memory.
const SYNTHESIS_AGE: usize = 32;
/// Views from one attempt at re-detection to the next, as long as nothing ties the view to those before a gap.
const RETRY_VIEWS: usize = 3;
/// Maximum number of these attempts.
const MAX_RETRIES: usize = 20;
/// Age in views from which a keyframe is a candidate for loop closure: the length of the longest tracks.
const LOOP_AGE: usize = 100;
/// Minimum number of views from one loop closure to the next, which bounds the cost that [`LOOP_VIEWS`] names.
const LOOP_INTERVAL: usize = 48;
/// Number of views in which the points of a loop closure are tracked: in the system of bundle adjustment each of these
/// views fills a row of its own.
const LOOP_VIEWS: usize = 8;
/// Number of features, the strongest, in the preliminary matching of candidates for loop closure.
const PRETEST_FEATURES: usize = 400;
/// Minimum number of preliminary matches with which a candidate is matched with all features.
const MIN_PRETEST_MATCHES: usize = 12;

fn is_rich(num_points: usize, most: usize) -> bool {
    num_points as f64 >= RICH_SHARE * most as f64
}

/// Previous view, in case that hardly any of its points is tracked to the next one.
struct Last {
    view: usize,
    pyramid: Arc<Pyramid>,
    mask: Mask,
    points: Vec<(usize, Point2<f32>)>,
}

/// Keyframes and the last view.
pub struct Memory {
    camera: Camera,
    patch_radius: i32,
    matching: MatchOptions,
    skip_tied: bool,
    /// True to re-detect only where the link to the previous view is broken, and without synthesized views.
    pub only_across_breaks: bool,
    keys: Vec<Keyframe>,
    last: Option<Last>,
    /// Last view with a loop closure.
    loop_closed_at: Option<usize>,
    /// First view after a gap, as long as nothing ties it to the views before.
    gap_since: Option<usize>,
    /// Appearance of the current view, if it becomes a keyframe.
    appearance_of_view: Option<AffineViews>,
}

impl Memory {
    /// Memory without views.
    pub fn new(camera: Camera, options: &VideoOptions) -> Self {
        Self {
            camera,
            patch_radius: options.patch_radius_px,
            matching: options.matching,
            skip_tied: options.skip_tied_keyframes,
            only_across_breaks: false,
            keys: Vec::new(),
            last: None,
            loop_closed_at: None,
            gap_since: None,
            appearance_of_view: None,
        }
    }

    /// Drops all views, whose indices change.
    pub fn forget(&mut self) {
        self.keys.clear();
        (self.last, self.loop_closed_at, self.gap_since, self.appearance_of_view) = (None, None, None, None);
    }

    /// Re-detects lost points of earlier views, where the link to these is weak.
    ///
    /// # Errors
    /// [`FeatureError::OpenCv`].
    pub fn redetect(
        &mut self,
        view: usize,
        gray: &GrayImage,
        mask: &Mask,
        live: &[TrackedPoint],
    ) -> Result<Vec<TrackedPoint>, FeatureError> {
        let alive: BTreeSet<usize> = live.iter().map(|point| point.track).collect();
        if self.is_disconnected(&alive) {
            self.gap_since = Some(view);
        }
        let is_broken = self.is_broken(&alive);
        let is_wanted = || !self.only_across_breaks && (self.is_weak(&alive) || self.is_retry_due(view, &alive));
        if !is_broken && !is_wanted() {
            return Ok(Vec::new());
        }
        if let Some(last) = self.last.take().filter(|last| is_broken && !self.is_key(last.view)) {
            let gray = last.pyramid.picture();
            self.keep(last.view, AffineViews::new(gray, &last.mask)?, gray, &last.points);
        }
        let mut affine_views = AffineViews::new(gray, mask)?;
        let chosen = self.chosen(view, &affine_views.plain.features, &alive);
        let mut found = self.points_of(&chosen, &self.current(&affine_views, gray, mask), &alive);
        if !self.only_across_breaks && found.is_empty() && (is_broken || self.gap_since.is_some()) {
            let chosen = self.chosen_for_synthesis(view, &alive);
            self.tilt(&chosen, &mut affine_views)?;
            found = self.points_of(&chosen, &self.current(&affine_views, gray, mask), &alive);
        }
        self.record_ties(view, &found);
        self.appearance_of_view = Some(affine_views);
        Ok(found.into_iter().flat_map(|(_, points)| points).collect())
    }

    fn current<'a>(&'a self, affine_views: &'a AffineViews, gray: &'a GrayImage, mask: &'a Mask) -> CurrentView<'a> {
        CurrentView { camera: &self.camera, matching: &self.matching, affine_views, gray, mask }
    }

    fn tilt(&mut self, chosen: &[Chosen], current: &mut AffineViews) -> Result<(), FeatureError> {
        let keys = chosen.iter().map(|chosen| chosen.key);
        keys.into_iter().try_for_each(|key| self.keys[key].affine_views.tilt())?;
        if chosen.is_empty() { Ok(()) } else { current.tilt() }
    }

    /// Re-detected points, by keyframe.
    fn points_of(
        &self,
        chosen: &[Chosen],
        current: &CurrentView<'_>,
        alive: &BTreeSet<usize>,
    ) -> Vec<(Chosen, Vec<TrackedPoint>)> {
        let mut known = alive.clone();
        let mut all = Vec::new();
        for chosen in chosen {
            let key = &self.keys[chosen.key];
            let found =
                redetection::find(key, current, self.patch_radius, |track| known.contains(&track), chosen.max_views);
            tracing::trace!(key = key.view, matches = chosen.num_matches, found = found.len(), "looked back");
            if !found.is_empty() {
                known.extend(found.iter().map(|point| point.track));
                all.push((*chosen, found));
            }
        }
        all
    }

    fn record_ties(&mut self, view: usize, found: &[(Chosen, Vec<TrackedPoint>)]) {
        for (chosen, _) in found {
            let keyframe = self.keys[chosen.key].view;
            self.loop_closed_at = chosen.max_views.map(|_| view).or(self.loop_closed_at);
            self.gap_since = self.gap_since.filter(|first| keyframe >= *first);
        }
    }

    /// Stores a view with all its points, including new ones.
    pub fn remember(&mut self, view: usize, pyramid: Arc<Pyramid>, mask: Mask, live: &[TrackedPoint]) {
        let points: Vec<_> = live.iter().map(|point| (point.track, point.warp.center)).collect();
        if let Some(affine_views) = self.appearance_of_view.take() {
            self.keep(view, affine_views, pyramid.picture(), &points);
        }
        self.last = Some(Last { view, pyramid, mask, points });
    }

    fn is_key(&self, view: usize) -> bool {
        self.keys.last().is_some_and(|key| key.view == view)
    }

    /// Number of points of the previous view that are still tracked, and of all its points.
    fn link(&self, alive: &BTreeSet<usize>) -> Option<[usize; 2]> {
        let points = &self.last.as_ref()?.points;
        Some([points.iter().filter(|(track, _)| alive.contains(track)).count(), points.len()])
    }

    /// Returns true if hardly any point of the previous view is still tracked.
    fn is_broken(&self, alive: &BTreeSet<usize>) -> bool {
        self.link(alive).is_some_and(|[tracked, all]| all >= FEW_POINTS && (tracked as f64) < BROKEN_LINK * all as f64)
    }

    /// Returns true if too few points of the previous view are still tracked to tie the views together.
    fn is_disconnected(&self, alive: &BTreeSet<usize>) -> bool {
        self.link(alive).is_some_and(|[tracked, _]| tracked < FEW_POINTS)
    }

    /// Returns true if another attempt at re-detection after a gap is due.
    ///
    /// An object that reappears from an occlusion shows another part at first than before it.
    fn is_retry_due(&self, view: usize, alive: &BTreeSet<usize>) -> bool {
        self.gap_since.is_some_and(|first| {
            let since = view - first;
            alive.len() >= FEW_POINTS && since.is_multiple_of(RETRY_VIEWS) && since <= RETRY_VIEWS * MAX_RETRIES
        })
    }

    /// Returns true if a keyframe has enough of the tracked points.
    ///
    /// It would have the most matches, and tie nothing new.
    fn is_tied(key: &Keyframe, alive: &BTreeSet<usize>) -> bool {
        key.appearances.iter().filter(|appearance| alive.contains(&appearance.track)).count() >= FEW_POINTS
    }

    /// Returns true if few of the last keyframe's points are still tracked.
    fn is_weak(&self, alive: &BTreeSet<usize>) -> bool {
        let Some(key) = self.keys.last() else { return alive.len() >= FEW_POINTS };
        let common = key.appearances.iter().filter(|appearance| alive.contains(&appearance.track)).count() as f64;
        // Only a part of the tracked points could have an appearance.
        let sampled = key.appearances.len() as f64 / key.num_points.max(1) as f64;
        common < WEAK_LINK * (key.appearances.len() as f64).max(alive.len() as f64 * sampled)
    }

    /// Keeps a keyframe unless it has hardly any points: nothing could be re-detected in it.
    fn keep(&mut self, view: usize, affine_views: AffineViews, gray: &GrayImage, points: &[(usize, Point2<f32>)]) {
        if points.len() < FEW_POINTS {
            return;
        }
        // Two pixels more: for differences, and for a center between pixels.
        let radius = self.patch_radius.unsigned_abs() + 2;
        self.keys.push(Keyframe::new(view, affine_views, gray, points, radius));
        if let Some(old) = self.keys.len().checked_sub(SYNTHESIS_AGE).and_then(|old| self.keys.get_mut(old)) {
            old.affine_views.drop_tilted();
        }
        if self.keys.len() > MAX_KEYFRAMES {
            let mut index = 0;
            self.keys.retain(|_| {
                index += 1;
                index % 2 == 1
            });
        }
    }

    /// Selects the keyframes in which points are re-detected.
    ///
    /// They are the recent ones with the most matches, and of the candidates for loop closure the first with at least
    /// half the matches of the best one.
    fn chosen(&self, view: usize, features: &Features, alive: &BTreeSet<usize>) -> Vec<Chosen> {
        let num_loop_candidates = self.num_loop_candidates(view);
        let mut chosen: Vec<Chosen> = self
            .near(view, alive)
            .into_iter()
            .map(|key| Chosen { key, num_matches: self.num_matches(key, features), max_views: None })
            .filter(|chosen| chosen.num_matches >= FEW_POINTS)
            .collect();
        chosen.sort_by_key(|chosen| (usize::MAX - chosen.num_matches, usize::MAX - chosen.key));
        chosen.truncate(NUM_SEARCHED);
        if self.loop_closed_at.is_none_or(|tied| view - tied >= LOOP_INTERVAL) {
            chosen.extend(self.loop_closure(num_loop_candidates, features));
        }
        chosen
    }

    /// Selects the keyframes whose affine views are matched where plain ones have too few matches.
    ///
    /// They are the latest rich ones, once the view is rich itself: parts behind leaves or at the border have too many
    /// chance matches.
    fn chosen_for_synthesis(&self, view: usize, alive: &BTreeSet<usize>) -> Vec<Chosen> {
        let near = self.near(view, alive);
        let most = near.iter().map(|key| self.keys[*key].num_points).max().unwrap_or(0);
        if !is_rich(alive.len(), most) {
            return Vec::new();
        }
        let last = near.into_iter().rev().filter(|key| is_rich(self.keys[*key].num_points, most)).take(NUM_SYNTHESIZED);
        last.map(|key| Chosen { key, num_matches: 0, max_views: None }).collect()
    }

    /// Number of keyframes that are old enough for loop closure.
    fn num_loop_candidates(&self, view: usize) -> usize {
        self.keys.iter().take_while(|key| view - key.view >= LOOP_AGE).count()
    }

    /// Recent keyframes that are not tied to the tracked points: the latest ones, and the latest rich ones.
    ///
    /// An object that disappears behind leaves has a series of keyframes with hardly any points.
    fn near(&self, view: usize, alive: &BTreeSet<usize>) -> BTreeSet<usize> {
        let num_loop_candidates = self.num_loop_candidates(view);
        let is_before_gap = |key: &&Keyframe| self.gap_since.is_none_or(|first| key.view < first);
        let keys = num_loop_candidates..self.keys.iter().take_while(is_before_gap).count().max(num_loop_candidates);
        let most = self.keys[keys.clone()].iter().map(|key| key.num_points).max().unwrap_or(0);
        let last = keys.clone().rev().take(NUM_COMPARED);
        let rich = keys.rev().filter(|key| is_rich(self.keys[*key].num_points, most)).take(NUM_COMPARED);
        last.chain(rich).filter(|key| !self.skip_tied || !Self::is_tied(&self.keys[*key], alive)).collect()
    }

    fn loop_closure(&self, num_loop_candidates: usize, features: &Features) -> Option<Chosen> {
        let passes_pretest = |key: &usize| {
            let seen = &self.keys[*key].affine_views.plain.features;
            match_strongest(seen, features, PRETEST_FEATURES, &self.matching).len() >= MIN_PRETEST_MATCHES
        };
        let candidates: Vec<Chosen> = (0..num_loop_candidates)
            .filter(passes_pretest)
            .map(|key| Chosen { key, num_matches: self.num_matches(key, features), max_views: Some(LOOP_VIEWS) })
            .collect();
        let most = candidates.iter().map(|chosen| chosen.num_matches).max()?;
        candidates.into_iter().find(|chosen| 2 * chosen.num_matches >= most)
    }

    fn num_matches(&self, key: usize, features: &Features) -> usize {
        match_features(&self.keys[key].affine_views.plain.features, features, &self.matching).len()
    }
}

/// A keyframe in which points are re-detected.
#[derive(Clone, Copy)]
struct Chosen {
    /// Its index.
    key: usize,
    num_matches: usize,
    /// Number of views in which its points are tracked; `None` for as long as they are visible.
    max_views: Option<usize>,
}
