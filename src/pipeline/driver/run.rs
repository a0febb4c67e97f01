//! The driver: reuses finished stages, runs the others, and measures their cost.

use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::Value;

use super::cost::Meter;
use super::workspace::{Marker, Workspace};
use super::{fingerprint, intermediate};
use crate::ffi::memory;
use crate::pipeline::{Options, PipelineError, Progress, Result, Stage, work_of};
use crate::scene::{Frame, MAX_SHOWN, Topic, Warning};
use crate::video::{Info, Source};

/// File name of the list of frames, in the folder for the run's state.
pub(in crate::pipeline) const FRAMES: &str = "frames-list.json";

/// Results of a stage in addition to its files.
#[derive(Debug, Default)]
pub(in crate::pipeline) struct Outcome {
    /// Warnings of a stage that has a result.
    pub(in crate::pipeline) warnings: Vec<String>,
    /// Counts and measures, by name.
    pub(in crate::pipeline) figures: BTreeMap<String, Value>,
    /// Files and folders that the stage wrote, absolute.
    pub(in crate::pipeline) outputs: Vec<PathBuf>,
    /// Hash of everything that the stage's result depends on.
    pub(in crate::pipeline) fingerprint: String,
    /// Warnings by topic.
    num_warned: BTreeMap<Topic, usize>,
}

impl Outcome {
    /// Records a warning, and shows it if it is one of the first few on its topic.
    pub(in crate::pipeline) fn warn(&mut self, warning: Warning) {
        let num = self.num_warned.entry(warning.topic).or_default();
        *num += 1;
        if *num <= MAX_SHOWN {
            tracing::warn!("{warning}");
        }
        self.note(warning);
    }

    /// Shows the number of warnings that were not shown.
    fn note_hidden_warnings(&self) {
        for (topic, num) in self.num_warned.iter().filter(|(_, num)| **num > MAX_SHOWN) {
            let warning = topic.not_shown(num - MAX_SHOWN);
            tracing::warn!("{warning}");
        }
    }

    /// As [`Outcome::warn`], for notes that are no problem.
    pub(in crate::pipeline) fn mention(&mut self, warning: Warning) {
        tracing::info!("{warning}");
        self.note(warning);
    }

    /// As [`Outcome::warn`], for warnings that the end of the run shows in any case.
    pub(in crate::pipeline) fn note(&mut self, warning: Warning) {
        self.warnings.push(warning.to_string());
    }

    pub(in crate::pipeline) fn figure(&mut self, name: &str, value: impl Into<Value>) {
        self.figures.insert(name.to_owned(), value.into());
    }
}

/// State of a stage at the end of a run.
#[derive(Clone, Debug)]
pub struct StageRecord {
    /// The stage.
    pub stage: Stage,
    /// Marker of the stage.
    pub marker: Marker,
    /// True if the result is that of an earlier run.
    pub reused: bool,
}

/// A run in progress.
pub(in crate::pipeline) struct Run<'a> {
    pub(in crate::pipeline) options: &'a Options,
    pub(in crate::pipeline) workspace: &'a Workspace,
    pub(in crate::pipeline) source: &'a Source,
    pub(in crate::pipeline) arguments: &'a [String],
    pub(in crate::pipeline) progress: &'a dyn Progress,
    /// The last stage to run.
    pub(in crate::pipeline) goal: Stage,
    /// Hash of the input.
    pub(in crate::pipeline) content: String,
    pub(in crate::pipeline) records: Vec<StageRecord>,
    /// Anomalies of the input, found before any stage.
    warnings: Vec<String>,
    frames: OnceCell<Vec<Frame>>,
    /// 35 mm equivalent focal length by the log of a video, millimeters.
    pub(in crate::pipeline) film_focal_mm: OnceCell<Option<f64>>,
}

impl<'a> Run<'a> {
    pub(in crate::pipeline) fn new(
        options: &'a Options,
        workspace: &'a Workspace,
        source: &'a Source,
        arguments: &'a [String],
        progress: &'a dyn Progress,
    ) -> Self {
        Self {
            options,
            workspace,
            source,
            arguments,
            progress,
            goal: Stage::Report,
            content: String::new(),
            records: Vec::new(),
            warnings: Vec::new(),
            frames: OnceCell::new(),
            film_focal_mm: OnceCell::new(),
        }
    }

    pub(in crate::pipeline) fn input(&self) -> &Path {
        self.source.path()
    }

    pub(in crate::pipeline) fn info(&self) -> &Info {
        self.source.info()
    }

    /// Width and height of the frames, pixels.
    pub(in crate::pipeline) fn size(&self) -> (u32, u32) {
        (self.info().width, self.info().height)
    }

    /// The selected frames; the stage `frames` must be done.
    pub(in crate::pipeline) fn frames(&self) -> Result<&[Frame]> {
        if self.frames.get().is_none() {
            let frames = intermediate::checked_frames(self.workspace.read_state(FRAMES)?)
                .map_err(|flaw| intermediate::damaged(&self.workspace.state(FRAMES), flaw))?;
            let _ = self.frames.set(frames);
        }
        Ok(self.frames.get().map_or(&[], Vec::as_slice))
    }

