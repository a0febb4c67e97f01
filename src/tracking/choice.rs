//! Which of several masks is the object's.
//!
//! A network that is asked for the mask of a box may answer with a patch of road, the whole scene or half the car; a
//! mask that was carried for long may have worn out. Each mask gets a score, the product of
//!
//! - what the network expects of it, or expected of the mask that was carried, less a share per frame;
//! - how well it fits the size that the object had, its colours, the place to which it was carried, and the box that
//!   was found. Each of these counts as perfect from a tolerance on, so that masks that agree are ranked by quality.

use super::appearance::Appearance;
use super::region::Region;
use crate::scene::Rect;

/// Agreement (intersection over union, ratio of areas) that a good mask may lack.
const TOLERATED_OVERLAP: f64 = 0.7;
/// Similarity of colours that a good mask may lack.
const TOLERATED_SIMILARITY: f64 = 0.85;
/// Share of its quality that a mask loses per frame for which it is carried.
const WEAR_PER_FRAME: f64 = 0.02;
/// A new mask below this score is worth nothing.
pub(super) const MIN_SCORE: f64 = 0.25;

/// A mask that a network gave.
#[derive(Clone, Debug)]
pub(super) struct Fresh {
    pub(super) region: Region,
    /// Mask quality by the network's own estimate, 0 to 1.
    pub(super) quality: f64,
    pub(super) appearance: Option<Appearance>,
}

/// Expectation of an object before its mask in this frame is known.
#[derive(Clone, Copy, Debug)]
pub(super) struct Expected<'a> {
    /// Its mask by optical flow.
    pub(super) carried: Option<&'a Region>,
    /// Its outline by optical flow, where a part of it is hidden and may come up again.
    pub(super) whole: Option<&'a Region>,
    /// Where a detector or motion found it.
    pub(super) rect: Option<Rect>,
    /// Pixels of its masks so far.
    pub(super) area: f64,
    pub(super) appearance: Option<&'a Appearance>,
}

/// Agreement of a new mask with the expectation, 0 to 1.
pub(super) fn score(fresh: &Fresh, expected: &Expected) -> f64 {
    let quality = fresh.quality.clamp(0.0, 1.0);
    quality * fit(&fresh.region, fresh.appearance.as_ref(), expected)
}

/// Agreement of a propagated mask with the expectation, 0 to 1; `quality` is that of the mask that was propagated for
/// `frames`.
pub(super) fn score_carried(region: &Region, quality: f64, frames: usize, expected: &Expected) -> f64 {
    let wear = (1.0 - WEAR_PER_FRAME).powi(i32::try_from(frames).unwrap_or(i32::MAX));
    quality.clamp(0.0, 1.0) * wear * fit(region, expected.appearance, expected)
}

fn fit(region: &Region, appearance: Option<&Appearance>, expected: &Expected) -> f64 {
    let (size, place) = match (expected.carried, expected.whole) {
        (Some(carried), Some(whole)) => fit_in_part(region, carried, whole),
        (carried, _) => {
            let area = region.area() as f64;
            let size = area.min(expected.area) / area.max(expected.area).max(1.0);
            (size, carried.map_or(1.0, |carried| carried.iou(region)))
        }
    };
    let in_box = expected.rect.map_or(1.0, |rect| rect.iou(&region.rect()));
    // A box says where the object is and how large; what was before says less, and may have worn out.
    let [size, place] = [size, place].map(|before| if expected.rect.is_some() { before.max(in_box) } else { before });
    let looks = appearance.zip(expected.appearance).map_or(1.0, |(a, b)| a.similarity(b));
    let overlaps = [size, place, in_box].map(|overlap| (overlap / TOLERATED_OVERLAP).min(1.0));
    overlaps.iter().product::<f64>() * (looks / TOLERATED_SIMILARITY).min(1.0)
}

/// Size and place of a mask of an object that is partly hidden: it holds what is known to be seen, lies within the
/// whole outline, and is no larger than that.
fn fit_in_part(region: &Region, carried: &Region, whole: &Region) -> (f64, f64) {
    let size = (whole.area() as f64 / region.area() as f64).min(1.0);
    (size, carried.covered_by(region).min(region.covered_by(whole)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Mask;

    fn block(x: u32, y: u32, w: u32, h: u32) -> Region {
        Region::from_mask(&Mask::from_fn(80, 60, |u, v| (x..x + w).contains(&u) && (y..y + h).contains(&v))).unwrap()
    }

    fn fresh(region: Region, quality: f64) -> Fresh {
        Fresh { region, quality, appearance: None }
    }

    fn expected<'a>(carried: &'a Region, area: f64, rect: Option<Rect>) -> Expected<'a> {
        Expected { carried: Some(carried), whole: None, rect, area, appearance: None }
    }

    #[test]
    fn of_masks_that_agree_the_new_one_wins() {
        let carried = block(10, 10, 20, 10);
        let expected = expected(&carried, 200.0, None);
        let new = score(&fresh(block(10, 10, 21, 11), 0.9), &expected);
        assert!(new > score_carried(&carried, 0.9, 5, &expected));
    }

    #[test]
    fn a_patch_of_road_and_half_a_car_give_way() {
        let carried = block(10, 10, 20, 10);
        let expected = expected(&carried, 200.0, None);
        let kept = score_carried(&carried, 0.9, 10, &expected);
        assert!(score(&fresh(block(0, 0, 80, 40), 0.99), &expected) < MIN_SCORE);
        assert!(score(&fresh(block(10, 10, 10, 10), 0.95), &expected) < kept);
    }

    #[test]
    fn a_worn_mask_gives_way_to_the_whole_object_in_its_box() {
        let worn = block(10, 10, 9, 10);
        let expected = expected(&worn, 200.0, Some(Rect { x0: 10.0, y0: 10.0, x1: 30.0, y1: 20.0 }));
        assert!(score(&fresh(block(10, 10, 20, 10), 0.9), &expected) > score_carried(&worn, 0.9, 5, &expected));
    }

    #[test]
    fn what_comes_up_again_fits_and_what_hides_it_does_not() {
        let (seen, whole) = (block(10, 10, 8, 10), block(10, 10, 20, 10));
        let expected = Expected { whole: Some(&whole), ..expected(&seen, 200.0, None) };
        let score_of = |region| score(&fresh(region, 0.9), &expected);
        assert_eq!(score_of(block(10, 10, 14, 10)), 0.9);
        assert_eq!(score_of(block(10, 10, 20, 10)), 0.9);
        assert!(score_of(block(18, 10, 12, 10)) < MIN_SCORE && score_of(block(5, 0, 60, 40)) < MIN_SCORE);
    }

    #[test]
    fn other_colours_are_another_object() {
        let region = block(10, 10, 20, 10);
        let look = |colour| Appearance::of(&::image::RgbImage::from_pixel(80, 60, ::image::Rgb(colour)), &region);
        let (red, blue) = (look([200, 20, 20]), look([20, 20, 200]));
        let expected = Expected { appearance: red.as_ref(), ..expected(&region, 200.0, None) };
        let painted = |appearance| Fresh { appearance, ..fresh(region.clone(), 0.9) };
        assert!(score(&painted(red.clone()), &expected) > 0.8 && score(&painted(blue), &expected) < 0.01);
    }
}
