//! The one way through the pictures: every stage that looks at frames takes them here.

use ::image::RgbImage;

use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::{PipelineError, Stage};
use crate::scene::{Frame, Topic};
use crate::video::{Frames, VideoError};

/// Hands every picture to `run_stage`, as a part of a stage's progress with a step each. A frame that cannot be decoded
/// is left out, and the first stage that meets it says so.
///
/// * `frames` – with their number.
///
/// # Errors
/// What `run_stage` says; that the machine is at fault where a frame cannot be decoded: what comes of that must not be
/// taken for a result by the next run.
pub(in crate::pipeline) fn for_each(
    run: &Run,
    stage: Stage,
    (frames, number): (Frames, usize),
    outcome: &mut Outcome,
    mut run_stage: impl FnMut(Frame, RgbImage) -> Result<(), PipelineError>,
) -> Result<(), PipelineError> {
    run.progress.begin(stage.name(), Some(number as u64));
    for item in frames {
        match item {
            Ok((frame, picture)) => run_stage(frame, picture)?,
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
