//! Stage `segment`: the instances in every frame.

use std::collections::BTreeSet;
use std::path::Path;

use serde_json::{Value, json};

use super::detections::DetectionFolder;
use super::run::{Outcome, Run};
use super::{Instances, PipelineError, Stage, fingerprint};
use crate::perception::{SegmentationOptions, load_segmenter};
use crate::scene::Frame;

pub(super) fn depends_on(run: &Run) -> Result<Value, PipelineError> {
    Ok(match &run.options.instances {
        Instances::None => json!("none"),
        // Given masks are read by the next stage; this one has nothing to do.
        Instances::Masks(_) => json!("masks"),
        Instances::Model(path) => json!({
            "model": fingerprint::of_content(path)?,
            // The number of threads is no part of the result.
            "options": SegmentationOptions { num_threads: 0, ..run.options.segmentation.clone() },
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

fn detect(run: &Run, model: &Path, fingerprint: &str) -> Result<Outcome, PipelineError> {
    let path = run.workspace.keep_only("detections-", &folder_name(fingerprint))?;
    let store = DetectionFolder::new(path.clone(), (run.info().width, run.info().height));
    let num_threads = run.options.threads.unwrap_or(0);
    let mut segmenter =
        load_segmenter(model, &SegmentationOptions { num_threads, ..run.options.segmentation.clone() })?;
    let frames = run.frames()?;
    let open: BTreeSet<_> = frames.iter().filter(|frame| !store.has(frame)).map(|frame| frame.id).collect();
    run.progress.begin("segment", Some(open.len() as u64));
    let mut outcome = Outcome::default();
    let num_open = open.len();
    for item in run.source.frames_at(open)? {
        run.progress.step();
        match item {
            Ok((frame, picture)) => store.write(&frame, &segmenter.segment(&picture)?)?,
            Err(error) => outcome.warn(error.to_string()),
        }
    }
    tracing::debug!("{} of {} frames were segmented before", frames.len() - num_open, frames.len());
    let found = count(&store, frames)?;
    outcome.figure("num_detections", found);
    if found == 0 {
        outcome.warn(format!("{}: the model finds nothing that moves in any frame", model.display()));
    }
    outcome.outputs.push(path);
    Ok(outcome)
}

fn count(store: &DetectionFolder, frames: &[Frame]) -> Result<usize, PipelineError> {
    frames.iter().try_fold(0, |sum, frame| Ok(sum + store.read(frame.id)?.len()))
}
