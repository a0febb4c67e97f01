//! Points followed all over the pictures, for the stage `motion`.
//!
//! Following needs nothing but pictures. The stage `features` goes through all of them anyway, and where `motion`
//! comes after it in the same run the points are followed on the way: a video is decoded once for both. What they
//! became lies next to the tracks of `features`, in [`FILE_NAME`]; where it is not, `motion` follows
//! by itself, to the same result.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::image::Picture;
use crate::motion::{PointFollower, PointTrack};
use crate::pipeline::driver::intermediate;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::{images, order};
use crate::pipeline::{Instances, Result, Stage};
use crate::scene::Frame;

/// Prefix of the folder of the stage `features`, where the points lie that it tracked on the way.
pub(in crate::pipeline) const FEATURES_PREFIX: &str = "features-";

/// Points and the frames that their tracks count, from 0: those that could be decoded.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(in crate::pipeline) struct Followed {
    pub(in crate::pipeline) frames: Vec<Frame>,
    pub(in crate::pipeline) tracks: Vec<PointTrack>,
}

/// Returns true if motion is wanted and the images are in time order.
pub(in crate::pipeline) fn is_wanted(run: &Run) -> Result<bool> {
    Ok(order::found(run)?.in_time && run.options.instances != Instances::None)
}

/// Follows points from picture to picture.
pub(in crate::pipeline) struct Follower {
    points: PointFollower,
    frames: Vec<Frame>,
}

impl Follower {
    /// Nothing seen yet.
    pub(in crate::pipeline) fn new(run: &Run) -> Self {
        Self { points: PointFollower::new(run.size()), frames: Vec::new() }
    }

    /// Takes the next frame.
    pub(in crate::pipeline) fn push(&mut self, frame: &Frame, picture: &Picture) -> Result<()> {
        self.points.push(picture)?;
        self.frames.push(frame.clone());
        Ok(())
    }

    /// Tracks of all points.
    pub(in crate::pipeline) fn finish(self) -> Followed {
        Followed { frames: self.frames, tracks: self.points.finish() }
    }
}

/// Name of the file with the points.
pub(in crate::pipeline) const FILE_NAME: &str = "points.bin";

/// Points that the stage `features` left; otherwise they are tracked now, and kept in `folder`.
pub(in crate::pipeline) fn points(run: &Run, folder: &Path, outcome: &mut Outcome) -> Result<Followed> {
    let beside = beside_features(run);
    if beside.is_file() {
        return intermediate::read(&beside);
    }
    let mut follower = Follower::new(run);
    let wanted = run.frames()?.iter().map(|frame| frame.id).collect();
    images::for_each(run, Stage::Motion, wanted, outcome, |frame, picture| {
        follower.push(&frame, &Picture::new(&picture))
    })?;
    let followed = follower.finish();
    intermediate::write(&folder.join(FILE_NAME), &followed)?;
    Ok(followed)
}

/// Points that [`points`] gave; `folder` is where it may be kept.
pub(in crate::pipeline) fn kept_points(run: &Run, folder: &Path) -> Result<Followed> {
    let beside = beside_features(run);
    intermediate::read(&if beside.is_file() { beside } else { folder.join(FILE_NAME) })
}

fn beside_features(run: &Run) -> PathBuf {
    run.folder(FEATURES_PREFIX, Stage::Features).join(FILE_NAME)
}
