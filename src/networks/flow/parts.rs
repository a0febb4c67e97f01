//! The parts of a frame in which flow is needed: boxes with room round them.

use ::image::RgbImage;
use ::image::imageops::crop_imm;

use super::Field;
use crate::scene::{BoundingBox, Flow, Rect};

/// Room round a box, in its longer sides: for its own motion, for the background next to it, and for what may come
/// before it.
const ROOM: f64 = 0.5;
/// Besides, in longer sides of the frame: flow is found from coarse to fine, and a small part has no coarse.
const MORE_ROOM: f64 = 0.05;
/// Parts that cover more than this share of the frame cost as much as all of it.
const MOST: f64 = 0.8;

/// Boxes with room round them, joined until none overlap; the whole frame where they cover most of it. Ascending by
/// their place, and none where there are no boxes.
pub(super) fn parts(boxes: &[Rect], (width, height): (u32, u32)) -> Vec<BoundingBox> {
    let more_px = MORE_ROOM * f64::from(width.max(height));
    let with_room = |rect: &Rect| {
        let room = ROOM * rect.width().max(rect.height()) + more_px;
        let bound = |value: f64, limit: u32| value.clamp(0.0, f64::from(limit)) as u32;
        let (x0, y0) = (bound((rect.x0 - room).floor(), width), bound((rect.y0 - room).floor(), height));
        let (x1, y1) = (bound((rect.x1 + room).ceil(), width), bound((rect.y1 + room).ceil(), height));
        (x0 < x1 && y0 < y1).then_some(BoundingBox { x0, y0, x1, y1 })
    };
    let mut parts: Vec<BoundingBox> = Vec::new();
    for part in boxes.iter().filter_map(with_room) {
        add(&mut parts, part);
    }
    let area = |part: &BoundingBox| f64::from(part.width()) * f64::from(part.height());
    if parts.iter().map(area).sum::<f64>() > MOST * f64::from(width) * f64::from(height) {
        return vec![BoundingBox { x0: 0, y0: 0, x1: width, y1: height }];
    }
    parts.sort_by_key(|part| (part.y0, part.x0));
    parts
}

/// Adds a part, joined with those that it overlaps.
fn add(parts: &mut Vec<BoundingBox>, mut part: BoundingBox) {
    while let Some(k) = parts.iter().position(|p| p.x0 < part.x1 && part.x0 < p.x1 && p.y0 < part.y1 && part.y0 < p.y1)
    {
        let other = parts.swap_remove(k);
        part = BoundingBox {
            x0: part.x0.min(other.x0),
            y0: part.y0.min(other.y0),
            x1: part.x1.max(other.x1),
            y1: part.y1.max(other.y1),
        };
    }
    parts.push(part);
}

/// The pixels of a part.
pub(super) fn crop(image: &RgbImage, part: BoundingBox) -> RgbImage {
    crop_imm(image, part.x0, part.y0, part.width(), part.height()).to_image()
}

/// A flow of the frame's size in which nothing is consistent.
pub(super) fn nothing((width, height): (u32, u32)) -> Flow {
    let size = width as usize * height as usize;
    Flow { width, height, displacement: vec![[0.0; 2]; size], consistent: vec![false; size] }
}

/// Puts an estimate of a part, of whatever size, into the flow of the frame.
pub(super) fn put(flow: &mut Flow, part: BoundingBox, forward: &Field, consistent: &[bool]) {
    let size = [part.width(), part.height()];
    let is_same = [forward.width, forward.height] == size.map(|side| side as usize);
    let per_x = forward.width as f32 / size[0] as f32;
    let per_y = forward.height as f32 / size[1] as f32;
    for y in 0..size[1] {
        let v = (y as f32 + 0.5) * per_y;
        let row = (v as usize).min(forward.height - 1) * forward.width;
        let start = (part.y0 + y) as usize * flow.width as usize + part.x0 as usize;
        for x in 0..size[0] {
            let u = (x as f32 + 0.5) * per_x;
            let cell = row + (u as usize).min(forward.width - 1);
            let [dx, dy] = if is_same { [forward.dx[cell], forward.dy[cell]] } else { forward.sample(u, v) };
            flow.displacement[start + x as usize] = [dx / per_x, dy / per_y];
            flow.consistent[start + x as usize] = consistent[cell];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rect(x0: f64, y0: f64, width: f64, height: f64) -> Rect {
        Rect { x0, y0, x1: x0 + width, y1: y0 + height }
    }

    #[test]
    fn boxes_get_room_and_near_ones_are_one_part() {
        let found = parts(&[rect(100.0, 100.0, 40.0, 20.0), rect(600.0, 300.0, 40.0, 20.0)], (1000, 500));
        let expected = [[30, 30, 210, 190], [530, 230, 710, 390]];
        assert_eq!(found.iter().map(|b| [b.x0, b.y0, b.x1, b.y1]).collect::<Vec<_>>(), expected);
        let found = parts(&[rect(100.0, 100.0, 40.0, 20.0), rect(220.0, 110.0, 40.0, 20.0)], (1000, 500));
        assert_eq!(found, [BoundingBox { x0: 30, y0: 30, x1: 330, y1: 200 }]);
        assert!(parts(&[], (1000, 500)).is_empty() && parts(&[rect(2000.0, 0.0, 9.0, 9.0)], (1000, 500)).is_empty());
    }

    #[test]
    fn a_part_that_joins_two_others_is_one_with_both() {
        let boxes = [rect(100.0, 100.0, 10.0, 10.0), rect(400.0, 100.0, 10.0, 10.0), rect(250.0, 100.0, 90.0, 10.0)];
        assert_eq!(parts(&boxes, (1000, 500)), [BoundingBox { x0: 45, y0: 5, x1: 465, y1: 205 }]);
    }

    #[test]
    fn most_of_the_frame_is_all_of_it() {
        let whole = BoundingBox { x0: 0, y0: 0, x1: 100, y1: 50 };
        assert_eq!(parts(&[rect(10.0, 5.0, 60.0, 40.0)], (100, 50)), [whole]);
    }

    #[test]
    fn a_part_lies_in_its_place_and_elsewhere_is_nothing() {
        let (part, width, height) = (BoundingBox { x0: 2, y0: 1, x1: 6, y1: 3 }, 2, 1);
        let field = Field { width, height, dx: vec![1.0, 2.0], dy: vec![-0.5, -0.5] };
        let mut flow = nothing((8, 4));
        put(&mut flow, part, &field, &[true, false]);
        assert_eq!((flow.at(2, 1), flow.is_consistent(2, 1)), ([2.0, -1.0], true));
        assert_eq!((flow.at(5, 2), flow.is_consistent(5, 2)), ([4.0, -1.0], false));
        assert!(!flow.is_consistent(1, 1) && !flow.is_consistent(2, 0) && flow.at(6, 1) == [0.0, 0.0]);
    }
}
