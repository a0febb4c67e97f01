//! The command line: raw flags, then options, then the pipeline; what comes back goes to the terminal.
//!
//! Results go to stdout, everything else to stderr. An error is printed once, with all its causes and what to do about
//! it. Exit codes: 0 done, 1 failed on the input, 2 wrong use.

mod args;
pub mod bal;
mod benchmark;
mod common;
pub mod compare;
pub mod convert;
mod doctor;
pub mod evaluate;
mod job;
mod models;
mod output;
mod run;
mod terminal;

use std::ffi::OsString;
use std::process::ExitCode;

use clap::Parser;

use args::{Args, Command};
use output::Failure;

/// Runs the program on the arguments of the process.
pub fn main() -> ExitCode {
    crate::video::silence_decoders();
    let arguments: Vec<OsString> = std::env::args_os().collect();
    let args = match Args::try_parse_from(&arguments) {
        Ok(args) => args,
        // Help and version count as done, anything else as wrong use; clap says which.
        Err(error) => {
            let _ = error.print();
            return ExitCode::from(u8::try_from(error.exit_code()).unwrap_or(2));
        }
    };
    let talk = terminal::Talk::start(args.quiet, args.verbose);
    match dispatch(&args, &arguments, &talk) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            talk.finish();
            eprintln!("tractrix: error: {failure}");
            ExitCode::from(failure.code())
        }
    }
}

fn dispatch(args: &Args, arguments: &[OsString], talk: &terminal::Talk) -> Result<(), Failure> {
    let json = args.json;
    match &args.command {
        Command::Run(job)
        | Command::Segment(job)
        | Command::Track(job)
        | Command::Sfm(job)
        | Command::Ground(job)
        | Command::Scale(job) => run::run(job, args.command.goal(), arguments, json, talk),
        Command::Evaluate(own) => evaluate::run(&evaluate::Args { json: json || own.json, ..own.clone() }),
        Command::Benchmark(own) => benchmark::run(own, arguments, json, talk),
        Command::Compare(own) => Ok(compare::run(&compare::Args { json: json || own.json, ..own.clone() })?),
        Command::Convert(own) => Ok(convert::run(own)?),
        Command::Bal(own) => Ok(bal::run(&bal::BalArgs { json: json || own.json, ..own.clone() })?),
        Command::Doctor(doctor) => doctor::run(doctor, json),
    }
}
