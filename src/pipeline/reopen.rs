//! The input of a run that is over, for what is made of its results afterwards.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::{FeatureKind, FrameOrder, Instances, Options, PipelineError, cameras, own_file};
use crate::io::{RunFolder, json};
use crate::scene::Frame;
use crate::video::{self, Source};

/// What `run.json` tells of the input and how it was read; the other options change from version to version.
#[derive(Deserialize)]
struct Told {
    input: ToldInput,
    options: ToldOptions,
}

#[derive(Deserialize)]
struct ToldInput {
    path: PathBuf,
}

#[derive(Deserialize)]
struct ToldOptions {
    video: video::Options,
    instances: Instances,
    features: FeatureKind,
    order: FrameOrder,
    background_model: Option<PathBuf>,
}

/// Opens the input as the run in `output` opened it.
///
/// * `input` – where it lies now, if not where it lay then.
///
/// # Errors
/// A folder without `run.json`; an input that is not there or cannot be read.
pub fn reopen(output: &Path, input: Option<&Path>) -> Result<Source, PipelineError> {
    let told: Told = json::read(&RunFolder::at(output).run_json())?;
    let ToldOptions { video, instances, features, order, background_model } = told.options;
    let options = Options { video, instances, features, order, background_model, ..Options::default() };
    cameras::open(input.unwrap_or(&told.input.path), &options)
}

/// The frames of the run in `output` with their times; `None` where its own files do not tell them any more.
pub fn known_frames(output: &Path) -> Option<Vec<Frame>> {
    let frames = json::read(&output.join(RunFolder::STATE).join("frames-list.json")).ok()?;
    own_file::checked(frames).ok()
}
