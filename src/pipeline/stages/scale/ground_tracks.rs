//! Ground tracks of the vehicles that have no usable trajectory.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Vector3};
use serde_json::json;

use super::{Scene, description};
use crate::math::median;
use crate::math::rounding::percent;
use crate::pipeline::Result;
use crate::pipeline::driver::run::Outcome;
use crate::pipeline::stages::background::ModelReport;
use crate::scene::{
    Frame, FrameId, GroundPosition, GroundTrack, ObjectId, ObjectPose, ObjectTrajectory, Reason, ReasonKind, Topic,
    TrackedObject, Trust,
};
use crate::trajectory::{self, BodyOnGround, ContactEvidence, FocalError, Silhouette, outline_pixels, with_reason};

/// Share of a vehicle's frames that its trajectory must cover to need no ground track besides: less is an excerpt.
const MOSTLY: f64 = 0.5;
/// Deviation from the ground track of the same vehicle, in standard deviations of both, that refutes a trajectory.
const MAX_DEVIATIONS: f64 = 3.0;
/// Standard deviation of a ground track, as a share of the trajectory's, below which it is the better answer.
const BETTER: f64 = 0.5;

/// Ground tracks of the vehicles that have a model, or why they have none.
pub(super) type Followed = BTreeMap<ObjectId, Result<OnGround, String>>;
/// A ground track, and the body of its vehicle.
pub(super) type OnGround = (GroundTrack, Option<BodyOnGround>);

/// Outcomes of the vehicles so far.
pub(super) struct Placed<'a> {
    pub(super) tracked: &'a [TrackedObject],
    pub(super) objects: &'a [ObjectTrajectory],
    pub(super) reports: &'a BTreeMap<ObjectId, ModelReport>,
    pub(super) failures: &'a BTreeMap<ObjectId, String>,
    pub(super) followed: Followed,
}

impl Placed<'_> {
    /// Why a vehicle gets a ground track; `None` where its trajectory is usable, or it gets none of any kind. Empty for
    /// a doubtful trajectory, which meters may refute: [`decided`] has the last word.
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
        } else if (placed as f64) < MOSTLY * visible as f64 {
            return Some(format!("trajectory in {placed} of {visible} frames only"));
        }
        let verdict = trajectory.verdict.as_ref().filter(|verdict| verdict.state == Trust::Doubtful)?;
        Some(verdict.by_ground_track().map_or_else(String::new, |reason| reason.says.clone()))
    }
}

/// Why a trajectory is rejected; `None` for one that is not.
fn rejection(trajectory: &ObjectTrajectory) -> Option<String> {
    let refuted = || trajectory.verdict.as_ref()?.against().next().map(|reason| reason.says.clone());
    let reason = || trajectory.scale.reason.clone().or_else(refuted).unwrap_or_default();
    trajectory.is_ruled_out().then(|| format!("trajectory rejected: {}", reason()))
}

/// The ground tracks of vehicles whose trajectory is unusable by its last verdict, with the class of the trajectory.
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

/// Follows every vehicle on the ground whose trajectory is unusable or doubtful.
pub(super) fn find(
    scene: &Scene,
    mut placed: Placed,
    bodies: &mut BTreeMap<ObjectId, BodyOnGround>,
    outcome: &mut Outcome,
) -> Result<Vec<GroundTrack>> {
    let wanted = placed.tracked.iter().filter_map(|tracked| Some((tracked, placed.reason(tracked)?)));
    let are_wanted = !scene.background.is_empty() && !scene.run.options.scale.method_only;
    let wanted: Vec<_> = wanted.filter(|_| are_wanted).collect();
    let (mut tracks, mut without) = (Vec::new(), BTreeMap::new());
    for (tracked, reason) in wanted {
        let is_needed = !reason.is_empty();
        match placed.followed.remove(&tracked.id).unwrap_or_else(|| follow(scene, tracked)) {
            Ok((track, body)) => {
                bodies.extend(body.map(|body| (tracked.id, body)));
                tracks.push(GroundTrack { reason, ..track });
            }
            Err(reason) if is_needed => drop(without.insert(tracked.id.to_string(), reason)),
            Err(_) => {}
        }
    }
    if !without.is_empty() {
        outcome.figure("without_ground_track", json!(without));
    }
    Ok(tracks)
}

