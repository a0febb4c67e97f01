//! Stage `scale`: the scale ratio of every object, and its trajectory.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::run::{Outcome, Run};
use super::track::{self, TrackedObject};
use super::{PipelineError, exports, ground, models, objects};
use crate::scene::{
    Frame, FrameId, Ground, GroundPlane, ObjectId, ObjectTrajectory, Reconstruction, ScaleEstimate, ScaleMethod,
    Trajectories, Unit,
};
use crate::trajectory::{
    Grounded, ObjectDescription, Silhouette, Views, assemble, estimate_scale, joint, joint_estimate,
};

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
    let reports = objects::reports(run)?;
    let frames = run.frames()?;
    run.workspace.remove(&run.workspace.root().join("ply"))?;
    outcome.outputs.push(exports::background(run, &background)?);
    let mut found = Vec::new();
    let mut failures = BTreeMap::new();
    let silhouettes = silhouettes(run, frames)?;
    for tracked in track::objects(run)? {
        let Some(report) = reports.get(&tracked.id) else { continue };
        let Some(mut model) = objects::reconstructed(run, tracked.id, report)? else { continue };
        let scene =
            Scene { background: &background, ground: &ground, silhouettes: silhouettes.get(&tracked.id), frames };
        let trajectory = scene.trajectory(run, &tracked, &mut model, report.given, &mut outcome);
        objects::store(run, tracked.id, &model)?;
        match trajectory {
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

/// The outlines of all objects, where any is to be adjusted with the ground.
fn silhouettes(
    run: &Run,
    frames: &[Frame],
) -> Result<BTreeMap<ObjectId, BTreeMap<FrameId, Silhouette>>, PipelineError> {
    let mut found: BTreeMap<ObjectId, BTreeMap<FrameId, Silhouette>> = BTreeMap::new();
    if run.options.scale.method != ScaleMethod::Joint {
        return Ok(found);
    }
    let objects = track::objects(run)?;
    for frame in frames {
        for (id, mask) in track::masks_of(run, &objects, frame)? {
            if let Some(silhouette) = Silhouette::of(&mask) {
                found.entry(id).or_default().insert(frame.id, silhouette);
            }
        }
    }
    Ok(found)
}

/// Where an object drives.
struct Scene<'a> {
    background: &'a Reconstruction,
    ground: &'a Ground,
    silhouettes: Option<&'a BTreeMap<FrameId, Silhouette>>,
    frames: &'a [Frame],
}

impl Scene<'_> {
    /// One object's trajectory, or why there is none. Puts its model on the ground, unless the user gave it.
    fn trajectory(
        &self,
        run: &Run,
        tracked: &TrackedObject,
        model: &mut Reconstruction,
        is_given: bool,
        outcome: &mut Outcome,
    ) -> Result<ObjectTrajectory, String> {
        let planes = self.ground.planes.iter().filter(|((id, _), _)| *id == tracked.id);
        let planes: BTreeMap<FrameId, GroundPlane> = planes.map(|(&(_, frame), &plane)| (frame, plane)).collect();
        let is_adjusted = run.options.scale.method == ScaleMethod::Joint && !is_given;
        let adjusted = is_adjusted.then(|| self.on_the_ground(run, tracked.id, model, &planes, outcome)).flatten();
        let scale = match adjusted {
            Some(scale) => scale,
            None => {
                let views = Views::new(self.background, model, &planes);
                estimate_scale(&views, &run.options.scale).map_err(|error| error.to_string())?
            }
        };
        let description =
            ObjectDescription { id: tracked.id, class: tracked.class.clone(), confidence: tracked.confidence };
        let trajectory = assemble(description, self.background, model, scale, self.frames, Unit::Background);
        if trajectory.poses.is_empty() {
            return Err("no frame is registered in both the background's and the object's model".to_owned());
        }
        Ok(trajectory)
    }

    /// Adjusts a model with the ground; where that cannot be done it stays as it is, and a warning says why.
    fn on_the_ground(
        &self,
        run: &Run,
        id: ObjectId,
        model: &mut Reconstruction,
        planes: &BTreeMap<FrameId, GroundPlane>,
        outcome: &mut Outcome,
    ) -> Option<ScaleEstimate> {
        let nothing = BTreeMap::new();
        let grounded = Grounded {
            background: self.background,
            object: model,
            planes,
            silhouettes: self.silhouettes.unwrap_or(&nothing),
            frames: self.frames,
        };
        match joint(&grounded, &run.options.scale.joint) {
            Ok(found) => {
                outcome.figure(
                    &format!("object_{id}"),
                    json!({
                        "mirrored": found.mirrored,
                        "frames_with_outline": found.contact.num_frames,
                        "median_error_px": found.error_px,
                        "num_uncertain_points": found.num_uncertain,
                    }),
                );
                let views = Views::new(self.background, &found.object, planes);
                let scale = joint_estimate(&views, &found, &run.options.scale);
                *model = found.object;
                Some(scale)
            }
            Err(error) => {
                outcome.warn(format!("object {id} is not adjusted with the ground: {error}"));
                None
            }
        }
    }
}
