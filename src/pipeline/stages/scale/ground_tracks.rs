//! Ground tracks of the vehicles that have no usable trajectory.

use std::collections::BTreeMap;

use serde_json::json;

use super::{Scene, description};
use crate::pipeline::PipelineError;
use crate::pipeline::driver::run::Outcome;
use crate::pipeline::stages::background::ModelReport;
use crate::pipeline::stages::ground;
use crate::scene::{Frame, GroundTrack, ObjectId, ObjectTrajectory, TrackedObject, Trust};
use crate::trajectory::{self, ContactEvidence, Silhouette, outline_pixels};

/// Share of a vehicle's frames that its trajectory must cover to need no ground track besides: less is an excerpt.
const MOSTLY: f64 = 0.5;

/// Outcomes of the vehicles so far.
pub(super) struct Placed<'a> {
    pub(super) tracked: &'a [TrackedObject],
    pub(super) objects: &'a [ObjectTrajectory],
    pub(super) reports: &'a BTreeMap<ObjectId, ModelReport>,
    pub(super) failures: &'a BTreeMap<String, String>,
}

impl Placed<'_> {
    /// Why a vehicle gets a ground track; `None` where its trajectory is usable, or it gets none of any kind. Empty for
    /// a doubtful trajectory, which meters may refute: [`decided`] has the last word.
    fn reason(&self, tracked: &TrackedObject) -> Option<String> {
        let report = self.reports.get(&tracked.id).filter(|_| tracked.left_out.is_none())?;
        let Some(trajectory) = self.objects.iter().find(|object| object.id == tracked.id) else {
            let failure = self.failures.get(&tracked.id.to_string()).or(report.failure.as_ref());
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
        let state = trajectory.verdict.as_ref().map(|verdict| verdict.state);
        (state == Some(Trust::Doubtful)).then(String::new)
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
pub(super) fn find(scene: &Scene, placed: &Placed, outcome: &mut Outcome) -> Result<Vec<GroundTrack>, PipelineError> {
    let wanted = placed.tracked.iter().filter_map(|tracked| Some((tracked, placed.reason(tracked)?)));
    let are_wanted = !scene.background.is_empty() && !scene.run.options.scale.method_only;
    let wanted: Vec<_> = wanted.filter(|_| are_wanted).collect();
    if wanted.is_empty() {
        return Ok(Vec::new());
    }
    let (run, background) = (scene.run, scene.background);
    let sources = ground::sources(run)?;
    let chain = sources.chain(background, run.options);
    let (mut tracks, mut without) = (Vec::new(), BTreeMap::new());
    for (tracked, reason) in wanted {
        let none = BTreeMap::<_, Silhouette>::new();
        let pixels = outline_pixels(scene.outlines.get(&tracked.id).unwrap_or(&none));
        let planes = chain.planes_below(tracked.id, &pixels, &run.options.ground, run.options.seed).planes;
        let seen = |frame: &&Frame| tracked.frames.binary_search(&frame.id).is_ok();
        let frames: Vec<&Frame> = scene.frames.iter().filter(seen).collect();
        let (outlines, focal_std) = (&scene.outlines, scene.focal_std);
        let evidence = ContactEvidence { background, planes: &planes, outlines, frames: &frames, focal_std };
        let is_needed = !reason.is_empty();
        match trajectory::ground_track(description(tracked), &evidence, reason) {
            Ok(track) => tracks.push(track),
            Err(reason) if is_needed => drop(without.insert(tracked.id.to_string(), reason)),
            Err(_) => {}
        }
    }
    if !without.is_empty() {
        outcome.figure("without_ground_track", json!(without));
    }
    Ok(tracks)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{GroundTrackMethod, Reason, ReasonKind, ScaleEstimate, ScaleMethod, Verdict};

    #[test]
    fn the_last_verdict_decides_on_a_ground_track() {
        let trajectory = |state| ObjectTrajectory {
            id: ObjectId(1),
            class: "car".to_owned(),
            confidence: 1.0,
            scale: ScaleEstimate::new(1.0, ScaleMethod::Joint),
            ground: BTreeMap::new(),
            body_center: None,
            verdict: Some(Verdict { state, reasons: vec![Reason::doubts(ReasonKind::Size, 1.0, "half as large")] }),
            dimensions: None,
            travel: None,
            poses: Vec::new(),
        };
        let track = |reason: &str| GroundTrack {
            id: ObjectId(1),
            class: "car".to_owned(),
            confidence: 1.0,
            method: GroundTrackMethod::GroundContact,
            reason: reason.to_owned(),
            verdict: None,
            ground: BTreeMap::new(),
            omitted: BTreeMap::new(),
            apparent_size: [0.0; 2],
            apparent_size_m: None,
            travel: None,
            positions: Vec::new(),
        };
        let reasons = |reason: &str, state| -> Vec<String> {
            decided(vec![track(reason)], &[trajectory(state)]).into_iter().map(|track| track.reason).collect()
        };
        assert_eq!(reasons("", Trust::Doubtful), Vec::<String>::new());
        assert_eq!(reasons("", Trust::Rejected), ["trajectory rejected: half as large"]);
        assert_eq!(reasons("trajectory in 2 of 9 frames only", Trust::Good), ["trajectory in 2 of 9 frames only"]);
    }
}
