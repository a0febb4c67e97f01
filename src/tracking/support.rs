//! Which objects are vehicles enough to get a trajectory.
//!
//! An object with masks in a handful of frames gets none, nor does a piece of the ground, nor a blob that neither a
//! class nor motion supports. A class supports an object if the detector named it in enough of the frames that it
//! looked at, or named it surely; motion supports it if it moves against the background or was found by motion for long
//! enough.

use std::fmt;

use super::TrackSummary;
use crate::scene::Movement;

/// Frames with a box that any support needs: two may be chance.
pub(super) const MIN_FRAMES: usize = 3;
/// Mean confidence from which the detector's word holds, however seldom it comes: networks that see a kind of picture
/// rarely answer in one frame of ten.
const SURE: f64 = 0.5;
/// Mean confidence that the detector needs where it answers often.
const LIKELY: f64 = 0.3;
/// Share of looks from which the detector answers often.
const OFTEN: f64 = 0.3;
/// Mean confidence that the detector needs for what stands: roofs, containers and stalls look like vehicles from afar,
/// and nothing but the class speaks for a parked one.
pub(super) const SURE_OF_STANDING: f64 = 0.55;
/// Share of looks in which it must name what stands, unless it is very sure.
const OFTEN_STANDING: f64 = 0.5;
/// Mean confidence from which it is.
const VERY_SURE: f64 = 0.7;
/// Share of looks in which motion must have found an object of which nothing else is known to move.
const MOVES_OFTEN: f64 = 0.25;

/// Frames with a mask below which there is nothing to reconstruct: no length, no way, no speed.
const MIN_MASKS: usize = 6;
/// Share of the picture that a piece of the ground covers at least. What is smaller is so far away that everything
/// looks flat.
const LEAST_FLAT_SHARE: f64 = 0.03;

/// Evidence of an object's masks besides the sources of its detections.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskEvidence {
    /// Frames in which it has a mask.
    pub num_frames: usize,
    /// Mean share of the picture that its masks cover.
    pub mean_share: f64,
    /// Motion state by the points in its masks.
    pub movement: Movement,
    /// True if none of them rises over the ground ([`Judgement::is_flat`](crate::motion::Judgement)).
    pub is_flat: bool,
}

/// Why an object gets no trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unsupported {
    /// It has masks in too few frames.
    Brief {
        /// Frames in which it has one.
        num_frames: usize,
    },
    /// It is a piece of the ground.
    Flat,
    /// Neither class nor motion supports it.
    Doubtful {
        /// Frames in which the detector named it.
        num_named: usize,
        /// Mean confidence of the detector, 0 to 1.
        confidence: f64,
        /// Frames in which motion found it.
        num_moving: usize,
        /// Frames at which the detector looked.
        num_looks: usize,
        /// Motion state by its own points.
        movement: Movement,
    },
}

impl fmt::Display for Unsupported {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Brief { num_frames } => {
                write!(f, "masks in {num_frames} frames only, at least {MIN_MASKS} needed")
            }
            Self::Flat => write!(f, "none of its points is above the ground: a patch of road, not a vehicle"),
            Self::Doubtful { num_named, confidence, num_moving, num_looks, movement } => {
                match num_named {
                    0 => write!(f, "no detection")?,
                    _ => write!(f, "detected in {num_named} of {num_looks} frames, score {confidence:.2}")?,
                }
                match (movement, num_moving) {
                    (Movement::Stationary, _) => write!(f, ", and stationary"),
                    (_, 0) => write!(f, ", and no evidence of motion"),
                    _ => write!(f, ", and motion detected in {num_moving} frames only"),
                }
            }
        }
    }
}

/// Checks that an object has enough masks, is more than a patch of ground, and is supported by a class or by motion.
///
/// # Errors
/// [`Unsupported`] says what it lacks.
pub fn support(summary: &TrackSummary, sighted: &MaskEvidence) -> Result<(), Unsupported> {
    let &MaskEvidence { num_frames, mean_share, movement, is_flat } = sighted;
    if num_frames < MIN_MASKS {
        return Err(Unsupported::Brief { num_frames });
    }
    if is_flat && movement != Movement::Moving && mean_share >= LEAST_FLAT_SHARE {
        return Err(Unsupported::Flat);
    }
    if is_named(summary, movement) || is_moving(summary, movement) {
        return Ok(());
    }
    Err(Unsupported::Doubtful {
        num_named: summary.found.by_detector(),
        confidence: summary.class_confidence,
        num_moving: summary.found.by_motion(),
        num_looks: summary.num_detector_looks,
        movement,
    })
}

fn is_named(summary: &TrackSummary, movement: Movement) -> bool {
    let (named, confidence) = (summary.found.by_detector(), summary.class_confidence);
    let is_share = |share: f64| named as f64 >= share * summary.num_detector_looks as f64;
    let is_likely = match movement {
        // That its points stand counts for less where motion found it all along.
        Movement::Stationary if !moves_often(summary) => {
            confidence >= VERY_SURE || is_share(OFTEN_STANDING) && confidence >= SURE_OF_STANDING
        }
        _ => confidence >= SURE || is_share(OFTEN) && confidence >= LIKELY,
    };
    named >= MIN_FRAMES && is_likely
}

