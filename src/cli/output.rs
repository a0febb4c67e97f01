//! Output of the program: results on stdout, in the requested form, and failures with their exit code.

use std::fmt;
use std::io::{self, BufWriter, Write};

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Value, json};

use super::stop::{Signal, TRY_AGAIN};
use crate::checks::text::printable;
use crate::export::ExportError;
use crate::io::FolderError;
use crate::pipeline::PipelineError;

/// Why a command ends without having done what was asked.
#[derive(Debug)]
pub(super) enum Failure {
    /// The input, the machine or a file stands in the way: exit code 1.
    Input(anyhow::Error),
    /// The command line asks for what cannot be: exit code 2.
    Usage(String),
    /// Another process has the output folder: exit code 75.
    Busy(anyhow::Error),
    /// A signal ended the program before it was done: exit code 130 or 75.
    Stopped(Signal),
    /// There is a result, which was printed, and it is not what was asked for: exit code 1. As JSON it holds the error.
    Partial(anyhow::Error),
    /// As [`Self::Partial`], and the same command again would come further: exit code 75.
    Again(anyhow::Error),
}

/// Value of "error" in the JSON output.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct ErrorOutput {
    /// `input`, `usage`, `busy`, `stopped` or `again`.
    kind: &'static str,
    /// Subject, problem and remedy.
    message: String,
}

impl Failure {
    pub(super) fn code(&self) -> u8 {
        match self {
            Self::Input(_) | Self::Partial(_) => 1,
            Self::Usage(_) => 2,
            Self::Busy(_) | Self::Again(_) => TRY_AGAIN,
            Self::Stopped(signal) => signal.exit_code(),
        }
    }

    /// Returns true if the work ended on request.
    pub(super) fn is_stop(&self) -> bool {
        matches!(self, Self::Input(error) if matches!(error.downcast_ref(), Some(PipelineError::Stopped)))
    }

    /// Value of "error" in the JSON output.
    pub(super) fn as_json(&self) -> Value {
        json!(self.output())
    }

    /// The same, typed.
    pub(super) fn output(&self) -> ErrorOutput {
        let kind = match self {
            Self::Input(_) | Self::Partial(_) => "input",
            Self::Usage(_) => "usage",
            Self::Busy(_) => "busy",
            Self::Stopped(_) => "stopped",
            Self::Again(_) => "again",
        };
        ErrorOutput { kind, message: self.to_string() }
    }

    /// Prints the failure to stdout where JSON was asked for, unless that holds it already.
    pub(super) fn show_as_json(&self, form: Form) {
        if form == Form::Json && !matches!(self, Self::Partial(_) | Self::Again(_)) {
            // What cannot be printed cannot be reported either.
            let _ = print_json(&json!({ "error": self.as_json() }));
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Usage(text) => text.fmt(f),
            Self::Stopped(_) => PipelineError::Stopped.fmt(f),
            Self::Input(error) | Self::Partial(error) | Self::Busy(error) | Self::Again(error) => {
                let mut said = error.to_string();
                said.fmt(f)?;
                for cause in error.chain().skip(1).map(ToString::to_string) {
                    // Messages that already carry their cause are not repeated.
                    if !said.contains(&cause) {
                        write!(f, ": {cause}")?;
                        said.push_str(&cause);
                    }
                }
                match error.chain().any(is_full_disk) {
                    true => f.write_str("; free some space and run the same command again: it resumes"),
                    false => Ok(()),
                }
            }
        }
    }
}

fn is_full_disk(cause: &(dyn std::error::Error + 'static)) -> bool {
    let is_full = |kind| matches!(kind, io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded);
    cause.downcast_ref().is_some_and(|cause: &io::Error| is_full(cause.kind()))
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        let error = error.into();
        let is = |of_pipeline: fn(&PipelineError) -> bool, of_folder: fn(&FolderError) -> bool| {
            let exported = match error.downcast_ref() {
                Some(ExportError::Folder(error)) => Some(error),
                _ => None,
            };
            error.downcast_ref().is_some_and(of_pipeline) || error.downcast_ref().or(exported).is_some_and(of_folder)
        };
        if is(PipelineError::is_wrong_use, FolderError::is_wrong_use) {
            Self::Usage(error.to_string())
        } else if is(PipelineError::is_busy, FolderError::is_busy) {
            Self::Busy(error)
        } else {
            Self::Input(error)
        }
    }
}

/// The form in which a result is printed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    /// For people.
    Text,
    /// One JSON object, for programs.
    Json,
    /// Not at all: it lies in files.
    Nothing,
}

/// Prints a result to stdout.
pub(super) fn show(form: Form, value: &impl Serialize, text: impl FnOnce() -> String) -> Result<(), Failure> {
    match form {
        Form::Text => print(&text()),
        Form::Json => print_json(value),
        Form::Nothing => Ok(()),
    }
}

/// Prints to stdout. A reader that has gone away (`| head`) is no failure.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut stdout = BufWriter::new(io::stdout().lock());
    is_taken(stdout.write_all(printable(text).as_bytes()).and_then(|()| stdout.flush())).map(drop)
}

/// Returns true if stdout took it; a reader that has gone away takes nothing more.
fn is_taken(written: io::Result<()>) -> Result<bool, Failure> {
    match written {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// Writes JSON without control characters: `serde_json` leaves some in texts, which it writes piece by piece, each of
/// whole characters.
struct Printable<W>(W);

impl<W: Write> Write for Printable<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match std::str::from_utf8(bytes) {
            Ok(text) => self.0.write_all(printable(text).as_bytes())?,
            Err(_) => self.0.write_all(bytes)?,
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

/// Prints a value as indented JSON.
pub(super) fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    let mut stdout = Printable(BufWriter::new(io::stdout().lock()));
    let written = serde_json::to_writer_pretty(&mut stdout, value).map_err(io::Error::from);
    is_taken(written.and_then(|()| stdout.write_all(b"\n")).and_then(|()| stdout.flush())).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_said_once() {
        let inner = anyhow::anyhow!("permission denied");
        let failure = Failure::from(inner.context("cannot read a.mp4"));
        assert_eq!(failure.to_string(), "cannot read a.mp4: permission denied");
        let inner = anyhow::anyhow!("permission denied");
        let failure = Failure::from(inner.context("a.mp4: permission denied; check it"));
        assert_eq!(failure.to_string(), "a.mp4: permission denied; check it");
    }

    #[test]
    fn a_full_disk_has_a_cure() {
        let full = anyhow::Error::from(io::Error::from(io::ErrorKind::StorageFull));
        let failure = Failure::Input(full.context("cannot write out/a.png"));
        assert!(failure.to_string().ends_with("run the same command again: it resumes"), "{failure}");
    }

    #[test]
    fn json_has_no_control_characters_and_reads_back() {
        let mut written = Printable(Vec::new());
        serde_json::to_writer_pretty(&mut written, &json!({ "a\u{9b}": ["\u{1b}[2J", "é\u{7f}"] })).unwrap();
        let text = String::from_utf8(written.0).unwrap();
        assert!(!text.chars().any(|letter| letter.is_control() && letter != '\n'), "{text}");
        assert_eq!(serde_json::from_str::<Value>(&text).unwrap()["a\u{9b}"][1], "é\u{7f}");
    }

    #[test]
    fn programs_are_told_whose_fault_it_is() {
        let failure = Failure::Usage("--start must be before --end".to_owned());
        assert_eq!(failure.as_json(), json!({ "kind": "usage", "message": "--start must be before --end" }));
        assert_eq!(Failure::from(anyhow::anyhow!("a.mp4 is empty")).as_json()["kind"], "input");
    }
}
