//! The input of a finished run, for commands that process its results.

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

/// Content of `run.json` that other commands read.
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

/// Opens the input with the options of the run in `output`.
///
/// * `input` – its present path, if it was moved.
///
/// # Errors
/// A folder without `run.json`; a missing or unreadable input; [`PipelineError::OtherInput`] if the file at its path is
/// not the one that the results were made from.
pub fn reopen(output: &Path, input: Option<&Path>) -> Result<Source> {
    let RunJson { input: told, mut options, .. } = RunJson::read(output)?;
    // The other options change between versions.
    options.retain(|name, _| ["video", "instances", "features", "order", "background_model"].contains(&name.as_str()));
    if input.is_none() {
        check_input(output, &told.path)?;
    }
    cameras::open(input.unwrap_or(&told.path), &Options::default().with_tree(&Value::Object(options))?)
}

/// Checks that the results in `output` were made from a file or folder: an output folder from an untrusted source can
/// name any file of the user's.
///
/// # Errors
/// [`PipelineError::OtherInput`]. The caller handles a path without a file.
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

/// The command line of the last run in `output`; `None` if its `run.json` cannot be read.
pub fn arguments_of_run(output: &Path) -> Option<Vec<String>> {
    RunJson::read(output).ok().map(|run| run.arguments)
}

/// The frames of the run in `output` with their times; `None` if its intermediate files are missing or damaged.
pub fn known_frames(output: &Path) -> Option<Vec<Frame>> {
    intermediate::checked_frames(read_state(output, FRAMES).ok()?).ok()
}
