//! Ground tracks of the vehicles that have no usable trajectory.

use std::collections::BTreeMap;

use serde_json::json;

use super::{Scene, description};
use crate::pipeline::PipelineError;
use crate::pipeline::driver::run::Outcome;
use crate::pipeline::stages::background::ModelReport;
use crate::pipeline::stages::ground;
use crate::scene::{Frame, GroundTrack, ObjectId, ObjectTrajectory, TrackedObject};
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
    /// Why a vehicle has no usable trajectory; `None` where it has one, or gets none of any kind.
    fn unusable(&self, tracked: &TrackedObject) -> Option<String> {
        let report = self.reports.get(&tracked.id).filter(|_| tracked.left_out.is_none())?;
        let Some(trajectory) = self.objects.iter().find(|object| object.id == tracked.id) else {
            let failure = self.failures.get(&tracked.id.to_string()).or(report.failure.as_ref());
            return Some(
                failure.map_or_else(|| "no trajectory".to_owned(), |failure| format!("no trajectory: {failure}")),
            );
        };
        if trajectory.is_ruled_out() {
            let refuted = || trajectory.verdict.as_ref()?.against().next().map(|reason| reason.says.clone());
            let reason = trajectory.scale.reason.clone().or_else(refuted).unwrap_or_default();
            return Some(format!("trajectory rejected: {reason}"));
        }
        let (placed, visible) = (trajectory.poses.len(), tracked.frames.len());
        ((placed as f64) < MOSTLY * visible as f64).then(|| format!("trajectory in {placed} of {visible} frames only"))
    }
}

/// Follows every vehicle without a usable trajectory on the ground.
pub(super) fn find(scene: &Scene, placed: &Placed, outcome: &mut Outcome) -> Result<Vec<GroundTrack>, PipelineError> {
    let wanted = placed.tracked.iter().filter_map(|tracked| Some((tracked, placed.unusable(tracked)?)));
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
        match trajectory::ground_track(description(tracked), &evidence, reason) {
            Ok(track) => tracks.push(track),
            Err(reason) => drop(without.insert(tracked.id.to_string(), reason)),
        }
    }
    outcome.figure("num_ground_tracks", tracks.len());
    if !without.is_empty() {
        outcome.figure("without_ground_track", json!(without));
    }
    Ok(tracks)
}
