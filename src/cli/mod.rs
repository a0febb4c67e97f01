//! The command line: raw flags, then options, then the pipeline; what comes back goes to the terminal.
//!
//! Results go to stdout, everything else to stderr. An error is printed once, with all its causes and what to do about
//! it; with `--json` it stands on stdout as well, as `{"error": {"kind": "input", "message": ...}}`, whose kind is
//! `input`, `usage`, `busy` or `stopped`. Exit codes: 0 done, 1 failed on the input, 2 wrong use, 75 stopped by the
//! system or the output folder is in use, so that the same command is to be given again, 130 stopped by Ctrl-C.

mod analyse;
mod args;
mod bal;
mod batch;
mod benchmark;
mod calibrate;
mod common;
mod compare;
mod convert;
mod doctor;
pub mod evaluate;
mod export;
mod forecast;
mod frame;
mod job;
mod live;
mod manual;
mod models;
mod options;
mod output;
mod paired_times;
mod recording;
mod run;
mod run_output;
mod schema;
mod stage_progress;
mod stop;
mod summarize;
mod summary;
mod telemetry;
mod terminal;

use std::borrow::Cow;
use std::ffi::OsString;
use std::io::{self, Write};
use std::process::ExitCode;
use std::sync::{Mutex, MutexGuard, PoisonError};

use args::{Args, Command};
use clap::{CommandFactory, Parser};
use output::{Failure, Form};
use terminal::{TerminalProgress, Verbosity};

use crate::checks::text::printable;

/// Runs the program on the arguments of the process.
pub fn main() -> ExitCode {
    // First of all, so that no signal ends the program without its own exit code.
    let caught = stop::CaughtSignals::new();
    crate::video::silence_decoders();
    let arguments: Vec<OsString> = std::env::args_os().collect();
    let args = match Args::try_parse_from(&arguments) {
        Ok(args) => args,
        Err(error) => return not_parsed(&error, &arguments),
    };
    let talk = TerminalProgress::start(caught, args.progress, verbosity(&args), form(&args));
    match (dispatch(&args, &arguments, &talk), talk.stopped_by()) {
        (Ok(()), _) => ExitCode::SUCCESS,
        (Err(failure), Some(signal)) if failure.is_stop() => {
            talk.say_stopped();
            ended(&Failure::Stopped(signal), &args)
        }
        (Err(failure), _) => {
            talk.error(&failure.to_string());
            ended(&failure, &args)
        }
    }
}

fn ended(failure: &Failure, args: &Args) -> ExitCode {
    failure.show_as_json(form(args));
    ExitCode::from(failure.code())
}

/// Help and version count as done, anything else as wrong use; clap says which.
fn not_parsed(error: &clap::Error, arguments: &[OsString]) -> ExitCode {
    // The colors of clap go to a terminal as they are, and with them what stands in the arguments.
    let is_plain = |argument: &OsString| matches!(printable(&argument.to_string_lossy()), Cow::Borrowed(_));
    match arguments.iter().all(is_plain) {
        true => drop(error.print()),
        false => drop(io::stderr().write_all(printable(&error.render().to_string()).as_bytes())),
    }
    let wants_json = arguments.iter().take_while(|argument| *argument != "--").any(|argument| argument == "--json");
    if wants_json && error.use_stderr() {
        let failure = Failure::Usage(error.render().to_string().trim().to_owned());
        failure.show_as_json(Form::Json);
    }
    ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2))
}

fn verbosity(args: &Args) -> Verbosity {
    match (args.quiet, args.verbose) {
        (true, _) => Verbosity::Quiet,
        (_, true) => Verbosity::Verbose,
        _ => Verbosity::Normal,
    }
}

fn form(args: &Args) -> Form {
    match (args.json, args.quiet) {
        (true, _) => Form::Json,
        (_, true) => Form::Nothing,
        _ => Form::Text,
    }
}

/// Context of a command.
#[derive(Clone, Copy)]
struct Call<'a> {
    /// The command line.
    arguments: &'a [OsString],
    form: Form,
    talk: &'a TerminalProgress,
}

/// A lock, also of a thread that has panicked.
fn lock<T>(state: &Mutex<T>) -> MutexGuard<'_, T> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

fn dispatch(args: &Args, arguments: &[OsString], talk: &TerminalProgress) -> Result<(), Failure> {
    let form = form(args);
    let call = Call { arguments, form, talk };
    match &args.command {
        Command::Run(job)
        | Command::Segment(job)
        | Command::Track(job)
        | Command::Sfm(job)
        | Command::Ground(job)
        | Command::Scale(job)
        | Command::Metric(job) => run::run(job, args.command.goal(), call),
        Command::Live(own) => live::run(own, call),
        Command::Batch(own) => batch::run(own, call),
        Command::Evaluate(own) => evaluate::run(own, form),
        Command::Benchmark(own) => benchmark::run(own, call),
        Command::Calibrate(own) => calibrate::run(own, call),
        Command::Compare(own) => compare::run(own, arguments, form),
        Command::Convert(own) => convert::run(own, form),
        Command::Export(own) => export::run(own, form, talk),
        Command::Analyse(own) => analyse::run(own, form),
        Command::Summary(own) => summarize::run(own, form),
        Command::Bal(own) => bal::run(own, form),
        Command::Telemetry(own) => telemetry::run(own, form),
        Command::Options(own) => options::run(own, form),
        Command::Schema(own) => schema::run(own, form),
        Command::Doctor(own) => doctor::run(own, form),
        Command::Completions(own) => manual::completions(own, Args::command()),
        Command::Manual(own) => manual::pages(own, Args::command(), form),
    }
}
