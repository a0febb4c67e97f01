//! Tracks of image points from the frames of a video.
//!
//! A point is a corner (J. Shi, C. Tomasi, *Good Features to Track*, CVPR 1994; `corners`). Pyramidal Lucas-Kanade
//! predicts it in the next frame (`point_tracking`). Alignment with the patch of its first observation
//! ([`super::patch`]) keeps long tracks from drifting, ends them where the point is occluded, and gives the covariance
//! of the position ([`Whitening`](crate::bundle::Whitening)). A point that Lucas-Kanade loses is searched where the
//! motion of its neighbors leads.
//!
//! Points that are lost for longer, after occlusions or outside of the image, are re-detected in keyframes
//! (`keyframe_memory`, `redetection`).

mod affine_views;
mod corners;
mod keyframe;
mod keyframe_memory;
mod point_tracking;
mod redetection;
mod search_range;
#[cfg(test)]
mod tests;
mod tracked_point;

use std::sync::Arc;

use nalgebra::{Matrix2, Point2, Vector2};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Target;
use super::matching::MatchOptions;
use super::patch::{Patch, Warp};
use super::tracks::{Feature, Track, TrackTable, View};
use crate::camera::Camera;
use crate::checks::{Checked, under, within};
use crate::features::FeatureError;
use crate::image::{CornerStrength, GrayImage, Picture, Pyramid, RgbImage};
use crate::scene::{BoundingBox, Frame, Mask};
use keyframe_memory::Memory;
use search_range::{Extent, SearchRange};
use tracked_point::{TrackedPoint, whitening};

/// Start of the search for a tracked point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum FirstLook {
    /// Its predicted position, in the finest images; the whole pyramid if it is not there.
    Predicted,
    /// Its last position, through the whole pyramid.
    Pyramid,
}

/// Options of the video front end.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct VideoOptions {
    /// Maximum number of points tracked at a time: more make poses more accurate and everything slower.
    #[schemars(extend("unit" = "points"))]
    pub max_points: usize,
    /// Minimum distance of a new point from any other: spreads the points over the image.
    pub min_distance_px: f64,
    /// Minimum corner strength relative to the strongest in the frame.
    #[schemars(extend("unit" = "share"))]
    pub quality: f64,
    /// Half the side of the prediction window.
    pub window_radius_px: i32,
    /// Half the side of the patch that is compared with a point's first observation.
    pub patch_radius_px: i32,
    /// Levels of the pyramid above the image: each doubles the motion from frame to frame that can be tracked.
    #[schemars(extend("unit" = "levels"))]
    pub pyramid_levels: i32,
    /// Start of the search for a tracked point.
    pub first_look: FirstLook,
    /// Minimum correlation with the first patch.
    #[schemars(extend("unit" = "correlation"))]
    pub min_correlation: f32,
    /// Minimum correlation with the first patch of a point that is searched where its neighbors' motion leads.
    #[schemars(extend("unit" = "correlation"))]
    pub min_found_again: f32,
    /// Minimum distance of points from the mask's border: points on an outline belong to no surface.
    pub border_px: u32,
    /// Minimum length of a track.
    #[schemars(extend("unit" = "views"))]
    pub min_track_length: usize,
    /// True if keyframes that share enough live points are not searched for lost ones.
    pub skip_tied_keyframes: bool,
    /// Descriptor matching of re-detection.
    pub matching: MatchOptions,
}

impl VideoOptions {
    /// Options for a target.
    pub fn of(target: Target) -> Self {
        match target {
            Target::Background => Self::background(),
            Target::Object => Self::object(),
        }
    }

    /// Rejects options that are out of range; upper limits bound the memory of an image's points and patches.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("max_points", self.max_points, 1..=100_000)?;
        within("min_distance_px", self.min_distance_px, 0.0..=1000.0)?;
        within("quality", self.quality, 1e-9..=1.0)?;
        within("window_radius_px", self.window_radius_px, 1..=100)?;
        within("patch_radius_px", self.patch_radius_px, 1..=100)?;
        within("pyramid_levels", self.pyramid_levels, 0..=10)?;
        within("min_correlation", self.min_correlation, -1.0..=1.0)?;
        within("min_found_again", self.min_found_again, -1.0..=1.0)?;
        within("border_px", self.border_px, 0..=1000)?;
        within("min_track_length", self.min_track_length, 2..=1_000_000)?;
        under("matching", self.matching.check())
    }

    /// Options for the background.
    pub fn background() -> Self {
        Self {
            // With 1,500 the trajectories of six rendered drives are as accurate; with 800 camera trajectories are a
            // third worse.
            max_points: 1000,
            min_distance_px: 12.0,
            quality: 0.003,
            window_radius_px: 7,
            patch_radius_px: 7,
            pyramid_levels: 3,
            first_look: FirstLook::Predicted,
            min_correlation: 0.7,
            min_found_again: 0.8,
            border_px: 0,
            min_track_length: 4,
            skip_tied_keyframes: true,
            matching: MatchOptions::default(),
        }
    }

    /// Options for one object: denser points and smaller windows, since it is small and its surfaces end soon.
    ///
    /// The search starts at coarse pyramid levels, since it moves on its own, and the road next to it is near.
    pub fn object() -> Self {
        let first_look = FirstLook::Pyramid;
        Self { max_points: 800, min_distance_px: 4.0, quality: 0.002, border_px: 2, first_look, ..Self::background() }
    }
}

