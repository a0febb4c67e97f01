//! One sequence in one variant: an ordinary run in a folder of its own, evaluated.

use std::fs;
use std::path::{Path, PathBuf};

use super::degrade;
use super::variant::{Kind, Variant, WINDOW};
use crate::cli::benchmark::single::attempted;
use crate::cli::job::apply_sequence;
use crate::cli::output::Failure;
use crate::cli::terminal::TerminalProgress;
use crate::eval::calibration::Case;
use crate::eval::{Evaluation, Outcome};
use crate::io::{OwnedFolder, RunFolder, Sequence, TARGET_LABEL};
use crate::math::median;
use crate::pipeline::{self, Instances, Job, Options, Overwrite, PipelineError, Stage, Summary};
use crate::scene::{ObjectId, Trust};
use crate::video::Position;

/// Settings that all cases share.
pub(super) struct Setting<'a> {
    pub(super) results: &'a OwnedFolder,
    pub(super) options: &'a Options,
    pub(super) overwrite: Overwrite,
    pub(super) arguments: &'a [String],
    pub(super) talk: &'a TerminalProgress,
}

impl Setting<'_> {
    /// The result of one case, which may be that it failed.
    ///
    /// # Errors
    /// Only what stands in the way of every case: an output folder that cannot be written to or that is in use.
    pub(super) fn case(&self, folder: &Path, variant: Variant) -> Result<Case, Failure> {
        let sequence = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let described = Case {
            sequence: sequence.clone(),
            variant: variant.to_string(),
            kind: variant.kind.name(),
            level: variant.level,
            ..Case::default()
        };
        let output = self.results.subfolder(&sequence)?.join(variant.to_string());
        let found = attempted(|| self.result(folder, variant, &output, described.clone()))?;
        Ok(found.unwrap_or_else(|reason| Case { failure: Some(reason), ..described }))
    }

    fn result(&self, folder: &Path, variant: Variant, output: &Path, case: Case) -> anyhow::Result<Case> {
        let made = self.made(&case.sequence, variant, |place| {
            degrade::write(&Sequence::open(folder)?, variant, place, self.options.seed)
        })?;
        let truth = made.as_deref().unwrap_or(folder);
        let sequence = Sequence::open(truth)?;
        let done = self.run(&sequence, variant, output);
        if let Some(made) = &made {
            fs::remove_dir_all(made)?;
        }
        let (evaluation, why_not) = done?;
        let verdict = verdict(output, &evaluation);
        let original = Sequence::open(folder)?;
        let case = Case { object_px: object_px(&original, variant), climb: climb(&original, variant), ..case };
        let case = case.with_evaluation(&evaluation, verdict);
        // What stopped the run says more than what the evaluation misses for it.
        let failure = case.failure.as_ref().map(|missing| why_not.unwrap_or_else(|| missing.clone()));
        Ok(Case { failure, ..case })
    }

    /// The folder of a variant whose pictures or masks differ, written again; `None` for one that needs none.
    ///
    /// * `name` – of the sequence or the clip.
    pub(super) fn made(
        &self,
        name: &str,
        variant: Variant,
        write: impl FnOnce(&Path) -> anyhow::Result<()>,
    ) -> anyhow::Result<Option<PathBuf>> {
        if !variant.kind.is_degraded() {
            return Ok(None);
        }
        let place = self.results.root().join(RunFolder::STATE).join("variants").join(format!("{name}-{variant}"));
        // A stopped run may have left something there.
        if place.exists() {
            fs::remove_dir_all(&place)?;
        }
        write(&place)?;
        Ok(Some(place))
    }

    /// Runs all stages.
    pub(super) fn work(
        &self,
        input: &Path,
        output: &Path,
        options: &Options,
        also_read: Vec<(&str, &Path)>,
    ) -> Result<Summary, PipelineError> {
        let (overwrite, arguments) = (self.overwrite, self.arguments);
        let job = Job { input, output, options, goal: Stage::Report, also_read, overwrite, arguments };
        pipeline::run(&job, self.talk)
    }

    fn run(&self, sequence: &Sequence, variant: Variant, output: &Path) -> anyhow::Result<Done> {
        let mut options = self.options.clone();
        let input = match variant.kind {
            Kind::Raw => {
                options.instances = Instances::Vehicles;
                sequence.input()?
            }
            _ => {
                options.only_objects = [ObjectId(TARGET_LABEL.into())].into();
                apply_sequence(sequence, &mut options)?
            }
        };
        apply(variant, &mut options);
        let summary = self.work(&input, output, &options, vec![("the sequence", &sequence.folder)])?;
        let evaluation = pipeline::evaluate(output, &sequence.folder)?;
        pipeline::keep_evaluation(output, &sequence.folder, &evaluation)?;
        let target = summary.vehicles.get(&ObjectId(TARGET_LABEL.into()));
        let why_not = target.and_then(|vehicle| vehicle.model.failure.clone().or(vehicle.not_placed.clone()));
        Ok((evaluation, summary.failure().or(why_not)))
    }
}

/// The evaluation of a run, and why there is no trajectory, where there is none.
type Done = (Evaluation, Option<String>);

/// First frame and end of the frames that a variant uses, where it does not use all.
fn range(variant: Variant) -> [Option<u32>; 2] {
    let level = variant.level as u32;
    match variant.kind {
        Kind::Frames => [None, Some(level)],
        Kind::Window => [Some(level), Some(level.saturating_add(WINDOW))],
        _ => [None, None],
    }
}

/// Applies a variant to the options.
pub(super) fn apply(variant: Variant, options: &mut Options) {
    let [start, end] = range(variant).map(|index| index.map(Position::Frame));
    options.video.start = start.or(options.video.start);
    options.video.end = end.or(options.video.end);
    if variant.kind == Kind::Seed {
        options.seed = variant.level as u64;
    }
}

/// The run's verdict on the target.
fn verdict(output: &Path, evaluation: &Evaluation) -> Option<Trust> {
    let Outcome::Ok(target) = &evaluation.target else { return None };
    let trajectories = RunFolder::at(output).read_trajectories().ok()?;
    let found = trajectories.objects.into_iter().find(|found| found.id == target.object)?;
    found.verdict.map(|verdict| verdict.state)
}

/// Returns true if a variant uses a frame.
fn is_used(variant: Variant, index: u32) -> bool {
    let [start, end] = range(variant);
    start.is_none_or(|start| index >= start) && end.is_none_or(|end| index < end)
}

/// Median of the longer side of the target's mask, pixels of the variant.
fn object_px(sequence: &Sequence, variant: Variant) -> Option<f64> {
    let factor = if variant.kind == Kind::Scale { variant.level } else { 1.0 };
    let used = sequence.frames.iter().filter(|frame| is_used(variant, frame.id.0));
    let bounds = used.filter_map(|frame| sequence.target_mask(frame).ok()?.bounding_box());
    median(bounds.map(|bounds| factor * f64::from(bounds.width().max(bounds.height()))).collect())
}

/// Change of the camera's height over the target, as a share of its mean. The worlds of sequences are z up.
fn climb(sequence: &Sequence, variant: Variant) -> Option<f64> {
    let used = sequence.frames.iter().filter(|frame| is_used(variant, frame.id.0));
    let heights: Vec<f64> =
        used.map(|frame| frame.cam_from_world.center().z - frame.world_from_object.translation.z).collect();
    let (least, most) = heights.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), h| (a.min(*h), b.max(*h)));
    let mean = heights.iter().sum::<f64>() / heights.len() as f64;
    Some((most - least) / mean).filter(|climb| climb.is_finite() && mean > 0.0)
}
