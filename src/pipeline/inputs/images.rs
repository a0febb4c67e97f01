//! Iteration over the images of a run, for all stages.

use std::collections::BTreeSet;

use ::image::RgbImage;

use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::{Result, Stage};
use crate::scene::{Frame, FrameId, Topic};
use crate::video::VideoError;

/// Calls `process` for every selected image, and counts a step of the stage's progress for each. A frame that cannot be
/// decoded is skipped, with a warning by the first stage that reads it.
///
/// # Errors
/// Those of `process`; a frame that cannot be decoded because of the machine, since that must not become a result.
pub(in crate::pipeline) fn for_each(
    run: &Run,
    stage: Stage,
    wanted: BTreeSet<FrameId>,
    outcome: &mut Outcome,
    mut process: impl FnMut(Frame, RgbImage) -> Result<()>,
) -> Result<()> {
    let frames = run.source.frames_at(wanted.clone())?;
    run.progress.begin(stage.name(), Some(wanted.len() as u64));
    for item in frames {
        match item {
            Ok((frame, picture)) => process(frame, picture)?,
            Err(error) if error.is_of_machine() => return Err(error.into()),
            Err(error) => {
                let topic = match error {
                    VideoError::SizeChanges { .. } => Topic::FrameSizeChanges,
                    _ => Topic::FrameNotDecoded,
                };
                let warning = topic.warning(error.to_string());
                if !run.has_warned(&warning) {
                    outcome.warn(warning);
                }
            }
        }
        run.step()?;
    }
    Ok(())
}
