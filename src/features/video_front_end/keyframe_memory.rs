//! Re-detection: the appearance of earlier views, to find lost points again.
//!
//! Some views are kept as *key views*: their SIFT features, and small pictures of their points. A view becomes one
//! where few of its points are those of the last key view, or where hardly any point lives on from the view before,
//! which then is one, too. It is compared with the key views before it, and points that were lost since go on where
//! they are found again ([`super::redetection`]): behind a pole, after another vehicle swept over them, on a vehicle
//! that was out of the picture, at a place where the camera comes back.

use std::collections::BTreeSet;
use std::sync::Arc;

use nalgebra::Point2;

use super::affine_views::AffineViews;
use super::keyframe::{FEW_POINTS, Keyframe};
use super::redetection::{self, Now};
use super::tracked_point::Live;
use super::{FeatureError, VideoOptions};
use crate::camera::Camera;
use crate::features::matching::{MatchOptions, match_features, match_strongest};
use crate::features::rootsift::Features;
use crate::image::{GrayImage, Pyramid};
use crate::scene::Mask;

/// The link to the view before is broken, and that to the last key view weak, below these shares of common points.
const BROKEN_LINK: f64 = 0.3;
const WEAK_LINK: f64 = 0.3;
/// Key views that are kept; beyond, every other one is forgotten, so that cost and memory are bounded.
const MAX_KEYS: usize = 256;
/// Key views a short time ago with which a view is compared, and of those the ones in which points are looked for.
const NEAR_KEYS: usize = 8;
const NEAR_CHOSEN: usize = 2;
/// Share of the points of another key view from which on one shows much, and how many of those are tilted.
const SHOWS_MUCH: f64 = 0.5;
const TILTED_KEYS: usize = 3;
/// Key views that can be tilted, so that memory is bounded: nine sets of features each.
const PICTURES: usize = 32;
/// Views from one look back to the next, and the most of them, as long as what is seen is tied to no earlier view.
const LOOK_EVERY: usize = 3;
const LOOKS_BACK: usize = 20;
/// Views after which a place counts as one that comes back: as many as the longest tracks live.
const COMES_BACK_AFTER: usize = 100;
/// Smallest distance between two ties to such places, and for how many views their points are followed: in the system
/// of bundle adjustment each of these views fills a row of its own.
const TIE_DISTANCE: usize = 48;
const TIE_VIEWS: usize = 8;
/// Features in a first comparison with views long ago, and how many must match for a second one.
const GLANCE_FEATURES: usize = 400;
const GLANCE_MATCHES: usize = 12;

fn shows_much(num_points: usize, most: usize) -> bool {
    num_points as f64 >= SHOWS_MUCH * most as f64
}

/// The view before, in case that the next one shows hardly any of its points.
struct Last {
    view: usize,
    pyramid: Arc<Pyramid>,
    mask: Mask,
    points: Vec<(usize, Point2<f32>)>,
}

/// Key views and the last view.
pub struct Memory {
    camera: Camera,
    patch_radius: i32,
    matching: MatchOptions,
    skip_tied: bool,
    /// True to re-detect only where the link to the view before is broken, and without synthesized views.
    pub only_across_breaks: bool,
    keys: Vec<Keyframe>,
    last: Option<Last>,
    /// The view that was tied to a place long ago last.
    tied_at: Option<usize>,
    /// The first view of what is seen now, as long as nothing ties it to the views before.
    apart_since: Option<usize>,
    /// Appearance of the current view, if it becomes a keyframe.
    described: Option<AffineViews>,
}

impl Memory {
    /// Nothing seen yet.
    pub fn new(camera: Camera, options: &VideoOptions) -> Self {
        Self {
            camera,
            patch_radius: options.patch_radius_px,
            matching: options.matching,
            skip_tied: options.skip_tied_keyframes,
            only_across_breaks: false,
            keys: Vec::new(),
            last: None,
            tied_at: None,
            apart_since: None,
            described: None,
        }
    }

    /// Forgets all views, whose numbers change.
    pub fn forget(&mut self) {
        self.keys.clear();
        (self.last, self.tied_at, self.apart_since, self.described) = (None, None, None, None);
    }

    /// Finds points of earlier views that are not alive, where the link to those views is weak.
    ///
    /// # Errors
    /// [`FeatureError::OpenCv`].
    pub fn find_again(
        &mut self,
        view: usize,
        gray: &GrayImage,
        mask: &Mask,
        live: &[Live],
    ) -> Result<Vec<Live>, FeatureError> {
        let alive: BTreeSet<usize> = live.iter().map(|point| point.track).collect();
        if self.is_cut(&alive) {
            self.apart_since = Some(view);
        }
        let is_broken = self.is_broken(&alive);
        let is_wanted = || !self.only_across_breaks && (self.is_weak(&alive) || self.is_due(view, &alive));
        if !is_broken && !is_wanted() {
            return Ok(Vec::new());
        }
        if let Some(last) = self.last.take().filter(|last| is_broken && !self.is_key(last.view)) {
            let gray = last.pyramid.picture();
            self.keep(last.view, AffineViews::new(gray, &last.mask)?, gray, &last.points);
        }
        let mut looks = AffineViews::new(gray, mask)?;
        let chosen = self.chosen(view, &looks.plain.features, &alive);
        let mut found = self.points_of(&chosen, &self.now(&looks, gray, mask), &alive);
        if !self.only_across_breaks && found.is_empty() && (is_broken || self.apart_since.is_some()) {
            let chosen = self.chosen_to_tilt(view, &alive);
            self.tilt(&chosen, &mut looks)?;
            found = self.points_of(&chosen, &self.now(&looks, gray, mask), &alive);
        }
        self.note_ties(view, &found);
        self.described = Some(looks);
        Ok(found.into_iter().flat_map(|(_, points)| points).collect())
    }

