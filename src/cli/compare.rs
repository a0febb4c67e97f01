//! `tractrix compare A B`: how far two reconstructions of the same images are apart.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context;

use crate::eval::comparison::compare;
use crate::io::model;

/// Compares two reconstructions of the same images, in any format that is read.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// COLMAP folder, output folder of `tractrix run`, or OpenMVG's sfm_data.json; sets frame and unit
    #[arg(value_name = "A")]
    pub a: PathBuf,
    /// The other one
    #[arg(value_name = "B")]
    pub b: PathBuf,
    /// Print the figures as JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// Compares and prints the figures.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let comparison = compare(&model::read(&args.a)?, &model::read(&args.b)?);
    let text = if args.json { serde_json::to_string_pretty(&comparison)? + "\n" } else { comparison.to_string() };
    std::io::stdout().lock().write_all(text.as_bytes()).context("cannot print the figures")
}
