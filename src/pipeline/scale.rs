//! Stage `scale`: the scale ratio of every object, and its trajectory.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::run::{Outcome, Run};
use super::track::{self, TrackedObject};
use super::{PipelineError, exports, ground, models, objects, workspace};
use crate::scene::{Frame, FrameId, Ground, GroundPlane, ObjectId, Ratios, ScaleMethod, Trajectories, Unit};
use crate::trajectory::{self, Adjustment, Evidence, ModelOrigin, ObjectDescription, Silhouette};

/// The name of the list of objects without a trajectory, and why.
const FAILURES: &str = "scale-failures.json";
/// What the estimators that leave a reconstruction as it is say of those that were adjusted.
const AS_RECONSTRUCTED: &str = "as-reconstructed.json";

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
    let no_silhouettes = BTreeMap::new();
    for tracked in track::objects(run)? {
        let Some(report) = reports.get(&tracked.id) else { continue };
        let Some(object) = objects::reconstructed(run, tracked.id, report)? else { continue };
        let placed = trajectory::place(
            &Evidence {
                description: description(&tracked),
                origin: if report.given { ModelOrigin::Given } else { ModelOrigin::Reconstructed },
                background: &background,
                object: &object,
                planes: &planes(&ground, tracked.id),
                silhouettes: silhouettes.get(&tracked.id).unwrap_or(&no_silhouettes),
                frames,
            },
            &run.options.scale,
        );
        objects::store(run, tracked.id, &placed.object)?;
        describe_adjustment(tracked.id, &placed.adjustment, &mut outcome);
        match placed.trajectory {
            Ok(trajectory) => {
                if let Some(before) = &trajectory.scale.as_reconstructed {
                    as_reconstructed.insert(tracked.id, before.clone());
                }
                outcome.outputs.push(exports::object(run, &trajectory, &placed.object)?);
                if let Some(reason) = &trajectory.scale.reason {
                    outcome.warn(format!("object {}: its scale ratio is not to be trusted: {reason}", tracked.id));
                }
                found.push(trajectory);
            }
            Err(reason) => {
                outcome.warn(format!("object {} has no trajectory: {reason}", tracked.id));
                failures.insert(tracked.id.to_string(), reason.to_string());
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

fn description(tracked: &TrackedObject) -> ObjectDescription {
    ObjectDescription { id: tracked.id, class: tracked.class.clone(), confidence: tracked.confidence }
}

/// The local planes under one object.
fn planes(ground: &Ground, id: ObjectId) -> BTreeMap<FrameId, GroundPlane> {
    let planes = ground.planes.iter().filter(|((of, _), _)| *of == id);
    planes.map(|(&(_, frame), &plane)| (frame, plane)).collect()
}

fn describe_adjustment(id: ObjectId, adjustment: &Adjustment, outcome: &mut Outcome) {
    match adjustment {
        Adjustment::None => {}
        Adjustment::Failed(error) => outcome.warn(format!("object {id} is not adjusted with the ground: {error}")),
        Adjustment::Done(found) => outcome.figure(
            &format!("object_{id}"),
            json!({
                "mirrored": found.mirrored,
                "frames_with_outline": found.frames_with_outline,
                "median_error_px": found.error_px,
                "num_uncertain_points": found.num_uncertain,
            }),
        ),
    }
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
