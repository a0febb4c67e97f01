//! Occluders of an object: the pixels of its outline that show something else.
//!
//! A mask that is carried as a whole would lie on the occluder. An occluder is recognized by its own motion: pixels
//! from outside the mask, or from what is known to lie before it, whose flow is consistent and not the object's, and
//! which land on it. What lies behind the object does not: its flow has no way back. Dense flow lets smooth paint move
//! as the road next to it, so that the pictures must agree: a pixel of the object shows an occluder only if the
//! occluder's pixel explains its colours, and the object's own does not.

use ::image::RgbImage;

use super::affine::{Affine, length};
use super::region::Region;
use crate::scene::{BoundingBox, Flow, Mask};

/// The picture before a frame and that of the frame.
#[derive(Clone, Copy)]
pub(super) struct Pictures<'a> {
    pub(super) before: &'a RgbImage,
    pub(super) now: &'a RgbImage,
}

/// Flow that differs from the object's by less than this may be the object's, pixels.
const MIN_DIFFERENCE_PX: f64 = 1.5;
/// Mean difference of colours that the object's own pixel leaves where it is covered, grey levels.
const MIN_CONTRAST: f64 = 12.0;
/// Margin by which the occluder's pixel must explain the colors better.
const BETTER: f64 = 0.5;
/// Pixels round an object in which occluders are looked for, besides half its size.
const REACH_PX: u32 = 48;
/// Bounds of half the minimum width of an occluder, pixels: a narrower strip is the rim, where outlines and flow are
/// uncertain.
const MIN_RADIUS_PX: (f64, f64) = (2.0, 6.0);
/// Half the minimum width of an occluder within these bounds, as a share of the object's side.
const MIN_RADIUS: f64 = 0.025;
/// Minimum share of the outline that an occluder covers.
const MIN_SHARE: f64 = 0.03;

/// Occluded pixels of an object's outline in a frame.
#[derive(Clone, Debug, Default)]
pub(super) struct Cover {
    /// Pixels that show an occluder; `None` if there are none.
    pub(super) region: Option<Region>,
    /// Such that are too narrow a strip to be sure; if one comes before the object they become more.
    pub(super) suspect: Option<Region>,
}

/// An object that was carried into a frame.
pub(super) struct Moved<'a> {
    /// Its visible pixels in the frame before.
    pub(super) before: &'a Region,
    /// The same, carried.
    pub(super) visible: &'a Region,
    /// All of its outline, carried.
    pub(super) whole: &'a Region,
    /// Motion.
    pub(super) motion: &'a Affine,
}

impl Cover {
    /// Occluded pixels of an object in the next frame.
    ///
    /// * `self` – the same in the frame before.
    pub(super) fn advance(&self, object: &Moved<'_>, flow: &Flow, pictures: Pictures<'_>) -> Self {
        let bounds = object.whole.bounds();
        let mut marks = Mask::empty(bounds.width(), bounds.height());
        for (x, y) in window(bounds, flow) {
            if self.may_show_other(object, x, y)
                && let Some((u, v)) = landing(object, flow, pictures, x, y)
            {
                marks.set(u - bounds.x0, v - bounds.y0);
            }
        }
        let marks = marks.dilated(1).eroded(1);
        let radius = (MIN_RADIUS * object.whole.size()).clamp(MIN_RADIUS_PX.0, MIN_RADIUS_PX.1) as u32;
        let sure = marks.eroded(radius).dilated(radius + 1);
        let on_it = |mask: &Mask| {
            let is_set = |x: u32, y: u32| mask.get(i64::from(x - bounds.x0), i64::from(y - bounds.y0));
            object.whole.filtered(is_set)
        };
        let least = MIN_SHARE * object.whole.area() as f64;
        let region = on_it(&sure).filter(|cover| cover.area() as f64 >= least);
        let is_new = |x: u32, y: u32| region.as_ref().is_none_or(|sure| !sure.contains(x, y));
        let suspect = on_it(&marks).and_then(|marks| marks.filtered(is_new));
        Self { region, suspect }
    }

    /// Visible part of a mask; `None` if there is none.
    pub(super) fn cut(&self, mask: &Region) -> Option<Region> {
        match &self.region {
            Some(cover) => mask.filtered(|x, y| !cover.contains(x, y)),
            None => Some(mask.clone()),
        }
    }

    /// Returns true if a pixel of the frame before may show an occluder of the object.
    fn may_show_other(&self, object: &Moved<'_>, x: u32, y: u32) -> bool {
        let known = [&self.region, &self.suspect].into_iter().flatten().any(|region| region.contains(x, y));
        known || !object.before.contains(x, y)
    }
}

/// Pixels round a box.
fn window(b: BoundingBox, flow: &Flow) -> impl Iterator<Item = (u32, u32)> + use<> {
    let reach = REACH_PX + b.width().max(b.height()) / 2;
    let BoundingBox { x0, y0, x1, y1 } = b.grown(reach, (flow.width, flow.height));
    (y0..y1).flat_map(move |y| (x0..x1).map(move |x| (x, y)))
}

/// Where a pixel that moves by itself lands on an object.
fn landing(object: &Moved<'_>, flow: &Flow, pictures: Pictures<'_>, x: u32, y: u32) -> Option<(u32, u32)> {
    if !flow.is_consistent(x, y) {
        return None;
    }
    let [dx, dy] = flow.at(x, y).map(f64::from);
    let (from_x, from_y) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
    let (u, v) = ((from_x + dx).floor(), (from_y + dy).floor());
    if u < 0.0 || v < 0.0 || !object.whole.contains(u as u32, v as u32) {
        return None;
    }
    let [own_x, own_y] = object.motion.at([from_x, from_y]);
    if length([own_x - from_x - dx, own_y - from_y - dy]) < MIN_DIFFERENCE_PX {
        return None;
    }
    let at = (u as u32, v as u32);
    // What was covered already showed the occluder before, too: its colours say nothing.
    (!object.visible.contains(at.0, at.1) || is_explained(object, pictures, (x, y), at)).then_some(at)
}

/// Returns true if an occluder's pixel explains the colors at a position, and the object's does not.
fn is_explained(object: &Moved<'_>, pictures: Pictures<'_>, from: (u32, u32), at: (u32, u32)) -> bool {
    let [own_x, own_y] = object.motion.source(f64::from(at.0) + 0.5, f64::from(at.1) + 0.5);
    if own_x < 0.0 || own_y < 0.0 {
        return false;
    }
    let own = difference(pictures, (own_x as u32, own_y as u32), at);
    own >= MIN_CONTRAST && difference(pictures, from, at) <= BETTER * own
}

/// Mean difference of colours round two places, grey levels.
fn difference(pictures: Pictures<'_>, from: (u32, u32), at: (u32, u32)) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (i, j) in [(1, 1), (0, 1), (2, 1), (1, 0), (1, 2)] {
        let place = |(x, y): (u32, u32)| ((x + i).wrapping_sub(1), (y + j).wrapping_sub(1));
        let ((a, b), (c, d)) = (place(from), place(at));
        let both = pictures.before.get_pixel_checked(a, b).zip(pictures.now.get_pixel_checked(c, d));
        if let Some((p, q)) = both {
            sum += p.0.iter().zip(q.0).map(|(p, q)| f64::from(p.abs_diff(q))).sum::<f64>() / 3.0;
            count += 1.0;
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}
