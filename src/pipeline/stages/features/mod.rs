//! Stage `features`: tracks of image points on the background, and the file format of such tracks.

pub(in crate::pipeline) mod found_features;
pub(in crate::pipeline) mod masking;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::motion::point_tracks::{self, TrackedPoints};
use crate::features::{FrontEnd, TrackTable};
use crate::image::Picture;
use crate::motion::PointFollower;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::driver::{fingerprint, intermediate};
use crate::pipeline::inputs::{cameras, images, order, telemetry};
use crate::pipeline::{Instances, Result, Stage};
use crate::scene::{FrameId, Topic};
use crate::video::VideoError;
use masking::Masking;

pub(in crate::pipeline) const BACKGROUND: &str = "background";

pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    let cameras: Vec<_> = cameras::initial(run)?.into_iter().map(|initial| initial.camera).collect();
    let (background, _) = order::sfm_options(run)?;
    // No stage before this one reads given masks.
    let masks = match &run.options.instances {
        Instances::Masks(folder) => Some(fingerprint::of_content(folder)?),
        Instances::None | Instances::Model(_) | Instances::Vehicles => None,
    };
    // A log may have positions of unordered photographs by name; those in the photographs are part of the input.
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

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    let folder = run.workspace.intermediate(Stage::Features, &outcome.fingerprint)?;
    let mut points = point_tracks::is_wanted(run)?.then(|| PointFollower::new(run.size()));
    let mut background = match run.options.background_model {
        None => Some(Background::new(run, outcome)?),
        Some(_) => None,
    };
    let mut frames = Vec::new();
    let wanted = run.frames()?.iter().filter(|_| points.is_some() || background.is_some());
    images::for_each(run, Stage::Features, wanted.map(|frame| frame.id).collect(), outcome, |frame, picture| {
        let of_frame = Picture::new(&picture);
        if let Some(points) = &mut points {
            points.push(&of_frame)?;
        }
        if let Some(Background { front_end, camera_of, masking }) = &mut background {
            let mask = masking.background(&frame, picture.dimensions())?;
            front_end.push_of(camera_of.get(&frame.id).copied().unwrap_or_default(), &frame, &of_frame, &mask)?;
        }
        frames.push(frame);
        Ok(())
    })?;
    if let Some(background) = background {
        if frames.is_empty() {
            // Not stored as a result that later runs would reuse: the cause may be a lack of memory.
            return Err(VideoError::NoFrames { path: run.input().to_owned() }.into());
        }
        let table = background.front_end.finish(run.options.seed)?;
        outcome.figure("background_tracks", table.tracks.len());
        intermediate::write(&tracks_of(&folder, BACKGROUND), &table)?;
    }
    if let Some(points) = points {
        intermediate::write(&point_tracks::path_in(&folder), &TrackedPoints { frames, tracks: points.finish() })?;
    }
    outcome.outputs.push(folder);
    Ok(())
}

/// The front end of the background, and the masks to which it restricts points.
struct Background {
    front_end: FrontEnd,
    camera_of: BTreeMap<FrameId, usize>,
    masking: Masking,
}

impl Background {
    fn new(run: &Run, outcome: &mut Outcome) -> Result<Self> {
        let initial = cameras::initial(run)?;
        if let Some(open) = cameras::not_covered(run, &initial) {
            outcome.warn(Topic::IntrinsicsIncomplete.warning(open));
        }
        let cameras = initial.into_iter().map(|initial| initial.camera).collect();
        let mut front_end = FrontEnd::of_cameras(&order::sfm_options(run)?.0.front_end, cameras)?;
        if !order::found(run)?.in_time {
            front_end.know_positions(telemetry::positions_by_name(run));
        }
        Ok(Self { front_end, camera_of: cameras::of_frames(run)?, masking: Masking::new(run)? })
    }
}

/// The tracks of the background; the stage must be done.
pub(in crate::pipeline) fn of_background(run: &Run) -> Result<TrackTable> {
    intermediate::read(&tracks_of(&run.folder(Stage::Features), BACKGROUND))
}

/// The file with the tracks of a target in a stage's folder.
pub(in crate::pipeline) fn tracks_of(folder: &Path, target: &str) -> PathBuf {
    folder.join(format!("{target}.bin"))
}
