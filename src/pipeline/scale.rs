//! Stage `scale`: the scale ratio of every object, and its trajectory.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::run::{Outcome, Run};
use super::track::{self, TrackedObject};
use super::{PipelineError, exports, ground, models, objects, workspace};
use crate::scene::{
    Frame, FrameId, Ground, GroundPlane, ObjectId, ObjectTrajectory, Reconstruction, ScaleEstimate, ScaleMethod,
    Trajectories, Unit,
};
use crate::trajectory::{
    Grounded, ObjectDescription, Silhouette, Views, all_ratios, assemble, estimate_scale, joint, joint_estimate,
};

/// The name of the list of objects without a trajectory, and why.
const FAILURES: &str = "scale-failures.json";
/// What the estimators that leave a reconstruction as it is say of those that were adjusted.
const AS_RECONSTRUCTED: &str = "as-reconstructed.json";

/// Ratios by the name of the estimator.
type Ratios = BTreeMap<String, f64>;

pub(super) fn depends_on(run: &Run) -> Value {
    json!({ "options": run.options.scale, "keeps": AS_RECONSTRUCTED })
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
    let mut as_reconstructed = BTreeMap::new();
    let with_model = reports.iter().filter(|(_, report)| report.failure.is_none()).map(|(id, _)| *id).collect();
    let silhouettes = silhouettes(run, frames, &with_model)?;
    for tracked in track::objects(run)? {
        let Some(report) = reports.get(&tracked.id) else { continue };
        let Some(mut model) = objects::reconstructed(run, tracked.id, report)? else { continue };
        let scene =
            Scene { background: &background, ground: &ground, silhouettes: silhouettes.get(&tracked.id), frames };
        let is_adjusted = run.options.scale.method == ScaleMethod::Joint && !report.given;
        let adjusted = is_adjusted.then(|| scene.on_the_ground(run, tracked.id, &mut model, &mut outcome)).flatten();
        let scale = adjusted.map(|(scale, before)| {
            as_reconstructed.insert(tracked.id, before);
            scale
        });
        let trajectory = scene.trajectory(run, &tracked, &model, scale);
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
    run.workspace.write_state(AS_RECONSTRUCTED, &as_reconstructed)?;
    outcome.outputs.extend([path, run.workspace.state(FAILURES), run.workspace.state(AS_RECONSTRUCTED)]);
    Ok(outcome)
}

/// An object as it was before it was adjusted with the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct AsReconstructed {
    /// Folder of its COLMAP model.
    pub model: PathBuf,
    /// What the estimators that leave it as it is say of it, by their names.
    pub ratios: Ratios,
}

/// The objects of the run in the folder `output` that were adjusted with the ground, as they were before. Empty where none
/// was, or where the folder has nothing but results.
///
/// # Errors
/// [`PipelineError::Io`] if what the run left of them was changed by other hands.
pub fn as_reconstructed(output: &Path) -> Result<BTreeMap<ObjectId, AsReconstructed>, PipelineError> {
    let path = workspace::state_of(output, AS_RECONSTRUCTED);
    if !path.exists() {
        return Ok(BTreeMap::new());
    }
    let ratios: BTreeMap<ObjectId, Ratios> = crate::io::json::read(&path)?;
    let with_model = |(id, ratios): (ObjectId, Ratios)| {
        let model = workspace::state_of(output, "objects").join(id.to_string());
        (id, AsReconstructed { model, ratios })
    };
    Ok(ratios.into_iter().map(with_model).collect())
}

/// The trajectories; the stage must be done.
pub(super) fn trajectories(run: &Run) -> Result<Trajectories, PipelineError> {
    Ok(crate::io::trajectories::read(&run.workspace.root().join("trajectories.json"))?)
}

/// Why objects have no trajectory although they have a model, by id; the stage must be done.
pub(super) fn failures(run: &Run) -> Result<BTreeMap<String, String>, PipelineError> {
    run.workspace.read_state(FAILURES)
}

/// The outlines of objects, where any is to be adjusted with the ground.
fn silhouettes(
    run: &Run,
    frames: &[Frame],
    wanted: &BTreeSet<ObjectId>,
) -> Result<BTreeMap<ObjectId, BTreeMap<FrameId, Silhouette>>, PipelineError> {
    let mut found: BTreeMap<ObjectId, BTreeMap<FrameId, Silhouette>> = BTreeMap::new();
    if run.options.scale.method != ScaleMethod::Joint {
        return Ok(found);
    }
    let mut objects = track::objects(run)?;
    objects.retain(|object| wanted.contains(&object.id));
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
    /// The local planes under one object.
    fn planes(&self, id: ObjectId) -> BTreeMap<FrameId, GroundPlane> {
        let planes = self.ground.planes.iter().filter(|((of, _), _)| *of == id);
        planes.map(|(&(_, frame), &plane)| (frame, plane)).collect()
    }

    /// One object's trajectory, or why there is none. `scale` is known where the model was adjusted with the ground.
    fn trajectory(
        &self,
        run: &Run,
        tracked: &TrackedObject,
        model: &Reconstruction,
        scale: Option<ScaleEstimate>,
    ) -> Result<ObjectTrajectory, String> {
        let estimated = || {
            let planes = self.planes(tracked.id);
            let views = Views::new(self.background, model, &planes);
            estimate_scale(&views, &run.options.scale).map_err(|error| error.to_string())
        };
        let scale = scale.map_or_else(estimated, Ok)?;
        let description =
            ObjectDescription { id: tracked.id, class: tracked.class.clone(), confidence: tracked.confidence };
        let trajectory = assemble(description, self.background, model, scale, self.frames, Unit::Background);
        if trajectory.poses.is_empty() {
            return Err("no frame is registered in both the background's and the object's model".to_owned());
        }
        Ok(trajectory)
    }

    /// Adjusts a model with the ground: its scale, and what the other estimators say of it as it was. Where that cannot be
    /// done it stays as it is, and a warning says why.
    fn on_the_ground(
        &self,
        run: &Run,
        id: ObjectId,
        model: &mut Reconstruction,
        outcome: &mut Outcome,
    ) -> Option<(ScaleEstimate, Ratios)> {
        let planes = self.planes(id);
        let nothing = BTreeMap::new();
        let grounded = Grounded {
            background: self.background,
            object: model,
            planes: &planes,
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
                let before = all_ratios(&Views::new(self.background, model, &planes), &run.options.scale);
                let views = Views::new(self.background, &found.object, &planes);
                let scale = joint_estimate(&views, &found, &run.options.scale);
                *model = found.object;
                Some((scale, before))
            }
            Err(error) => {
                outcome.warn(format!("object {id} is not adjusted with the ground: {error}"));
                None
            }
        }
    }
}
