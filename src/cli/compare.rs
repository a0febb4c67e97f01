//! `tractrix compare A B`: how far two reconstructions of the same images are apart.

use std::path::PathBuf;

use super::output::{Failure, Form, show};
use crate::eval::comparison::compare;
use crate::io::model;

/// Compares two reconstructions of the same images, in any format that is read.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// COLMAP folder, output folder of `tractrix run`, or OpenMVG's sfm_data.json; sets frame and unit
    #[arg(value_name = "A")]
    pub(super) a: PathBuf,
    /// The other one
    #[arg(value_name = "B")]
    pub(super) b: PathBuf,
}

/// Compares and prints the figures.
pub(super) fn run(args: &Args, form: Form) -> Result<(), Failure> {
    let (a, _) = model::read(&args.a)?;
    let (b, _) = model::read(&args.b)?;
    let comparison = compare(&a, &b);
    show(form, &comparison, || comparison.to_string())
}
