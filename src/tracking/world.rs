//! Synthetic 2D scene for tests: colored boxes over a background, with exact masks and flow.

use std::collections::BTreeMap;

use ::image::{Rgb, RgbImage};

use super::{BackwardTracker, BoxSource, DetectedBox, FrameInput, TrackSummary, TrackedMask, Tracker, TrackerOptions};
use crate::networks::{BoxMask, BoxSegmenter, KnownMasks, PerceptionError};
use crate::scene::{BoxDetection, Detection, DetectionSource, Flow, Frame, FrameId, Mask, ObjectId, Rect};

pub(super) const WIDTH: u32 = 200;
pub(super) const HEIGHT: u32 = 80;
pub(super) const FPS: f64 = 10.0;

/// A box; later ones in the list occlude earlier ones.
pub(super) struct Thing {
    /// Upper left corner in a frame.
    pub(super) at: Box<dyn Fn(usize) -> (i64, i64)>,
    pub(super) size: (i64, i64),
    pub(super) color: [u8; 3],
    /// Class under which it is detected; `None` for an occluder.
    pub(super) class: Option<&'static str>,
}

impl Thing {
    pub(super) fn car(color: [u8; 3], at: impl Fn(usize) -> (i64, i64) + 'static) -> Self {
        Self { at: Box::new(at), size: (24, 14), color, class: Some("car") }
    }

    pub(super) fn wall(x: i64, width: i64) -> Self {
        Self { at: Box::new(move |_| (x, 0)), size: (width, i64::from(HEIGHT)), color: [90, 90, 90], class: None }
    }

    fn covers(&self, t: usize, x: u32, y: u32) -> bool {
        let (left, top) = (self.at)(t);
        let (dx, dy) = (i64::from(x) - left, i64::from(y) - top);
        (0..self.size.0).contains(&dx) && (0..self.size.1).contains(&dy)
    }
}

/// Things over a background that moves by `pan` pixels a frame.
pub(super) struct World {
    pub(super) things: Vec<Thing>,
    pub(super) pan: (i64, i64),
}

impl World {
    pub(super) fn still(things: Vec<Thing>) -> Self {
        Self { things, pan: (0, 0) }
    }

    /// Index of the thing that a pixel shows.
    fn front(&self, t: usize, x: u32, y: u32) -> Option<usize> {
        (0..self.things.len()).rev().find(|&i| self.things[i].covers(t, x, y))
    }

    /// The visible pixels of a thing.
    pub(super) fn mask(&self, t: usize, thing: usize) -> Mask {
        Mask::from_fn(WIDTH, HEIGHT, |x, y| self.front(t, x, y) == Some(thing))
    }

    pub(super) fn frame(t: usize) -> Frame {
        Frame { id: FrameId(t as u32), name: format!("{t:06}.jpg"), time_s: t as f64 / FPS }
    }

    pub(super) fn image(&self, t: usize) -> RgbImage {
        RgbImage::from_fn(WIDTH, HEIGHT, |x, y| {
            Rgb(self.front(t, x, y).map_or([40, 120, 50], |i| self.things[i].color))
        })
    }

    /// Every detectable thing of which at least a third of the full size is visible.
    pub(super) fn detections(&self, t: usize) -> Vec<Detection> {
        let detect = |i: usize| {
            let (thing, mask) = (&self.things[i], self.mask(t, i));
            let visible = mask.area_px2() as f64 / (thing.size.0 * thing.size.1) as f64;
            let class = thing.class.filter(|_| visible > 0.34)?.to_owned();
            Some(Detection { class, confidence: 0.5 + 0.4 * visible, mask })
        };
        (0..self.things.len()).filter_map(detect).collect()
    }

    /// Exact flow from frame t - 1 to t; pixels that are occluded or outside the frame at t are inconsistent.
    pub(super) fn flow(&self, t: usize) -> Flow {
        self.flow_between(t - 1, t)
    }

    /// Exact flow between neighboring frames.
    pub(super) fn flow_between(&self, from: usize, to: usize) -> Flow {
        let shift = |i: Option<usize>| match i {
            Some(i) => {
                let (a, b) = ((self.things[i].at)(from), (self.things[i].at)(to));
                (b.0 - a.0, b.1 - a.1)
            }
            None if to > from => self.pan,
            None => (-self.pan.0, -self.pan.1),
        };
        let mut flow = Flow { width: WIDTH, height: HEIGHT, displacement: Vec::new(), consistent: Vec::new() };
        for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
            let front = self.front(from, x, y);
            let (dx, dy) = shift(front);
            let (u, v) = (i64::from(x) + dx, i64::from(y) + dy);
            let inside = (0..i64::from(WIDTH)).contains(&u) && (0..i64::from(HEIGHT)).contains(&v);
            flow.displacement.push([dx as f32, dy as f32]);
            flow.consistent.push(inside && self.front(to, u as u32, v as u32) == front);
        }
        flow
    }

    /// Tracks frames 0 to `num_frames`; `alter` may change the detections of a frame.
    pub(super) fn track(
        &self,
        num_frames: usize,
        alter: impl Fn(usize, Vec<Detection>) -> Vec<Detection>,
    ) -> (Vec<Vec<TrackedMask>>, Vec<TrackSummary>) {
        let mut tracker = Tracker::new(TrackerOptions::default());
        let mut frames = Vec::new();
        for t in 0..num_frames {
            let flow = (t > 0).then(|| self.flow(t));
            let detections = alter(t, self.detections(t));
            let (found, mut known) = (DetectedBox::of_masks(&detections), KnownMasks::new(detections));
            let input = FrameInput { found, by: BoxSource::Detector, segmenter: Some(&mut known) };
            frames.push(tracker.advance(&Self::frame(t), &self.image(t), input, flow.as_ref()).unwrap());
        }
        (frames, tracker.finish())
    }
}

