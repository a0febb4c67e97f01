//! `tractrix evaluate OUT --truth SEQUENCE`: how far a run is from the truth.

use std::path::PathBuf;

use super::output::{Failure, Form, show};
use crate::pipeline::{self, Kept};

/// Compares the output of a run with a sequence whose truth is known.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Output folder of `tractrix run`
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Folder of the sequence: scene.json, masks/, object_mesh.ply
    #[arg(long, value_name = "SEQUENCE")]
    pub truth: PathBuf,
}

/// Evaluates, prints the figures, writes `OUT/evaluation.json`, and makes the report again with them.
pub(super) fn run(args: &Args, form: Form) -> Result<(), Failure> {
    let evaluation = pipeline::evaluate(&args.output, &args.truth)?;
    show(form, &evaluation, || evaluation.to_string())?;
    let output = args.output.display();
    match pipeline::keep_evaluation(&args.output, &args.truth, &evaluation)? {
        Kept::Everywhere => {}
        Kept::WithoutPage(reason) => tracing::warn!("{output}/report.html does not show the evaluation: {reason}"),
        Kept::Nowhere => tracing::warn!(
            "{output}: was not made by tractrix run, so evaluation.json is not written into it; --json prints its \
             content"
        ),
    }
    Ok(())
}
