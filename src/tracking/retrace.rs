//! Correction of propagated masks by a later new mask.
//!
//! A mask degrades with every frame of propagation. When a new one arrives, half of the frames before it are nearer to
//! it than to the last one. There the new mask is propagated back, by the inverse of the same motions. With
//! segmentation in every K-th frame no mask is then propagated further than K / 2 frames.
//!
//! An object that enters the image is truncated, and its propagated mask stays a part, as does the mask of an object of
//! which only a part was detected. Such an object's new mask is propagated back through all frames and clipped at the
//! image border.

use std::collections::VecDeque;

use super::affine::Affine;
use super::merging::is_same_size;
use super::propagation::Propagated;
use super::region::Region;
use crate::scene::{FrameId, Mask, ObjectId};

/// Maximum number of frames that are kept.
const MAX_FRAMES: usize = 40;
/// Minimum overlap of the masks propagated forward and back to a frame: below it, one of them shows something else, and
/// the motion between is unreliable.
const AGREEMENT: f64 = 0.6;

/// Improved mask of an earlier frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Correction {
    /// Frame of the mask.
    pub frame: FrameId,
    /// Provisional id of the object.
    pub object: ObjectId,
    /// Its pixels; none of them belongs to another object.
    pub mask: Mask,
}

/// Propagated masks of an object since its last new one.
#[derive(Clone, Debug, Default)]
pub(super) struct MaskHistory {
    /// The last new mask.
    first: Option<Region>,
    steps: VecDeque<Step>,
}

#[derive(Clone, Debug)]
struct Step {
    frame: FrameId,
    /// Motion from the previous frame.
    motion: Affine,
    region: Region,
    is_occluded: bool,
}

impl MaskHistory {
    /// Appends a frame to which the mask was propagated.
    pub(super) fn push(&mut self, frame: FrameId, propagated: &Propagated) {
        if self.steps.len() >= MAX_FRAMES {
            self.steps.pop_front();
        }
        let (motion, region, is_occluded) =
            (propagated.motion.clone(), propagated.region.clone(), is_occluded(propagated));
        self.steps.push_back(Step { frame, motion, region, is_occluded });
    }

    /// Restarts at a new mask; without one, nothing is propagated back beyond this frame.
    pub(super) fn restart(&mut self, first: Option<&Region>) {
        *self = Self { first: first.cloned(), steps: VecDeque::new() };
    }

    /// Propagates a new mask back to the frames that are nearer to it than to the last one.
    ///
    /// If the last one was a part of the object, all frames count. Ends where the object is partly occluded.
    ///
    /// * `propagated` – the object as propagated to the frame of the new mask.
    pub(super) fn retraced(
        &self,
        new: &Region,
        propagated: &Propagated,
        (width, height): (u32, u32),
    ) -> Vec<(FrameId, Region)> {
        let mut found = Vec::new();
        if is_occluded(propagated) {
            return found;
        }
        // An object that leaves the image is still truncated after propagation.
        let is_truncated = |region: &Region| region.bounds().is_truncated(width, height);
        let enters = self.first.as_ref().is_some_and(is_truncated) && !is_truncated(&propagated.region);
        let was_part = enters || !is_same_size(new.area() as f64 / propagated.region.area() as f64);
        let agreement = |region: &Region, before: &Region| {
            if was_part { before.covered_by(region) } else { region.iou(before) }
        };
        let num_frames = if was_part { self.steps.len() } else { self.steps.len() / 2 };
        let mut motion = propagated.motion.clone();
        for step in self.steps.iter().rev().take(num_frames) {
            if step.is_occluded {
                break;
            }
            let region = motion.apply_inverse(new);
            let Some(region) = region.filter(|region| agreement(region, &step.region) >= AGREEMENT) else { break };
            found.push((step.frame, region));
            motion = step.motion.then(&motion);
        }
        found
    }
}

