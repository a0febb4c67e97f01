//! Linking of regions in successive frames to objects.

use std::collections::BTreeMap;

use nalgebra::{Point2, Point3, Vector3};

use super::{ComparedFrame, MovingObject};
use crate::math::upper_median;
use crate::motion::{Surroundings, View};
use crate::scene::Rect;

/// Maximum number of successive frames without a detection before a track is lost.
const MAX_MISSED: usize = 2;
/// Maximum distance between a region and the predicted position, in lengths of the object: in a fifth of a second at
/// 15 m/s a car drives 0.7 of its length.
const MAX_STEP: f64 = 1.5;
/// Maximum ratio of the areas of two regions of one object in successive frames.
const MAX_AREA_RATIO: f64 = 2.5;
/// Minimum number of detections of an object: those of one second.
const MIN_DETECTIONS: usize = 5;
/// Minimum share of the frames from first to last with a detection: edges of houses flicker.
const MIN_SEEN: f64 = 0.7;
/// Minimum displacement as a share of the path length: swaying objects return.
const MIN_STRAIGHTNESS: f64 = 0.7;
/// Minimum displacement of an object, in lengths of its own.
const MIN_DISPLACEMENT: f64 = 0.7;

/// Confidence after a displacement by d lengths: 1 - exp(-d times this), so that one length starts a track.
const CERTAINTY: f64 = 2.0;

/// Region of differences in one frame.
#[derive(Clone, Copy, Debug)]
struct RegionDetection {
    index: u32,
    /// Number among the compared frames.
    frame: usize,
    time_s: f64,
    /// Direction of its center in the world, a unit vector.
    direction: Vector3<f64>,
    /// Sides as angles, radians.
    sides: [f64; 2],
}

impl RegionDetection {
    fn new(number: usize, frame: &ComparedFrame, rect: &Rect) -> Self {
        let middle = Point2::from(rect.center());
        let ray = frame.view.cam_from_world.rotation.inverse() * frame.view.camera.ray_from_pixel(middle);
        let sides = [rect.width(), rect.height()].map(|side| side / frame.view.camera.mean_focal());
        Self { index: frame.index, frame: number, time_s: frame.time_s, direction: ray.normalize(), sides }
    }

    fn length(&self) -> f64 {
        self.sides[0].max(self.sides[1])
    }

    fn area(&self) -> f64 {
        self.sides[0] * self.sides[1]
    }

    /// Box in a view; `None` behind the camera.
    fn rect(&self, view: &View) -> Option<Rect> {
        let middle = view.camera.pixel_from_cam(Point3::from(view.cam_from_world.rotation * self.direction))?;
        let [dx, dy] = self.sides.map(|side| 0.5 * side * view.camera.mean_focal());
        Some(Rect { x0: middle.x - dx, y0: middle.y - dy, x1: middle.x + dx, y1: middle.y + dy })
    }

    /// Linear interpolation between two detections.
    fn between(&self, other: &Self, time_s: f64) -> Self {
        let share = (time_s - self.time_s) / (other.time_s - self.time_s);
        let mixed = |a: f64, b: f64| a + share * (b - a);
        Self {
            direction: (self.direction + (other.direction - self.direction) * share).normalize(),
            sides: [0, 1].map(|side| mixed(self.sides[side], other.sides[side])),
            time_s,
            ..*self
        }
    }
}

/// Track of regions in successive frames.
#[derive(Clone, Debug)]
struct RegionTrack {
    detections: Vec<RegionDetection>,
    num_missed: usize,
}

impl RegionTrack {
    fn last(&self) -> &RegionDetection {
        &self.detections[self.detections.len() - 1]
    }

    /// Predicted direction at a time, by constant angular velocity.
    fn predicted(&self, time_s: f64) -> Vector3<f64> {
        let last = self.last();
        let [.., before, _] = self.detections.as_slice() else { return last.direction };
        let velocity = (last.direction - before.direction) / (last.time_s - before.time_s);
        last.direction + velocity * (time_s - last.time_s)
    }

