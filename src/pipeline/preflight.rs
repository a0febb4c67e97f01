//! What can be known to be wrong before the first long stage.
//!
//! A model that cannot be used, a mask that does not fit: an hour of work must not come before an error in a file that
//! is needed last. What an earlier run has done already is not looked at again.

use super::given_masks::MaskFolder;
use super::run::Run;
use super::{GroundLabels, Instances, PipelineError, Stage, ground, lens, models, segment, track};

/// Looks at the camera that was given; needs nothing but the input's size.
///
/// # Errors
/// [`PipelineError::Options`] for intrinsics that cannot be meant.
pub(super) fn check_camera(run: &mut Run) -> Result<(), PipelineError> {
    if run.options.intrinsics.is_none() {
        return Ok(());
    }
    let (camera, _) = models::initial_camera(run)?;
    if let Some(reason) = lens::impossible(&camera) {
        return Err(PipelineError::Options(reason));
    }
    lens::doubts(&camera).into_iter().for_each(|doubt| run.warn(doubt));
    Ok(())
}

/// Looks at every file that the stages are given which are still to be done; `frames` must be done.
///
/// # Errors
/// What the stage itself would say of the file.
pub(super) fn check_files(run: &Run, open: &[Stage]) -> Result<(), PipelineError> {
    open.iter().try_for_each(|stage| match stage {
        Stage::Segment => segmentation_model(run),
        Stage::Track => masks_and_flow_model(run),
        Stage::Background => background_model(run),
        Stage::Objects => object_models(run),
        Stage::Ground => ground_labels(run),
        Stage::Frames | Stage::Features | Stage::Scale | Stage::Report => Ok(()),
    })
}

fn segmentation_model(run: &Run) -> Result<(), PipelineError> {
    match &run.options.instances {
        Instances::Model(path) => segment::load(run, path).map(drop),
        Instances::None | Instances::Masks(_) => Ok(()),
    }
}

fn masks_and_flow_model(run: &Run) -> Result<(), PipelineError> {
    match &run.options.instances {
        Instances::None => Ok(()),
        Instances::Masks(folder) => MaskFolder::open(folder, run.frames()?, run.info())?.check(),
        Instances::Model(_) => track::load_flow_estimator(run).map(drop),
    }
}

fn background_model(run: &Run) -> Result<(), PipelineError> {
    run.options.background_model.iter().try_for_each(|folder| models::given(folder, run).map(drop))
}

fn object_models(run: &Run) -> Result<(), PipelineError> {
    run.options.object_models.values().try_for_each(|folder| models::given(folder, run).map(drop))
}

fn ground_labels(run: &Run) -> Result<(), PipelineError> {
    match &run.options.ground_labels {
        GroundLabels::Geometric => Ok(()),
        GroundLabels::Masks { folder, .. } => MaskFolder::open(folder, run.frames()?, run.info())?.check(),
        GroundLabels::Model(path) => ground::load(run, path).map(drop),
    }
}
