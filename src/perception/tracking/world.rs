//! A flat world for tests: coloured boxes slide over a background, with exact masks and exact flow.

use ::image::{Rgb, RgbImage};

use super::{TrackSummary, TrackedMask, Tracker, TrackerOptions};
use crate::scene::{Detection, Flow, Frame, FrameId, Mask};

pub(super) const WIDTH: u32 = 200;
pub(super) const HEIGHT: u32 = 80;
pub(super) const FPS: f64 = 10.0;

/// A box; later ones in the list hide earlier ones.
pub(super) struct Thing {
    /// Upper left corner at a frame.
    pub(super) at: Box<dyn Fn(usize) -> (i64, i64)>,
    pub(super) size: (i64, i64),
    pub(super) colour: [u8; 3],
    /// Class under which it is detected; `None` for what only hides others.
    pub(super) class: Option<&'static str>,
}

impl Thing {
    pub(super) fn car(colour: [u8; 3], at: impl Fn(usize) -> (i64, i64) + 'static) -> Self {
        Self { at: Box::new(at), size: (24, 14), colour, class: Some("car") }
    }

    pub(super) fn wall(x: i64, width: i64) -> Self {
        Self { at: Box::new(move |_| (x, 0)), size: (width, i64::from(HEIGHT)), colour: [90, 90, 90], class: None }
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

    /// The thing that a pixel shows.
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
            Rgb(self.front(t, x, y).map_or([40, 120, 50], |i| self.things[i].colour))
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

    /// Exact flow from frame t - 1 to t; what is hidden or out of the frame at t is inconsistent.
    pub(super) fn flow(&self, t: usize) -> Flow {
        let shift = |i: Option<usize>| match i {
            Some(i) => {
                let (a, b) = ((self.things[i].at)(t - 1), (self.things[i].at)(t));
                (b.0 - a.0, b.1 - a.1)
            }
            None => self.pan,
        };
        let mut flow = Flow { width: WIDTH, height: HEIGHT, displacement: Vec::new(), consistent: Vec::new() };
        for (x, y) in (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y))) {
            let front = self.front(t - 1, x, y);
            let (dx, dy) = shift(front);
            let (u, v) = (i64::from(x) + dx, i64::from(y) + dy);
            let inside = (0..i64::from(WIDTH)).contains(&u) && (0..i64::from(HEIGHT)).contains(&v);
            flow.displacement.push([dx as f32, dy as f32]);
            flow.consistent.push(inside && self.front(t, u as u32, v as u32) == front);
        }
        flow
    }

    /// Tracks frames 0 to `num_frames`; `seen` may change the detections of a frame.
    pub(super) fn track(
        &self,
        num_frames: usize,
        seen: impl Fn(usize, Vec<Detection>) -> Vec<Detection>,
    ) -> (Vec<Vec<TrackedMask>>, Vec<TrackSummary>) {
        let mut tracker = Tracker::new(TrackerOptions::default());
        let mut frames = Vec::new();
        for t in 0..num_frames {
            let flow = (t > 0).then(|| self.flow(t));
            let detections = seen(t, self.detections(t));
            frames.push(tracker.advance(&Self::frame(t), &self.image(t), detections, flow.as_ref()).unwrap());
        }
        (frames, tracker.finish())
    }
}