    /// Distance of a region in lengths of the object; `None` if it cannot be the same object.
    fn distance(&self, detection: &RegionDetection) -> Option<f64> {
        let last = self.last();
        let ratio = detection.area() / last.area();
        let length = last.length().max(detection.length());
        let nearest =
            [self.predicted(detection.time_s), last.direction].map(|at| (detection.direction - at).norm() / length);
        let distance = nearest[0].min(nearest[1]);
        ((MAX_AREA_RATIO.recip()..=MAX_AREA_RATIO).contains(&ratio) && distance <= MAX_STEP).then_some(distance)
    }

    /// Object with interpolated boxes, if it passes the tests of its displacement and detections.
    fn object(&self, surroundings: &Surroundings) -> Option<MovingObject> {
        let (first, last) = (self.detections.first()?, self.detections.last()?);
        let length = upper_median(self.detections.iter().map(RegionDetection::length).collect())?;
        let path_length: f64 =
            self.detections.windows(2).map(|pair| (pair[1].direction - pair[0].direction).norm()).sum();
        let displacement = (last.direction - first.direction).norm();
        let seen = self.detections.len() as f64 / (1 + last.frame - first.frame) as f64;
        let is_displaced = displacement >= MIN_DISPLACEMENT * length && displacement >= MIN_STRAIGHTNESS * path_length;
        let is_object = self.detections.len() >= MIN_DETECTIONS && seen >= MIN_SEEN && is_displaced;
        tracing::trace!(
            first = first.index,
            last = last.index,
            num_detections = self.detections.len(),
            seen,
            displacement = displacement / length,
            path_length = path_length / length,
            is_object,
            "difference"
        );
        if !is_object {
            return None;
        }
        let mut boxes = BTreeMap::new();
        for pair in self.detections.windows(2) {
            for index in pair[0].index..=pair[1].index {
                let detection = pair[0].between(&pair[1], surroundings.times_s[index as usize]);
                boxes.extend(surroundings.view(index).and_then(|view| Some((index, detection.rect(view)?))));
            }
        }
        Some(MovingObject { boxes, confidence: 1.0 - (-CERTAINTY * displacement / length).exp() })
    }
}

/// Links regions from frame to frame.
#[derive(Default)]
pub(super) struct Linker {
    num_frames: usize,
    live: Vec<RegionTrack>,
    ended: Vec<RegionTrack>,
}

impl Linker {
    /// Links the regions of the next frame, pixels of its view.
    pub(super) fn push(&mut self, frame: &ComparedFrame, regions: &[Rect]) {
        let detections: Vec<RegionDetection> =
            regions.iter().map(|rect| RegionDetection::new(self.num_frames, frame, rect)).collect();
        self.num_frames += 1;
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (k, track) in self.live.iter().enumerate() {
            let near =
                detections.iter().enumerate().filter_map(|(s, detection)| Some((track.distance(detection)?, k, s)));
            pairs.extend(near);
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let (mut is_found, mut is_used) = (vec![false; self.live.len()], vec![false; detections.len()]);
        for (_, k, s) in pairs {
            if !is_found[k] && !is_used[s] {
                (is_found[k], is_used[s]) = (true, true);
                self.live[k].detections.push(detections[s]);
                self.live[k].num_missed = 0;
            }
        }
        for (track, is_found) in self.live.iter_mut().zip(is_found) {
            track.num_missed += usize::from(!is_found);
        }
        let ended = self.live.extract_if(.., |track| track.num_missed > MAX_MISSED);
        self.ended.extend(ended.filter(|track| track.detections.len() >= MIN_DETECTIONS));
        let new = detections.iter().zip(is_used).filter(|(_, is_used)| !is_used);
        self.live.extend(new.map(|(detection, _)| RegionTrack { detections: vec![*detection], num_missed: 0 }));
    }

    /// Returns all objects, in the order of their first frames.
    pub(super) fn finish(mut self, surroundings: &Surroundings) -> Vec<MovingObject> {
        self.ended.append(&mut self.live);
        self.ended.sort_by_key(|track| track.detections[0].index);
        self.ended.iter().filter_map(|track| track.object(surroundings)).collect()
    }
}