/// Returns the mask of the thing that best fills a box; in an empty box, the box itself as a poor mask.
pub(super) struct WorldSegmenter<'a> {
    pub(super) world: &'a World,
    pub(super) t: usize,
    /// Number of box prompts so far.
    pub(super) num_prompts: usize,
    /// Changes an answer.
    pub(super) spoil: &'a dyn Fn(usize, BoxMask) -> Option<BoxMask>,
}

impl BoxSegmenter for WorldSegmenter<'_> {
    fn masks(&mut self, _: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError> {
        self.num_prompts += boxes.len();
        Ok(boxes.iter().map(|rect| (self.spoil)(self.t, self.answer(rect))).collect())
    }

    fn is_coarse(&self) -> bool {
        false
    }
}

impl WorldSegmenter<'_> {
    fn answer(&self, rect: &Rect) -> BoxMask {
        let masks = (0..self.world.things.len()).map(|thing| self.world.mask(self.t, thing));
        let overlap = |mask: &Mask| mask.bounding_box().map_or(0.0, |b| Rect::from(b).iou(rect));
        let best = masks.max_by(|a, b| overlap(a).total_cmp(&overlap(b))).filter(|mask| overlap(mask) > 0.4);
        let filled = || Mask::from_fn(WIDTH, HEIGHT, |x, y| rect.contains(f64::from(x) + 0.5, f64::from(y) + 0.5));
        best.map_or_else(|| BoxMask { mask: filled(), quality: 0.5 }, |mask| BoxMask { mask, quality: 0.9 })
    }
}

/// Boxes without evidence from points.
pub(super) fn found_boxes(boxes: Vec<BoxDetection>) -> Vec<DetectedBox> {
    boxes.into_iter().map(DetectedBox::from).collect()
}

pub(super) fn box_of(detection: &Detection, finder: DetectionSource) -> Option<BoxDetection> {
    let rect = Rect::from(detection.mask.bounding_box()?);
    let class = if finder == DetectionSource::Motion { "vehicle".to_owned() } else { detection.class.clone() };
    Some(BoxDetection { class, confidence: detection.confidence, rect, finder })
}

impl World {
    /// Boxes of all detectable things.
    pub(super) fn boxes(&self, t: usize, finder: DetectionSource) -> Vec<BoxDetection> {
        self.detections(t).iter().filter_map(|detection| box_of(detection, finder)).collect()
    }

    /// Tracks frames 0 to `num_frames` by boxes, with segmentation in every `every`-th frame.
    pub(super) fn track_boxes(
        &self,
        num_frames: usize,
        every: usize,
        boxes: impl Fn(usize) -> Vec<BoxDetection>,
        spoil: &dyn Fn(usize, BoxMask) -> Option<BoxMask>,
    ) -> (Vec<Vec<TrackedMask>>, Vec<TrackSummary>) {
        let mut tracker = Tracker::new(TrackerOptions::default());
        let mut frames = Vec::new();
        for t in 0..num_frames {
            let flow = (t > 0).then(|| self.flow(t));
            let mut segmenter = WorldSegmenter { world: self, t, num_prompts: 0, spoil };
            let segmenter = t.is_multiple_of(every).then_some(&mut segmenter as &mut dyn BoxSegmenter);
            let input = FrameInput { found: found_boxes(boxes(t)), by: BoxSource::Detector, segmenter };
            frames.push(tracker.advance(&Self::frame(t), &self.image(t), input, flow.as_ref()).unwrap());
        }
        (frames, tracker.finish())
    }

    /// Tracks objects backward from the last frame to the first.
    ///
    /// Reliable masks are added to those of the frames, under final ids.
    pub(super) fn extend_back(
        &self,
        frames: &mut [Vec<TrackedMask>],
        tracks: &[TrackSummary],
        every: usize,
        spoil: &dyn Fn(usize, BoxMask) -> Option<BoxMask>,
    ) -> BTreeMap<ObjectId, FrameId> {
        let with_final_id = |m: TrackedMask, t: usize| {
            let track = tracks.iter().find(|track| track.provisional == m.object)?;
            (track.first.0..=track.last.0).contains(&(t as u32)).then_some(TrackedMask { object: track.id, ..m })
        };
        let mut tracker = BackwardTracker::new(TrackerOptions::default(), tracks);
        for t in (0..frames.len()).rev() {
            frames[t] = std::mem::take(&mut frames[t]).into_iter().filter_map(|m| with_final_id(m, t)).collect();
            let known: Vec<(ObjectId, Mask)> = frames[t].iter().map(|m| (m.object, m.mask.clone())).collect();
            let flow = (t + 1 < frames.len()).then(|| self.flow_between(t + 1, t));
            let mut segmenter = WorldSegmenter { world: self, t, num_prompts: 0, spoil };
            let segmenter = t.is_multiple_of(every).then_some(&mut segmenter as &mut dyn BoxSegmenter);
            let earlier = tracker.advance(&Self::frame(t), &self.image(t), &known, segmenter, flow.as_ref()).unwrap();
            frames[t].extend(earlier);
        }
        let firsts = tracker.finish();
        for (t, masks) in frames.iter_mut().enumerate() {
            masks.retain(|m| firsts.get(&m.object).is_none_or(|first| first.0 as usize <= t));
        }
        firsts
    }
}
