//! `run` and the commands that do a part of it.

use std::path::Path;

use super::Call;
use super::common::lossy;
use super::job::{JobArgs, resolve, use_machine};
use super::models;
use super::output::{Failure, Form, show};
use super::recording;
use super::run_output::RunOutput;
use super::summary;
use super::terminal::TerminalProgress;
use crate::io::RunFolder;
use crate::pipeline::{self, Job, Options, Overwrite, Stage, Summary};
use crate::scene::Trajectories;

pub(super) fn run(job: &JobArgs, goal: Stage, call: Call) -> Result<(), Failure> {
    let (mut input, options) = resolve(job, goal)?;
    use_machine(&options)?;
    if input == Path::new(recording::STDIN) {
        input = recording::record(&job.output, job.overwrite)?;
    }
    run_on(&input, job, &options, goal, call)
}

/// As [`run`], on a given input with given options.
pub(super) fn run_on(input: &Path, job: &JobArgs, options: &Options, goal: Stage, call: Call) -> Result<(), Failure> {
    let arguments = lossy(call.arguments);
    let task = Job {
        input,
        output: &job.output,
        options,
        goal,
        also_read: job.common.options.iter().map(|path| ("--options", path.as_path())).collect(),
        overwrite: if job.overwrite { Overwrite::AnyInput } else { Overwrite::SameInput },
        arguments: &arguments,
    };
    perform(&task, call.form, call.talk)
}

/// Does a run and prints what came of it.
pub(super) fn perform(task: &Job, form: Form, talk: &TerminalProgress) -> Result<(), Failure> {
    let goal = task.goal;
    talk.ends_in_order();
    let summary = pipeline::run(task, talk)?;
    talk.finish();
    let folder = RunFolder::at(task.output);
    let trajectories = (goal >= Stage::Scale).then(|| folder.read_trajectories()).transpose()?;
    let failure = summary.failure().map(|failure| Failure::Partial(anyhow::anyhow!(failure)));
    let output = RunOutput::new(&summary, goal, trajectories.as_ref(), failure.as_ref());
    show(form, &output, || as_text(&summary, goal, trajectories.as_ref()))?;
    failure.map_or(Ok(()), Err)
}

fn as_text(summary: &Summary, goal: Stage, trajectories: Option<&Trajectories>) -> String {
    let mut text = if goal == Stage::Objects { models::as_text(summary) } else { String::new() };
    // What has no background has no vehicles either, and the failure says why.
    if let Some(found) = trajectories.filter(|_| summary.failure().is_none()) {
        text += &summary::as_text(summary, found);
    }
    let folder = RunFolder::at(&summary.output);
    let result = if has_page(goal) { folder.report() } else { summary.output.clone() };
    text + &format!("{}\n", result.display())
}

/// Returns true if the parts up to a stage end with a page.
pub(super) fn has_page(goal: Stage) -> bool {
    matches!(goal, Stage::Objects | Stage::Report)
}
