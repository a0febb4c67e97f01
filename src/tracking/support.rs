//! Minimum evidence of a vehicle for a trajectory.
//!
//! Skipped are objects with masks in too few frames, patches of the ground, and objects that neither a class nor motion
//! supports. A class supports an object if the detector found it in enough of the frames in which it ran, or with a
//! high confidence. Motion supports it if it moves against the background or was found by motion detection often
//! enough.

use std::fmt;

use super::TrackSummary;
use crate::scene::Movement;

/// Minimum number of frames with a box for any support: two may be chance.
pub(super) const MIN_FRAMES: usize = 3;
/// Mean detector confidence that suffices at any detection rate: on kinds of images that they rarely saw, networks
/// detect an object in one frame of ten.
const SUFFICIENT_CONFIDENCE: f64 = 0.5;
/// Minimum mean detector confidence at a high detection rate.
const MIN_FREQUENT_CONFIDENCE: f64 = 0.3;
/// Minimum detection rate that counts as high, as a share of the frames in which the detector ran.
const FREQUENT_SHARE: f64 = 0.3;
/// Minimum mean detector confidence for a stationary object: roofs, containers and stalls look like vehicles from afar,
/// and a parked vehicle has no other evidence than its class.
pub(super) const MIN_STATIONARY_CONFIDENCE: f64 = 0.55;
/// Minimum detection rate of a stationary object, unless its mean confidence is very high.
const FREQUENT_STATIONARY_SHARE: f64 = 0.5;
/// Mean detector confidence of a stationary object that suffices at any detection rate.
const SUFFICIENT_STATIONARY_CONFIDENCE: f64 = 0.7;
/// Minimum share of its frames in which motion detection found an object without other evidence of motion.
const FREQUENT_MOTION_SHARE: f64 = 0.25;

/// Minimum number of frames with a mask: fewer leave nothing to reconstruct, no length, no path, no speed.
const MIN_MASKS: usize = 6;
/// Minimum share of the image that a patch of the ground covers. Smaller objects are so far away that everything looks
/// flat.
const MIN_FLAT_SHARE: f64 = 0.03;

/// Evidence of an object's masks, in addition to the sources of its detections.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MaskEvidence {
    /// Number of frames with a mask.
    pub num_frames: usize,
    /// Mean share of the image that its masks cover.
    pub mean_share: f64,
    /// Motion state by the points in its masks.
    pub movement: Movement,
    /// True if none of these points rises over the ground ([`Judgement::is_flat`](crate::motion::Judgement)).
    pub is_flat: bool,
}

