//! Stage order, options tree, progress; what is done is not done twice.
//!
//! Every stage reads what earlier stages left in the output folder and leaves its own files there, whole or not at all,
//! and last of all a marker in `.tractrix/` with a fingerprint of everything that the result was made from. A stage
//! whose marker has the fingerprint of the moment is skipped: a run that was killed goes on where it was, a changed
//! option does the stages again that it touches and those after them, a changed input all of them.
//!
//! Entry point: [`run`].

mod driver;
mod error;
mod evaluate;
mod inputs;
mod options;
mod stages;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

pub use driver::completion::{
    Completion, FolderState, Identity, RunFailure, folder_state, folder_state_of_given, is_begun,
};
pub use driver::cost::{Cost, process_cpu_s};
use driver::progress::Muted;
pub use driver::progress::{Plan, Planned, Progress, Silent};
pub use driver::reopen::{arguments_of_run, known_frames, reopen};
pub use driver::run::StageRecord;
pub use driver::run_json::run_json_schema;
pub use driver::stage::Stage;
pub use driver::workspace::{Marker, Overwrite, Workspace};
pub use error::{PipelineError, Result};
pub use evaluate::{SavedEvaluation, evaluate, keep_evaluation};
pub use inputs::attitude::orientation as gimbal_orientation;
pub use inputs::hovering::{OnMap, Station, camera_by_map_points, check_map_points, on_map_points, stated_tilts};
pub use inputs::telemetry::telemetry_of;
pub use options::{
    Ablation, DetectorChoice, FeatureKind, FrameOrder, GroundLabels, Instances, IntrinsicsSource, MOST_THREADS,
    MaskChoice, MaskingOptions, Method, MetricOptions, MotionChoice, OptionRow, OptionSection, Options,
    TelemetryChoice, VehicleOptions,
};
pub use stages::background::{CameraReport, ModelReport, background_frame};
pub use stages::features::found_features::found_features;
pub use stages::metric::dates_of_log;
pub use stages::objects::object_pose_priors;
pub use stages::report::link_exports;

use crate::io::InputIdentity;
use crate::scene::{Movement, ObjectId, TimeBase, TrackedObject};
use driver::run::{Outcome, Run};
use driver::threads::on_threads;
use driver::{fingerprint, run_json};
use inputs::{cameras, given_models, preflight};
use stages::{background, features, follow, frames, ground, metric, motion, objects, report, scale, segment, track};

/// Summary of a run.
#[derive(Clone, Debug)]
pub struct Summary {
    /// The output folder.
    pub output: PathBuf,
    /// The stages up to the goal, in order.
    pub stages: Vec<StageRecord>,
    /// The frames that were chosen.
    pub num_frames: usize,
    /// Unit of their times.
    pub time_base: TimeBase,
    /// Report on the background; `None` before the goal [`Stage::Background`].
    pub background: Option<ModelReport>,
    /// Outcomes of the vehicles; empty before the goal [`Stage::Objects`].
    pub vehicles: BTreeMap<ObjectId, Vehicle>,
    /// Problems although there is a result.
    pub warnings: Vec<String>,
}

/// A vehicle that was to be reconstructed.
#[derive(Clone, Debug, Default)]
pub struct Vehicle {
    /// Class, by the model that detected it.
    pub class: String,
    /// Motion state.
    pub movement: Option<Movement>,
    /// Report on its model.
    pub model: ModelReport,
    /// Why it has no trajectory although it has a model, where that is so.
    pub not_placed: Option<String>,
}

impl Summary {
    /// Why there is no background to speak of, where there is none: the input did not give what was asked for, although
    /// all that could be found stands in the output folder.
    pub fn failure(&self) -> Option<String> {
        let failure = self.background.as_ref()?.failure.as_ref()?;
        Some(format!("background not reconstructed: {failure}"))
    }
}

