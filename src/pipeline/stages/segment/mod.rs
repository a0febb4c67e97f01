//! Stage `segment`: what may move, in every frame: masks by a network of the user's, or boxes by the detector.

pub(in crate::pipeline) mod detections;
pub(in crate::pipeline) mod schedule;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::networks::{Segmenter, load_segmenter};
use crate::pipeline::driver::fingerprint;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::images;
use crate::pipeline::inputs::networks::{Networks, of_networks};
use crate::pipeline::{Instances, PipelineError, Stage};
use crate::scene::{BoxDetection, Frame, FrameId, Topic};
use detections::{DetectionFolder, FrameFolder};
use schedule::Schedule;

/// The boxes of a run, by frame.
pub(in crate::pipeline) type BoxFolder = FrameFolder<BoxDetection>;

pub(in crate::pipeline) const MASKS: &str = "detections-";
pub(in crate::pipeline) const BOXES: &str = "boxes-";

pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value, PipelineError> {
    Ok(match &run.options.instances {
        Instances::None => json!("none"),
        // Given masks are read by later stages; this one has nothing to do.
        Instances::Masks(_) => json!("masks"),
        Instances::Model(path) => json!({
            "model": of_networks(run, std::slice::from_ref(path))?,
            "options": run.options.segmentation,
        }),
        Instances::Vehicles => {
            let detector = Networks::of(run)?.fingerprint_of_detector(run)?;
            let every = Schedule::of(run)?.detector;
            json!({ "detector": detector, "options": run.options.detector, "every": every })
        }
    })
}

pub(in crate::pipeline) fn run_stage(run: &Run, fingerprint: &str) -> Result<Outcome, PipelineError> {
    match &run.options.instances {
        Instances::None | Instances::Masks(_) => Ok(Outcome::default()),
        Instances::Model(path) => find_masks(run, path, fingerprint),
        Instances::Vehicles => find_boxes(run, fingerprint),
    }
}

/// The masks that the user's network found; the stage must be done.
pub(in crate::pipeline) fn finished(run: &Run) -> DetectionFolder {
    masks_in(run, run.workspace.state(&fingerprint::folder_name(MASKS, run.fingerprint(Stage::Segment))))
}

/// The boxes that the detector found; the stage must be done.
pub(in crate::pipeline) fn finished_boxes(run: &Run) -> BoxFolder {
    FrameFolder::new(run.workspace.state(&fingerprint::folder_name(BOXES, run.fingerprint(Stage::Segment))))
}

fn masks_in(run: &Run, folder: PathBuf) -> DetectionFolder {
    DetectionFolder::new(folder, (run.info().width, run.info().height))
}

/// Loads the user's network with the options of the run.
pub(in crate::pipeline) fn load(run: &Run, model: &Path) -> Result<Box<dyn Segmenter>, PipelineError> {
    Ok(load_segmenter(model, &run.options.segmentation, run.options.resources())?)
}

fn find_masks(run: &Run, model: &Path, fingerprint: &str) -> Result<Outcome, PipelineError> {
    let mut outcome = Outcome::default();
    let path = run.workspace.intermediate(MASKS, fingerprint)?;
    let store = masks_in(run, path.clone());
    let mut segmenter = load(run, model)?;
    let Split { open, done } = split(run.frames()?.iter(), |frame| store.has(frame));
    let mut found = done.iter().map(|frame| store.count(*frame)).sum::<Result<u64, _>>()?;
    let frames = (run.source.frames_at(open.clone())?, open.len());
    images::for_each(run, Stage::Segment, frames, &mut outcome, |frame, picture| {
        let detections = segmenter.segment(&picture)?;
        found += detections.len() as u64;
        store.write(&frame, &detections)
    })?;
    outcome.figure("num_detections", found);
    if found == 0 {
        outcome.warn(Topic::ModelFindsNoVehicle.warning(format!(
            "{}: no vehicle detected in any frame; the network may not know such views, or the vehicles are too small \
             (options segmentation.tiling, segmentation.confidence)",
            model.display()
        )));
    }
    outcome.outputs.push(path);
    Ok(outcome)
}

fn find_boxes(run: &Run, fingerprint: &str) -> Result<Outcome, PipelineError> {
    let mut outcome = Outcome::default();
    let path = run.workspace.intermediate(BOXES, fingerprint)?;
    outcome.outputs.push(path.clone());
    let networks = Networks::of(run)?;
    networks.doubts.iter().for_each(|doubt| outcome.warn(Topic::NetworksMissing.warning(doubt)));
    let Some(mut detector) = networks.load_detector(run)? else { return Ok(outcome) };
    let store = BoxFolder::new(path);
    let rhythm = Schedule::of(run)?;
    let looked = run.frames()?.iter().enumerate().filter(|(index, _)| rhythm.is_detected(*index));
    let Split { open, done } = split(looked.map(|(_, frame)| frame), |frame| store.has(frame));
    let mut found = done.iter().map(|frame| store.count(*frame)).sum::<Result<u64, _>>()?;
    let frames = (run.source.frames_at(open.clone())?, open.len());
    images::for_each(run, Stage::Segment, frames, &mut outcome, |frame, picture| {
        let boxes = detector.detect(&picture)?;
        found += boxes.len() as u64;
        store.write(&frame, &boxes)
    })?;
    outcome.figure("num_detections", found);
    Ok(outcome)
}

/// The frames to look at: those that a run that was stopped did, and the others.
struct Split {
    open: BTreeSet<FrameId>,
    done: Vec<FrameId>,
}

fn split<'a>(frames: impl Iterator<Item = &'a Frame>, is_done: impl Fn(&Frame) -> bool) -> Split {
    let (done, open): (Vec<&Frame>, Vec<&Frame>) = frames.partition(|frame| is_done(frame));
    tracing::debug!("{} of {} frames already processed", done.len(), done.len() + open.len());
    let ids = |frames: Vec<&Frame>| frames.into_iter().map(|frame| frame.id).collect::<Vec<_>>();
    Split { open: ids(open).into_iter().collect(), done: ids(done) }
}
