//! Points tracked all over the images, for the stage `motion`.
//!
//! Tracking needs only images, and the stage `features` decodes all of them anyway: a video is decoded once for both.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::motion::PointTrack;
use crate::pipeline::driver::intermediate;
use crate::pipeline::driver::run::Run;
use crate::pipeline::inputs::order;
use crate::pipeline::{Instances, Result, Stage};
use crate::scene::Frame;

/// Points and the frames that their tracks index, from 0: those that could be decoded.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(in crate::pipeline) struct TrackedPoints {
    pub(in crate::pipeline) frames: Vec<Frame>,
    pub(in crate::pipeline) tracks: Vec<PointTrack>,
}

/// Returns true if motion is wanted and the images are in temporal order.
pub(in crate::pipeline) fn is_wanted(run: &Run) -> Result<bool> {
    Ok(order::found(run)?.in_time && run.options.instances != Instances::None)
}

/// The points; the stage `features` must be done.
pub(in crate::pipeline) fn points(run: &Run) -> Result<TrackedPoints> {
    intermediate::read(&path_in(&run.folder(Stage::Features)))
}

/// The file of the points in the folder of the stage `features`.
pub(in crate::pipeline) fn path_in(folder: &Path) -> PathBuf {
    folder.join("points.bin")
}
