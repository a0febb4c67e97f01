//! Sources of an object's detections, its motion, and the amount of its data.

use super::{HALF, Measures, SMALL, percent, times};
use crate::scene::ReasonKind::{Amount, Detection, Movement as MovementKind, Pixels};
use crate::scene::{Movement, Outline, Reason, TrackedObject};

/// Mean score from which on a detection counts as confident.
const SURE: f64 = 0.6;

/// Checks the numbers of points and frames.
///
/// * `num_visible` – frames in which it is visible, where that is known.
pub(super) fn amount(num_points: usize, num_frames: usize, num_visible: Option<usize>) -> Reason {
    let of = num_visible.map_or_else(String::new, |visible| format!(" of {visible}"));
    let text = format!("{num_points} points, 3D position in {num_frames}{of} frames");
    let weight = |count: usize, [few, next_to_none]: [usize; 2]| match count {
        c if c < next_to_none => 1.0,
        c if c < few => HALF,
        _ => 0.0,
    };
    // A position in few of the frames in which it is visible may be the result of an identity switch.
    let is_part = num_visible.is_some_and(|visible| 2 * num_frames < visible);
    let weights = [weight(num_points, [20, 10]), weight(num_frames, [10, 5]), if is_part { SMALL } else { 0.0 }];
    match weights.into_iter().fold(0.0, f64::max) {
        weight if weight > 0.0 => Reason::doubts(Amount, weight, format!("only {text}")),
        _ => Reason::supports(Amount, text),
    }
}

/// Checks its size in the image.
pub(super) fn pixels(measures: &Measures) -> Option<Reason> {
    let pixels = measures.pixels?;
    let text = format!("its points span {pixels:.0} px in the image");
    // Smaller vehicles have a few corners only.
    Some(match pixels < 20.0 {
        true => Reason::doubts(Pixels, HALF, format!("small: {text}")),
        false => Reason::supports(Pixels, text),
    })
}

/// Checks the sources and confidence of its detections; `None` where its masks were given.
pub(super) fn detection(tracked: &TrackedObject) -> Option<Reason> {
    if tracked.outline == Outline::Given {
        return None;
    }
    let found = &tracked.found_in;
    let text = format!("mean detector score {:.0} %; mask source: {found}", 100.0 * tracked.confidence.clamp(0.0, 1.0));
    let by_motion = found.by_motion() > tracked.frames.len() / 4;
    let is_coarse = tracked.outline == Outline::Coarse;
    // Expected intersection over union with the true mask.
    let is_poor = tracked.mask_quality.is_some_and(|quality| quality < 0.8);
    Some(match tracked.confidence {
        score if score < 0.45 && !by_motion => Reason::doubts(Detection, HALF, format!("low detector score: {text}")),
        _ if is_coarse => Reason::doubts(Detection, HALF, format!("coarse masks, by color only; {text}")),
        _ if is_poor => {
            Reason::doubts(Detection, SMALL, format!("poor masks, by the mask network's own score; {text}"))
        }
        score if score >= SURE || by_motion => Reason::supports(Detection, text),
        _ => Reason::doubts(Detection, SMALL, format!("moderate detector score: {text}")),
    })
}

/// Checks the path against the motion state by its points, or by the path alone.
pub(super) fn movement(tracked: &TrackedObject, measures: &Measures) -> Option<Reason> {
    let heights = measures.in_heights(measures.reach)?;
    // A stationary object cannot have moved so far.
    let is_far = heights > 2.0;
    let far = format!("{} vehicle heights", times(heights));
    let why = &tracked.movement.reason;
    match tracked.movement.state {
        Movement::Moving => Some(Reason::supports(MovementKind, format!("moving: {why}"))),
        Movement::Stationary if !is_far => {
            Some(Reason::supports(MovementKind, format!("stationary, and its position is constant: {why}")))
        }
        _ if is_far && tracked.confidence < SURE => Some(Reason::doubts(
            MovementKind,
            HALF,
            format!("only the path suggests motion ({far}); detection confidence {}", percent(tracked.confidence)),
        )),
        _ => None,
    }
}
