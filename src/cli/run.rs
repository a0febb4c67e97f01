//! `run` and the commands that do a part of it.

use std::ffi::OsString;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::Context;
use serde_json::json;

use super::args::JobArgs;
use super::models;
use super::output::{Failure, print, print_json};
use super::terminal::Talk;
use crate::io::{IoError, RunFolder, Sequence};
use crate::pipeline::{self, GroundLabels, Instances, Intrinsics, Job, Options, Overwrite, Stage, Summary};
use crate::scene::{ObjectTrajectory, Trajectories};

pub(super) fn run(job: &JobArgs, goal: Stage, arguments: &[OsString], json: bool, talk: &Talk) -> Result<(), Failure> {
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
    let summary = pipeline::run(&task, talk)?;
    talk.finish();
    let folder = RunFolder::at(&job.output);
    let trajectories = (goal >= Stage::Scale).then(|| folder.read_trajectories()).transpose()?;
    match json {
        true => print_json(&as_json(&summary, goal, trajectories.as_ref()))?,
        false => print(&as_text(&summary, goal, trajectories.as_ref()))?,
    }
    match summary.failure() {
        Some(failure) => Err(Failure::Input(anyhow::anyhow!(failure))),
        None => Ok(()),
    }
}

/// Input and options from the flags, the options file, and the folder of a sequence.
fn resolve(job: &JobArgs, goal: Stage) -> Result<(PathBuf, Options), Failure> {
    let mut options = job.common.options()?;
    apply_flags(job, &mut options);
    let mut input = job.input.clone();
    if input.join("scene.json").is_file() {
        input = apply_sequence(&Sequence::open(&job.input)?, &mut options)?;
    }
    let looks_for_vehicles = !matches!(goal, Stage::Frames | Stage::Objects);
    if looks_for_vehicles && options.instances == Instances::None {
        return Err(Failure::Usage(
            "nothing says where the vehicles are; give --segmentation-model FILE (an ONNX model of the YOLO-seg family) \
             or --masks DIR (`tractrix doctor` says more)"
                .to_owned(),
        ));
    }
    options.check().map_err(|error| Failure::Usage(error.to_string()))?;
    check_paths(&options)?;
    Ok((input, options))
}

fn apply_flags(job: &JobArgs, options: &mut Options) {
    if let Some(folder) = &job.masks {
        options.instances = Instances::Masks(folder.clone());
    } else if let Some(model) = &job.segmentation_model {
        options.instances = Instances::Model(model.clone());
    }
    if let Some(folder) = &job.ground_masks {
        options.ground_labels = GroundLabels::Masks { folder: folder.clone(), label: job.ground_label };
    } else if let Some(model) = &job.ground_model {
        options.ground_labels = GroundLabels::Model(model.clone());
    }
    let set = |to: &mut Option<PathBuf>, flag: &Option<PathBuf>| {
        if flag.is_some() {
            to.clone_from(flag);
        }
    };
    set(&mut options.flow_model, &job.flow_model);
    set(&mut options.background_model, &job.background_model);
    options.object_models.extend(job.object_model.iter().cloned());
    options.only_objects.extend(job.only_object.iter().copied());
    options.intrinsics = job.intrinsics.clone().or(options.intrinsics.take());
    options.video.start = job.start.or(options.video.start);
    options.video.end = job.end.or(options.video.end);
    options.video.every = job.every.unwrap_or(options.video.every);
    options.video.max_dimension = job.max_dimension.or(options.video.max_dimension);
    options.video.fps = job.fps.or(options.video.fps);
    options.features = job.features.unwrap_or(options.features);
    options.order = job.order.unwrap_or(options.order);
}

/// Fills in what a ground-truth sequence knows and nobody gave; gives its folder of images or its video.
pub(super) fn apply_sequence(sequence: &Sequence, options: &mut Options) -> Result<PathBuf, IoError> {
    let input = sequence.input()?;
    let Some(first) = sequence.frames.first() else { return Ok(input) };
    let folder_of = |file: &Path| sequence.folder.join(file.parent().unwrap_or(Path::new("")));
    if options.instances == Instances::None {
        options.instances = Instances::Masks(folder_of(&first.mask));
    }
    if let (GroundLabels::Geometric, Some(semantic)) = (&options.ground_labels, &first.semantic) {
        let label = Some(crate::io::GROUND_LABEL);
        options.ground_labels = GroundLabels::Masks { folder: folder_of(semantic), label };
    }
    if options.intrinsics.is_none() {
        options.intrinsics = Some(Intrinsics::Given(sequence.camera.intrinsics()));
    }
    options.video.fps = options.video.fps.or(Some(sequence.fps));
    Ok(input)
}

/// Says which file is missing before any work starts.
fn check_paths(options: &Options) -> Result<(), Failure> {
    for (flag, path) in options.named_paths() {
        fs::metadata(path).with_context(|| format!("{}: cannot be read; check {flag}", path.display()))?;
    }
    Ok(())
}

pub(super) fn use_threads(threads: Option<usize>) -> Result<(), Failure> {
    let Some(threads) = threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().context("cannot start the threads")?;
    opencv::core::set_num_threads(i32::try_from(threads).unwrap_or(i32::MAX))?;
    Ok(())
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
