//! Stage `track`: one mask per object and frame, the sources of its detections, and its motion state.

mod backward;
mod cached_prompts;
mod detected;
mod end_motion;
mod given;
mod kept_masks;
mod merged;
pub(in crate::pipeline) mod movement;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::segment::schedule::Schedule;
use crate::io::{RunFolder, atomic, masks};
use crate::networks::{FlowEstimator, load_flow};
use crate::pipeline::driver::fingerprint;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::networks::{Networks, hashes_by_name, of_networks};
use crate::pipeline::inputs::order;
use crate::pipeline::{Instances, PipelineError, Result, Stage};
use crate::scene::{Frame, Mask, Movement, ObjectId, Topic, TrackedObject};
use crate::tracking::{MaskEvidence, TrackSummary, support};
use detected::Detections;
use kept_masks::KeptMasks;

pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    let options = run.options;
    let following = || -> Result<Value> {
        let flow_model = of_networks(run, options.flow_model.as_slice())?;
        let (_, objects) = order::sfm_options(run)?;
        Ok(json!({
            "tracker": options.tracker,
            "flow_model": flow_model,
            "matching": objects.front_end.matching(),
        }))
    };
    Ok(match &options.instances {
        Instances::None => json!("none"),
        Instances::Masks(folder) => json!({ "masks": fingerprint::of_content(folder)? }),
        Instances::Model(_) => following()?,
        Instances::Vehicles => json!({
            "following": following()?,
            "masks": of_networks(run, &Networks::of(run)?.masks)?,
            "prompt": options.prompt,
            "every": Schedule::of(run)?.masks,
        }),
    })
}

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    // Prompted masks, cached while the stage runs.
    let answers = run.workspace.intermediate(Stage::Track, &outcome.fingerprint)?.join("answers");
    let objects = run.workspace.put_folder(&run.workspace.tracks(), |folder| {
        let (mut objects, summaries) = tracked(run, folder, &answers, outcome)?;
        let masks = KeptMasks::keep(run, folder, &objects, outcome)?;
        let evidence = movement::judge_all(run, &masks, &mut objects, outcome)?;
        mark_skipped(&mut objects, &summaries, &evidence, outcome);
        Ok(objects)
    })?;
    if objects.is_empty() && run.options.instances != Instances::None {
        let text = "no vehicle tracked: the result has no vehicle trajectories";
        outcome.warn(Topic::NoVehicleTracked.warning(text));
    }
    atomic::remove_folder(&answers)?;
    run.workspace.put_file(&run.workspace.tracked(), |fresh| crate::io::tracks::write(fresh, &objects))?;
    outcome.figure("num_objects", objects.len());
    outcome.figure("num_moving", objects.iter().filter(|object| object.movement.state == Movement::Moving).count());
    outcome.outputs.extend([run.workspace.tracks(), run.workspace.tracked()]);
    Ok(())
}

fn tracked(
    run: &Run,
    folder: &Path,
    answers: &Path,
    outcome: &mut Outcome,
) -> Result<(Vec<TrackedObject>, BTreeMap<ObjectId, TrackSummary>)> {
    let mut detections = match &run.options.instances {
        Instances::None => return Ok((Vec::new(), BTreeMap::new())),
        Instances::Masks(masks) => return Ok((given::split(run, masks, folder, outcome)?, BTreeMap::new())),
        Instances::Model(_) => Detections::masks(run),
        Instances::Vehicles => Detections::boxes(run, answers.to_owned(), outcome)?,
    };
    let networks = Networks::of(run)?;
    let masks = if run.options.instances == Instances::Vehicles { networks.serving_masks(run) } else { &[] };
    outcome.figure("networks", hashes_by_name(masks.iter().chain(&run.options.flow_model))?);
    let mut tracks = detected::track_forward(run, &mut detections, folder, outcome)?;
    backward::extend(run, &mut detections, folder, &mut tracks, outcome)?;
    merged::merge_pieces(run, folder, &mut tracks, outcome)?;
    let (mut objects, mut summaries): (Vec<_>, BTreeMap<_, _>) =
        tracks.into_iter().map(|f| (f.object(), (f.summary.id, f.summary))).unzip();
    if let Detections::Masks { .. } = detections {
        // Objects of a user's network count as vehicles, and their masks have no stated quality.
        summaries.clear();
        objects.iter_mut().for_each(|object: &mut TrackedObject| object.mask_quality = None);
    }
    Ok((objects, summaries))
}

/// Marks the objects without enough evidence of being vehicles as skipped.
///
/// * `summaries` – of the objects that the program detected.
/// * `evidence` – of the masks of each object.
fn mark_skipped(
    objects: &mut [TrackedObject],
    summaries: &BTreeMap<ObjectId, TrackSummary>,
    evidence: &BTreeMap<ObjectId, MaskEvidence>,
    outcome: &mut Outcome,
) {
    for object in objects {
        let Some((summary, evidence)) = summaries.get(&object.id).zip(evidence.get(&object.id)) else { continue };
        if let Err(reason) = support(summary, evidence) {
            outcome.warn(Topic::VehicleSkipped.warning(format!("object {}: skipped: {reason}", object.id)));
            object.left_out = Some(reason.to_string());
        }
    }
}

/// Masks of all tracked objects in one frame.
pub(in crate::pipeline) fn masks_of(
    run: &Run,
    objects: &[TrackedObject],
    frame: &Frame,
) -> Result<Vec<(ObjectId, Mask)>> {
    KeptMasks::done(run).read(objects, frame)
}

/// Mask of an object in a folder of images that is being written.
fn mask_in(run: &Run, folder: &Path, id: ObjectId, frame: &Frame) -> Result<Mask> {
    Ok(masks::read_mask(&mask_path(folder, id, frame), run.size())?)
}

/// File path of an object's mask in a folder of masks.
fn mask_path(folder: &Path, id: ObjectId, frame: &Frame) -> PathBuf {
    folder.join(id.to_string()).join(RunFolder::mask_name(frame))
}

/// Loads the optical flow of the run's options.
pub(in crate::pipeline) fn load_flow_estimator(run: &Run) -> Result<Box<dyn FlowEstimator>> {
    let options = run.options;
    Ok(load_flow(options.flow_model.as_deref(), options.resources())?)
}

/// Rejects models of objects that do not exist.
///
/// # Errors
/// [`PipelineError::Options`] lists those that exist.
pub(in crate::pipeline) fn check_models(run: &Run, ids: &BTreeSet<ObjectId>) -> Result<()> {
    let unknown = run.options.object_models.keys().find(|id| !ids.contains(id));
    let Some(id) = unknown else { return Ok(()) };
    let text = format!("--object-model {id}=...: object {id} does not exist; tracked: {}", list(ids));
    Err(PipelineError::Options(text))
}

/// Checks the objects that options name by id against the tracked ones.
///
/// # Errors
/// As [`check_models`].
pub(in crate::pipeline) fn check_ids(run: &Run, tracked: &[TrackedObject], outcome: &mut Outcome) -> Result<()> {
    let ids: BTreeSet<ObjectId> = tracked.iter().map(|object| object.id).collect();
    check_models(run, &ids)?;
    for id in run.options.only_objects.difference(&ids) {
        let text = format!("--only-object {id}: object {id} does not exist; tracked: {}", list(&ids));
        outcome.warn(Topic::UnknownVehicle.warning(text));
    }
    Ok(())
}

fn list(ids: &BTreeSet<ObjectId>) -> String {
    let ids: Vec<String> = ids.iter().map(ToString::to_string).collect();
    if ids.is_empty() { "none".to_owned() } else { ids.join(", ") }
}