/// Tracks points frame by frame.
pub struct VideoFrontEnd {
    options: VideoOptions,
    previous: Option<Arc<Pyramid>>,
    /// Extent of the target in the last frame.
    extent: Option<Extent>,
    /// Search range around a point in the current frame, and displacement of the target to it.
    reach: SearchRange,
    shift: Option<Vector2<f32>>,
    live: Vec<TrackedPoint>,
    memory: Memory,
    table: TrackTable,
}

impl VideoFrontEnd {
    /// Front end without frames; `camera` serves to verify re-detected points, and a guess suffices.
    pub fn new(options: VideoOptions, camera: Camera) -> Self {
        let memory = Memory::new(camera, &options);
        let reach = SearchRange::new(&options, None);
        let (live, table) = (Vec::new(), TrackTable::default());
        Self { options, previous: None, extent: None, reach, shift: None, live, memory, table }
    }

    /// Re-detects lost points only where hardly any point of the previous view is tracked, and without synthesized
    /// views.
    ///
    /// This is for live video, where SIFT of every keyframe takes as long as all other work in a frame.
    pub fn only_across_breaks(mut self) -> Self {
        self.memory.only_across_breaks = true;
        self
    }

    /// Adds the next frame; points are tracked only where the mask is set.
    ///
    /// # Errors
    /// [`FeatureError::OpenCv`] if OpenCV fails.
    pub fn push(&mut self, frame: &Frame, picture: &Picture, mask: &Mask) -> Result<(), FeatureError> {
        let extent = Extent::of(mask);
        self.reach = SearchRange::new(&self.options, extent);
        self.shift = search_range::shift(&self.options, self.extent, extent);
        self.extent = extent;
        let mask = mask.eroded(self.reach.border_px);
        let pyramid = picture.pyramid(self.options.pyramid_levels.max(0) as usize)?;
        if let Some(previous) = self.previous.take() {
            self.follow(&previous, &pyramid, &mask);
        }
        let gray = pyramid.picture();
        self.redetect(gray, &mask)?;
        self.detect_new(gray, picture.known_corners(), &mask);
        self.memory.remember(self.table.views.len(), pyramid.clone(), mask, &self.live);
        self.record(frame, picture.rgb());
        self.previous = Some(pyramid);
        Ok(())
    }

    /// Scales the positions of the last frame by factors across and down.
    pub fn enlarge_last(&mut self, [across, down]: [f64; 2]) {
        for pixel in self.table.views.last_mut().into_iter().flat_map(|view| &mut view.pixels) {
            *pixel = Point2::new(pixel.x * across, pixel.y * down);
        }
    }

    /// Views so far, and all tracks, of any length.
    pub fn table(&self) -> &TrackTable {
        &self.table
    }

    /// Drops all other views, and the tracks without any of these: of an endless video not everything can be kept.
    ///
    /// Points that are lost now are not re-detected.
    pub fn retain_views(&mut self, is_kept: impl Fn(usize, &View) -> bool) {
        let kept: Vec<bool> = self.table.views.iter().enumerate().map(|(k, view)| is_kept(k, view)).collect();
        let new_index: Vec<u32> =
            kept.iter().scan(0, |next, kept| Some(std::mem::replace(next, *next + u32::from(*kept)))).collect();
        let mut is_live = vec![false; self.table.tracks.len()];
        self.live.iter().for_each(|point| is_live[point.track] = true);
        let mut number = vec![0; is_live.len()];
        let mut tracks = Vec::new();
        for (k, mut track) in std::mem::take(&mut self.table.tracks).into_iter().enumerate() {
            track.retain(|feature| kept[feature.view as usize]);
            track.iter_mut().for_each(|feature| feature.view = new_index[feature.view as usize]);
            if is_live[k] || !track.is_empty() {
                number[k] = tracks.len();
                tracks.push(track);
            }
        }
        self.table.tracks = tracks;
        self.live.iter_mut().for_each(|point| point.track = number[point.track]);
        let mut is_kept = kept.into_iter();
        self.table.views.retain(|_| is_kept.next().unwrap_or(false));
        self.memory.forget();
    }

