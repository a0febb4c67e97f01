//! `tractrix telemetry FILE`: what is understood of a receiver's log.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::output::{Failure, Form, show};
use crate::pipeline;
use crate::telemetry::{self, Log, Summary, TelemetryError};

/// Show what was parsed from a telemetry file: format, fixes, times, ranges, and what was skipped
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// DJI subtitles, GPX, NMEA, CSV, video with a text track, photograph, or folder of them (docs/telemetry.md)
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
    let summary = read(&args.file)?.summary();
    let output = Output { file: args.file.clone(), summary };
    show(form, &output, || output.summary.as_text())
}

/// A file that is no log may be a video with one in its text track.
fn read(file: &Path) -> Result<Log, TelemetryError> {
    match telemetry::read(file) {
        Err(error @ (TelemetryError::Unknown { .. } | TelemetryError::TooLarge { .. })) => {
            pipeline::telemetry_inside(file, None).unwrap_or(Err(error))
        }
        found => found,
    }
}
