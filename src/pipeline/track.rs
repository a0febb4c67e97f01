//! Stage `track`: one mask per object and frame.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use ::image::RgbImage;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::given_masks::MaskFolder;
use super::run::{Outcome, Run};
use super::{Instances, PipelineError, fingerprint, pictures, segment};
use crate::io::{IoError, RunFolder, masks};
use crate::perception::{FlowEstimator, TrackSummary, TrackedMask, Tracker, load_flow};
use crate::scene::{Frame, FrameId, Mask, ObjectId};

/// A vehicle that was followed through the frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct TrackedObject {
    pub(super) id: ObjectId,
    pub(super) class: String,
    /// Mean score of its detections, 0 to 1; 1 for given masks.
    pub(super) confidence: f64,
    /// Frames with a mask, ascending.
    pub(super) frames: Vec<FrameId>,
    /// Those whose mask was carried by flow and not detected.
    pub(super) num_carried: usize,
}

/// The name of the list of tracked objects among the run's own files.
const LIST: &str = "objects-list.json";
/// What given masks show; they do not say it.
const GIVEN_CLASS: &str = "vehicle";

pub(super) fn depends_on(run: &Run) -> Result<Value, PipelineError> {
    let options = run.options;
    Ok(match &options.instances {
        Instances::None => json!("none"),
        Instances::Masks(folder) => json!({ "masks": fingerprint::of_content(folder)? }),
        Instances::Model(_) => {
            let flow_model = options.flow_model.as_deref().map(fingerprint::of_content).transpose()?;
            json!({ "tracker": options.tracker, "flow": { "options": options.flow, "model": flow_model } })
        }
        Instances::Vehicles => json!("vehicles"),
    })
}

pub(super) fn work(run: &Run) -> Result<Outcome, PipelineError> {
    let mut outcome = Outcome::default();
    let objects = run.workspace.put_folder(&run.workspace.tracks(), |folder| match &run.options.instances {
        Instances::None => Ok(Vec::new()),
        Instances::Masks(given) => split_given(run, given, folder, &mut outcome),
        Instances::Model(_) | Instances::Vehicles => follow(run, folder, &mut outcome),
    })?;
    if objects.is_empty() && run.options.instances != Instances::None {
        outcome.warn("no vehicle is tracked: there are no object trajectories in the result");
    }
    run.workspace.write_state(LIST, &objects)?;
    outcome.figure("num_objects", objects.len());
    outcome.outputs.extend([run.workspace.tracks(), run.workspace.state(LIST)]);
    Ok(outcome)
}

/// The tracked objects; the stage must be done.
pub(super) fn objects(run: &Run) -> Result<Vec<TrackedObject>, PipelineError> {
    run.workspace.read_state(LIST)
}

/// The masks of all tracked objects in one frame.
pub(super) fn masks_of(
    run: &Run,
    objects: &[TrackedObject],
    frame: &Frame,
) -> Result<Vec<(ObjectId, Mask)>, PipelineError> {
    let size = (run.info().width, run.info().height);
    let seen = objects.iter().filter(|object| object.frames.binary_search(&frame.id).is_ok());
    seen.map(|object| Ok((object.id, masks::read_mask(&run.workspace.mask(object.id, frame), size)?))).collect()
}

/// One mask per label of the given label maps.
fn split_given(
    run: &Run,
    given: &Path,
    folder: &Path,
    outcome: &mut Outcome,
) -> Result<Vec<TrackedObject>, PipelineError> {
    let frames = run.frames()?;
    let files = MaskFolder::open(given, frames, run.info())?;
    if let Some(warning) = files.warning(given, frames) {
        outcome.warn(warning);
    }
    outcome.figure("num_frames_without_mask", files.missing.len());
    run.progress.begin("track", Some(frames.len() as u64));
    let mut seen: BTreeMap<ObjectId, Vec<FrameId>> = BTreeMap::new();
    for frame in frames {
        run.progress.step();
        let Some(labels) = files.labels(frame.id)? else { continue };
        for label in labels.present() {
            let id = ObjectId(label.into());
            masks::write_mask(&folder.join(id.to_string()).join(RunFolder::mask_name(frame)), &labels.mask(label))?;
            seen.entry(id).or_default().push(frame.id);
        }
    }
    let object =
        |(id, frames)| TrackedObject { id, class: GIVEN_CLASS.to_owned(), confidence: 1.0, frames, num_carried: 0 };
    Ok(seen.into_iter().map(object).collect())
}

