//! Stage `segment`: detection of movable objects in every frame: masks by a network of the user's, or boxes by the
//! detector.

pub(in crate::pipeline) mod detections;
pub(in crate::pipeline) mod schedule;

use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use crate::image::RgbImage;
use crate::networks::{PerceptionError, Segmenter, load_segmenter};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::images;
use crate::pipeline::inputs::networks::{Networks, hashes_by_name, of_networks};
use crate::pipeline::{Instances, Result, Stage};
use crate::scene::{BoxDetection, Detection, Frame, Topic};
use detections::FrameFolder;
use schedule::Schedule;

/// The boxes of a run, by frame.
pub(in crate::pipeline) type BoxFolder = FrameFolder<BoxDetection>;
/// The detections of a run, by frame.
pub(in crate::pipeline) type DetectionFolder = FrameFolder<Detection>;

pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    Ok(match &run.options.instances {
        Instances::None => json!("none"),
        // Given masks are read by later stages; this one has nothing to do.
        Instances::Masks(_) => json!("masks"),
        Instances::Model(path) => json!({
            "model": of_networks(run, std::slice::from_ref(path))?,
            "options": run.options.segmentation,
        }),
        Instances::Vehicles => {
            let detector = of_networks(run, Networks::of(run)?.detector.as_slice())?;
            let every = Schedule::of(run)?.detector;
            json!({ "detector": detector, "options": run.options.detector, "every": every })
        }
    })
}

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    match &run.options.instances {
        Instances::None | Instances::Masks(_) => Ok(()),
        Instances::Model(path) => find_masks(run, path, outcome),
        Instances::Vehicles => find_boxes(run, outcome),
    }
}

/// The masks by the user's network; the stage must be done.
pub(in crate::pipeline) fn finished(run: &Run) -> DetectionFolder {
    FrameFolder::new(run.folder(Stage::Segment))
}

/// The boxes by the detector; the stage must be done.
pub(in crate::pipeline) fn finished_boxes(run: &Run) -> BoxFolder {
    FrameFolder::new(run.folder(Stage::Segment))
}

/// Loads the user's network with the options of the run.
pub(in crate::pipeline) fn load(run: &Run, model: &Path) -> Result<Box<dyn Segmenter>> {
    Ok(load_segmenter(model, &run.options.segmentation, run.options.resources())?)
}

fn find_masks(run: &Run, model: &Path, outcome: &mut Outcome) -> Result<()> {
    let path = run.workspace.intermediate(Stage::Segment, &outcome.fingerprint)?;
    let store = DetectionFolder::new(path.clone());
    let mut segmenter = load(run, model)?;
    outcome.figure("networks", hashes_by_name([&model.to_owned()])?);
    let found = search(run, run.frames()?.iter(), &store, outcome, |picture| segmenter.segment(picture))?;
    if found == 0 {
        outcome.warn(Topic::ModelFindsNoVehicle.warning(format!(
            "{}: no vehicle detected in any frame; the network may not know such views, or the vehicles are too small \
             (options segmentation.tiling, segmentation.confidence)",
            model.display()
        )));
    }
    outcome.outputs.push(path);
    Ok(())
}

fn find_boxes(run: &Run, outcome: &mut Outcome) -> Result<()> {
    let path = run.workspace.intermediate(Stage::Segment, &outcome.fingerprint)?;
    outcome.outputs.push(path.clone());
    let networks = Networks::of(run)?;
    networks.doubts.iter().for_each(|doubt| outcome.warn(Topic::NetworksMissing.warning(doubt)));
    let Some(mut detector) = networks.load_detector(run)? else { return Ok(()) };
    outcome.figure("networks", hashes_by_name(&networks.detector)?);
    let store = BoxFolder::new(path);
    let schedule = Schedule::of(run)?;
    let scheduled = run.frames()?.iter().enumerate().filter(|(index, _)| schedule.is_detected(*index));
    search(run, scheduled.map(|(_, frame)| frame), &store, outcome, |picture| detector.detect(picture))?;
    Ok(())
}

/// Runs a detector on the frames that an earlier run has not finished. Returns the number of detections in all frames.
fn search<'a, T: Serialize + DeserializeOwned>(
    run: &Run,
    frames: impl Iterator<Item = &'a Frame>,
    store: &FrameFolder<T>,
    outcome: &mut Outcome,
    mut detect: impl FnMut(&RgbImage) -> Result<Vec<T>, PerceptionError>,
) -> Result<usize> {
    let (done, open): (Vec<&Frame>, Vec<&Frame>) = frames.partition(|frame| store.has(frame));
    tracing::debug!("{} of {} frames already processed", done.len(), done.len() + open.len());
    let mut found = 0;
    for frame in done {
        found += store.read(frame.id)?.len();
    }
    let open = open.iter().map(|frame| frame.id).collect();
    images::for_each(run, Stage::Segment, open, outcome, |frame, picture| {
        let detections = detect(&picture)?;
        found += detections.len();
        store.write(&frame, &detections)
    })?;
    outcome.figure("num_detections", found);
    Ok(found)
}
