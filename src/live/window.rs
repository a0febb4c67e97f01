//! Image points of the background in the latest frames, and the pose of every frame in the current map.

use std::collections::BTreeMap;

use ::image::RgbImage;
use nalgebra::Point2;

use super::map::WorldMap;
use super::{Purpose, WINDOW_S};
use crate::camera::Camera;
use crate::features::lines::ImageLines;
use crate::features::tracks::{Feature, Track, TrackTable};
use crate::features::video_front_end::{VideoFrontEnd, VideoOptions};
use crate::geometry::resection::{self, PixelsAndPoints};
use crate::image::Picture;
use crate::math::{Rigid3, median, seeded_rng};
use crate::pipeline::PipelineError;
use crate::scene::{CameraId, Frame, FrameId, Image, ImageId, Mask, Observation, Point3dId, Reconstruction, Rect};

/// Number of tracked points: the 1500 of a run add little to a window, and cost twice the time.
const MAX_POINTS: usize = 700;
/// Maximum number of keyframes of a map.
const MAX_KEYFRAMES: usize = 30;
/// Minimum time between keyframes, seconds: then they cover the window.
const KEY_S: f64 = WINDOW_S / MAX_KEYFRAMES as f64;
/// Number of first keyframes without a minimum time between them, so that the first map comes soon.
const FIRST_KEYFRAMES: usize = 12;
/// Minimum median displacement between keyframes, as a share of the longer side: 12 px of 1280. A camera that does not
/// move keeps its earlier keyframes, which show depth.
const KEY_SHIFT: f64 = 12.0 / 1280.0;
/// Share of its points that the last keyframe may lose before there is another one.
const KEY_SHARED: f64 = 0.5;
/// Time beyond the window for which views are kept, seconds: a map under way may still make them final.
pub(super) const SPARE_S: f64 = 4.0;
/// Number of views beyond the kept ones at which they are dropped. Re-detection loses its keyframes then.
const SPARE_VIEWS: usize = 40;
/// Maximum number of frames whose straight lines are kept: as in a run.
const NUM_LINES: usize = 5;
/// Minimum time between these frames, seconds: as in a run, so that compression and moving vehicles differ.
const LINES_S: f64 = 0.5;
/// Limits of a pose: those of the mapper for the background.
pub(super) const LIMITS: Limits = Limits { max_error_px: 4.0, min_inliers: 20, min_inlier_ratio: 0.2 };

/// Limits of a pose by resection.
pub(super) struct Limits {
    /// Maximum error of an inlier, pixels.
    pub(super) max_error_px: f64,
    /// Fewest inliers.
    pub(super) min_inliers: usize,
    /// Smallest share of inliers.
    pub(super) min_inlier_ratio: f64,
}

/// State of the window for the reconstruction of a map.
pub(super) struct Snapshot {
    pub(super) table: TrackTable,
    pub(super) frames: Vec<Frame>,
    pub(super) is_key: Vec<bool>,
    /// Poses in the frame of the last map.
    pub(super) poses: BTreeMap<FrameId, Rigid3>,
    /// Images of the vehicles.
    pub(super) vehicles: Vec<BTreeMap<FrameId, Rect>>,
    /// Straight lines of some of the frames.
    pub(super) lines: Vec<ImageLines>,
    pub(super) purpose: Purpose,
}

/// Tracks points through the latest frames.
pub(super) struct Window {
    front_end: VideoFrontEnd,
    camera: Camera,
    /// Of the views of the front end.
    frames: Vec<Frame>,
    is_key: Vec<bool>,
    poses: BTreeMap<FrameId, Rigid3>,
    /// Of some frames that are still there.
    lines: Vec<ImageLines>,
}

impl Window {
    pub(super) fn new(camera: Camera) -> Self {
        let options = VideoOptions { max_points: MAX_POINTS, ..VideoOptions::background() };
        let front_end = VideoFrontEnd::new(options, camera).only_across_breaks();
        Self { front_end, camera, frames: Vec::new(), is_key: Vec::new(), poses: BTreeMap::new(), lines: Vec::new() }
    }

    /// Takes the next frame.
    pub(super) fn push(&mut self, frame: &Frame, picture: &RgbImage, background: &Mask) -> Result<(), PipelineError> {
        self.front_end.push(frame, &Picture::new(picture), background)?;
        self.frames.push(frame.clone());
        self.is_key.push(false);
        let is_key = self.is_keyframe();
        if let Some(last) = self.is_key.last_mut() {
            *last = is_key;
        }
        self.find_lines(frame, picture);
        self.forget(frame.time_s);
        Ok(())
    }