/// Reason why an object gets no trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unsupported {
    /// Masks in too few frames.
    Brief {
        /// Number of frames with a mask.
        num_frames: usize,
    },
    /// Patch of the ground.
    Flat,
    /// Neither class nor motion supports it.
    Doubtful {
        /// Number of frames in which the detector found it.
        num_named: usize,
        /// Mean confidence of the detector, 0 to 1.
        confidence: f64,
        /// Number of frames in which motion detection found it.
        num_moving: usize,
        /// Number of frames in which the detector ran.
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
/// [`Unsupported`] gives the missing evidence.
pub fn support(summary: &TrackSummary, evidence: &MaskEvidence) -> Result<(), Unsupported> {
    let &MaskEvidence { num_frames, mean_share, movement, is_flat } = evidence;
    if num_frames < MIN_MASKS {
        return Err(Unsupported::Brief { num_frames });
    }
    if is_flat && movement != Movement::Moving && mean_share >= MIN_FLAT_SHARE {
        return Err(Unsupported::Flat);
    }
    if is_supported_by_class(summary, movement) || is_supported_by_motion(summary, movement) {
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

fn is_supported_by_class(summary: &TrackSummary, movement: Movement) -> bool {
    let (named, confidence) = (summary.found.by_detector(), summary.class_confidence);
    let is_share = |share: f64| named as f64 >= share * summary.num_detector_looks as f64;
    let is_likely = match movement {
        // Stationary points are weaker evidence where motion detection found the object often.
        Movement::Stationary if !is_often_moving(summary) => {
            confidence >= SUFFICIENT_STATIONARY_CONFIDENCE
                || is_share(FREQUENT_STATIONARY_SHARE) && confidence >= MIN_STATIONARY_CONFIDENCE
        }
        _ => confidence >= SUFFICIENT_CONFIDENCE || is_share(FREQUENT_SHARE) && confidence >= MIN_FREQUENT_CONFIDENCE,
    };
    named >= MIN_FRAMES && is_likely
}

fn is_often_moving(summary: &TrackSummary) -> bool {
    let moving = summary.found.by_motion();
    moving >= MIN_FRAMES && moving as f64 >= FREQUENT_MOTION_SHARE * summary.num_looks as f64
}

fn is_supported_by_motion(summary: &TrackSummary, movement: Movement) -> bool {
    let moving = summary.found.by_motion();
    match movement {
        Movement::Moving => moving > 0 || summary.found.by_detector() > 0,
        Movement::Undetermined => is_often_moving(summary) && summary.found.by_detector() > 0,
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

    fn evidence(movement: Movement) -> MaskEvidence {
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
        assert_eq!(support(&named(38, 0.6), &evidence(Movement::Stationary)), Ok(()));
        assert_eq!(support(&named(4, 0.7), &evidence(Movement::Stationary)), Ok(()));
    }

    #[test]
    fn a_rarely_detected_patch_of_road_is_not_supported() {
        for movement in [Movement::Stationary, Movement::Undetermined] {
            assert!(support(&named(5, 0.35), &evidence(movement)).is_err());
            assert!(support(&named(2, 0.9), &evidence(movement)).is_err());
        }
        let reason = support(&named(5, 0.35), &evidence(Movement::Stationary)).unwrap_err().to_string();
        assert_eq!(reason, "detected in 5 of 40 frames, score 0.35, and stationary");
        let reason = support(&named(0, 0.0), &evidence(Movement::Undetermined)).unwrap_err().to_string();
        assert_eq!(reason, "no detection, and no evidence of motion");
    }

    #[test]
    fn a_stationary_object_needs_a_higher_confidence_than_an_undetermined_one() {
        assert_eq!(support(&named(30, 0.4), &evidence(Movement::Undetermined)), Ok(()));
        assert!(support(&named(30, 0.4), &evidence(Movement::Stationary)).is_err());
        assert!(support(&named(10, 0.6), &evidence(Movement::Stationary)).is_err());
        let found = summary(DetectionCounts { both: 15, detector: 20, ..DetectionCounts::default() }, 0.4, 40);
        assert_eq!(support(&found, &evidence(Movement::Stationary)), Ok(()));
    }

    #[test]
    fn a_moving_object_needs_no_class() {
        let moving = |frames| summary(DetectionCounts { motion: frames, ..DetectionCounts::default() }, 0.0, 40);
        assert_eq!(support(&moving(2), &evidence(Movement::Moving)), Ok(()));
        assert!(support(&moving(20), &evidence(Movement::Undetermined)).is_err());
        assert!(support(&moving(5), &evidence(Movement::Undetermined)).is_err());
        assert!(support(&moving(20), &evidence(Movement::Stationary)).is_err());
    }

    #[test]
    fn a_handful_of_masks_is_too_few() {
        let brief = MaskEvidence { num_frames: 3, ..evidence(Movement::Moving) };
        let reason = support(&named(38, 0.9), &brief).unwrap_err();
        assert_eq!(reason.to_string(), "masks in 3 frames only, at least 6 needed");
        assert_eq!(support(&named(38, 0.9), &MaskEvidence { num_frames: 6, ..brief }), Ok(()));
    }

    #[test]
    fn a_patch_of_road_is_skipped_unless_it_moves_or_is_far_away() {
        let road = MaskEvidence { mean_share: 0.3, is_flat: true, ..evidence(Movement::Stationary) };
        assert_eq!(support(&named(38, 0.9), &road), Err(Unsupported::Flat));
        assert_eq!(support(&named(38, 0.9), &MaskEvidence { mean_share: 0.005, ..road }), Ok(()));
        assert_eq!(support(&named(38, 0.9), &MaskEvidence { movement: Movement::Moving, ..road }), Ok(()));
    }
}
