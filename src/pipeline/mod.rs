//! Stage order, options tree, progress; what is done is not done twice.
//!
//! Every stage reads what earlier stages left in the output folder and leaves its own files there, whole or not at all,
//! and last of all a marker in `.tractrix/` with a fingerprint of everything that the result was made from. A stage whose
//! marker has the fingerprint of the moment is skipped: a run that was killed goes on where it was, a changed option does
//! the stages anew that it touches and those after them, a changed input all of them.
//!
//! Entry point: [`run`].

mod detections;
mod error;
mod exports;
mod features;
mod fingerprint;
mod frames;
mod given_masks;
mod ground;
mod masking;
mod meter;
mod models;
mod objects;
mod options;
mod order;
mod progress;
mod report;
mod run;
mod run_json;
mod scale;
mod segment;
mod stage;
mod track;
mod workspace;

use std::path::{Path, PathBuf};

use serde_json::json;

pub use error::PipelineError;
pub use meter::{Cost, process_cpu_s};
pub use options::{FeatureKind, FrameOrder, GroundLabels, Instances, Intrinsics, MaskingOptions, Options};
pub use progress::{Progress, Silent};
pub use run::StageRecord;
pub use scale::{AsReconstructed, as_reconstructed};
pub use stage::Stage;
pub use workspace::{Marker, Workspace};

use crate::video::Source;
use run::Run;

/// What a run did.
#[derive(Clone, Debug)]
pub struct Summary {
    /// The output folder.
    pub output: PathBuf,
    /// The stages up to the goal, in order.
    pub stages: Vec<StageRecord>,
    /// What is wrong although there is a result.
    pub warnings: Vec<String>,
    /// Why there is no background to speak of, where there is none: the input did not give what was asked for, although
    /// all that could be found stands in the output folder.
    pub failure: Option<String>,
}

/// Does everything up to and with the stage `goal`, as far as it is not done already.
///
/// `arguments` is the command line, for `run.json` and the report.
///
/// # Errors
/// [`PipelineError`] when there can be no result; what concerns single frames or objects is counted and reported instead.
pub fn run(
    input: &Path,
    output: &Path,
    options: &Options,
    goal: Stage,
    arguments: &[String],
    progress: &dyn Progress,
) -> Result<Summary, PipelineError> {
    options.check()?;
    let source = Source::open(input, &options.video)?;
    let workspace = Workspace::open(output)?;
    let mut run = Run::new(options, &workspace, &source, arguments, progress);
    let result = stages(&mut run, goal);
    let error = result.as_ref().err().map(ToString::to_string);
    run_json::write(&run, error.as_deref())?;
    let failure = result?;
    Ok(Summary { output: output.to_owned(), warnings: run.warnings(), stages: run.records, failure })
}

fn stages(run: &mut Run, goal: Stage) -> Result<Option<String>, PipelineError> {
    run.progress.begin("input", None);
    let input = fingerprint::of_content(run.input())?;
    run.progress.end(false);
    for stage in Stage::ALL.into_iter().filter(|stage| *stage <= goal) {
        one_stage(run, stage, &input)?;
    }
    if goal < Stage::Background {
        return Ok(None);
    }
    let (_, report) = models::background(run)?;
    Ok(report.failure.map(|failure| format!("the background cannot be reconstructed: {failure}")))
}

fn one_stage(run: &mut Run, stage: Stage, input: &str) -> Result<(), PipelineError> {
    use Stage::{Background, Features, Frames, Ground, Objects, Report, Scale, Segment, Track};
    match stage {
        Frames => run.stage(stage, &[], frames::depends_on(run, input), |run, _| frames::work(run)),
        Segment => run.stage(stage, &[Frames], segment::depends_on(run)?, segment::work),
        Track => run.stage(stage, &[Frames, Segment], track::depends_on(run)?, |run, _| track::work(run)),
        Features => run.stage(stage, &[Frames, Segment, Track], features::depends_on(run)?, features::work),
        Background => {
            let depends_on = models::background_depends_on(run)?;
            run.stage(stage, &[Features], depends_on, |run, _| models::background_work(run))
        }
        Objects => run.stage(stage, &[Features, Background], objects::depends_on(run)?, objects::work),
        Ground => run.stage(stage, &[Background, Objects], ground::depends_on(run)?, ground::work),
        Scale => run.stage(stage, &[Ground], scale::depends_on(run), |run, _| scale::work(run)),
        // The page shows the command line and what every stage cost, so it is made anew whenever anything was done.
        Report => {
            if !run.all_reused() {
                run.workspace.clear_marker(stage)?;
            }
            run.stage(stage, &[Scale], json!({ "arguments": run.arguments }), |run, _| report::work(run))
        }
    }
}
