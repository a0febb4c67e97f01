//! Selection of an object's mask among candidates.
//!
//! Prompted with a box, a network may return a patch of road, the whole scene or half the car; a mask that was
//! propagated for long may have degraded. The score of a mask is the product of
//!
//! - its quality by the network's estimate, for a propagated mask reduced by a share per frame;
//! - its agreement with the object's known size and colors, with the propagated position, and with the detected box.
//!   Each of these counts as perfect from a tolerance on, so that masks that agree are ranked by quality.

use super::appearance::Appearance;
use super::region::Region;
use crate::scene::Rect;

/// Agreement (intersection over union, ratio of areas) from which a mask counts as perfect.
const TOLERATED_OVERLAP: f64 = 0.7;
/// Similarity of colors from which a mask counts as perfect.
const TOLERATED_SIMILARITY: f64 = 0.85;
/// Share of its quality that a mask loses per frame of propagation.
const WEAR_PER_FRAME: f64 = 0.02;
/// Minimum score of a new mask.
pub(super) const MIN_SCORE: f64 = 0.25;

/// Mask that a segmenter gave in the current frame.
#[derive(Clone, Debug)]
pub(super) struct NewMask {
    pub(super) region: Region,
    /// Mask quality by the network's own estimate, 0 to 1.
    pub(super) quality: f64,
    pub(super) appearance: Option<Appearance>,
}

/// Expected mask of an object in a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected<'a> {
    /// Its mask by optical flow.
    pub(super) propagated: Option<&'a Region>,
    /// Its whole outline by optical flow, where a part of it is occluded and may become visible.
    pub(super) whole: Option<&'a Region>,
    /// Its box by the detector or by motion detection.
    pub(super) rect: Option<Rect>,
    /// Area of the fully visible object, pixels.
    pub(super) area: f64,
    pub(super) appearance: Option<&'a Appearance>,
}

/// Agreement of a new mask with the expectation, 0 to 1.
pub(super) fn score(new_mask: &NewMask, expected: &Expected) -> f64 {
    let quality = new_mask.quality.clamp(0.0, 1.0);
    quality * fit(&new_mask.region, new_mask.appearance.as_ref(), expected)
}

/// Agreement of a propagated mask with the expectation, 0 to 1.
///
/// * `quality` – of the mask that was propagated for `frames`.
pub(super) fn score_propagated(region: &Region, quality: f64, frames: usize, expected: &Expected) -> f64 {
    let wear = (1.0 - WEAR_PER_FRAME).powi(i32::try_from(frames).unwrap_or(i32::MAX));
    quality.clamp(0.0, 1.0) * wear * fit(region, expected.appearance, expected)
}

fn fit(region: &Region, appearance: Option<&Appearance>, expected: &Expected) -> f64 {
    let (size, place) = match (expected.propagated, expected.whole) {
        (Some(propagated), Some(whole)) => fit_occluded(region, propagated, whole),
        (propagated, _) => {
            let area = region.area() as f64;
            let size = area.min(expected.area) / area.max(expected.area).max(1.0);
            (size, propagated.map_or(1.0, |propagated| propagated.iou(region)))
        }
    };
    let in_box = expected.rect.map_or(1.0, |rect| rect.iou(&region.rect()));
    // A box gives the position and size of the object; earlier masks are weaker evidence and may have degraded.
    let [size, place] = [size, place].map(|before| if expected.rect.is_some() { before.max(in_box) } else { before });
    let similarity = appearance.zip(expected.appearance).map_or(1.0, |(a, b)| a.similarity(b));
    let overlaps = [size, place, in_box].map(|overlap| (overlap / TOLERATED_OVERLAP).min(1.0));
    overlaps.iter().product::<f64>() * (similarity / TOLERATED_SIMILARITY).min(1.0)
}

/// Scores of size and position of a mask of a partly occluded object.
///
/// The mask contains the visible part, is inside the whole outline, and is no larger than that.
fn fit_occluded(region: &Region, propagated: &Region, whole: &Region) -> (f64, f64) {
    let size = (whole.area() as f64 / region.area() as f64).min(1.0);
    (size, propagated.covered_by(region).min(region.covered_by(whole)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Mask;

    fn block(x: u32, y: u32, w: u32, h: u32) -> Region {
        Region::from_mask(&Mask::from_fn(80, 60, |u, v| (x..x + w).contains(&u) && (y..y + h).contains(&v))).unwrap()
    }

    fn new_mask(region: Region, quality: f64) -> NewMask {
        NewMask { region, quality, appearance: None }
    }

    fn expected<'a>(propagated: &'a Region, area: f64, rect: Option<Rect>) -> Expected<'a> {
        Expected { propagated: Some(propagated), whole: None, rect, area, appearance: None }
    }

    #[test]
    fn new_mask_wins_among_masks_that_agree() {
        let propagated = block(10, 10, 20, 10);
        let expected = expected(&propagated, 200.0, None);
        let new = score(&new_mask(block(10, 10, 21, 11), 0.9), &expected);
        assert!(new > score_propagated(&propagated, 0.9, 5, &expected));
    }

    #[test]
    fn propagated_mask_wins_over_road_and_half_a_car() {
        let propagated = block(10, 10, 20, 10);
        let expected = expected(&propagated, 200.0, None);
        let kept = score_propagated(&propagated, 0.9, 10, &expected);
        assert!(score(&new_mask(block(0, 0, 80, 40), 0.99), &expected) < MIN_SCORE);
        assert!(score(&new_mask(block(10, 10, 10, 10), 0.95), &expected) < kept);
    }

    #[test]
    fn whole_object_in_its_box_wins_over_degraded_mask() {
        let worn = block(10, 10, 9, 10);
        let expected = expected(&worn, 200.0, Some(Rect { x0: 10.0, y0: 10.0, x1: 30.0, y1: 20.0 }));
        assert!(score(&new_mask(block(10, 10, 20, 10), 0.9), &expected) > score_propagated(&worn, 0.9, 5, &expected));
    }

    #[test]
    fn reappearing_part_fits_and_occluder_does_not() {
        let (seen, whole) = (block(10, 10, 8, 10), block(10, 10, 20, 10));
        let expected = Expected { whole: Some(&whole), ..expected(&seen, 200.0, None) };
        let score_of = |region| score(&new_mask(region, 0.9), &expected);
        assert_eq!(score_of(block(10, 10, 14, 10)), 0.9);
        assert_eq!(score_of(block(10, 10, 20, 10)), 0.9);
        assert!(score_of(block(18, 10, 12, 10)) < MIN_SCORE && score_of(block(5, 0, 60, 40)) < MIN_SCORE);
    }

    #[test]
    fn different_colors_do_not_match() {
        let region = block(10, 10, 20, 10);
        let appearance = |color| Appearance::of(&::image::RgbImage::from_pixel(80, 60, ::image::Rgb(color)), &region);
        let (red, blue) = (appearance([200, 20, 20]), appearance([20, 20, 200]));
        let expected = Expected { appearance: red.as_ref(), ..expected(&region, 200.0, None) };
        let painted = |appearance| NewMask { appearance, ..new_mask(region.clone(), 0.9) };
        assert!(score(&painted(red.clone()), &expected) > 0.8 && score(&painted(blue), &expected) < 0.01);
    }
}
