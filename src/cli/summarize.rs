//! `tractrix summary DIR...`: the results of many runs in one table.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow};
use serde_json::Value;

use super::output::{Failure, Form, print, print_json};
use crate::export::summary::Summary;
use crate::io::{FolderError, atomic, refuse_place_of_results};
use crate::math::rounding::counted;

/// Combine the results of many runs: one row per vehicle of every run, with reasons for missing ones
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Args {
    /// Output folders of `tractrix run`, or folders that contain them
    #[arg(value_name = "DIR", required = true)]
    pub(super) folders: Vec<PathBuf>,
    /// Format: table, or points on a map
    #[arg(long, value_enum, default_value_t)]
    pub(super) format: TableFormat,
    /// Output file [default: stdout]
    #[arg(short, long, value_name = "FILE")]
    pub(super) output: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long)]
    pub(super) overwrite: bool,
}

/// Form of the table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum TableFormat {
    /// Comma-separated values
    #[default]
    Csv,
    /// GeoJSON: one point per vehicle, at its first position
    Geojson,
}

/// Reads, writes and prints.
///
/// # Errors
/// A file that is there or cannot be written; folders that could not be read, after everything is written.
pub(super) fn run(args: &Args, form: Form) -> Result<(), Failure> {
    let summary = Summary::of(&args.folders);
    let text = match args.format {
        TableFormat::Csv => summary.to_csv()?,
        TableFormat::Geojson => (serde_json::to_string_pretty(&summary.to_geojson())? + "\n").into_bytes(),
    };
    match (&args.output, form) {
        (Some(path), _) => keep(path, &text, args.overwrite)?,
        (None, Form::Text) => print(&String::from_utf8_lossy(&text))?,
        (None, Form::Json | Form::Nothing) => {}
    }
    let failure = failure(&summary);
    match form {
        Form::Json => print_json(&as_json(&summary, failure.as_ref())?)?,
        Form::Text if args.output.is_some() => print(&line(&summary))?,
        Form::Text | Form::Nothing => {}
    }
    failure.map_or(Ok(()), Err)
}

/// The rows, and the error if there is one.
fn as_json(summary: &Summary, failure: Option<&Failure>) -> Result<Value, serde_json::Error> {
    let mut value = serde_json::to_value(summary)?;
    if let Some(failure) = failure {
        value["error"] = failure.as_json();
    }
    Ok(value)
}

fn keep(path: &Path, text: &[u8], overwrite: bool) -> Result<(), Failure> {
    refuse_place_of_results(path)?;
    if !overwrite && path.symlink_metadata().is_ok() {
        return Err(FolderError::Exists { path: path.to_owned() }.into());
    }
    Ok(atomic::write(path, text).with_context(|| format!("{}: the table cannot be written", path.display()))?)
}

/// `12 rows of 3 runs`.
fn line(summary: &Summary) -> String {
    format!("{} of {}\n", counted(summary.rows.len(), "row"), counted(summary.num_runs, "run"))
}

fn failure(summary: &Summary) -> Option<Failure> {
    let (first, more) = summary.unreadable.split_first()?;
    let others = if more.is_empty() { String::new() } else { format!(" and {} more", more.len()) };
    let rows = summary.rows.iter().find(|row| row.run == *first).and_then(|row| row.missing.as_deref());
    let reason = rows.unwrap_or("see the table");
    // Messages of files name them already.
    let shown = first.display().to_string();
    let said = if reason.contains(&shown) { reason.to_owned() } else { format!("{shown}: {reason}") };
    Some(Failure::Partial(anyhow!("{said}{others}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_cannot_be_read_fails_at_the_end_and_files_are_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("all.csv");
        let args = Args {
            folders: vec![folder.path().join("gone")],
            format: TableFormat::Csv,
            output: Some(path.clone()),
            overwrite: false,
        };
        let failed = run(&args, Form::Nothing).unwrap_err();
        assert!(failed.code() == 1 && failed.to_string().contains("gone: cannot be read"), "{failed}");
        assert!(std::fs::read_to_string(&path).unwrap().contains("cannot be read"));
        let refused = run(&args, Form::Nothing).unwrap_err();
        assert!(refused.code() == 2 && refused.to_string().contains("--overwrite"), "{refused}");
        assert_eq!(run(&Args { overwrite: true, ..args }, Form::Nothing).unwrap_err().code(), 1);
    }
}