    /// Keeps straight lines of some of the frames.
    fn find_lines(&mut self, frame: &Frame, picture: &RgbImage) {
        let age_s = |lines: &ImageLines| {
            let of_lines = self.frames.iter().find(|frame| frame.id == lines.image.frame());
            of_lines.map_or(f64::INFINITY, |before| frame.time_s - before.time_s)
        };
        self.lines.retain(|lines| age_s(lines) <= WINDOW_S);
        let is_early = self.lines.last().is_some_and(|lines| age_s(lines) < LINES_S);
        if self.lines.len() < NUM_LINES && !is_early {
            // OpenCV may have been built without the detector.
            self.lines.extend(ImageLines::of(picture, frame.id.into()).ok());
        }
    }

    /// Camera by the last map.
    pub(super) fn camera(&self) -> Camera {
        self.camera
    }

    /// Number of keyframes.
    pub(super) fn num_keys(&self) -> usize {
        self.is_key.iter().filter(|is_key| **is_key).count()
    }

    /// Time that the frames span, seconds.
    pub(super) fn span_s(&self) -> f64 {
        self.frames.first().zip(self.frames.last()).map_or(0.0, |(first, last)| last.time_s - first.time_s)
    }

    /// The window as it is now.
    pub(super) fn snapshot(&self, purpose: Purpose, vehicles: Vec<BTreeMap<FrameId, Rect>>) -> Snapshot {
        let (table, frames, is_key) = (self.front_end.table().clone(), self.frames.clone(), self.is_key.clone());
        let (poses, lines) = (self.poses.clone(), self.lines.clone());
        Snapshot { table, frames, is_key, poses, vehicles, lines, purpose }
    }

    /// Takes the poses of a new map; those of frames that it lacks are kept only if it continues the local frame.
    pub(super) fn take_poses(&mut self, map: &WorldMap) {
        if !map.is_continued {
            self.poses.clear();
        }
        for (id, image) in &map.model.images {
            self.poses.insert(id.frame(), image.cam_from_world);
        }
        self.camera = map.camera;
    }

    /// The last frame as an image of a map; `None` where too few of its points are known.
    pub(super) fn register(&mut self, map: &WorldMap) -> Option<(ImageId, Image)> {
        let view = self.frames.len().checked_sub(1)?;
        let points = known_points(self.front_end.table(), &map.model, &[view]).pop()?;
        let before = self.frames[..view].iter().rev().find_map(|frame| self.poses.get(&frame.id)).copied();
        let table_view = &self.front_end.table().views[view];
        let image = resected(&table_view.pixels, &table_view.name, points, &map.model, &self.camera, before, &LIMITS)?;
        self.poses.insert(self.frames[view].id, image.cam_from_world);
        Some((table_view.image, image))
    }

    fn is_keyframe(&self) -> bool {
        let table = self.front_end.table();
        let now = self.frames.len() - 1;
        let Some(before) = self.is_key.iter().rposition(|is_key| *is_key) else { return true };
        let is_early = self.frames[now].time_s - self.frames[before].time_s < 0.99 * KEY_S;
        if is_early && self.num_keys() >= FIRST_KEYFRAMES {
            return false;
        }
        let pixel = |track: &Track, view: usize| {
            let place = track.binary_search_by_key(&(view as u32), |feature| feature.view).ok()?;
            Some(table.pixel(track[place]))
        };
        let ends_now = |track: &&Track| track.last().is_some_and(|last| last.view as usize == now);
        let shifts =
            table.tracks.iter().filter(ends_now).filter_map(|track| Some(pixel(track, now)? - pixel(track, before)?));
        let shifts: Vec<f64> = shifts.map(|shift| shift.norm()).collect();
        let is_lost = (shifts.len() as f64) < KEY_SHARED * table.views[before].pixels.len() as f64;
        let longer_px = f64::from(self.camera.width.max(self.camera.height));
        is_lost || median(shifts).is_none_or(|shift| shift >= KEY_SHIFT * longer_px)
    }

    /// Drops the views that neither are in the window nor are keyframes of the next map.
    fn forget(&mut self, now_s: f64) {
        let num_keys = self.num_keys();
        let mut keys_left = num_keys;
        let kept: Vec<bool> = self
            .frames
            .iter()
            .zip(&self.is_key)
            .map(|(frame, is_key)| {
                let is_recent_key = *is_key && keys_left <= MAX_KEYFRAMES;
                keys_left -= usize::from(*is_key);
                is_recent_key || now_s - frame.time_s <= WINDOW_S + SPARE_S
            })
            .collect();
        if kept.iter().filter(|kept| !**kept).count() < SPARE_VIEWS {
            return;
        }
        self.front_end.retain_views(|view, _| kept[view]);
        let mut is_kept = kept.iter().copied();
        self.frames.retain(|_| is_kept.next().unwrap_or(false));
        let mut is_kept = kept.iter().copied();
        self.is_key.retain(|_| is_kept.next().unwrap_or(false));
        let first = self.frames.iter().map(|frame| frame.id).collect::<std::collections::BTreeSet<_>>();
        self.poses.retain(|frame, _| first.contains(frame));
    }
}

