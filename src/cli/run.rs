//! `run` and the commands that do a part of it.

use std::ffi::OsString;

use serde_json::json;

use super::job::{JobArgs, resolve, use_machine};
use super::models;
use super::output::{Failure, Form, show};
use super::summary;
use super::terminal::TerminalProgress;
use crate::io::RunFolder;
use crate::pipeline::{self, Job, Overwrite, Stage, Summary};
use crate::scene::Trajectories;

pub(super) fn run(
    job: &JobArgs,
    goal: Stage,
    arguments: &[OsString],
    form: Form,
    talk: &TerminalProgress,
) -> Result<(), Failure> {
    let (input, options) = resolve(job, goal)?;
    use_machine(&options)?;
    let arguments: Vec<String> = arguments.iter().map(|argument| argument.to_string_lossy().into_owned()).collect();
    let task = Job {
        input: &input,
        output: &job.output,
        options: &options,
        goal,
        also_read: job.common.options.iter().map(|path| ("--options", path.as_path())).collect(),
        overwrite: if job.overwrite { Overwrite::AnyInput } else { Overwrite::SameInput },
        arguments: &arguments,
    };
    perform(&task, form, talk)
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
    let mut value = as_json(&summary, goal, trajectories.as_ref());
    if let Some(failure) = &failure {
        value["error"] = failure.as_json();
    }
    show(form, &value, || as_text(&summary, goal, trajectories.as_ref()))?;
    failure.map_or(Ok(()), Err)
}

fn as_json(summary: &Summary, goal: Stage, trajectories: Option<&Trajectories>) -> serde_json::Value {
    let stages: serde_json::Map<_, _> = summary
        .stages
        .iter()
        .map(|record| {
            let value =
                json!({ "cost": record.marker.cost, "reused": record.reused, "figures": record.marker.figures });
            (record.stage.name().to_owned(), value)
        })
        .collect();
    json!({
        "output": summary.output,
        "report": (goal == Stage::Report).then(|| RunFolder::at(&summary.output).report()),
        "objects": trajectories.map(|found| summary::placed_as_json(summary, found)),
        "ground_tracks": trajectories.map(summary::ground_tracks_as_json),
        "missing": trajectories.map(|found| summary::missing_as_json(summary, found)),
        "stages": stages,
        "warnings": summary.warnings,
        "failure": summary.failure(),
    })
}

fn as_text(summary: &Summary, goal: Stage, trajectories: Option<&Trajectories>) -> String {
    let mut text = if goal == Stage::Objects { models::as_text(summary) } else { String::new() };
    // What has no background has no vehicles either, and the failure says why.
    if let Some(found) = trajectories.filter(|_| summary.failure().is_none()) {
        text += &summary::as_text(summary, found);
    }
    let folder = RunFolder::at(&summary.output);
    let result = if goal == Stage::Report { folder.report() } else { summary.output.clone() };
    text + &format!("{}\n", result.display())
}