/// Request for a run.
#[derive(Clone, Debug)]
pub struct Job<'a> {
    /// A video file or a folder of images.
    pub input: &'a Path,
    /// The output folder.
    pub output: &'a Path,
    /// Everything that decides the result.
    pub options: &'a Options,
    /// The last stage that is done.
    pub goal: Stage,
    /// Other files that were read to come here, after the flags that named them: they must not lie where the run
    /// writes.
    pub also_read: Vec<(&'a str, &'a Path)>,
    /// Permission to replace results.
    pub overwrite: Overwrite,
    /// The command line, for `run.json` and the report.
    pub arguments: &'a [String],
}

/// Does everything up to and with the goal, as far as it is not done already.
///
/// Nothing is written before it is sure that the output folder is the run's own, or new, and that no input lies in it.
///
/// # Errors
/// [`PipelineError`] when there can be no result; what concerns single frames or objects is counted and reported
/// instead.
pub fn run(job: &Job, progress: &dyn Progress) -> Result<Summary> {
    job.options.check()?;
    on_threads(job.options.threads, || run_checked(job, progress))?
}

fn run_checked(job: &Job, progress: &dyn Progress) -> Result<Summary> {
    let Job { options, goal, .. } = *job;
    metric::check(options)?;
    Workspace::inspect(job.output, &job.inputs())?;
    for (flag, path) in options.named_models() {
        Workspace::inspect(job.output, &[(flag, given_models::place(path).as_path())])?;
    }
    let source = cameras::open(job.input, options)?;
    preflight::check_pictures(&source, options)?;
    let workspace = Workspace::open(job.output)?;
    let identity = Identity::of(job.input, options);
    progress.plan(&Plan::new(&workspace, options, source.info(), goal));
    progress.begin("input", None);
    let content = fingerprint::of_content(source.path());
    progress.end();
    let content = content?;
    let path = std::fs::canonicalize(source.path()).unwrap_or_else(|_| source.path().to_owned());
    let input = InputIdentity { path, content: content.clone() };
    workspace.owned.claim(input, job.overwrite == Overwrite::AnyInput)?;
    workspace.clear_ended()?;
    let muted = Muted(progress);
    let mut run = Run::new(options, &workspace, &source, job.arguments, progress);
    (run.goal, run.content) = (goal, content);
    let result = stages(&mut run, &muted).and_then(|()| page_of_models(&run));
    let error = result.as_ref().err().map(ToString::to_string);
    let written = run_json::write(&run, error.as_deref());
    // What went wrong first says what to do: on a full disk it names the file that did not fit.
    result?;
    written?;
    let summary = summary(job, run)?;
    leave_record(job, &workspace, identity, &summary)?;
    Ok(summary)
}

/// Writes the page of `tractrix sfm`, unless a whole run with the same models has left its page.
fn page_of_models(run: &Run) -> Result<()> {
    let has_page = run.all_reused() && run.workspace.marker(Stage::Report).is_some();
    if run.goal != Stage::Objects || has_page {
        return Ok(());
    }
    run.workspace.clear_marker(Stage::Report)?;
    report::write_models(run)
}

/// Says that nothing is left to be done, unless there is, or a file has changed since the run began.
fn leave_record(job: &Job, workspace: &Workspace, of: Identity, summary: &Summary) -> Result<()> {
    let is_whole = job.goal == Stage::Report && summary.failure().is_none();
    match is_whole && Identity::of(job.input, job.options) == of {
        true => workspace.set_ended(&Completion::new(of, job.options, None)),
        false => Ok(()),
    }
}

fn summary(job: &Job, run: Run) -> Result<Summary> {
    let background = (job.goal >= Stage::Background).then(|| background::background_report(&run)).transpose()?;
    let vehicles = vehicles(&run, job.goal)?;
    let (output, warnings, num_frames) = (job.output.to_owned(), run.warnings(), run.frames()?.len());
    let time_base = run.info().time_base();
    Ok(Summary { output, stages: run.records, num_frames, time_base, background, vehicles, warnings })
}

