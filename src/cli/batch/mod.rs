//! `tractrix batch LIST`: the jobs of a list, one by one for a scheduler, side by side on this machine, or what has
//! become of them.
//!
//! A job is a run of its own in DIR/NAME. It knows what is done, goes on where it was, and its exit code says whether
//! to start it again: so the recovery from anything is to submit all jobs again. docs/fleet.md has the contract.

mod item;
mod list;
mod resources;
mod side_by_side;
mod status;
mod words;

use std::ffi::OsString;
use std::num::NonZeroUsize;

use anyhow::Context;
use clap::ArgGroup;
use rustix::process::{Signal, getpid, getppid, kill_process, set_parent_process_death_signal};

use super::Call;
use super::job::JobArgs;
use super::output::Failure;
use crate::memory::MemoryLimit;
use item::Maker;
use list::List;
use side_by_side::Share;

#[derive(Debug, clap::Args)]
#[command(
    group(ArgGroup::new("which").required(true).args(["index", "jobs", "status"])),
    mut_arg("input", list_flag),
    mut_arg("output", |flag| flag.help("Folder of the results, with one output folder per job")),
)]
pub(super) struct Args {
    /// Run one job, the K-th from 0 (for schedulers)
    #[arg(long, value_name = "K")]
    pub(super) index: Option<usize>,
    /// Run all jobs on this machine, up to N in parallel; --threads is their total
    #[arg(long, value_name = "N")]
    pub(super) jobs: Option<NonZeroUsize>,
    /// Show the state of every job; exit code 0 if all are done
    #[arg(long)]
    pub(super) status: bool,
    /// Job of a parent process, which has read the list
    #[arg(long, hide = true, requires = "index")]
    pub(super) entry: Option<OsString>,
    /// Process that started this one: it ends with that
    #[arg(long, hide = true, requires = "index")]
    pub(super) parent: Option<u32>,
    #[command(flatten)]
    pub(super) job: JobArgs,
}

/// The list, in place of a video.
fn list_flag(flag: clap::Arg) -> clap::Arg {
    let list = "List of videos, one per line, each optionally followed by a tab and its options; or a folder of videos";
    let lines = "A line is a video, or a folder of images. Relative paths start at the folder of the list. Empty lines \
         and lines that begin with # are skipped. The results of a job are in DIR/NAME: NAME is the video's file name \
         without extension, or the value of --name among its options.";
    flag.value_name("LIST").help(list).long_help(format!("{list}\n\n{lines}"))
}

pub(super) fn run(args: &Args, call: Call) -> Result<(), Failure> {
    let path = &args.job.input;
    let list = args.entry.as_ref().map_or_else(|| List::open(path), |handed| List::of_handed(path, handed))?;
    let maker = Maker::new(args, &list);
    match (args.index, args.jobs) {
        (Some(index), _) => {
            args.parent.map_or(Ok(()), end_with_parent)?;
            let arguments = words::alone(call.arguments, index, &[]);
            let entry = list.entry(if args.entry.is_some() { 0 } else { index })?;
            maker.item(index, entry)?.work(&arguments, call.form, call.talk)
        }
        (None, Some(jobs)) => {
            let common = &args.job.common;
            let memory = common.memory_limit.unwrap_or_else(MemoryLimit::of_machine);
            let share = Share { jobs, threads: common.threads, memory };
            side_by_side::run(&list, &maker, share, call)
        }
        (None, None) => status::run(args, &list, &maker, call.form),
    }
}

/// Has this process asked to end when the parent process ends, however that happens.
fn end_with_parent(parent: u32) -> Result<(), Failure> {
    set_parent_process_death_signal(Some(Signal::TERM)).context("cannot follow the parent process")?;
    // The parent may have ended before.
    if getppid().is_none_or(|now| now.as_raw_nonzero().get().unsigned_abs() != parent) {
        kill_process(getpid(), Signal::TERM).context("cannot end with the parent process")?;
    }
    Ok(())
}
