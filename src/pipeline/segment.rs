//! Stage `segment`: the instances in every frame.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::{Value, json};

use super::detections::DetectionFolder;
use super::run::{Outcome, Run};
use super::{Instances, PipelineError, Stage, fingerprint, pictures};
use crate::perception::{Segmenter, load_segmenter};

pub(super) fn depends_on(run: &Run) -> Result<Value, PipelineError> {
    Ok(match &run.options.instances {
        Instances::None => json!("none"),
        // Given masks are read by the next stage; this one has nothing to do.
        Instances::Masks(_) => json!("masks"),
        Instances::Model(path) => json!({
            "model": fingerprint::of_content(path)?,
            "options": run.options.segmentation,
        }),
    })
}

pub(super) fn work(run: &Run, fingerprint: &str) -> Result<Outcome, PipelineError> {
    match &run.options.instances {
        Instances::None | Instances::Masks(_) => Ok(Outcome::default()),
        Instances::Model(path) => detect(run, path, fingerprint),
    }
}

/// Where the detections of a run lie; `None` where there are none.
pub(super) fn folder(run: &Run, fingerprint: &str) -> Option<DetectionFolder> {
    let size = (run.info().width, run.info().height);
    let is_model = matches!(run.options.instances, Instances::Model(_));
    is_model.then(|| DetectionFolder::new(run.workspace.state(&folder_name(fingerprint)), size))
}

/// As [`folder`], of the stage that this run has been through.
pub(super) fn finished(run: &Run) -> Option<DetectionFolder> {
    folder(run, run.fingerprint(Stage::Segment))
}

fn folder_name(fingerprint: &str) -> String {
    format!("detections-{}", fingerprint.get(..16).unwrap_or_default())
}

/// Loads the model with the options of the run.
pub(super) fn load(run: &Run, model: &Path) -> Result<Box<dyn Segmenter>, PipelineError> {
    let num_threads = run.options.threads.unwrap_or(0);
    Ok(load_segmenter(model, &run.options.segmentation, num_threads)?)
}

fn detect(run: &Run, model: &Path, fingerprint: &str) -> Result<Outcome, PipelineError> {
    let path = run.workspace.keep_only("detections-", &folder_name(fingerprint))?;
    let store = DetectionFolder::new(path.clone(), (run.info().width, run.info().height));
    let mut segmenter = load(run, model)?;
    let frames = run.frames()?;
    let open: BTreeSet<_> = frames.iter().filter(|frame| !store.has(frame)).map(|frame| frame.id).collect();
    run.progress.begin("segment", Some(open.len() as u64));
    let mut outcome = Outcome::default();
    tracing::debug!("{} of {} frames were segmented before", frames.len() - open.len(), frames.len());
    let before = frames.iter().filter(|frame| !open.contains(&frame.id));
    let mut found = before.map(|frame| store.count(frame.id)).sum::<Result<u64, _>>()?;
    pictures::for_each(run, run.source.frames_at(open)?, &mut outcome, |frame, picture| {
        let detections = segmenter.segment(&picture)?;
        found += detections.len() as u64;
        store.write(&frame, &detections)
    })?;
    outcome.figure("num_detections", found);
    if found == 0 {
        outcome.warn(format!(
            "{}: the model finds no vehicle in any frame; it may not know such views, or the vehicles are too small \
             for it (options segmentation.tiling and segmentation.confidence)",
            model.display()
        ));
    }
    outcome.outputs.push(path);
    Ok(outcome)
}
