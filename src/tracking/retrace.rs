//! Masks between two looks of the mask network, taken from the nearer one.
//!
//! A mask that is carried wears out with every frame. When a new one comes, the frames before it are nearer to it than
//! to the last one: there the new mask is carried back, by the same motions the other way round. With a look in every
//! K-th frame no mask is then carried further than K / 2 frames.
//!
//! An object that enters the picture is seen in part, and its carried mask stays a part, as does the mask of an object
//! of which a part was found: there the new mask is carried back all the way, and the border of the picture cuts it.

use std::collections::VecDeque;

use super::affine::Affine;
use super::merging::is_same_size;
use super::propagation::Propagated;
use super::region::Region;
use crate::scene::{FrameId, Mask, ObjectId};

/// Frames that are remembered.
const MAX_FRAMES: usize = 40;
/// Overlap of the mask that was carried there with the one that is carried back: below it, one of them shows something
/// else, and the motion between is in doubt.
const AGREEMENT: f64 = 0.6;

/// A mask of an earlier frame that is better known now.
#[derive(Clone, Debug, PartialEq)]
pub struct Correction {
    /// The frame.
    pub frame: FrameId,
    /// The provisional id of the object.
    pub object: ObjectId,
    /// Its pixels; none of them belongs to another object.
    pub mask: Mask,
}

/// The way of an object since its last new mask.
#[derive(Clone, Debug, Default)]
pub(super) struct Way {
    /// That mask.
    first: Option<Region>,
    steps: VecDeque<Step>,
}

#[derive(Clone, Debug)]
struct Step {
    frame: FrameId,
    /// From the frame before.
    motion: Affine,
    region: Region,
    is_hidden: bool,
}

impl Way {
    /// Goes on to a frame to which the mask was carried.
    pub(super) fn go(&mut self, frame: FrameId, carried: &Propagated) {
        if self.steps.len() >= MAX_FRAMES {
            self.steps.pop_front();
        }
        let (motion, region, is_hidden) = (carried.motion.clone(), carried.region.clone(), is_hidden(carried));
        self.steps.push_back(Step { frame, motion, region, is_hidden });
    }

    /// Begins again at a new mask; without one, nothing can be carried back to before.
    pub(super) fn begin(&mut self, first: Option<&Region>) {
        *self = Self { first: first.cloned(), steps: VecDeque::new() };
    }

    /// The masks of the frames that are nearer to a new mask than to the last one, or of all if that was a part of the
    /// object, as far back as nothing hides a part of it.
    ///
    /// * `carried` – the object as it was carried into the frame of the new mask.
    pub(super) fn retraced(
        &self,
        new: &Region,
        carried: &Propagated,
        (width, height): (u32, u32),
    ) -> Vec<(FrameId, Region)> {
        let mut found = Vec::new();
        if is_hidden(carried) {
            return found;
        }
        // What leaves is still cut where it is carried to.
        let is_truncated = |region: &Region| region.bounds().is_truncated(width, height);
        let enters = self.first.as_ref().is_some_and(is_truncated) && !is_truncated(&carried.region);
        let was_part = enters || !is_same_size(new.area() as f64 / carried.region.area() as f64);
        let agreement = |region: &Region, before: &Region| {
            if was_part { before.covered_by(region) } else { region.iou(before) }
        };
        let num_frames = if was_part { self.steps.len() } else { self.steps.len() / 2 };
        let mut motion = carried.motion.clone();
        for step in self.steps.iter().rev().take(num_frames) {
            if step.is_hidden {
                break;
            }
            let region = motion.pulled(new);
            let Some(region) = region.filter(|region| agreement(region, &step.region) >= AGREEMENT) else { break };
            found.push((step.frame, region));
            motion = step.motion.then(&motion);
        }
        found
    }
}

fn is_hidden(carried: &Propagated) -> bool {
    carried.cover.region.is_some() || carried.is_partly_hidden()
}

/// Masks reported for the latest frames.
#[derive(Clone, Debug, Default)]
pub(super) struct Reported(VecDeque<(FrameId, Vec<(ObjectId, Region)>)>);

impl Reported {
    pub(super) fn remember(&mut self, frame: FrameId, masks: Vec<(ObjectId, Region)>) {
        if self.0.len() >= MAX_FRAMES {
            self.0.pop_front();
        }
        self.0.push_back((frame, masks));
    }

