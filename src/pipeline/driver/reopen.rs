//! The input of a run that is over, for what is made of its results afterwards.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::{Map, Value};

use super::run::FRAMES;
use super::workspace::read_state;
use super::{fingerprint, intermediate};
use crate::io::{OwnedFolder, RunFolder, json};
use crate::pipeline::inputs::cameras;
use crate::pipeline::{Completion, Options, PipelineError, Result};
use crate::scene::Frame;
use crate::video::Source;

/// Content of `run.json` that commands read.
#[derive(Deserialize)]
pub(in crate::pipeline) struct RunJson {
    pub(in crate::pipeline) arguments: Vec<String>,
    pub(in crate::pipeline) input: InputJson,
    pub(in crate::pipeline) options: Map<String, Value>,
}

#[derive(Deserialize)]
pub(in crate::pipeline) struct InputJson {
    pub(in crate::pipeline) path: PathBuf,
}

impl RunJson {
    pub(in crate::pipeline) fn read(output: &Path) -> Result<Self> {
        Ok(json::read(&RunFolder::at(output).run_json())?)
    }
}

/// Opens the input as the run in `output` opened it.
///
/// * `input` – where it lies now, if not where it lay then.
///
/// # Errors
/// A folder without `run.json`; an input that is not there or cannot be read; [`PipelineError::OtherInput`] for a file
/// at its place from which the results were not made.
pub fn reopen(output: &Path, input: Option<&Path>) -> Result<Source> {
    let RunJson { input: told, mut options, .. } = RunJson::read(output)?;
    // The other options change from version to version.
    options.retain(|name, _| ["video", "instances", "features", "order", "background_model"].contains(&name.as_str()));
    if input.is_none() {
        check_input(output, &told.path)?;
    }
    cameras::open(input.unwrap_or(&told.path), &Options::default().with_tree(&Value::Object(options))?)
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
    let content = OwnedFolder::input_of(output, RunFolder::MADE_BY).map(|input| input.content);
    match content.is_some() && fingerprint::of_content(input).ok() == content {
        true => Ok(()),
        false => Err(PipelineError::OtherInput { path: input.to_owned(), output: output.to_owned() }),
    }
}

/// The command line of the last run in `output`; `None` where its `run.json` cannot be read.
pub fn arguments_of_run(output: &Path) -> Option<Vec<String>> {
    RunJson::read(output).ok().map(|run| run.arguments)
}

/// The frames of the run in `output` with their times; `None` where its own files do not tell them any more.
pub fn known_frames(output: &Path) -> Option<Vec<Frame>> {
    intermediate::checked_frames(read_state(output, FRAMES).ok()?).ok()
}
