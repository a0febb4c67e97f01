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
use crate::pipeline::{self, Instances, Job, Options, Overwrite, Stage};
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
        let made = self.made(folder, variant)?;
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
    fn made(&self, folder: &Path, variant: Variant) -> anyhow::Result<Option<PathBuf>> {
        if !variant.kind.is_degraded() {
            return Ok(None);
        }
        let name = folder.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let place = self.place_of(&name, variant)?;
        degrade::write(&Sequence::open(folder)?, variant, &place, self.options.seed)?;
        Ok(Some(place))
    }

    /// Where the pictures of a variant are made; what a stopped run left there is gone.
    pub(super) fn place_of(&self, name: &str, variant: Variant) -> anyhow::Result<PathBuf> {
        let place = self.results.root().join(RunFolder::STATE).join("variants").join(format!("{name}-{variant}"));
        if place.exists() {
            fs::remove_dir_all(&place)?;
        }
        Ok(place)
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
        let job = Job {
            input: &input,
            output,
            options: &options,
            goal: Stage::Report,
            also_read: vec![("the sequence", &sequence.folder)],
            overwrite: self.overwrite,
            arguments: self.arguments,
        };
        let summary = pipeline::run(&job, self.talk)?;
        let evaluation = pipeline::evaluate(output, &sequence.folder)?;
        pipeline::keep_evaluation(output, &sequence.folder, &evaluation)?;
        let target = summary.vehicles.get(&ObjectId(TARGET_LABEL.into()));
        let why_not = target.and_then(|vehicle| vehicle.model.failure.clone().or(vehicle.not_placed.clone()));
        Ok((evaluation, summary.failure().or(why_not)))
    }
}

/// The evaluation of a run, and why there is no trajectory, where there is none.
type Done = (Evaluation, Option<String>);

/// Applies a variant to the options.
pub(super) fn apply(variant: Variant, options: &mut Options) {
    let level = variant.level as u32;
    match variant.kind {
        Kind::Frames => options.video.end = Some(Position::Frame(level)),
        Kind::Window => {
            options.video.start = Some(Position::Frame(level));
            options.video.end = Some(Position::Frame(level.saturating_add(WINDOW)));
        }
        Kind::Seed => options.seed = variant.level as u64,
        _ => {}
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
    let level = variant.level as u32;
    match variant.kind {
        Kind::Frames => index < level,
        Kind::Window => (level..level.saturating_add(WINDOW)).contains(&index),
        _ => true,
    }
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