/// The keyframes of a map among the views of a snapshot.
pub(super) fn keyframes(snapshot: &Snapshot) -> Vec<usize> {
    let keys: Vec<usize> = (0..snapshot.is_key.len()).filter(|&view| snapshot.is_key[view]).collect();
    keys[keys.len().saturating_sub(MAX_KEYFRAMES)..].to_vec()
}

/// The tracks of some views that at least `min_track` of them show.
pub(super) fn sub_table(table: &TrackTable, chosen: &[usize], min_track: usize) -> TrackTable {
    let mut place = vec![None; table.views.len()];
    chosen.iter().enumerate().for_each(|(k, &view)| place[view] = Some(k as u32));
    let of_track = |track: &Track| {
        let kept = track.iter().filter_map(|f| Some(Feature { view: place[f.view as usize]?, feature: f.feature }));
        Some(kept.collect::<Track>()).filter(|track| track.len() >= min_track)
    };
    let views = chosen.iter().map(|&view| table.views[view].clone()).collect();
    TrackTable { views, tracks: table.tracks.iter().filter_map(of_track).collect() }
}

/// For some views of a table the point of a model that each feature shows, by the tracks that both have in common.
pub(super) fn known_points(table: &TrackTable, model: &Reconstruction, views: &[usize]) -> Vec<Vec<Option<Point3dId>>> {
    let images: Vec<Option<&Image>> = table.views.iter().map(|view| model.images.get(&view.image)).collect();
    let mut place = vec![None; table.views.len()];
    views.iter().enumerate().for_each(|(k, &view)| place[view] = Some(k));
    let mut found: Vec<Vec<Option<Point3dId>>> =
        views.iter().map(|&view| vec![None; table.views[view].pixels.len()]).collect();
    for track in &table.tracks {
        let wanted =
            || track.iter().filter_map(|feature| Some((place[feature.view as usize]?, feature.feature as usize)));
        if wanted().next().is_none() {
            continue;
        }
        let mut seen =
            track.iter().filter_map(|f| images[f.view as usize]?.observations.get(f.feature as usize)?.point);
        let Some(point) = seen.next() else { continue };
        wanted().for_each(|(k, feature)| found[k][feature] = Some(point));
    }
    found
}

/// Selects at most a number of views, evenly spaced.
pub(super) fn evenly(views: &[usize], most: usize) -> impl Iterator<Item = usize> {
    views.iter().copied().step_by(views.len().div_ceil(most).max(1))
}

/// Registers in a model the views that it lacks, where there are enough inliers.
pub(super) fn register(
    model: &mut Reconstruction,
    table: &TrackTable,
    views: impl IntoIterator<Item = usize>,
    camera: &Camera,
    limits: &Limits,
) {
    let is_open = |view: &usize| !model.images.contains_key(&table.views[*view].image);
    let views: Vec<usize> = views.into_iter().filter(is_open).collect();
    let points = known_points(table, model, &views);
    for (&view, points) in views.iter().zip(points) {
        let seen = &table.views[view];
        let before = model.images.range(..seen.image).next_back().map(|(_, image)| image.cam_from_world);
        let image = resected(&seen.pixels, &seen.name, points, model, camera, before, limits);
        model.images.extend(image.map(|image| (seen.image, image)));
    }
}

/// An image of a model by resection; `None` where there are too few inliers.
///
/// * `points` – by feature.
/// * `before` – a pose nearby.
pub(super) fn resected(
    pixels: &[Point2<f64>],
    name: &str,
    points: Vec<Option<Point3dId>>,
    model: &Reconstruction,
    camera: &Camera,
    before: Option<Rigid3>,
    limits: &Limits,
) -> Option<Image> {
    let known =
        pixels.iter().zip(&points).filter_map(|(pixel, id)| Some((*pixel, model.points.get(&(*id)?)?.position)));
    let (seen, positions): (Vec<_>, Vec<_>) = known.unzip();
    let data = PixelsAndPoints { camera, pixels: &seen, points: &positions };
    let is_enough = |found: &resection::Resection| {
        let inliers = found.inliers.len();
        inliers >= limits.min_inliers && inliers as f64 >= limits.min_inlier_ratio * seen.len() as f64
    };
    let near = before.and_then(|pose| resection::refine_from(&data, &pose, limits.max_error_px)).filter(is_enough);
    let found =
        near.or_else(|| resection::estimate(&data, limits.max_error_px, &mut seeded_rng(0, 0)).filter(is_enough))?;
    let observations = pixels.iter().zip(points).map(|(&pixel, point)| Observation { pixel, point }).collect();
    Some(Image { name: name.to_owned(), camera: CameraId(1), cam_from_world: found.cam_from_world, observations })
}
