//! `tractrix evaluate OUT --truth SEQUENCE`: how far a run is from the truth.

use std::path::PathBuf;

use super::output::{Failure, Form, show};
use crate::pipeline::{self, SavedEvaluation};
use crate::scene::Topic;

/// Compare the output of a run with a sequence of known truth
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Output folder of `tractrix run`
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Sequence folder: scene.json, masks/, object_mesh.ply
    #[arg(long, value_name = "SEQUENCE")]
    pub truth: PathBuf,
}

/// Evaluates, prints the figures, writes `OUT/evaluation.json`, and makes the report again with them.
pub(super) fn run(args: &Args, form: Form) -> Result<(), Failure> {
    let evaluation = pipeline::evaluate(&args.output, &args.truth)?;
    show(form, &evaluation, || evaluation.to_string())?;
    let output = args.output.display();
    let problem = match pipeline::keep_evaluation(&args.output, &args.truth, &evaluation)? {
        SavedEvaluation::Everywhere => return Ok(()),
        SavedEvaluation::WithoutPage(reason) => format!("{output}/report.html: evaluation not added: {reason}"),
        SavedEvaluation::Nowhere => {
            format!("{output}: not made by tractrix run; evaluation.json not written, --json prints it")
        }
    };
    tracing::warn!("{}", Topic::EvaluationNotKept.warning(problem));
    Ok(())
}
