//! The input of a run that is over, for what is made of its results afterwards.

use std::path::Path;

use super::report::Told;
use super::{PipelineError, cameras};
use crate::io::{RunFolder, json};
use crate::scene::Frame;
use crate::video::Source;

/// Opens the input as the run in `output` opened it.
///
/// * `input` – where it lies now, if not where it lay then.
///
/// # Errors
/// A folder without `run.json`; an input that is not there or cannot be read.
pub fn reopen(output: &Path, input: Option<&Path>) -> Result<Source, PipelineError> {
    let told: Told = json::read(&RunFolder::at(output).run_json())?;
    cameras::open(input.unwrap_or(&told.input.path), &told.options)
}

/// The frames of the run in `output` with their times; `None` where its own files do not tell them any more.
pub fn known_frames(output: &Path) -> Option<Vec<Frame>> {
    json::read(&output.join(RunFolder::STATE).join("frames-list.json")).ok()
}
