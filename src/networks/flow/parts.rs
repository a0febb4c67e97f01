//! Regions of a frame in which flow is needed: boxes with a margin.

use ::image::GrayImage;
use ::image::imageops::crop_imm;

use super::Field;
use crate::scene::{BoundingBox, Flow, Rect};

/// Margin around a box, in its longer sides: for its own motion, and for objects that may occlude it.
const ROOM: f64 = 0.5;
/// Minimum side of a region, pixels: smaller ones show no motion.
const MIN_SIDE: u32 = 8;

/// A box with a margin, and its predicted displacement to the next frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Part {
    /// Region in the first frame.
    pub(super) bounds: BoundingBox,
    /// Displacement from there to the next frame, pixels.
    pub(super) shift: [i32; 2],
}

impl Part {
    /// Region of a box whose pixels move by about `shift`; `None` where it is not visible in both frames.
    pub(super) fn of(rect: &Rect, shift: [i32; 2], (width, height): (u32, u32)) -> Option<Self> {
        let room = ROOM * rect.width().max(rect.height());
        let side = |from: f64, to: f64, shift: i32, limit: u32| {
            let (least, most) = (f64::from((-shift).max(0)), f64::from(limit) - f64::from(shift.max(0)));
            let from = (from - room).floor().max(least);
            let to = (to + room).ceil().min(most);
            (to - from >= f64::from(MIN_SIDE)).then_some((from as u32, to as u32))
        };
        let (x0, x1) = side(rect.x0, rect.x1, shift[0], width)?;
        let (y0, y1) = side(rect.y0, rect.y1, shift[1], height)?;
        Some(Self { bounds: BoundingBox { x0, y0, x1, y1 }, shift })
    }

    /// Crop of the first frame.
    pub(super) fn cut(&self, from: &GrayImage) -> GrayImage {
        let BoundingBox { x0, y0, .. } = self.bounds;
        crop_imm(from, x0, y0, self.bounds.width(), self.bounds.height()).to_image()
    }

    /// Crop of the next frame, displaced by the shift.
    pub(super) fn cut_shifted(&self, to: &GrayImage) -> GrayImage {
        let moved = |at: u32, by: i32| (i64::from(at) + i64::from(by)) as u32;
        let (x, y) = (moved(self.bounds.x0, self.shift[0]), moved(self.bounds.y0, self.shift[1]));
        crop_imm(to, x, y, self.bounds.width(), self.bounds.height()).to_image()
    }
}

/// Flow of a region relative to its shift, at any resolution.
pub(super) struct PartFlow {
    pub(super) part: Part,
    pub(super) forward: Field,
    pub(super) consistent: Vec<bool>,
}

impl PartFlow {
    /// Writes the flow of an area into that of the frame, as far as the region covers it.
    pub(super) fn put(&self, flow: &mut Flow, area: &BoundingBox) {
        let (Self { part: Part { bounds, shift }, forward, consistent }, width) = (self, flow.width as usize);
        let per_x = forward.width as f32 / bounds.width() as f32;
        let per_y = forward.height as f32 / bounds.height() as f32;
        for y in bounds.y0.max(area.y0)..bounds.y1.min(area.y1) {
            let v = ((y - bounds.y0) as f32 + 0.5) * per_y;
            let row = (v as usize).min(forward.height - 1) * forward.width;
            for x in bounds.x0.max(area.x0)..bounds.x1.min(area.x1) {
                let u = ((x - bounds.x0) as f32 + 0.5) * per_x;
                let [dx, dy] = forward.sample(u, v);
                let at = y as usize * width + x as usize;
                flow.displacement[at] = [dx / per_x + shift[0] as f32, dy / per_y + shift[1] as f32];
                flow.consistent[at] = consistent[row + (u as usize).min(forward.width - 1)];
            }
        }
    }
}

/// A flow of the frame's size in which nothing is consistent.
pub(super) fn nothing((width, height): (u32, u32)) -> Flow {
    let size = width as usize * height as usize;
    Flow { width, height, displacement: vec![[0.0; 2]; size], consistent: vec![false; size] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_in_both_frames() {
        let of = |x0: f64, shift| Part::of(&Rect { x0, y0: 40.0, x1: x0 + 40.0, y1: 60.0 }, shift, (200, 100));
        let bounds = |x0, y0, x1, y1| BoundingBox { x0, y0, x1, y1 };
        assert_eq!(of(100.0, [0, 0]).unwrap().bounds, bounds(80, 20, 160, 80));
        assert_eq!(of(100.0, [50, -30]).unwrap().bounds, bounds(80, 30, 150, 80));
        assert_eq!(of(10.0, [-20, 30]).unwrap().bounds, bounds(20, 20, 70, 70));
        assert!(of(100.0, [120, 0]).is_none() && of(230.0, [0, 0]).is_none());
        let frame = GrayImage::from_fn(200, 100, |x, _| ::image::Luma([x as u8]));
        let part = of(100.0, [50, -30]).unwrap();
        assert_eq!((part.cut(&frame).get_pixel(0, 0).0, part.cut_shifted(&frame).get_pixel(0, 0).0), ([80], [130]));
    }

    #[test]
    fn a_part_lies_in_its_place_and_elsewhere_is_nothing() {
        let part = Part { bounds: BoundingBox { x0: 2, y0: 1, x1: 6, y1: 3 }, shift: [3, 0] };
        let forward = Field { width: 2, height: 1, dx: vec![1.0, 2.0], dy: vec![-0.5, -0.5] };
        let mut flow = nothing((8, 4));
        let found = PartFlow { part, forward, consistent: vec![true, false] };
        found.put(&mut flow, &BoundingBox { x0: 0, y0: 0, x1: 8, y1: 4 });
        assert_eq!((flow.at(2, 1), flow.at(5, 2)), ([5.0, -1.0], [7.0, -1.0]));
        let expected = |x: u32, y: u32| (2..4).contains(&x) && (1..3).contains(&y);
        assert!((0..32).all(|i| flow.is_consistent(i % 8, i / 8) == expected(i % 8, i / 8)));
        let mut row = nothing((8, 4));
        found.put(&mut row, &BoundingBox { x0: 0, y0: 1, x1: 3, y1: 2 });
        assert_eq!((row.at(2, 1), row.at(3, 1), row.at(2, 2)), ([5.0, -1.0], [0.0, 0.0], [0.0, 0.0]));
    }
}
