//! `run` and the commands that do a part of it.

use std::ffi::OsString;
use std::fmt::Write;

use serde_json::json;

use super::job::{JobArgs, resolve, use_threads};
use super::models;
use super::output::{Failure, Form, show};
use super::terminal::Talk;
use crate::io::RunFolder;
use crate::pipeline::{self, Job, Overwrite, Stage, Summary};
use crate::scene::{ObjectTrajectory, Trajectories};

pub(super) fn run(job: &JobArgs, goal: Stage, arguments: &[OsString], form: Form, talk: &Talk) -> Result<(), Failure> {
    let (input, options) = resolve(job, goal)?;
    use_threads(options.threads)?;
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
    talk.say_how_to_go_on();
    let summary = pipeline::run(&task, talk)?;
    talk.finish();
    let folder = RunFolder::at(&job.output);
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
    let objects = trajectories.map(|found| {
        let object =
            |o: &ObjectTrajectory| json!({ "id": o.id, "class": o.class, "frames": o.poses.len(), "scale": o.scale });
        found.objects.iter().map(object).collect::<Vec<_>>()
    });
    json!({
        "output": summary.output,
        "report": (goal == Stage::Report).then(|| RunFolder::at(&summary.output).report()),
        "objects": objects,
        "stages": stages,
        "warnings": summary.warnings,
        "failure": summary.failure(),
    })
}

fn as_text(summary: &Summary, goal: Stage, trajectories: Option<&Trajectories>) -> String {
    let mut text = if goal == Stage::Objects { models::as_text(summary) } else { String::new() };
    // Writing to a string cannot fail.
    if let Some(found) = trajectories {
        let _ = writeln!(text, "{} vehicles with a trajectory", found.objects.len());
        for object in &found.objects {
            let scale = &object.scale;
            let verdict = if scale.degenerate { ", not to be trusted" } else { "" };
            let (id, class, poses, ratio) = (object.id, &object.class, object.poses.len(), scale.ratio);
            let _ = writeln!(
                text,
                "  {id}: {class}, {poses} frames, scale ratio {ratio:.5} ({}{verdict})",
                scale.method.name()
            );
        }
    }
    let folder = RunFolder::at(&summary.output);
    let result = if goal == Stage::Report { folder.report() } else { summary.output.clone() };
    let _ = writeln!(text, "{}", result.display());
    text
}
