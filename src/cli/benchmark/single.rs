//! One sequence: run, evaluate, sum up.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};

use super::Args;
use super::sequences::names;
use crate::cli::job::apply_sequence;
use crate::cli::output::Failure;
use crate::cli::terminal::TerminalProgress;
use crate::eval::Evaluation;
use crate::eval::benchmark::{Cost, Entry};
use crate::io::{FolderError, OwnedFolder, Sequence, TARGET_LABEL};
use crate::pipeline::{self, Job, Options, Overwrite, PipelineError, Stage, Summary};
use crate::scene::ObjectId;

/// A sequence that is to be run.
#[derive(Clone, Copy)]
pub(super) struct Attempt<'a> {
    pub(super) args: &'a Args,
    /// The sequence.
    pub(super) folder: &'a Path,
    /// Folder of the benchmark.
    pub(super) results: &'a OwnedFolder,
    pub(super) options: &'a Options,
    /// Folder of this run; `None` for the sequence's own.
    pub(super) output: Option<&'a Path>,
    pub(super) arguments: &'a [String],
    pub(super) talk: &'a TerminalProgress,
}

/// The result on one sequence, which may be that it failed.
///
/// # Errors
/// Only what stands in the way of every sequence: an output folder that cannot be written to or that is in use.
pub(super) fn sequence(attempt: &Attempt<'_>) -> Result<Entry, Failure> {
    let Attempt { folder, results, output, .. } = *attempt;
    let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let truth = Sequence::open(folder);
    let (vehicle, trajectory) = names(&name, truth.as_ref().ok());
    let output = output.map_or_else(|| results.subfolder(&name), |output| Ok(output.to_owned()))?;
    let found = attempted(|| {
        let truth = truth?;
        let summary = run(attempt, &name, &truth, &output)?;
        let evaluation = pipeline::evaluate(&output, folder)?;
        pipeline::keep_evaluation(&output, folder, &evaluation)?;
        Ok(entry(&evaluation, &summary))
    })?;
    let found = found.unwrap_or_else(|reason| Entry { failure: Some(reason), ..Entry::default() });
    Ok(Entry { folder: name, vehicle, trajectory, ..found })
}

/// The result of work on one of many sequences, or why it failed. A panic is a defect of the program, but it must not
/// take the others with it.
///
/// # Errors
/// Only what stands in the way of every sequence.
pub(in crate::cli) fn attempted<T>(work: impl FnOnce() -> anyhow::Result<T>) -> Result<Result<T, String>, Failure> {
    match catch_unwind(AssertUnwindSafe(work)) {
        Ok(Ok(found)) => Ok(Ok(found)),
        Ok(Err(error)) if stands_in_every_way(&error) => Err(error.into()),
        Ok(Err(error)) => Ok(Err(Failure::Input(error).to_string())),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
            Ok(Err(format!("internal error; please report it: {}", text.unwrap_or("no message"))))
        }
    }
}

/// Returns true if the next sequence would fail in the same way.
pub(in crate::cli) fn stands_in_every_way(error: &anyhow::Error) -> bool {
    match error.downcast_ref() {
        Some(PipelineError::Stopped) => true,
        Some(PipelineError::Folder(error)) => {
            error.is_wrong_use() || matches!(error, FolderError::Busy { .. } | FolderError::System { .. })
        }
        _ => false,
    }
}

fn run(attempt: &Attempt<'_>, name: &str, truth: &Sequence, output: &Path) -> anyhow::Result<Summary> {
    let Attempt { args, arguments, .. } = *attempt;
    let target = ObjectId(TARGET_LABEL.into());
    let mut options = attempt.options.clone();
    // Other moving vehicles are kept out of the background; what they cost to reconstruct is not the question here.
    options.only_objects = [target].into();
    let input = apply_sequence(truth, &mut options)?;
    if let Some(model) = given(args.models.as_deref(), name, Some("background"))
        .or_else(|| given(args.background_models.as_deref(), name, None))
    {
        options.background_model = Some(exists(model)?);
    }
    if let Some(model) =
        given(args.models.as_deref(), name, Some("object")).or_else(|| given(args.object_models.as_deref(), name, None))
    {
        options.object_models = [(target, exists(model)?)].into();
    }
    options.check_labels()?;
    let job = Job {
        input: &input,
        output,
        options: &options,
        goal: Stage::Report,
        also_read: vec![("the sequence", &truth.folder)],
        overwrite: if args.overwrite { Overwrite::AnyInput } else { Overwrite::SameInput },
        arguments,
    };
    Ok(pipeline::run(&job, attempt.talk)?)
}

/// Where the model of a sequence would lie.
fn given(models: Option<&Path>, name: &str, part: Option<&str>) -> Option<PathBuf> {
    let folder = models?.join(name);
    Some(part.map_or(folder.clone(), |part| folder.join(part)))
}

fn exists(model: PathBuf) -> anyhow::Result<PathBuf> {
    anyhow::ensure!(model.is_dir(), "{}: model not found; the other program may have failed", model.display());
    Ok(model)
}

fn entry(evaluation: &Evaluation, summary: &Summary) -> Entry {
    let mut entry = Entry::of(evaluation);
    // What stopped the run says more than what the evaluation misses for it.
    if entry.failure.is_some() && summary.failure().is_some() {
        entry.failure = summary.failure();
    }
    let is_sfm = |stage: Stage| matches!(stage, Stage::Features | Stage::Background | Stage::Follow | Stage::Objects);
    let mut cost = Cost::default();
    for record in &summary.stages {
        let of_stage = record.marker.cost;
        cost.wall_s += of_stage.wall_s;
        cost.cpu_s += of_stage.cpu_s;
        cost.sfm_cpu_s += if is_sfm(record.stage) { of_stage.cpu_s } else { 0.0 };
        cost.peak_rss_mib = cost.peak_rss_mib.max(of_stage.peak_rss_mib);
    }
    entry.cost = Some(cost);
    entry.warnings.clone_from(&summary.warnings);
    entry
}