fn is_occluded(propagated: &Propagated) -> bool {
    propagated.occlusion.region.is_some() || propagated.is_partly_occluded()
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

    /// Replaces a reported mask by a better one, without the pixels of other objects.
    ///
    /// `None` if no mask was reported or nothing remains.
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
    use crate::tracking::occlusion::Occlusion;

    const SIZE: (u32, u32) = (60, 40);

    fn block(x: u32, y: u32, w: u32, h: u32) -> Region {
        Region::from_mask(&Mask::from_fn(60, 40, |u, v| (x..x + w).contains(&u) && (y..y + h).contains(&v))).unwrap()
    }

    /// A mask propagated by (3, 1) into a frame.
    fn propagated(region: Region) -> Propagated {
        let displacement = [3.0, 1.0];
        let motion = Affine::shift(displacement);
        Propagated {
            whole: region.clone(),
            region,
            occlusion: Occlusion::default(),
            displacement,
            inlier_ratio: 1.0,
            motion,
        }
    }

    /// History of a mask that loses two columns in every frame; it was new, and 20 wide, in frame 0.
    fn worn(num_frames: u32) -> MaskHistory {
        let mut history = MaskHistory::default();
        for t in 1..=num_frames {
            history.push(FrameId(t), &propagated(block(5 + 3 * t, 5 + t, 20 - 2 * t, 10)));
        }
        history
    }

    #[test]
    fn frames_nearer_to_the_new_mask_take_it() {
        let found = worn(4).retraced(&block(20, 10, 20, 10), &propagated(block(20, 10, 10, 10)), SIZE);
        assert_eq!(found, [(FrameId(4), block(17, 9, 20, 10)), (FrameId(3), block(14, 8, 20, 10))]);
        let found = worn(3).retraced(&block(17, 9, 20, 10), &propagated(block(17, 9, 12, 10)), SIZE);
        assert_eq!(found, [(FrameId(3), block(14, 8, 20, 10))]);
    }

    #[test]
    fn an_entering_object_takes_the_new_mask_in_all_frames() {
        // The left half was visible in frame 0, and is propagated; the new mask shows all of the object.
        let mut history = MaskHistory::default();
        history.restart(Some(&block(0, 5, 10, 10)));
        for t in 1..=4 {
            history.push(FrameId(t), &propagated(block(3 * t, 5 + t, 10, 10)));
        }
        let found = history.retraced(&block(5, 10, 20, 10), &propagated(block(15, 10, 10, 10)), SIZE);
        let expected =
            [(4, block(2, 9, 20, 10)), (3, block(0, 8, 19, 10)), (2, block(0, 7, 16, 10)), (1, block(0, 6, 13, 10))];
        assert_eq!(found, expected.map(|(frame, region)| (FrameId(frame), region)));
        let still_truncated = history.retraced(&block(0, 10, 25, 10), &propagated(block(15, 10, 10, 10)), SIZE);
        let expected =
            [(4, block(0, 9, 22, 10)), (3, block(0, 8, 19, 10)), (2, block(0, 7, 16, 10)), (1, block(0, 6, 13, 10))];
        assert_eq!(still_truncated, expected.map(|(frame, region)| (FrameId(frame), region)));
        // A vehicle that leaves through the left border: an oversized mask replaces at most half of the frames.
        let mut history = MaskHistory::default();
        history.restart(Some(&block(0, 5, 20, 10)));
        for t in 1..=4 {
            history.push(FrameId(t), &propagated(block(0, 5 + t, 20 - 3 * t, 10)));
        }
        assert!(history.retraced(&block(0, 10, 9, 10), &propagated(block(0, 10, 5, 10)), SIZE).len() <= 2);
    }

    #[test]
    fn a_partially_tracked_object_takes_the_new_mask_in_all_frames() {
        let mut history = MaskHistory::default();
        history.restart(Some(&block(12, 12, 5, 4)));
        for t in 1..=4 {
            history.push(FrameId(t), &propagated(block(12 + 3 * t, 12 + t, 5, 4)));
        }
        let found = history.retraced(&block(25, 15, 20, 10), &propagated(block(27, 17, 5, 4)), SIZE);
        assert_eq!((found.len(), &found[3]), (4, &(FrameId(1), block(13, 11, 20, 10))));
    }

    #[test]
    fn occluded_and_other_objects_keep_their_masks() {
        let (mut history, new) = (worn(3), block(20, 10, 20, 10));
        let occluded = Propagated { whole: block(17, 9, 20, 10), ..propagated(block(17, 9, 10, 10)) };
        history.push(FrameId(4), &occluded);
        assert!(history.retraced(&new, &propagated(block(20, 10, 10, 10)), SIZE).is_empty());
        assert!(
            worn(4)
                .retraced(&new, &Propagated { whole: new.clone(), ..propagated(block(20, 10, 5, 10)) }, SIZE)
                .is_empty()
        );
        assert!(worn(4).retraced(&block(45, 10, 10, 10), &propagated(block(20, 10, 10, 10)), SIZE).is_empty());
    }

    #[test]
    fn a_correction_excludes_pixels_of_other_objects() {
        let mut reported = Reported::default();
        let (own, other) = (ObjectId(1), ObjectId(2));
        reported.remember(FrameId(7), vec![(own, block(5, 5, 6, 10)), (other, block(12, 5, 10, 10))]);
        let found = reported.correct(FrameId(7), own, &block(5, 5, 10, 10)).unwrap();
        assert_eq!(found.mask, block(5, 5, 7, 10).mask().clone());
        assert_eq!(reported.correct(FrameId(7), ObjectId(3), &block(5, 5, 9, 9)), None);
        assert_eq!(reported.correct(FrameId(6), own, &block(5, 5, 9, 9)), None);
    }
}
