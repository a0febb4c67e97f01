//! Stage `track`: one mask per object and frame, what found each object, and whether it moved.

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
use detected::Finds;
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
    // Masks that were asked for, while the stage is at work.
    let answers = run.workspace.intermediate(Stage::Track, &outcome.fingerprint)?.join("answers");
    let objects = run.workspace.put_folder(&run.workspace.tracks(), |folder| {
        let (mut objects, summaries) = tracked(run, folder, &answers, outcome)?;
        let masks = KeptMasks::keep(run, folder, &objects, outcome)?;
        let sighted = movement::find(run, &masks, &mut objects, outcome)?;
        leave_out(&mut objects, &summaries, &sighted, outcome);
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
    let mut finds = match &run.options.instances {
        Instances::None => return Ok((Vec::new(), BTreeMap::new())),
        Instances::Masks(masks) => return Ok((given::split(run, masks, folder, outcome)?, BTreeMap::new())),
        Instances::Model(_) => Finds::masks(run),
        Instances::Vehicles => Finds::boxes(run, answers.to_owned(), outcome)?,
    };
    let networks = Networks::of(run)?;
    let masks = if run.options.instances == Instances::Vehicles { networks.serving_masks(run) } else { &[] };
    outcome.figure("networks", hashes_by_name(masks.iter().chain(&run.options.flow_model))?);
    let mut followed = detected::follow(run, &mut finds, folder, outcome)?;
    backward::extend(run, &mut finds, folder, &mut followed, outcome)?;
    merged::join_pieces(run, folder, &mut followed, outcome)?;
    let (mut objects, mut summaries): (Vec<_>, BTreeMap<_, _>) =
        followed.into_iter().map(|f| (f.object(), (f.summary.id, f.summary))).unzip();
    if let Finds::Masks { .. } = finds {
        // What a network of the user's finds is taken for a vehicle, and states no quality of its masks.
        summaries.clear();
        objects.iter_mut().for_each(|object: &mut TrackedObject| object.mask_quality = None);
    }
    Ok((objects, summaries))
}

/// Says of the objects that are not vehicles enough that they are not reconstructed.
///
/// * `summaries` – of the objects that the program found by itself.
/// * `sighted` – what the masks say of each.
fn leave_out(
    objects: &mut [TrackedObject],
    summaries: &BTreeMap<ObjectId, TrackSummary>,
    sighted: &BTreeMap<ObjectId, MaskEvidence>,
    outcome: &mut Outcome,
) {
    for object in objects {
        let Some((summary, sighted)) = summaries.get(&object.id).zip(sighted.get(&object.id)) else { continue };
        if let Err(reason) = support(summary, sighted) {
            outcome.warn(Topic::VehicleSkipped.warning(format!("object {}: skipped: {reason}", object.id)));
            object.left_out = Some(reason.to_string());
        }
    }
}

/// The masks of all tracked objects in one frame.
pub(in crate::pipeline) fn masks_of(
    run: &Run,
    objects: &[TrackedObject],
    frame: &Frame,
) -> Result<Vec<(ObjectId, Mask)>> {
    KeptMasks::done(run).read(objects, frame)
}

/// The mask of an object in a folder of images that is still in the making.
fn mask_in(run: &Run, folder: &Path, id: ObjectId, frame: &Frame) -> Result<Mask> {
    Ok(masks::read_mask(&mask_path(folder, id, frame), run.size())?)
}

/// Where the mask of an object lies in a folder of masks.
fn mask_path(folder: &Path, id: ObjectId, frame: &Frame) -> PathBuf {
    folder.join(id.to_string()).join(RunFolder::mask_name(frame))
}

/// The optical flow of the run's options.
pub(in crate::pipeline) fn load_flow_estimator(run: &Run) -> Result<Box<dyn FlowEstimator>> {
    let options = run.options;
    Ok(load_flow(options.flow_model.as_deref(), options.resources())?)
}

/// Refuses models of objects that there are not.
///
/// # Errors
/// [`PipelineError::Options`] says which there are.
pub(in crate::pipeline) fn check_models(run: &Run, ids: &BTreeSet<ObjectId>) -> Result<()> {
    let unknown = run.options.object_models.keys().find(|id| !ids.contains(id));
    let Some(id) = unknown else { return Ok(()) };
    let text = format!("--object-model {id}=...: object {id} does not exist; tracked: {}", list(ids));
    Err(PipelineError::Options(text))
}

/// Holds what was asked for by id against what was tracked.
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