    /// Counts a finished step, and stops the run if requested.
    ///
    /// # Errors
    /// As [`Self::check_stop`].
    pub(in crate::pipeline) fn step(&self) -> Result<()> {
        self.progress.step();
        self.check_stop()
    }

    /// Checks for a stop request; to be called between units of work, when all finished work is stored.
    ///
    /// # Errors
    /// [`PipelineError::Stopped`].
    pub(in crate::pipeline) fn check_stop(&self) -> Result<()> {
        if self.progress.is_stopped() { Err(PipelineError::Stopped) } else { Ok(()) }
    }

    /// Runs a stage unless an earlier run has finished it.
    pub(in crate::pipeline) fn stage(&mut self, stage: Stage) -> Result<()> {
        self.check_stop()?;
        let (cache_key, run_stage) = work_of(stage);
        let upstream: Vec<&str> = stage.after().iter().map(|&stage| self.fingerprint(stage)).collect();
        let fingerprint = fingerprint::of_stage(stage, &cache_key(self)?, &upstream);
        let before = self.workspace.marker(stage);
        let is_other = before.as_ref().is_some_and(|marker| marker.fingerprint != fingerprint);
        let same = before.filter(|marker| !is_other && marker.is_complete(self.workspace.root()));
        if let Some(marker) = same {
            self.progress.skip(stage.name());
            self.records.push(StageRecord { stage, marker, reused: true });
            return Ok(());
        }
        if is_other {
            self.note_rerun_stages(stage);
        }
        self.workspace.clear_marker(stage)?;
        self.workspace.remove_intermediate(stage, &fingerprint)?;
        self.progress.begin(stage.name(), None);
        let meter = Meter::start();
        let mut outcome = Outcome { fingerprint, ..Outcome::default() };
        let done = run_stage(self, &mut outcome);
        self.progress.end();
        outcome.note_hidden_warnings();
        done?;
        let Outcome { warnings, figures, outputs, fingerprint, .. } = outcome;
        let cost = meter.read();
        memory::give_back();
        // A folder in which a stage stored no file does not exist; the result does not depend on it.
        let outputs = outputs.iter().filter(|path| path.exists());
        let outputs = outputs.map(|path| path.strip_prefix(self.workspace.root()).unwrap_or(path).to_owned()).collect();
        let marker = Marker { fingerprint, cost, warnings, figures, outputs };
        self.workspace.set_marker(stage, &marker)?;
        self.records.push(StageRecord { stage, marker, reused: false });
        Ok(())
    }

    /// Writes an intermediate value for later stages, as an output of the running stage.
    pub(in crate::pipeline) fn keep(&self, name: &str, value: &impl Serialize, outcome: &mut Outcome) -> Result<()> {
        outcome.outputs.push(self.workspace.state(name));
        self.workspace.write_state(name, value)
    }

    /// Folder for intermediate files of a stage of this run.
    pub(in crate::pipeline) fn folder(&self, stage: Stage) -> PathBuf {
        self.workspace.state(&fingerprint::folder_name(stage, self.fingerprint(stage)))
    }

    /// Returns true if an earlier run left the results of a stage with this fingerprint.
    pub(in crate::pipeline) fn is_done(&self, stage: Stage, fingerprint: &str) -> bool {
        let marker = self.workspace.marker(stage);
        marker.is_some_and(|marker| marker.fingerprint == fingerprint && marker.is_complete(self.workspace.root()))
    }

    /// Shows which results are replaced, once, for the first stage whose options have changed.
    fn note_rerun_stages(&self, first: Stage) {
        if first == Stage::Report || !self.all_reused() {
            return;
        }
        let stages: Vec<&str> = first.and_dependents().into_iter().map(Stage::name).collect();
        self.progress.note(&format!("options changed: re-running {}", stages.join(", ")));
    }

    /// The fingerprint of a stage of this run; empty for a skipped one.
    pub(in crate::pipeline) fn fingerprint(&self, stage: Stage) -> &str {
        self.records.iter().find(|record| record.stage == stage).map_or("", |record| &record.marker.fingerprint)
    }

    /// Loads the records of all stages that an earlier run finished.
    pub(in crate::pipeline) fn recall(&mut self) {
        let done = Stage::ALL
            .into_iter()
            .filter_map(|stage| self.workspace.marker(stage).map(|marker| StageRecord { stage, marker, reused: true }));
        self.records = done.collect();
    }

    /// Returns true if all stages so far were reused.
    pub(in crate::pipeline) fn all_reused(&self) -> bool {
        self.records.iter().all(|record| record.reused)
    }

    /// Records an anomaly of the input.
    pub(in crate::pipeline) fn warn(&mut self, warning: Warning) {
        tracing::warn!("{warning}");
        self.warnings.push(warning.to_string());
    }

    /// All warnings so far, in order.
    pub(in crate::pipeline) fn warnings(&self) -> Vec<String> {
        self.all_warnings().cloned().collect()
    }

    /// Returns true if an earlier stage gave this warning.
    pub(in crate::pipeline) fn has_warned(&self, warning: &Warning) -> bool {
        let displayed = warning.to_string();
        self.all_warnings().any(|warning| *warning == displayed)
    }

    fn all_warnings(&self) -> impl Iterator<Item = &String> {
        self.warnings.iter().chain(self.records.iter().flat_map(|record| &record.marker.warnings))
    }
}