    fn now<'a>(&'a self, looks: &'a AffineViews, gray: &'a GrayImage, mask: &'a Mask) -> Now<'a> {
        Now { camera: &self.camera, matching: &self.matching, looks, gray, mask }
    }

    fn tilt(&mut self, chosen: &[Chosen], now: &mut AffineViews) -> Result<(), FeatureError> {
        let keys = chosen.iter().map(|chosen| chosen.key);
        keys.into_iter().try_for_each(|key| self.keys[key].looks.tilt())?;
        if chosen.is_empty() { Ok(()) } else { now.tilt() }
    }

    /// The points of key views that are found again, by key view.
    fn points_of(&self, chosen: &[Chosen], now: &Now<'_>, alive: &BTreeSet<usize>) -> Vec<(Chosen, Vec<Live>)> {
        let mut known = alive.clone();
        let mut all = Vec::new();
        for chosen in chosen {
            let key = &self.keys[chosen.key];
            let found =
                redetection::find(key, now, self.patch_radius, |track| known.contains(&track), chosen.follow_for);
            tracing::trace!(key = key.view, matches = chosen.num_matches, found = found.len(), "looked back");
            if !found.is_empty() {
                known.extend(found.iter().map(|point| point.track));
                all.push((*chosen, found));
            }
        }
        all
    }

    fn note_ties(&mut self, view: usize, found: &[(Chosen, Vec<Live>)]) {
        for (chosen, _) in found {
            let keyframe = self.keys[chosen.key].view;
            self.tied_at = chosen.follow_for.map(|_| view).or(self.tied_at);
            self.apart_since = self.apart_since.filter(|first| keyframe >= *first);
        }
    }

    /// To be called with all points of a view, those that are new among them.
    pub fn remember(&mut self, view: usize, pyramid: Arc<Pyramid>, mask: Mask, live: &[Live]) {
        let points: Vec<_> = live.iter().map(|point| (point.track, point.warp.center)).collect();
        if let Some(looks) = self.described.take() {
            self.keep(view, looks, pyramid.picture(), &points);
        }
        self.last = Some(Last { view, pyramid, mask, points });
    }

    fn is_key(&self, view: usize) -> bool {
        self.keys.last().is_some_and(|key| key.view == view)
    }

    /// Number of points of the view before that are still tracked, and of all of them.
    fn link(&self, alive: &BTreeSet<usize>) -> Option<[usize; 2]> {
        let points = &self.last.as_ref()?.points;
        Some([points.iter().filter(|(track, _)| alive.contains(track)).count(), points.len()])
    }

    /// Returns true if hardly any point of the view before is still tracked.
    fn is_broken(&self, alive: &BTreeSet<usize>) -> bool {
        self.link(alive).is_some_and(|[tracked, all]| all >= FEW_POINTS && (tracked as f64) < BROKEN_LINK * all as f64)
    }

    /// Returns true if too few points of the view before are still tracked to tie the views together.
    fn is_cut(&self, alive: &BTreeSet<usize>) -> bool {
        self.link(alive).is_some_and(|[tracked, _]| tracked < FEW_POINTS)
    }

    /// Returns true if re-detection is due, to tie this view to those before a gap. An object that reappears from an
    /// occlusion shows another part at first than before it.
    fn is_due(&self, view: usize, alive: &BTreeSet<usize>) -> bool {
        self.apart_since.is_some_and(|first| {
            let since = view - first;
            alive.len() >= FEW_POINTS && since.is_multiple_of(LOOK_EVERY) && since <= LOOK_EVERY * LOOKS_BACK
        })
    }

    /// Returns true if a keyframe has enough of the points that are tracked now: it would match best, and tie nothing
    /// new.
    fn is_tied(key: &Keyframe, alive: &BTreeSet<usize>) -> bool {
        key.sights.iter().filter(|sight| alive.contains(&sight.track)).count() >= FEW_POINTS
    }

    /// Returns true if few of the last keyframe's points are still tracked.
    fn is_weak(&self, alive: &BTreeSet<usize>) -> bool {
        let Some(key) = self.keys.last() else { return alive.len() >= FEW_POINTS };
        let common = key.sights.iter().filter(|sight| alive.contains(&sight.track)).count() as f64;
        // Of the points alive only a part could have a sight.
        let sampled = key.sights.len() as f64 / key.num_points.max(1) as f64;
        common < WEAK_LINK * (key.sights.len() as f64).max(alive.len() as f64 * sampled)
    }