fn moves_often(summary: &TrackSummary) -> bool {
    let moving = summary.found.by_motion();
    moving >= MIN_FRAMES && moving as f64 >= MOVES_OFTEN * summary.num_looks as f64
}

fn is_moving(summary: &TrackSummary, movement: Movement) -> bool {
    let moving = summary.found.by_motion();
    match movement {
        Movement::Moving => moving > 0 || summary.found.by_detector() > 0,
        Movement::Undetermined => moves_often(summary) && summary.found.by_detector() > 0,
        Movement::Stationary => false,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::scene::{DetectionCounts, FrameId, ObjectId, Outline};

    pub fn summary(found: DetectionCounts, class_confidence: f64, num_looks: usize) -> TrackSummary {
        TrackSummary {
            id: ObjectId(1),
            provisional: ObjectId(1),
            class: "car".into(),
            confidence: class_confidence,
            first: FrameId(0),
            last: FrameId(99),
            num_carried: found.carried,
            found,
            num_looks,
            num_detector_looks: num_looks,
            class_confidence,
            mask_quality: Some(0.9),
            outline: Outline::Network,
            gaps: Vec::new(),
            after: None,
        }
    }

    fn seen(movement: Movement) -> MaskEvidence {
        MaskEvidence { num_frames: 40, mean_share: 0.01, movement, is_flat: false }
    }

    fn named(frames: usize, confidence: f64) -> TrackSummary {
        summary(
            DetectionCounts { detector: frames, prompted: 40 - frames, ..DetectionCounts::default() },
            confidence,
            40,
        )
    }

    #[test]
    fn a_parked_car_is_supported_by_its_class() {
        assert_eq!(support(&named(38, 0.6), &seen(Movement::Stationary)), Ok(()));
        assert_eq!(support(&named(4, 0.7), &seen(Movement::Stationary)), Ok(()));
    }

    #[test]
    fn a_patch_of_road_that_was_named_now_and_then_is_not() {
        for movement in [Movement::Stationary, Movement::Undetermined] {
            assert!(support(&named(5, 0.35), &seen(movement)).is_err());
            assert!(support(&named(2, 0.9), &seen(movement)).is_err());
        }
        let reason = support(&named(5, 0.35), &seen(Movement::Stationary)).unwrap_err().to_string();
        assert_eq!(reason, "detected in 5 of 40 frames, score 0.35, and stationary");
        let reason = support(&named(0, 0.0), &seen(Movement::Undetermined)).unwrap_err().to_string();
        assert_eq!(reason, "no detection, and no evidence of motion");
    }

    #[test]
    fn what_stands_needs_a_surer_class_than_what_nothing_is_known_of() {
        assert_eq!(support(&named(30, 0.4), &seen(Movement::Undetermined)), Ok(()));
        assert!(support(&named(30, 0.4), &seen(Movement::Stationary)).is_err());
        assert!(support(&named(10, 0.6), &seen(Movement::Stationary)).is_err());
        let found = summary(DetectionCounts { both: 15, detector: 20, ..DetectionCounts::default() }, 0.4, 40);
        assert_eq!(support(&found, &seen(Movement::Stationary)), Ok(()));
    }

    #[test]
    fn what_moves_needs_no_class() {
        let moving = |frames| summary(DetectionCounts { motion: frames, ..DetectionCounts::default() }, 0.0, 40);
        assert_eq!(support(&moving(2), &seen(Movement::Moving)), Ok(()));
        assert!(support(&moving(20), &seen(Movement::Undetermined)).is_err());
        assert!(support(&moving(5), &seen(Movement::Undetermined)).is_err());
        assert!(support(&moving(20), &seen(Movement::Stationary)).is_err());
    }

    #[test]
    fn a_handful_of_masks_is_too_few() {
        let brief = MaskEvidence { num_frames: 3, ..seen(Movement::Moving) };
        let reason = support(&named(38, 0.9), &brief).unwrap_err();
        assert_eq!(reason.to_string(), "masks in 3 frames only, at least 6 needed");
        assert_eq!(support(&named(38, 0.9), &MaskEvidence { num_frames: 6, ..brief }), Ok(()));
    }

    #[test]
    fn a_patch_of_road_is_left_out_unless_it_moves_or_is_far_away() {
        let road = MaskEvidence { mean_share: 0.3, is_flat: true, ..seen(Movement::Stationary) };
        assert_eq!(support(&named(38, 0.9), &road), Err(Unsupported::Flat));
        assert_eq!(support(&named(38, 0.9), &MaskEvidence { mean_share: 0.005, ..road }), Ok(()));
        assert_eq!(support(&named(38, 0.9), &MaskEvidence { movement: Movement::Moving, ..road }), Ok(()));
    }
}
