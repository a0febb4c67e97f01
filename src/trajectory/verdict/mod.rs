//! Verdict on a trajectory, from all evidence.
//!
//! A small standard deviation means that the data are consistent. It does not mean that they are those of a vehicle: a
//! patch of the horizon that was detected as a car has a small one, too. Every trajectory therefore passes several
//! checks, each a small function: scale ratio ([`scale`]), detections and amount of data ([`support`]), contact with
//! the ground ([`ground`]), shape, size and speed of its class ([`class`], [`size`]), and drivability of the path
//! ([`path`]). Each check supports, doubts or refutes the trajectory, with a weight and a sentence with its figure. The
//! [`Verdict`] follows:
//!
//! * one refutation, or doubts whose weights sum up to 3 or more: rejected;
//! * doubts whose weights sum up to 1 or more: doubtful;
//! * a standard deviation of more than 3 %, or any doubt: fair; else good.
//!
//! Support does not cancel doubts. Meters are not known: the unit of length is the vehicle's own height over the
//! ground, and vehicles are compared with one another. The stage `metric` adds a doubt ([`with_reason`]) where the size
//! contradicts the class.
//!
//! All limits, with their sources and the clips on which they were chosen: docs/maths/verdict.md. Entry point:
//! [`verdicts`].

mod class;
mod ground;
mod measures;
mod path;
mod scale;
mod size;
mod support;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use self::measures::Measures;
use crate::math::rounding::{percent, significant};
use crate::scene::{
    Finding, FocalChange, FrameId, GroundPlane, ObjectTrajectory, Reason, ReasonKind, Reconstruction, TimeBase,
    TrackedObject, Trust, Verdict,
};

/// Trajectory to judge, with its data.
#[derive(Clone, Copy, Debug)]
pub struct Candidate<'a> {
    /// The trajectory, in units of the background.
    pub trajectory: &'a ObjectTrajectory,
    /// Sources of the object's detections, and its motion state; `None` if unknown.
    pub tracked: Option<&'a TrackedObject>,
    /// The model to which the trajectory refers.
    pub object: &'a Reconstruction,
    /// The background's reconstruction.
    pub background: &'a Reconstruction,
    /// The local plane of each frame, in the background's frame.
    pub planes: &'a BTreeMap<FrameId, GroundPlane>,
}

/// Verdicts on all trajectories of a run, in their order; they are compared with one another.
///
/// * `time_base` – speeds are not checked where times count frames.
/// * `focal_changes` – changes of the focal length, which the reconstructions of background and objects interpret as
///   motion: no verdict is better than doubtful with one.
pub fn verdicts(candidates: &[Candidate], time_base: TimeBase, focal_changes: &[FocalChange]) -> Vec<Verdict> {
    let measures: Vec<Measures> = candidates.iter().map(Measures::of).collect();
    let mut reasons: Vec<Vec<Reason>> =
        candidates.iter().zip(&measures).map(|(candidate, measures)| alone(candidate, measures)).collect();
    let size_references = size::size_references(candidates, &measures, &reasons);
    for k in 0..candidates.len() {
        let class = class::of(&candidates[k].trajectory.class);
        let found = size::relative_to_others(k, &size_references).into_iter();
        reasons[k].extend(found.chain(size::speed(&measures[k], &class, time_base)));
        reasons[k].extend(focal_changes.first().map(|change| {
            let says = format!("{change}; cut the clip there or use a fixed zoom");
            Reason::doubts(ReasonKind::FocalLength, DOUBTFUL, says)
        }));
    }
    reasons.into_iter().map(weighed).collect()
}

/// Verdict with one more reason, which replaces support of the same kind.
pub fn with_reason(verdict: Verdict, reason: Reason) -> Verdict {
    let is_kept = |before: &Reason| before.kind != reason.kind || before.finding != Finding::Supports;
    let mut reasons: Vec<Reason> = verdict.reasons.into_iter().filter(is_kept).collect();
    reasons.push(reason);
    weighed(reasons)
}

/// Reasons from one trajectory alone.
fn alone(candidate: &Candidate, measures: &Measures) -> Vec<Reason> {
    let class = class::of(&candidate.trajectory.class);
    let num_visible = candidate.tracked.map(|tracked| tracked.frames.len());
    let amount = support::amount(candidate.object.points.len(), candidate.trajectory.poses.len(), num_visible);
    let mut reasons = vec![scale::deviation(&candidate.trajectory.scale), amount];
    reasons.extend(support::pixels(measures));
    if let Some(tracked) = candidate.tracked {
        reasons.extend(support::detection(tracked));
        reasons.extend(support::movement(tracked, measures));
    }
    reasons.extend(ground::reasons(measures));
    reasons.extend(size::shape(measures, &class));
    reasons.extend(size::stretch(measures, &class));
    reasons.extend(path::reasons(measures));
    reasons
}

/// Weight of a minor doubt.
const SMALL: f64 = 0.25;
/// Weight of a major doubt.
const HALF: f64 = 0.5;
/// Doubts that sum up to this make a trajectory doubtful.
const DOUBTFUL: f64 = 1.0;

/// Verdict from all reasons.
fn weighed(mut reasons: Vec<Reason>) -> Verdict {
    let gravity =
        |reason: &Reason| (std::cmp::Reverse(reason.finding), std::cmp::Reverse((1e6 * reason.weight) as u32));
    reasons.sort_by_key(|reason| (gravity(reason), reason.kind));
    let has = |finding| reasons.iter().any(|reason| reason.finding == finding);
    let doubt: f64 = reasons.iter().map(|reason| reason.weight).sum();
    let state = match () {
        // No correct trajectory has so many doubts.
        () if has(Finding::Refutes) || doubt >= 3.0 - 1e-9 => Trust::Rejected,
        () if doubt >= DOUBTFUL - 1e-9 => Trust::Doubtful,
        () if has(Finding::Doubts) => Trust::Fair,
        () => Trust::Good,
    };
    Verdict { state, reasons }
}

/// A doubt where a value exceeds the first limit, a refutation beyond the second; `None` within both.
fn graded(kind: ReasonKind, value: f64, [doubts, refutes]: [f64; 2], text: impl FnOnce() -> String) -> Option<Reason> {
    match value {
        v if v > refutes => Some(Reason::refutes(kind, text())),
        v if v > doubts => Some(Reason::doubts(kind, 1.0, text())),
        _ => None,
    }
}

/// A multiple, for messages.
fn times(value: f64) -> String {
    if value.abs() < 1e4 { significant(value, 2) } else { "more than 10000".to_owned() }
}
