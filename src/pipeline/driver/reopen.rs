//! The input of a run that is over, for what is made of its results afterwards.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::run::FRAMES;
use super::workspace::read_state;
use super::{fingerprint, intermediate};
use crate::io::{RunFolder, json};
use crate::pipeline::inputs::cameras;
use crate::pipeline::{Completion, FeatureKind, FrameOrder, Instances, Options, PipelineError, Result, Workspace};
use crate::scene::Frame;
use crate::video::{self, Source};

/// Input in `run.json` and its reading options; the other options change from version to version.
#[derive(Deserialize)]
struct RunJson {
    input: InputJson,
    options: OptionsJson,
}

/// Input in `run.json`.
#[derive(Deserialize)]
pub(in crate::pipeline) struct InputJson {
    pub(in crate::pipeline) path: PathBuf,
}

#[derive(Deserialize)]
struct OptionsJson {
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
/// A folder without `run.json`; an input that is not there or cannot be read; [`PipelineError::OtherInput`] for a file
/// at its place from which the results were not made.
pub fn reopen(output: &Path, input: Option<&Path>) -> Result<Source> {
    let told: RunJson = json::read(&RunFolder::at(output).run_json())?;
    let OptionsJson { video, instances, features, order, background_model } = told.options;
    let options = Options { video, instances, features, order, background_model, ..Options::default() };
    if input.is_none() {
        check_input(output, &told.input.path)?;
    }
    cameras::open(input.unwrap_or(&told.input.path), &options)
}

/// Looks whether the results in `output` were made from a file or folder: an output folder that somebody else made can
/// name any file of the user's.
///
/// # Errors
/// [`PipelineError::OtherInput`]. A path at which there is nothing is for the caller.
pub(in crate::pipeline) fn check_input(output: &Path, input: &Path) -> Result<()> {
    if !input.exists() || Completion::of_folder(output).is_some_and(|ended| ended.is_of_files(input)) {
        return Ok(());
    }
    let content = Workspace::input_of(output).map(|input| input.content);
    match content.is_some() && fingerprint::of_content(input).ok() == content {
        true => Ok(()),
        false => Err(PipelineError::OtherInput { path: input.to_owned(), output: output.to_owned() }),
    }
}

/// The command line of the last run in `output`; `None` where its `run.json` cannot be read.
pub fn arguments_of_run(output: &Path) -> Option<Vec<String>> {
    #[derive(Deserialize)]
    struct OfRun {
        arguments: Vec<String>,
    }
    json::read(&RunFolder::at(output).run_json()).ok().map(|run: OfRun| run.arguments)
}

/// The frames of the run in `output` with their times; `None` where its own files do not tell them any more.
pub fn known_frames(output: &Path) -> Option<Vec<Frame>> {
    intermediate::checked_frames(read_state(output, FRAMES).ok()?).ok()
}