    /// The tracks.
    pub fn finish(mut self) -> TrackTable {
        let min_length = self.options.min_track_length.min(self.table.views.len()).max(2);
        self.table.tracks.retain(|track| track.len() >= min_length);
        self.table
    }

    /// Continues the tracks of points that were lost in earlier frames and are re-detected here.
    ///
    /// Where a newer point has the same position, the older one continues.
    fn redetect(&mut self, gray: &GrayImage, mask: &Mask) -> Result<(), FeatureError> {
        let found = self.memory.redetect(self.table.views.len(), gray, mask, &self.live)?;
        // Two patches at this distance show the same surface.
        let is_distinct = |point: &TrackedPoint| found.iter().all(|f| (f.warp.center - point.warp.center).norm() > 2.0);
        self.live.retain(is_distinct);
        self.live.extend(found);
        Ok(())
    }

    /// Detects new points up to the wanted number, away from the tracked ones.
    ///
    /// * `strength` – of the whole frame, if it is known.
    fn detect_new(&mut self, gray: &GrayImage, strength: Option<&CornerStrength>, mask: &Mask) {
        let wanted = self.options.max_points.saturating_sub(self.live.len());
        let mut free = mask.clone();
        let reach = self.reach.min_distance_px.ceil() as i64;
        for point in &self.live {
            clear_disc(&mut free, point.warp.center, reach);
        }
        let Some(bounds) = free.bounding_box().filter(|_| wanted > 0) else { return };
        for center in self.corners(gray, strength, &free, bounds, wanted) {
            if let Some(patch) = Patch::cut(gray, center, self.reach.patch_radius_px) {
                let track = self.table.tracks.len();
                self.table.tracks.push(Track::new());
                let warp = Warp { shape: Matrix2::identity(), center };
                let whitening = whitening(patch.covariance(&warp.shape, TYPICAL_DIFFERENCE));
                self.live.push(TrackedPoint { track, patch, warp, whitening, step: None, views_left: None });
            }
        }
    }

    /// The strongest corners of the set pixels, all of which are within some bounds.
    ///
    /// Unless the strength of the whole frame is known, only the surroundings of a small object are searched.
    fn corners(
        &self,
        gray: &GrayImage,
        strength: Option<&CornerStrength>,
        free: &Mask,
        bounds: BoundingBox,
        wanted: usize,
    ) -> Vec<Point2<f32>> {
        let (quality, apart) = (self.options.quality, self.reach.min_distance_px);
        if let Some(strength) = strength {
            let whole = BoundingBox { x0: 0, y0: 0, x1: gray.width(), y1: gray.height() };
            return corners::strongest(strength, &free.pixels_in(whole), wanted, quality, apart);
        }
        // With the border that the strength of a corner depends on.
        let window = bounds.grown(8, gray.dimensions());
        let BoundingBox { x0, y0, .. } = window;
        let crop = ::image::imageops::crop_imm(gray, x0, y0, window.width(), window.height()).to_image();
        let found = corners::strongest(&CornerStrength::of(&crop), &free.pixels_in(window), wanted, quality, apart);
        found.into_iter().map(|corner| corner + Vector2::new(x0 as f32, y0 as f32)).collect()
    }

    fn record(&mut self, frame: &Frame, image: &RgbImage) {
        let view = self.table.views.len() as u32;
        let mut source = View::new(frame, 0);
        for (feature, point) in self.live.iter().enumerate() {
            let pixel = point.warp.center.cast::<f64>();
            let color = image.get_pixel_checked(pixel.x as u32, pixel.y as u32);
            source.pixels.push(pixel);
            source.whitening.push(point.whitening);
            source.rgb.push(color.map_or([0; 3], |c| c.0));
            self.table.tracks[point.track].push(Feature { view, feature: feature as u32 });
        }
        self.table.views.push(source);
    }
}

/// Mean squared difference between a patch and its next observation.
const TYPICAL_DIFFERENCE: f32 = 0.05;

fn clear_disc(mask: &mut Mask, center: Point2<f32>, reach: i64) {
    let (cx, cy) = (center.x as i64, center.y as i64);
    for y in (cy - reach).max(0)..=(cy + reach).min(i64::from(mask.height()) - 1) {
        let half = (reach * reach - (y - cy).pow(2)).isqrt();
        let clipped = |x: i64| x.clamp(0, i64::from(mask.width())) as u32;
        mask.fill(clipped(cx - half)..clipped(cx + half + 1), y as u32, false);
    }
}