    /// Keeps a key view; none that shows hardly anything, behind which there would be nothing to find.
    fn keep(&mut self, view: usize, looks: AffineViews, gray: &GrayImage, points: &[(usize, Point2<f32>)]) {
        if points.len() < FEW_POINTS {
            return;
        }
        // Two pixels more: for differences, and for a centre between pixels.
        let radius = self.patch_radius.unsigned_abs() + 2;
        self.keys.push(Keyframe::new(view, looks, gray, points, radius));
        if let Some(old) = self.keys.len().checked_sub(PICTURES).and_then(|old| self.keys.get_mut(old)) {
            old.looks.forget_tilted();
        }
        if self.keys.len() > MAX_KEYS {
            let mut index = 0;
            self.keys.retain(|_| {
                index += 1;
                index % 2 == 1
            });
        }
    }

    /// The key views in which points are looked for: of those a short time ago the ones that match best, and of those
    /// long ago the first that matches half as well as the best.
    fn chosen(&self, view: usize, features: &Features, alive: &BTreeSet<usize>) -> Vec<Chosen> {
        let num_far = self.num_far(view);
        let mut chosen: Vec<Chosen> = self
            .near(view, alive)
            .into_iter()
            .map(|key| Chosen { key, num_matches: self.num_matches(key, features), follow_for: None })
            .filter(|chosen| chosen.num_matches >= FEW_POINTS)
            .collect();
        chosen.sort_by_key(|chosen| (usize::MAX - chosen.num_matches, usize::MAX - chosen.key));
        chosen.truncate(NEAR_CHOSEN);
        if self.tied_at.is_none_or(|tied| view - tied >= TIE_DISTANCE) {
            chosen.extend(self.place_long_ago(num_far, features));
        }
        chosen
    }

    /// Where too little matches as it is, the last key views that show much are compared as seen from elsewhere; once
    /// as much is seen again, since what looks through leaves or comes in at the border matches too much by chance.
    fn chosen_to_tilt(&self, view: usize, alive: &BTreeSet<usize>) -> Vec<Chosen> {
        let near = self.near(view, alive);
        let most = near.iter().map(|key| self.keys[*key].num_points).max().unwrap_or(0);
        if !shows_much(alive.len(), most) {
            return Vec::new();
        }
        let last = near.into_iter().rev().filter(|key| shows_much(self.keys[*key].num_points, most)).take(TILTED_KEYS);
        last.map(|key| Chosen { key, num_matches: 0, follow_for: None }).collect()
    }

    /// Number of keyframes long ago.
    fn num_far(&self, view: usize) -> usize {
        self.keys.iter().take_while(|key| view - key.view >= COMES_BACK_AFTER).count()
    }

    /// Key views a short time ago that are not tied to what is alive: the last ones, and the last of those that show
    /// much. What disappears behind leaves leaves a row of key views that show hardly anything.
    fn near(&self, view: usize, alive: &BTreeSet<usize>) -> BTreeSet<usize> {
        let num_far = self.num_far(view);
        let is_before_gap = |key: &&Keyframe| self.apart_since.is_none_or(|first| key.view < first);
        let keys = num_far..self.keys.iter().take_while(is_before_gap).count().max(num_far);
        let most = self.keys[keys.clone()].iter().map(|key| key.num_points).max().unwrap_or(0);
        let last = keys.clone().rev().take(NEAR_KEYS);
        let rich = keys.rev().filter(|key| shows_much(self.keys[*key].num_points, most)).take(NEAR_KEYS);
        last.chain(rich).filter(|key| !self.skip_tied || !Self::is_tied(&self.keys[*key], alive)).collect()
    }

    fn place_long_ago(&self, num_far: usize, features: &Features) -> Option<Chosen> {
        let glance = |key: &usize| {
            let seen = &self.keys[*key].looks.plain.features;
            match_strongest(seen, features, GLANCE_FEATURES, &self.matching).len() >= GLANCE_MATCHES
        };
        let looked: Vec<Chosen> = (0..num_far)
            .filter(glance)
            .map(|key| Chosen { key, num_matches: self.num_matches(key, features), follow_for: Some(TIE_VIEWS) })
            .collect();
        let most = looked.iter().map(|chosen| chosen.num_matches).max()?;
        looked.into_iter().find(|chosen| 2 * chosen.num_matches >= most)
    }

    fn num_matches(&self, key: usize, features: &Features) -> usize {
        match_features(&self.keys[key].looks.plain.features, features, &self.matching).len()
    }
}

/// A key view in which points are looked for.
#[derive(Clone, Copy)]
struct Chosen {
    /// Its index.
    key: usize,
    num_matches: usize,
    /// For how many views its points are followed; `None` for as long as they are seen.
    follow_for: Option<usize>,
}
