//! `tractrix telemetry FILE`: what is understood of a receiver's log.

use std::path::PathBuf;

use serde::Serialize;

use super::output::{Failure, Form, show};
use crate::memory::MemoryLimit;
use crate::pipeline;
use crate::telemetry::Summary;

/// Show what was parsed from a telemetry file: format, fixes, times, ranges, and what was skipped
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// Subtitles of a drone, GPX, KML, NMEA, table, video with telemetry, photograph, or folder of them
    /// (docs/telemetry.md)
    pub(super) file: PathBuf,
}

#[derive(Debug, Serialize)]
struct Output {
    file: PathBuf,
    #[serde(flatten)]
    summary: Summary,
}

/// Reads and prints.
///
/// # Errors
/// Why the file gives no position.
pub(super) fn run(args: &Args, form: Form) -> Result<(), Failure> {
    let summary = pipeline::telemetry_of(&args.file, MemoryLimit::of_machine())?.summary();
    let output = Output { file: args.file.clone(), summary };
    show(form, &output, || output.summary.as_text())
}
