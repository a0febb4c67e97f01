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

use clap::ArgGroup;

use super::job::JobArgs;
use super::output::{Failure, Form};
use super::terminal::Talk;
use crate::limits::memory::MemoryLimit;
use item::Item;
use list::List;
use side_by_side::Share;

const LIST_HELP: &str = "List of videos, one a line, after each a tab and options of its own; or a folder of videos";
const LIST_LONG_HELP: &str =
    "List of videos, one a line, after each a tab and options of its own; or a folder of videos

A line is a video, or a folder of images. Relative paths begin at the folder of the list. Empty lines and those that \
                              begin with # are passed over. The results of a job lie in DIR/NAME: NAME is the video's \
                              without the ending, or what --name NAME says among its options.";
const OUTPUT_HELP: &str = "Folder for the results: one output folder per job";

#[derive(Debug, clap::Args)]
#[command(
    group(ArgGroup::new("which").required(true).args(["index", "jobs", "status"])),
    mut_arg("input", |flag| flag.value_name("LIST").help(LIST_HELP).long_help(LIST_LONG_HELP)),
    mut_arg("output", |flag| flag.help(OUTPUT_HELP)),
)]
pub(super) struct Args {
    /// Do one job alone, the K-th from 0: for schedulers
    #[arg(long, value_name = "K")]
    pub(super) index: Option<usize>,
    /// Do all jobs on this machine, up to N side by side; --threads are those of all together
    #[arg(long, value_name = "N")]
    pub(super) jobs: Option<NonZeroUsize>,
    /// Say what has become of every job; exit code 0 if all are done
    #[arg(long)]
    pub(super) status: bool,
    #[command(flatten)]
    pub(super) job: JobArgs,
}

pub(super) fn run(args: &Args, arguments: &[OsString], form: Form, talk: &Talk) -> Result<(), Failure> {
    let list = List::open(&args.job.input)?;
    match (args.index, args.jobs) {
        (Some(index), _) => {
            let arguments = words::alone(arguments, index, &[]);
            Item::new(args, &list, index)?.work(&arguments, form, talk)
        }
        (None, Some(jobs)) => {
            let common = &args.job.common;
            let memory = common.memory_limit.unwrap_or_else(MemoryLimit::of_machine);
            let share = Share { jobs, threads: common.threads, memory };
            side_by_side::run(&items(args, &list)?, share, arguments, form, talk)
        }
        (None, None) => status::run(&items(args, &list)?, form),
    }
}

fn items(args: &Args, list: &List) -> Result<Vec<Item>, Failure> {
    (0..list.entries.len()).map(|index| Item::new(args, list, index)).collect()
}