fn vehicles(run: &Run, goal: Stage) -> Result<BTreeMap<ObjectId, Vehicle>> {
    if goal < Stage::Objects {
        return Ok(BTreeMap::new());
    }
    let mut tracked: BTreeMap<ObjectId, TrackedObject> =
        run.workspace.read_tracked()?.into_iter().map(|object| (object.id, object)).collect();
    let mut failures = if goal >= Stage::Scale { scale::results(run)?.failures } else { BTreeMap::new() };
    let vehicle = |(id, model): (ObjectId, ModelReport)| {
        let (class, movement) = tracked.remove(&id).map(|found| (found.class, found.movement.state)).unzip();
        let not_placed = failures.remove(&id);
        (id, Vehicle { class: class.unwrap_or_default(), movement, model, not_placed })
    };
    Ok(objects::reports(run)?.into_iter().map(vehicle).collect())
}

impl Job<'_> {
    /// All that is read, after the flag that named it.
    fn inputs(&self) -> Vec<(&str, &Path)> {
        let mut inputs = vec![("the input", self.input)];
        inputs.extend(self.options.named_paths());
        inputs.extend(self.also_read.iter().copied());
        inputs
    }
}

fn stages<'a>(run: &mut Run<'a>, muted: &'a Muted<'a>) -> Result<()> {
    preflight::check_camera(run)?;
    let goal = run.goal;
    for stage in Stage::ALL.into_iter().filter(|stage| *stage <= goal) {
        // The page shows the command line and what every stage cost, so it is made again whenever anything was done.
        if stage == Stage::Report && !run.all_reused() {
            run.workspace.clear_marker(stage)?;
        }
        run.stage(stage)?;
        match stage {
            Stage::Frames => preflight::check_files(run, &open_stages(run)?)?,
            // Without a background later stages write down that there is nothing, which is not worth a word.
            Stage::Track if background::background_report(run)?.failure.is_some() => run.progress = muted,
            _ => {}
        }
    }
    Ok(())
}

/// Everything that a stage's result depends on besides the stages before it, and what it does.
type Work = (fn(&Run) -> Result<Value>, fn(&Run, &mut Outcome) -> Result<()>);

fn work_of(stage: Stage) -> Work {
    match stage {
        Stage::Frames => (frames::cache_key, frames::run_stage),
        Stage::Segment => (segment::cache_key, segment::run_stage),
        Stage::Features => (features::cache_key, features::run_stage),
        Stage::Background => (background::cache_key, background::run_stage),
        Stage::Motion => (motion::cache_key, motion::run_stage),
        Stage::Track => (track::cache_key, track::run_stage),
        Stage::Follow => (follow::cache_key, follow::run_stage),
        Stage::Objects => (objects::cache_key, objects::run_stage),
        Stage::Ground => (ground::cache_key, ground::run_stage),
        Stage::Scale => (scale::cache_key, scale::run_stage),
        Stage::Metric => (metric::cache_key, metric::run_stage),
        Stage::Report => (|run| Ok(json!({ "arguments": run.arguments })), report::run_stage),
    }
}

/// The stages up to the goal that no earlier run has done with the options and the input of this one; `frames` must be
/// done.
fn open_stages(run: &Run) -> Result<Vec<Stage>> {
    let stages: Vec<Stage> = Stage::ALL.into_iter().filter(|stage| *stage <= run.goal).collect();
    if stages.iter().skip(1).all(|&stage| run.workspace.marker(stage).is_none()) {
        return Ok(stages);
    }
    let mut fingerprints: BTreeMap<Stage, String> = BTreeMap::new();
    let mut open = Vec::new();
    for stage in stages {
        let upstream: Vec<&str> = stage.after().iter().map(|before| fingerprints[before].as_str()).collect();
        let fingerprint = fingerprint::of_stage(stage, &work_of(stage).0(run)?, &upstream);
        if !run.is_done(stage, &fingerprint) {
            open.push(stage);
        }
        fingerprints.insert(stage, fingerprint);
    }
    Ok(open)
}
