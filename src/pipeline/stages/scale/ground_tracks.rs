//! Ground tracks of the vehicles that have no usable trajectory.

use std::collections::BTreeMap;

use super::{Scene, description};
use crate::pipeline::stages::background::ModelReport;
use crate::scene::{Frame, GroundTrack, ObjectId, ObjectTrajectory, TrackedObject, Trust};
use crate::trajectory::{self, BodyOnGround, ContactEvidence, FocalError, Silhouette, outline_pixels};

/// Minimum share of a vehicle's frames that its trajectory must cover to make a ground track unnecessary.
const MIN_COVERAGE: f64 = 0.5;

/// A ground track, and the ground body of its vehicle.
type OnGround = (GroundTrack, Option<BodyOnGround>);

/// Outcomes of the vehicles so far.
pub(super) struct Placed<'a> {
    pub(super) tracked: &'a [TrackedObject],
    pub(super) objects: &'a [ObjectTrajectory],
    pub(super) reports: &'a BTreeMap<ObjectId, ModelReport>,
    pub(super) failures: &'a BTreeMap<ObjectId, String>,
}

impl Placed<'_> {
    /// Reason for a ground track; `None` if the vehicle's trajectory is usable, or it gets neither. Empty for a
    /// doubtful trajectory, which meters may refute: [`decided`] makes the final choice.
    fn reason(&self, tracked: &TrackedObject) -> Option<String> {
        let report = self.reports.get(&tracked.id).filter(|_| tracked.left_out.is_none())?;
        let Some(trajectory) = self.objects.iter().find(|object| object.id == tracked.id) else {
            let failure = self.failures.get(&tracked.id).or(report.failure.as_ref());
            return Some(
                failure.map_or_else(|| "no trajectory".to_owned(), |failure| format!("no trajectory: {failure}")),
            );
        };
        let (placed, visible) = (trajectory.poses.len(), tracked.frames.len());
        if let Some(reason) = rejection(trajectory) {
            return Some(reason);
        } else if (placed as f64) < MIN_COVERAGE * visible as f64 {
            return Some(format!("trajectory in {placed} of {visible} frames only"));
        }
        let is_doubtful = trajectory.verdict.as_ref().is_some_and(|verdict| verdict.state == Trust::Doubtful);
        is_doubtful.then(String::new)
    }
}

/// Reason why a trajectory is rejected; `None` for others.
fn rejection(trajectory: &ObjectTrajectory) -> Option<String> {
    let refuted = || trajectory.verdict.as_ref()?.against().next().map(|reason| reason.says.clone());
    let reason = || trajectory.scale.reason.clone().or_else(refuted).unwrap_or_default();
    trajectory.is_ruled_out().then(|| format!("trajectory rejected: {}", reason()))
}

/// The ground tracks of vehicles whose trajectory is unusable by its final verdict, with the class of the trajectory.
pub(in crate::pipeline) fn decided(tracks: Vec<GroundTrack>, objects: &[ObjectTrajectory]) -> Vec<GroundTrack> {
    let last = |mut track: GroundTrack| {
        let object = objects.iter().find(|object| object.id == track.id);
        if let Some(object) = object {
            track.class.clone_from(&object.class);
        }
        if track.reason.is_empty() {
            track.reason = object.and_then(rejection)?;
        }
        Some(track)
    };
    tracks.into_iter().filter_map(last).collect()
}

/// Tracks every vehicle with an unusable or doubtful trajectory on the ground. Also returns the reasons for missing
/// ground tracks.
pub(super) fn find(
    scene: &Scene,
    placed: &Placed,
    bodies: &mut BTreeMap<ObjectId, BodyOnGround>,
) -> (Vec<GroundTrack>, BTreeMap<ObjectId, String>) {
    let wanted = placed.tracked.iter().filter_map(|tracked| Some((tracked, placed.reason(tracked)?)));
    let are_wanted = !scene.background.is_empty() && !scene.run.options.scale.method_only;
    let wanted: Vec<_> = wanted.filter(|_| are_wanted).collect();
    let (mut tracks, mut without) = (Vec::new(), BTreeMap::new());
    for (tracked, reason) in wanted {
        let is_needed = !reason.is_empty();
        match follow(scene, tracked) {
            Ok((track, body)) => {
                bodies.extend(body.map(|body| (tracked.id, body)));
                tracks.push(GroundTrack { reason, ..track });
            }
            Err(reason) if is_needed => drop(without.insert(tracked.id, reason)),
            Err(_) => {}
        }
    }
    (tracks, without)
}

/// Tracks a vehicle on the ground.
///
/// # Errors
/// The reason for a missing ground track.
fn follow(scene: &Scene, tracked: &TrackedObject) -> Result<OnGround, String> {
    let (run, background) = (scene.run, scene.background);
    let chain = scene.sources.chain(background, run.options);
    let none = BTreeMap::<_, Silhouette>::new();
    let pixels = outline_pixels(scene.outlines.get(&tracked.id).unwrap_or(&none));
    let planes = chain.planes_below(tracked.id, &pixels, &run.options.ground, run.options.seed).planes;
    let seen = |frame: &&Frame| tracked.is_visible_in(frame.id);
    let frames: Vec<&Frame> = scene.frames.iter().filter(seen).collect();
    let turns = scene.sources.hovering.as_ref().map(|ground| ground.normal_by_focal);
    let focal = FocalError { std: scene.focal_std.unwrap_or(0.0), turns };
    let evidence = ContactEvidence { background, planes: &planes, outlines: &scene.outlines, frames: &frames, focal };
    trajectory::ground_track(description(tracked), &evidence, String::new())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Reason, ReasonKind, ScaleEstimate, ScaleMethod, Verdict};

    fn trajectory(state: Trust) -> ObjectTrajectory {
        ObjectTrajectory {
            verdict: Some(Verdict { state, reasons: vec![Reason::doubts(ReasonKind::Size, 1.0, "half as large")] }),
            ..ObjectTrajectory::new(ObjectId(1), "car", 1.0, ScaleEstimate::new(1.0, ScaleMethod::Joint))
        }
    }

    fn track(reason: &str) -> GroundTrack {
        GroundTrack { reason: reason.to_owned(), ..GroundTrack::new(ObjectId(1), "car", 1.0) }
    }

    #[test]
    fn the_last_verdict_decides_on_a_ground_track() {
        let reasons = |reason: &str, state| -> Vec<String> {
            decided(vec![track(reason)], &[trajectory(state)]).into_iter().map(|track| track.reason).collect()
        };
        assert_eq!(reasons("", Trust::Doubtful), Vec::<String>::new());
        assert_eq!(reasons("", Trust::Rejected), ["trajectory rejected: half as large"]);
        assert_eq!(reasons("trajectory in 2 of 9 frames only", Trust::Good), ["trajectory in 2 of 9 frames only"]);
    }
}
