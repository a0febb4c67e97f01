//! `tractrix telemetry FILE`: what is understood of a receiver's log.

use std::path::PathBuf;

use serde::Serialize;

use super::output::{Failure, Form, show};
use crate::telemetry::{self, Summary};

/// Says what is understood of a file of telemetry: format, fixes, times, ranges, and what was passed over.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// DJI's subtitles, GPX, NMEA, CSV, a photograph, or a folder of photographs (see docs/telemetry.md)
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
    let summary = telemetry::read(&args.file)?.summary();
    let output = Output { file: args.file.clone(), summary };
    show(form, &output, || output.summary.as_text())
}