    /// Puts a better mask in the place of one that was reported, without the pixels of other objects; `None` if there
    /// was none or nothing is left.
    pub(super) fn correct(&mut self, frame: FrameId, object: ObjectId, region: &Region) -> Option<Correction> {
        let (_, masks) = self.0.iter_mut().find(|(reported, _)| *reported == frame)?;
        let own = masks.iter().position(|(id, _)| *id == object)?;
        let others: Vec<&Region> = masks.iter().filter(|(id, _)| *id != object).map(|(_, other)| other).collect();
        let region = region.filtered(|x, y| others.iter().all(|other| !other.contains(x, y)))?;
        let mask = region.mask().clone();
        masks[own].1 = region;
        Some(Correction { frame, object, mask })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tracking::occlusion::Cover;

    const SIZE: (u32, u32) = (60, 40);

    fn block(x: u32, y: u32, w: u32, h: u32) -> Region {
        Region::from_mask(&Mask::from_fn(60, 40, |u, v| (x..x + w).contains(&u) && (y..y + h).contains(&v))).unwrap()
    }

    /// A mask that moved by (3, 1) into a frame.
    fn carried(region: Region) -> Propagated {
        let displacement = [3.0, 1.0];
        let motion = Affine::shift(displacement);
        Propagated { whole: region.clone(), region, cover: Cover::default(), displacement, share: 1.0, motion }
    }

    /// The way of a mask that loses two columns in every frame; it was new, and 20 wide, in frame 0.
    fn worn(num_frames: u32) -> Way {
        let mut way = Way::default();
        for t in 1..=num_frames {
            way.go(FrameId(t), &carried(block(5 + 3 * t, 5 + t, 20 - 2 * t, 10)));
        }
        way
    }

    #[test]
    fn frames_that_are_nearer_to_the_new_mask_get_it() {
        let found = worn(4).retraced(&block(20, 10, 20, 10), &carried(block(20, 10, 10, 10)), SIZE);
        assert_eq!(found, [(FrameId(4), block(17, 9, 20, 10)), (FrameId(3), block(14, 8, 20, 10))]);
        let found = worn(3).retraced(&block(17, 9, 20, 10), &carried(block(17, 9, 12, 10)), SIZE);
        assert_eq!(found, [(FrameId(3), block(14, 8, 20, 10))]);
    }

    #[test]
    fn what_enters_gets_the_new_mask_all_the_way() {
        // The left half was visible in frame 0, and is carried; the new mask shows all of it.
        let mut way = Way::default();
        way.begin(Some(&block(0, 5, 10, 10)));
        for t in 1..=4 {
            way.go(FrameId(t), &carried(block(3 * t, 5 + t, 10, 10)));
        }
        let found = way.retraced(&block(5, 10, 20, 10), &carried(block(15, 10, 10, 10)), SIZE);
        let expected =
            [(4, block(2, 9, 20, 10)), (3, block(0, 8, 19, 10)), (2, block(0, 7, 16, 10)), (1, block(0, 6, 13, 10))];
        assert_eq!(found, expected.map(|(frame, region)| (FrameId(frame), region)));
        let still_cut = way.retraced(&block(0, 10, 25, 10), &carried(block(15, 10, 10, 10)), SIZE);
        let expected =
            [(4, block(0, 9, 22, 10)), (3, block(0, 8, 19, 10)), (2, block(0, 7, 16, 10)), (1, block(0, 6, 13, 10))];
        assert_eq!(still_cut, expected.map(|(frame, region)| (FrameId(frame), region)));
        // A vehicle that leaves through the left border: a mask that is too large goes back half of the way at most.
        let mut way = Way::default();
        way.begin(Some(&block(0, 5, 20, 10)));
        for t in 1..=4 {
            way.go(FrameId(t), &carried(block(0, 5 + t, 20 - 3 * t, 10)));
        }
        assert!(way.retraced(&block(0, 10, 9, 10), &carried(block(0, 10, 5, 10)), SIZE).len() <= 2);
    }

    #[test]
    fn what_was_followed_by_a_part_gets_the_whole_all_the_way() {
        let mut way = Way::default();
        way.begin(Some(&block(12, 12, 5, 4)));
        for t in 1..=4 {
            way.go(FrameId(t), &carried(block(12 + 3 * t, 12 + t, 5, 4)));
        }
        let found = way.retraced(&block(25, 15, 20, 10), &carried(block(27, 17, 5, 4)), SIZE);
        assert_eq!((found.len(), &found[3]), (4, &(FrameId(1), block(13, 11, 20, 10))));
    }

    #[test]
    fn what_was_hidden_or_is_another_object_keeps_its_mask() {
        let (mut way, new) = (worn(3), block(20, 10, 20, 10));
        let hidden = Propagated { whole: block(17, 9, 20, 10), ..carried(block(17, 9, 10, 10)) };
        way.go(FrameId(4), &hidden);
        assert!(way.retraced(&new, &carried(block(20, 10, 10, 10)), SIZE).is_empty());
        assert!(
            worn(4)
                .retraced(&new, &Propagated { whole: new.clone(), ..carried(block(20, 10, 5, 10)) }, SIZE)
                .is_empty()
        );
        assert!(worn(4).retraced(&block(45, 10, 10, 10), &carried(block(20, 10, 10, 10)), SIZE).is_empty());
    }

    #[test]
    fn a_correction_leaves_others_their_pixels() {
        let mut reported = Reported::default();
        let (own, other) = (ObjectId(1), ObjectId(2));
        reported.remember(FrameId(7), vec![(own, block(5, 5, 6, 10)), (other, block(12, 5, 10, 10))]);
        let found = reported.correct(FrameId(7), own, &block(5, 5, 10, 10)).unwrap();
        assert_eq!(found.mask, block(5, 5, 7, 10).mask().clone());
        assert_eq!(reported.correct(FrameId(7), ObjectId(3), &block(5, 5, 9, 9)), None);
        assert_eq!(reported.correct(FrameId(6), own, &block(5, 5, 9, 9)), None);
    }
}
