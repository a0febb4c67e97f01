//! Stage `scale`: the scale ratio of every object, and its trajectory.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::run::{Outcome, Run};
use super::track::{self, TrackedObject};
use super::{PipelineError, exports, ground, models};
use crate::scene::{Frame, FrameId, Ground, GroundPlane, ObjectTrajectory, Reconstruction, Trajectories, Unit};
use crate::trajectory::{ObjectDescription, Views, assemble, estimate_scale};

/// The name of the list of objects without a trajectory, and why.
const FAILURES: &str = "scale-failures.json";

pub(super) fn depends_on(run: &Run) -> Value {
    json!(run.options.scale)
}

pub(super) fn work(run: &Run) -> Result<Outcome, PipelineError> {
    let mut outcome = Outcome::default();
    run.progress.begin("scale", None);
    let (background, _) = models::background(run)?;
    let ground = ground::ground(run)?;
    let reports = models::object_reports(run)?;
    let frames = run.frames()?;
    run.workspace.remove(&run.workspace.root().join("ply"))?;
    outcome.outputs.push(exports::background(run, &background)?);
    let mut found = Vec::new();
    let mut failures = BTreeMap::new();
    for tracked in track::objects(run)? {
        let Some(report) = reports.get(&tracked.id) else { continue };
        let Some(model) = models::object(run, tracked.id, report)? else { continue };
        match trajectory(run, &tracked, &background, &model, &ground, frames) {
            Ok(trajectory) => {
                outcome.outputs.push(exports::object(run, &trajectory, &model)?);
                if let Some(reason) = &trajectory.scale.reason {
                    outcome.warn(format!("object {}: its scale ratio is not to be trusted: {reason}", tracked.id));
                }
                found.push(trajectory);
            }
            Err(reason) => {
                outcome.warn(format!("object {} has no trajectory: {reason}", tracked.id));
                failures.insert(tracked.id.to_string(), reason);
            }
        }
    }
    outcome.figure("num_trajectories", found.len());
    let path = run.workspace.root().join("trajectories.json");
    crate::io::trajectories::write(&path, &Trajectories { unit: Unit::Background, objects: found })?;
    run.workspace.write_state(FAILURES, &failures)?;
    outcome.outputs.extend([path, run.workspace.state(FAILURES)]);
    Ok(outcome)
}

/// The trajectories; the stage must be done.
pub(super) fn trajectories(run: &Run) -> Result<Trajectories, PipelineError> {
    Ok(crate::io::trajectories::read(&run.workspace.root().join("trajectories.json"))?)
}

/// Why objects have no trajectory although they have a model, by id; the stage must be done.
pub(super) fn failures(run: &Run) -> Result<BTreeMap<String, String>, PipelineError> {
    run.workspace.read_state(FAILURES)
}

/// One object's trajectory, or why there is none.
fn trajectory(
    run: &Run,
    tracked: &TrackedObject,
    background: &Reconstruction,
    model: &Reconstruction,
    ground: &Ground,
    frames: &[Frame],
) -> Result<ObjectTrajectory, String> {
    let planes: BTreeMap<FrameId, GroundPlane> = ground
        .planes
        .iter()
        .filter(|((id, _), _)| *id == tracked.id)
        .map(|(&(_, frame), &plane)| (frame, plane))
        .collect();
    let views = Views::new(background, model, &planes);
    let scale = estimate_scale(&views, &run.options.scale).map_err(|error| error.to_string())?;
    let description =
        ObjectDescription { id: tracked.id, class: tracked.class.clone(), confidence: tracked.confidence };
    let trajectory = assemble(description, background, model, scale, frames, Unit::Background);
    if trajectory.poses.is_empty() {
        return Err("no frame is registered in both the background's and the object's model".to_owned());
    }
    Ok(trajectory)
}