/// The optical flow of the run's options.
pub(super) fn load_flow_estimator(run: &Run) -> Result<Box<dyn FlowEstimator>, PipelineError> {
    let options = run.options;
    Ok(load_flow(options.flow_model.as_deref(), &options.flow, options.threads.unwrap_or(0))?)
}

/// Refuses models of objects that there are not.
///
/// # Errors
/// [`PipelineError::Options`] says which there are.
pub(super) fn check_models(run: &Run, ids: &BTreeSet<ObjectId>) -> Result<(), PipelineError> {
    let unknown = run.options.object_models.keys().find(|id| !ids.contains(id));
    let Some(id) = unknown else { return Ok(()) };
    let text = format!("--object-model {id}=...: there is no object {id}; tracked are: {}", list(ids));
    Err(PipelineError::Options(text))
}

/// Holds what was asked for by id against what was tracked.
///
/// # Errors
/// As [`check_models`].
pub(super) fn check_ids(run: &Run, tracked: &[TrackedObject], outcome: &mut Outcome) -> Result<(), PipelineError> {
    let ids: BTreeSet<ObjectId> = tracked.iter().map(|object| object.id).collect();
    check_models(run, &ids)?;
    for id in run.options.only_objects.difference(&ids) {
        outcome.warn(format!("--only-object {id}: there is no object {id}; tracked are: {}", list(&ids)));
    }
    Ok(())
}

fn list(ids: &BTreeSet<ObjectId>) -> String {
    let ids: Vec<String> = ids.iter().map(ToString::to_string).collect();
    if ids.is_empty() { "none".to_owned() } else { ids.join(", ") }
}

/// Joins detections to tracks by optical flow.
fn follow(run: &Run, folder: &Path, outcome: &mut Outcome) -> Result<Vec<TrackedObject>, PipelineError> {
    let frames = run.frames()?;
    let mut flow = load_flow_estimator(run)?;
    let mut tracker = Tracker::new(run.options.tracker.clone());
    let detections = segment::finished(run);
    let mut previous: Option<RgbImage> = None;
    let mut seen: BTreeMap<ObjectId, BTreeSet<FrameId>> = BTreeMap::new();
    run.progress.begin("track", Some(frames.len() as u64));
    pictures::for_each(run, run.source.frames()?, outcome, |frame, picture| {
        let found = detections.read(frame.id)?;
        let carried = previous.as_ref().map(|previous| flow.flow(previous, &picture)).transpose()?;
        for TrackedMask { object, mask, .. } in tracker.advance(&frame, &picture, found, carried.as_ref())? {
            masks::write_mask(&provisional(folder, object).join(RunFolder::mask_name(&frame)), &mask)?;
            seen.entry(object).or_default().insert(frame.id);
        }
        previous = Some(picture);
        Ok(())
    })?;
    let names: BTreeMap<FrameId, &Frame> = frames.iter().map(|frame| (frame.id, frame)).collect();
    let summaries = tracker.finish();
    let objects =
        summaries.into_iter().map(|summary| settle(folder, summary, &mut seen, &names)).collect::<Result<_, _>>()?;
    for dropped in seen.into_keys() {
        run.workspace.remove_state(&provisional(folder, dropped))?;
    }
    Ok(objects)
}

fn provisional(folder: &Path, id: ObjectId) -> std::path::PathBuf {
    folder.join(format!("provisional-{id}"))
}

/// Gives a confirmed object its lasting id, without the masks that nothing confirms.
fn settle(
    folder: &Path,
    summary: TrackSummary,
    seen: &mut BTreeMap<ObjectId, BTreeSet<FrameId>>,
    names: &BTreeMap<FrameId, &Frame>,
) -> Result<TrackedObject, PipelineError> {
    let from = provisional(folder, summary.provisional);
    let mut frames = seen.remove(&summary.provisional).unwrap_or_default();
    let confirmed = summary.first..=summary.last;
    for frame in frames.extract_if(.., |frame| !confirmed.contains(frame)) {
        if let Some(frame) = names.get(&frame) {
            let mask = from.join(RunFolder::mask_name(frame));
            std::fs::remove_file(&mask).map_err(IoError::system("remove", &mask))?;
        }
    }
    let to = folder.join(summary.id.to_string());
    std::fs::rename(&from, &to).map_err(IoError::system("rename", &from))?;
    Ok(TrackedObject {
        id: summary.id,
        class: summary.class,
        confidence: summary.confidence,
        frames: frames.into_iter().collect(),
        num_carried: summary.num_carried,
    })
}