/// Follows a vehicle on the ground.
///
/// # Errors
/// Why it has no ground track.
pub(super) fn follow(scene: &Scene, tracked: &TrackedObject) -> Result<OnGround, String> {
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

fn centers(scene: &Scene) -> BTreeMap<FrameId, Point3<f64>> {
    scene.background.images.iter().map(|(id, image)| (id.frame(), image.cam_from_world.center())).collect()
}

/// Judges trajectories by the ground tracks of the same vehicles, below a camera that does not translate: a model has a
/// depth there as far as the vehicle turns against the line of sight, a footprint by the ground it stands on.
pub(super) fn judge(scene: &Scene, objects: &mut [ObjectTrajectory], followed: &Followed, outcome: &mut Outcome) {
    let Some(ground) = &scene.sources.hovering else { return };
    let level = Matrix3::identity() - ground.normal_in_world * ground.normal_in_world.transpose();
    let centers = centers(scene);
    for object in objects.iter_mut().filter(|object| !object.is_ruled_out()) {
        let Some(Ok((track, _))) = followed.get(&object.id) else { continue };
        let reason = by_ground_track(object, track, &centers, &level);
        let Some((reason, verdict)) = reason.zip(object.verdict.take()) else { continue };
        let says = reason.says.clone();
        let verdict = with_reason(verdict, reason);
        outcome.figure(&format!("verdict_{}", object.id), json!(verdict.state));
        if verdict.is_refuted() {
            outcome.warn(Topic::VehicleRejected.warning(format!("object {}: rejected: {says}", object.id)));
        }
        object.verdict = Some(verdict);
    }
}

/// Finding of a ground track on the trajectory; `None` where they share no frame, or the trajectory has no deviation.
fn by_ground_track(
    object: &ObjectTrajectory,
    track: &GroundTrack,
    centers: &BTreeMap<FrameId, Point3<f64>>,
    level: &Matrix3<f64>,
) -> Option<Reason> {
    let ratio_std = object.scale.std? / object.scale.ratio;
    let by_frame: BTreeMap<FrameId, &GroundPosition> =
        track.positions.iter().map(|position| (position.frame, position)).collect();
    // Shares of the distance: between both on the ground, and the standard deviation of each.
    let compared = |pose: &ObjectPose| {
        let seen = by_frame.get(&pose.frame)?;
        let position = Vector3::from(pose.position);
        let sight = position - centers.get(&pose.frame)?.coords;
        let off = level * (position - Vector3::from(seen.position));
        let of_track = (level * seen.error.covariance() * level).trace().max(0.0).sqrt();
        Some([off.norm(), (level * sight).norm() * ratio_std, of_track].map(|length| length / sight.norm()))
    };
    let all: Vec<[f64; 3]> = object.poses.iter().filter_map(compared).collect();
    let median_of = |k: usize| median(all.iter().map(|shares| shares[k]).collect());
    let (off, own, of_track) = (median_of(0)?, median_of(1)?, median_of(2)?);
    let deviations = off / own.hypot(of_track);
    let kind = ReasonKind::GroundTrack;
    let [off, own_std, track_std] = [off, own, of_track].map(percent);
    Some(if deviations > MAX_DEVIATIONS {
        let says = format!("{off} of the distance from its ground track ({deviations:.1} standard deviations)");
        Reason::refutes(kind, says)
    } else if of_track < BETTER * own {
        let says = format!("its ground track is more certain: ±{track_std} instead of ±{own_std} of the distance");
        Reason::doubts(kind, 1.0, says)
    } else {
        Reason::supports(kind, format!("agrees with its ground track: {off} of the distance (±{track_std})"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Sim3;
    use crate::scene::{ContactError, Finding, Reason, ReasonKind, ScaleEstimate, ScaleMethod, Verdict};

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
    fn a_trajectory_is_held_against_the_ground_track() {
        // From a camera 10 above the ground to a vehicle 10 away.
        let centers: BTreeMap<FrameId, Point3<f64>> =
            (0..8).map(|k| (FrameId(k), Point3::new(0.0, 0.0, 10.0))).collect();
        let level = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, 0.0));
        let finding = |off: f64, ratio_std: f64, track_std: f64| {
            let mut object = trajectory(Trust::Fair);
            object.scale.std = Some(ratio_std);
            let mut track = track("");
            for frame in (0..8).map(FrameId) {
                let (name, time_s) = (format!("{frame:?}"), f64::from(frame.0));
                let error = ContactError { common: [track_std, 0.0, 0.0], ..ContactError::default() };
                let position = GroundPosition {
                    frame,
                    name: name.clone(),
                    time_s,
                    position: [10.0, 0.0, 0.0],
                    error,
                    metric: None,
                };
                track.positions.push(position);
                let (position, world_from_object) = ([10.0 + off, 0.0, 0.0], Sim3::identity());
                object.poses.push(ObjectPose { frame, name, time_s, position, world_from_object, metric: None });
            }
            by_ground_track(&object, &track, &centers, &level).unwrap().finding
        };
        assert_eq!(finding(0.1, 0.02, 0.2), Finding::Supports);
        assert_eq!(finding(2.0, 0.02, 0.2), Finding::Refutes);
        assert_eq!(finding(0.1, 0.1, 0.2), Finding::Doubts);
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
