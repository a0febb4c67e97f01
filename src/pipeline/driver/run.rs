//! The driver: which stages are done already, which have to be done, and what they cost.

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

/// The list of frames among the run's own files.
pub(in crate::pipeline) const FRAMES: &str = "frames-list.json";

/// Results of a stage besides its files.
#[derive(Debug, Default)]
pub(in crate::pipeline) struct Outcome {
    /// Problems although there is a result.
    pub(in crate::pipeline) warnings: Vec<String>,
    /// Counts and measures, by name.
    pub(in crate::pipeline) figures: BTreeMap<String, Value>,
    /// Files and folders that the stage made, absolute.
    pub(in crate::pipeline) outputs: Vec<PathBuf>,
    /// Hash of everything that the stage's result is made from.
    pub(in crate::pipeline) fingerprint: String,
    /// Warnings by topic.
    num_warned: BTreeMap<Topic, usize>,
}

impl Outcome {
    /// Shows the first few warnings on a topic, and keeps all.
    pub(in crate::pipeline) fn warn(&mut self, warning: Warning) {
        let num = self.num_warned.entry(warning.topic).or_default();
        *num += 1;
        if *num <= MAX_SHOWN {
            tracing::warn!("{warning}");
        }
        self.note(warning);
    }

    /// Says how many warnings were not shown.
    fn say_what_is_not_shown(&self) {
        for (topic, num) in self.num_warned.iter().filter(|(_, num)| **num > MAX_SHOWN) {
            let warning = topic.not_shown(num - MAX_SHOWN);
            tracing::warn!("{warning}");
        }
    }

    /// As [`Outcome::warn`], of what is no fault.
    pub(in crate::pipeline) fn mention(&mut self, warning: Warning) {
        tracing::info!("{warning}");
        self.note(warning);
    }

    /// As [`Outcome::warn`], of what the end of the run says anyway.
    pub(in crate::pipeline) fn note(&mut self, warning: Warning) {
        self.warnings.push(warning.to_string());
    }

    pub(in crate::pipeline) fn figure(&mut self, name: &str, value: impl Into<Value>) {
        self.figures.insert(name.to_owned(), value.into());
    }
}

/// A stage as it stands at the end of a run.
#[derive(Clone, Debug)]
pub struct StageRecord {
    /// Which one.
    pub stage: Stage,
    /// Marker of the stage.
    pub marker: Marker,
    /// True if an earlier run did it.
    pub reused: bool,
}

/// One run under way.
pub(in crate::pipeline) struct Run<'a> {
    pub(in crate::pipeline) options: &'a Options,
    pub(in crate::pipeline) workspace: &'a Workspace,
    pub(in crate::pipeline) source: &'a Source,
    pub(in crate::pipeline) arguments: &'a [String],
    pub(in crate::pipeline) progress: &'a dyn Progress,
    /// The last stage that is to be done.
    pub(in crate::pipeline) goal: Stage,
    /// Hash of the input.
    pub(in crate::pipeline) content: String,
    pub(in crate::pipeline) records: Vec<StageRecord>,
    /// Anomalies of the input, found before any stage.
    warnings: Vec<String>,
    frames: OnceCell<Vec<Frame>>,
    /// Focal length that would show as much on film, by the log of a video, millimeters.
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

    /// The chosen frames; the stage `frames` must be done.
    pub(in crate::pipeline) fn frames(&self) -> Result<&[Frame]> {
        if self.frames.get().is_none() {
            let frames = intermediate::checked_frames(self.workspace.read_state(FRAMES)?)
                .map_err(|flaw| intermediate::damaged(&self.workspace.state(FRAMES), flaw))?;
            let _ = self.frames.set(frames);
        }
        Ok(self.frames.get().map_or(&[], Vec::as_slice))
    }

    /// Says that a step is done, and whether there may be another one.
    ///
    /// # Errors
    /// As [`Self::go_on`].
    pub(in crate::pipeline) fn step(&self) -> Result<()> {
        self.progress.step();
        self.go_on()
    }

    /// To be asked between units of work, when all that is done is in its place.
    ///
    /// # Errors
    /// [`PipelineError::Stopped`].
    pub(in crate::pipeline) fn go_on(&self) -> Result<()> {
        if self.progress.is_stopped() { Err(PipelineError::Stopped) } else { Ok(()) }
    }

    /// Does a stage, unless it is done already.
    pub(in crate::pipeline) fn stage(&mut self, stage: Stage) -> Result<()> {
        self.go_on()?;
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
            self.say_what_is_done_anew(stage);
        }
        self.workspace.clear_marker(stage)?;
        self.workspace.remove_intermediate(stage, &fingerprint)?;
        self.progress.begin(stage.name(), None);
        let meter = Meter::start();
        let mut outcome = Outcome { fingerprint, ..Outcome::default() };
        let done = run_stage(self, &mut outcome);
        self.progress.end();
        outcome.say_what_is_not_shown();
        done?;
        let Outcome { warnings, figures, outputs, fingerprint, .. } = outcome;
        let cost = meter.read();
        memory::give_back();
        // A folder into which a stage puts no file is not there: nothing of the result depends on it.
        let outputs = outputs.iter().filter(|path| path.exists());
        let outputs = outputs.map(|path| path.strip_prefix(self.workspace.root()).unwrap_or(path).to_owned()).collect();
        let marker = Marker { fingerprint, cost, warnings, figures, outputs };
        self.workspace.set_marker(stage, &marker)?;
        self.records.push(StageRecord { stage, marker, reused: false });
        Ok(())
    }

    /// Writes a value of the run's own for later stages, as an output of the stage at work.
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

    /// Says once, of the first stage whose options have changed, which results are replaced.
    fn say_what_is_done_anew(&self, first: Stage) {
        if first == Stage::Report || !self.all_reused() {
            return;
        }
        let stages: Vec<&str> = first.and_dependents().into_iter().map(Stage::name).collect();
        self.progress.note(&format!("options changed: re-running {}", stages.join(", ")));
    }

    /// The fingerprint of a stage that this run has been through; empty for one that it left out.
    pub(in crate::pipeline) fn fingerprint(&self, stage: Stage) -> &str {
        self.records.iter().find(|record| record.stage == stage).map_or("", |record| &record.marker.fingerprint)
    }

    /// Takes over what an earlier run did, as far as it went.
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

    /// Says what is odd about what was given.
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
