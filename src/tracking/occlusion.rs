//! Occlusion of an object: pixels of its outline that show an occluder.
//!
//! A mask that is propagated as a whole would cover the occluder. An occluder is recognized by its own motion: pixels
//! from outside the mask, or from known occluders, whose flow is consistent and not the object's, and which land on the
//! object. Background behind the object fails this test: its flow has no consistent inverse. Dense flow lets smooth
//! paint move with the road next to it, so the images must agree as well: a pixel of the object shows an occluder only
//! if the occluder's pixel explains its colors, and the object's own does not.

use ::image::RgbImage;

use super::affine::{Affine, length};
use super::region::Region;
use crate::scene::{BoundingBox, Flow, Mask};

/// Images of the previous and the current frame.
#[derive(Clone, Copy)]
pub(super) struct ImagePair<'a> {
    pub(super) before: &'a RgbImage,
    pub(super) now: &'a RgbImage,
}

/// Minimum difference of an occluder's flow from the object's, pixels.
const MIN_DIFFERENCE_PX: f64 = 1.5;
/// Minimum mean color difference between an occluded pixel and the object's own, gray levels.
const MIN_CONTRAST: f64 = 12.0;
/// Maximum color difference of the occluder's pixel, as a share of that of the object's own.
const MAX_DIFFERENCE_SHARE: f64 = 0.5;
/// Margin around an object in which occluders are searched, in addition to half its size, pixels.
const REACH_PX: u32 = 48;
/// Bounds of half the minimum width of an occluder, pixels: narrower strips are the rim, where outlines and flow are
/// uncertain.
const MIN_RADIUS_PX: (f64, f64) = (2.0, 6.0);
/// Half the minimum width of an occluder within these bounds, as a share of the object's side.
const MIN_RADIUS: f64 = 0.025;
/// Minimum share of the outline that an occluder covers.
const MIN_SHARE: f64 = 0.03;

/// Occluded pixels of an object's outline in a frame.
#[derive(Clone, Debug, Default)]
pub(super) struct Occlusion {
    /// Pixels that show an occluder; `None` if there are none.
    pub(super) region: Option<Region>,
    /// Candidates in strips that are too narrow to be certain; they grow if an occluder moves in front of the object.
    pub(super) suspect: Option<Region>,
}

/// Object propagated to a frame.
pub(super) struct PropagatedObject<'a> {
    /// Its visible pixels in the previous frame.
    pub(super) before: &'a Region,
    /// The same, propagated.
    pub(super) visible: &'a Region,
    /// Its whole outline, propagated.
    pub(super) whole: &'a Region,
    /// Motion from the previous frame.
    pub(super) motion: &'a Affine,
}

impl Occlusion {
    /// Occluded pixels of an object in the next frame.
    ///
    /// * `self` – the same in the previous frame.
    pub(super) fn advance(&self, object: &PropagatedObject<'_>, flow: &Flow, images: ImagePair<'_>) -> Self {
        let bounds = object.whole.bounds();
        let mut marks = Mask::empty(bounds.width(), bounds.height());
        for (x, y) in window(bounds, flow) {
            if self.may_be_occluder(object, x, y)
                && let Some((u, v)) = landing(object, flow, images, x, y)
            {
                marks.set(u - bounds.x0, v - bounds.y0);
            }
        }
        let marks = marks.dilated(1).eroded(1);
        let radius = (MIN_RADIUS * object.whole.size()).clamp(MIN_RADIUS_PX.0, MIN_RADIUS_PX.1) as u32;
        let sure = marks.eroded(radius).dilated(radius + 1);
        let within_outline = |mask: &Mask| {
            let is_set = |x: u32, y: u32| mask.get(i64::from(x - bounds.x0), i64::from(y - bounds.y0));
            object.whole.filtered(is_set)
        };
        let least = MIN_SHARE * object.whole.area() as f64;
        let region = within_outline(&sure).filter(|occlusion| occlusion.area() as f64 >= least);
        let is_new = |x: u32, y: u32| region.as_ref().is_none_or(|sure| !sure.contains(x, y));
        let suspect = within_outline(&marks).and_then(|marks| marks.filtered(is_new));
        Self { region, suspect }
    }

    /// Visible part of a mask; `None` if there is none.
    pub(super) fn cut(&self, mask: &Region) -> Option<Region> {
        match &self.region {
            Some(occlusion) => mask.filtered(|x, y| !occlusion.contains(x, y)),
            None => Some(mask.clone()),
        }
    }

    /// Returns true if a pixel of the previous frame may show an occluder of the object.
    fn may_be_occluder(&self, object: &PropagatedObject<'_>, x: u32, y: u32) -> bool {
        let known = [&self.region, &self.suspect].into_iter().flatten().any(|region| region.contains(x, y));
        known || !object.before.contains(x, y)
    }
}

/// Pixels around a box.
fn window(b: BoundingBox, flow: &Flow) -> impl Iterator<Item = (u32, u32)> + use<> {
    let reach = REACH_PX + b.width().max(b.height()) / 2;
    let BoundingBox { x0, y0, x1, y1 } = b.grown(reach, (flow.width, flow.height));
    (y0..y1).flat_map(move |y| (x0..x1).map(move |x| (x, y)))
}

/// Target on an object of a pixel that moves differently from it; `None` if the pixel is no occluder.
fn landing(object: &PropagatedObject<'_>, flow: &Flow, images: ImagePair<'_>, x: u32, y: u32) -> Option<(u32, u32)> {
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
    // A pixel that was occluded before showed the occluder already: its colors are no evidence.
    (!object.visible.contains(at.0, at.1) || matches_occluder(object, images, (x, y), at)).then_some(at)
}

/// Returns true if an occluder's pixel explains the colors at a position, and the object's does not.
fn matches_occluder(object: &PropagatedObject<'_>, images: ImagePair<'_>, from: (u32, u32), at: (u32, u32)) -> bool {
    let [own_x, own_y] = object.motion.source(f64::from(at.0) + 0.5, f64::from(at.1) + 0.5);
    if own_x < 0.0 || own_y < 0.0 {
        return false;
    }
    let own = difference(images, (own_x as u32, own_y as u32), at);
    own >= MIN_CONTRAST && difference(images, from, at) <= MAX_DIFFERENCE_SHARE * own
}

/// Mean color difference around two positions, gray levels.
fn difference(images: ImagePair<'_>, from: (u32, u32), at: (u32, u32)) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (i, j) in [(1, 1), (0, 1), (2, 1), (1, 0), (1, 2)] {
        let place = |(x, y): (u32, u32)| ((x + i).wrapping_sub(1), (y + j).wrapping_sub(1));
        let ((a, b), (c, d)) = (place(from), place(at));
        let both = images.before.get_pixel_checked(a, b).zip(images.now.get_pixel_checked(c, d));
        if let Some((p, q)) = both {
            sum += p.0.iter().zip(q.0).map(|(p, q)| f64::from(p.abs_diff(q))).sum::<f64>() / 3.0;
            count += 1.0;
        }
    }
    if count > 0.0 { sum / count } else { 0.0 }
}
