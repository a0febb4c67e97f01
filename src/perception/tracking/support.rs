//! Which objects are vehicles enough to get a trajectory.
//!
//! A blob that neither a class nor motion supports gets none. A class supports an object if the detector named it in
//! enough of the frames that it looked at, or named it surely; motion supports it if it moves against the background
//! or was found by motion for long enough.

use std::fmt;

use super::TrackSummary;
use crate::scene::Movement;

/// Frames with a box that any support needs: two may be chance.
const MIN_FRAMES: usize = 3;
/// Mean confidence from which the detector's word holds, however seldom it comes: networks that see a kind of picture
/// rarely answer in one frame of ten.
const SURE: f64 = 0.5;
/// Mean confidence that the detector needs where it answers often.
const LIKELY: f64 = 0.3;
/// Share of looks from which the detector answers often.
const OFTEN: f64 = 0.3;
/// Mean confidence that the detector needs for what stands: roofs, containers and stalls look like vehicles from afar,
/// and nothing but the class speaks for a parked one.
const SURE_OF_STANDING: f64 = 0.55;
/// Share of looks in which it must name what stands, unless it is very sure.
const OFTEN_STANDING: f64 = 0.5;
/// Mean confidence from which it is.
const VERY_SURE: f64 = 0.7;
/// Share of looks in which motion must have found an object of which nothing else is known to move.
const MOVES_OFTEN: f64 = 0.25;

/// Why an object gets no trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unsupported {
    /// Frames in which the detector named it.
    pub num_named: usize,
    /// Mean confidence of the detector, 0 to 1.
    pub confidence: f64,
    /// Frames in which motion found it.
    pub num_moving: usize,
    /// Frames that somebody looked at.
    pub num_looks: usize,
    /// Whether it moves, by its own points.
    pub movement: Movement,
}

impl fmt::Display for Unsupported {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { num_named, confidence, num_moving, num_looks, movement } = self;
        match num_named {
            0 => write!(f, "no detector names it")?,
            _ => write!(f, "a detector names it in {num_named} of {num_looks} frames, {confidence:.2} sure")?,
        }
        match (movement, num_moving) {
            (Movement::Standing, _) => write!(f, ", and it stands"),
            (_, 0) => write!(f, ", and nothing says that it moves"),
            _ => write!(f, ", and motion finds it in {num_moving} frames only"),
        }
    }
}

/// Whether a class or motion supports an object.
///
/// * `movement` – what the points in its masks say against the background.
///
/// # Errors
/// [`Unsupported`] says what is known of an object that nothing supports.
pub fn support(summary: &TrackSummary, movement: Movement) -> Result<(), Unsupported> {
    if is_named(summary, movement) || is_moving(summary, movement) {
        return Ok(());
    }
    Err(Unsupported {
        num_named: summary.found.by_detector(),
        confidence: summary.class_confidence,
        num_moving: summary.found.by_motion(),
        num_looks: summary.num_looks,
        movement,
    })
}

fn is_named(summary: &TrackSummary, movement: Movement) -> bool {
    let (named, confidence) = (summary.found.by_detector(), summary.class_confidence);
    let is_share = |share: f64| named as f64 >= share * summary.num_looks as f64;
    let is_likely = match movement {
        // That its points stand counts for less where motion found it all along.
        Movement::Standing if !moves_often(summary) => {
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
        Movement::Standing => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{FoundIn, FrameId, ObjectId, Outline};

    fn summary(found: FoundIn, class_confidence: f64, num_looks: usize) -> TrackSummary {
        TrackSummary {
            id: ObjectId(1),
            provisional: ObjectId(1),
            class: "car".into(),
            confidence: class_confidence,
            first: FrameId(0),
            last: FrameId(99),
            num_detected: found.by_detector() + found.motion,
            num_carried: found.carried,
            mean_area_px2: 500.0,
            found,
            num_looks,
            class_confidence,
            mask_quality: Some(0.9),
            outline: Outline::Network,
        }
    }

    fn named(frames: usize, confidence: f64) -> TrackSummary {
        summary(FoundIn { detector: frames, prompted: 40 - frames, ..FoundIn::default() }, confidence, 40)
    }

    #[test]
    fn a_parked_car_is_supported_by_its_class() {
        assert_eq!(support(&named(38, 0.6), Movement::Standing), Ok(()));
        assert_eq!(support(&named(4, 0.7), Movement::Standing), Ok(()));
    }

    #[test]
    fn a_patch_of_road_that_was_named_now_and_then_is_not() {
        for movement in [Movement::Standing, Movement::Undetermined] {
            assert!(support(&named(5, 0.35), movement).is_err());
            assert!(support(&named(2, 0.9), movement).is_err());
        }
        let reason = support(&named(5, 0.35), Movement::Standing).unwrap_err().to_string();
        assert_eq!(reason, "a detector names it in 5 of 40 frames, 0.35 sure, and it stands");
        let reason = support(&named(0, 0.0), Movement::Undetermined).unwrap_err().to_string();
        assert_eq!(reason, "no detector names it, and nothing says that it moves");
    }

    #[test]
    fn what_stands_needs_a_surer_class_than_what_nothing_is_known_of() {
        assert_eq!(support(&named(30, 0.4), Movement::Undetermined), Ok(()));
        assert!(support(&named(30, 0.4), Movement::Standing).is_err());
        assert!(support(&named(10, 0.6), Movement::Standing).is_err());
        let found = summary(FoundIn { both: 15, detector: 20, ..FoundIn::default() }, 0.4, 40);
        assert_eq!(support(&found, Movement::Standing), Ok(()));
    }

    #[test]
    fn what_moves_needs_no_class() {
        let moving = |frames| summary(FoundIn { motion: frames, ..FoundIn::default() }, 0.0, 40);
        assert_eq!(support(&moving(2), Movement::Moving), Ok(()));
        assert!(support(&moving(20), Movement::Undetermined).is_err());
        assert!(support(&moving(5), Movement::Undetermined).is_err());
        assert!(support(&moving(20), Movement::Standing).is_err());
    }
}
