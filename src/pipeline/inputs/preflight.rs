//! Checks before the first long stage.
//!
//! An error in a file that is needed last, such as an unusable model or a mask of the wrong size, must not follow an
//! hour of work. Inputs of finished stages are not checked again.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::cameras;
use super::given_masks::MaskFolder;
use super::given_models;
use super::hovering;
use super::networks::Networks;
use crate::features::Target;
use crate::pipeline::driver::run::Run;
use crate::pipeline::stages::background::calibration_check;
use crate::pipeline::stages::{ground, segment, track};
use crate::pipeline::{GroundLabels, Instances, Options, PipelineError, Result, Stage};
use crate::scene::{LabelMap, ObjectId};
use crate::video::{PictureCamera, Source};

/// Memory of an image at the size of its file, as stored and decoded, bytes per pixel. With that of the frame, three
/// images of 13,000 × 13,000 pixels took 36 bytes per pixel.
const SOURCE_BYTES_PER_PIXEL: u128 = 8;
/// Memory of an image at the size of the frames, with all data derived from it, bytes per pixel.
const FRAME_BYTES_PER_PIXEL: u128 = 32;

/// Checks that the images fit into memory.
///
/// # Errors
/// [`PipelineError::Memory`] with their size and the remedy.
pub(in crate::pipeline) fn check_pictures(source: &Source, options: &Options) -> Result<()> {
    let pixels = |width: u32, height: u32| u128::from(width) * u128::from(height);
    for camera in source.cameras() {
        let PictureCamera { width, height, source_width, source_height, .. } = *camera;
        let needed = SOURCE_BYTES_PER_PIXEL * pixels(source_width, source_height)
            + FRAME_BYTES_PER_PIXEL * pixels(width, height);
        let what = || {
            let path = source.path().display();
            format!("{path}: processing images of {source_width}x{source_height} pixels (--max-dimension reduces them)")
        };
        options.memory().check(what, needed)?;
    }
    Ok(())
}

/// Checks the given camera; needs only the input's size.
///
/// # Errors
/// [`PipelineError::Options`] for implausible intrinsics.
pub(in crate::pipeline) fn check_camera(run: &mut Run) -> Result<()> {
    if run.options.intrinsics.is_none() {
        return Ok(());
    }
    for camera in cameras::given(run)? {
        if let Some(reason) = calibration_check::impossible(&camera) {
            return Err(PipelineError::Options(reason));
        }
        calibration_check::doubts(&camera).into_iter().for_each(|doubt| run.warn(doubt));
    }
    Ok(())
}

/// Checks the given files of all unfinished stages; `frames` must be done.
///
/// # Errors
/// The errors of the stage that reads the file.
pub(in crate::pipeline) fn check_files(run: &Run, open: &[Stage]) -> Result<()> {
    open.iter().try_for_each(|stage| match (stage, &run.options.instances) {
        (Stage::Segment, Instances::Model(path)) => segment::load(run, path).map(drop),
        (Stage::Segment, Instances::Vehicles) => Networks::of(run)?.check_detector(run),
        (Stage::Features, Instances::Masks(folder)) => MaskFolder::open(folder, run.frames()?, run.info())?.check(),
        (Stage::Track, Instances::Model(_)) => track::load_flow_estimator(run).map(drop),
        (Stage::Track, Instances::Vehicles) => {
            track::load_flow_estimator(run)?;
            Networks::of(run)?.check_prompter(run)
        }
        (Stage::Follow, Instances::Masks(folder)) => object_ids(run, folder),
        (Stage::Background, _) => models(run, run.options.background_model.iter(), Target::Background),
        (Stage::Objects, _) => models(run, run.options.object_models.values(), Target::Object),
        (Stage::Ground, _) => ground_labels(run),
        (Stage::Segment | Stage::Features | Stage::Track | Stage::Follow, _) => Ok(()),
        (Stage::Metric, _) => hovering::check_map_points_in_frames(run),
        (Stage::Frames | Stage::Motion | Stage::Scale | Stage::Report, _) => Ok(()),
    })
}

/// Given masks determine the objects before tracking.
fn object_ids(run: &Run, folder: &Path) -> Result<()> {
    if run.options.object_models.is_empty() {
        return Ok(());
    }
    let frames = run.frames()?;
    let files = MaskFolder::open(folder, frames, run.info())?;
    let mut ids = BTreeSet::new();
    for frame in frames {
        let labels = files.labels(frame.id)?;
        ids.extend(labels.iter().flat_map(LabelMap::present).map(|label| ObjectId(label.into())));
    }
    track::check_models(run, &ids)
}

fn models<'a>(run: &Run, mut paths: impl Iterator<Item = &'a PathBuf>, target: Target) -> Result<()> {
    paths.try_for_each(|path| given_models::read(path, target, run).map(drop))
}

fn ground_labels(run: &Run) -> Result<()> {
    match &run.options.ground_labels {
        GroundLabels::Geometric => Ok(()),
        GroundLabels::Masks { folder, .. } => MaskFolder::open(folder, run.frames()?, run.info())?.check(),
        GroundLabels::Model(path) => ground::load(run, path).map(drop),
    }
}
