//! Stage `features`: tracks of image points on the background. Besides, how such tracks lie on disk.

pub(in crate::pipeline) mod found_features;
pub(in crate::pipeline) mod masking;

use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::motion::point_tracks::{self, Follower};
use crate::features::{FrontEnd, TrackTable};
use crate::image::Picture;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::driver::{fingerprint, intermediate};
use crate::pipeline::inputs::{cameras, images, order, telemetry};
use crate::pipeline::{Instances, Result, Stage};
use crate::scene::Topic;
use crate::video::VideoError;
use masking::Masking;

pub(in crate::pipeline) use super::motion::point_tracks::FEATURES_PREFIX as PREFIX;
pub(in crate::pipeline) const BACKGROUND: &str = "background";

pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    let cameras: Vec<_> = cameras::initial(run)?.into_iter().map(|initial| initial.camera).collect();
    let (background, _) = order::sfm_options(run)?;
    // No stage before this one reads given masks.
    let masks = match &run.options.instances {
        Instances::Masks(folder) => Some(fingerprint::of_content(folder)?),
        Instances::None | Instances::Model(_) | Instances::Vehicles => None,
    };
    // A log may have positions of unordered photographs by name; those inside of them are part of the input.
    let positions = if order::found(run)?.in_time { Vec::new() } else { telemetry::fingerprints(run) };
    Ok(json!({
        "cameras": cameras,
        "masking": run.options.masking,
        "background": background.front_end,
        "given_background": run.options.background_model.is_some(),
        "masks": masks,
        "positions": positions,
        "seed": run.options.seed,
    }))
}

pub(in crate::pipeline) fn run_stage(run: &Run, fingerprint: &str, outcome: &mut Outcome) -> Result<()> {
    let folder = run.workspace.intermediate(PREFIX, fingerprint)?;
    if run.options.background_model.is_none() {
        let are_wanted = run.goal >= Stage::Motion && point_tracks::is_wanted(run)?;
        let mut points = are_wanted.then(|| Follower::new(run));
        let table = follow_background(run, points.as_mut(), outcome)?;
        if let Some(points) = points {
            intermediate::write(&folder.join(point_tracks::FILE_NAME), &points.finish())?;
        }
        outcome.figure("background_tracks", table.tracks.len());
        intermediate::write(&tracks_of(&folder, BACKGROUND), &table)?;
    }
    outcome.outputs.push(folder);
    Ok(())
}

/// Tracks of the background; `points` of the vehicles are followed on the way, so that the images are decoded once.
fn follow_background(run: &Run, mut points: Option<&mut Follower>, outcome: &mut Outcome) -> Result<TrackTable> {
    let initial = cameras::initial(run)?;
    if let Some(open) = cameras::not_covered(run, &initial) {
        outcome.warn(Topic::IntrinsicsIncomplete.warning(open));
    }
    let camera_of = cameras::of_frames(run)?;
    let (options, _) = order::sfm_options(run)?;
    let masking = Masking::new(run)?;
    let initial = initial.into_iter().map(|initial| initial.camera).collect();
    let mut background = FrontEnd::of_cameras(&options.front_end, initial)?;
    if !order::found(run)?.in_time {
        background.know_positions(telemetry::positions_by_name(run));
    }
    let wanted = run.frames()?.iter().map(|frame| frame.id).collect();
    let mut num_decoded = 0u64;
    images::for_each(run, Stage::Features, wanted, outcome, |frame, picture| {
        let mask = masking.background(&frame, picture.dimensions())?;
        let camera = camera_of.get(&frame.id).copied().unwrap_or_default();
        num_decoded += 1;
        let picture = Picture::new(&picture);
        if let Some(points) = &mut points {
            points.push(&frame, &picture)?;
        }
        Ok(background.push_of(camera, &frame, &picture, &mask)?)
    })?;
    if num_decoded == 0 {
        // No result, which later runs would take over: memory may have been short.
        return Err(VideoError::NoFrames { path: run.input().to_owned() }.into());
    }
    Ok(background.finish(run.options.seed)?)
}

/// The tracks of the background; the stage must be done.
pub(in crate::pipeline) fn of_background(run: &Run) -> Result<TrackTable> {
    intermediate::read(&tracks_of(&run.folder(PREFIX, Stage::Features), BACKGROUND))
}

/// The file with the tracks of a target in a stage's folder.
pub(in crate::pipeline) fn tracks_of(folder: &Path, target: &str) -> PathBuf {
    folder.join(format!("{target}.bin"))
}
