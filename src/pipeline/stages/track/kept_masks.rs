//! The masks of all objects, frame by frame, as later stages read them: run lengths, so that the PNG images are decoded
//! once.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::pipeline::driver::intermediate::damaged;
use crate::pipeline::driver::run::Run;
use crate::pipeline::stages::segment::detections::{FrameFolder, mask_of_runs, runs_of_mask};
use crate::pipeline::{Result, Stage};
use crate::scene::{Frame, Mask, ObjectId, TrackedObject};

/// Prefix of the folder.
const PREFIX: &str = "tracked-masks-";

/// The mask of an object in a frame.
#[derive(Serialize, Deserialize)]
struct KeptMask {
    object: ObjectId,
    runs: Vec<u32>,
}

/// Masks by frame.
pub(super) struct KeptMasks {
    frames: FrameFolder<KeptMask>,
    size: (u32, u32),
}

impl KeptMasks {
    fn new(run: &Run, folder: PathBuf) -> Self {
        Self { frames: FrameFolder::new(folder), size: run.size() }
    }

    /// Those of the stage, which must be done.
    pub(super) fn done(run: &Run) -> Self {
        Self::new(run, run.folder(PREFIX, Stage::Track))
    }

    /// Keeps the masks of the stage's folder, each image of which is decoded once; gives their own folder, too.
    pub(super) fn keep(
        run: &Run,
        images: &Path,
        objects: &[TrackedObject],
        fingerprint: &str,
    ) -> Result<(Self, PathBuf)> {
        let folder = run.workspace.intermediate(PREFIX, fingerprint)?;
        let kept = Self::new(run, folder.clone());
        for frame in run.frames()? {
            let kept_mask = |object| {
                let mask = super::mask_in(run, images, object, frame)?;
                Ok(KeptMask { object, runs: runs_of_mask(&mask) })
            };
            let found: Vec<KeptMask> = visible(objects, frame).map(kept_mask).collect::<Result<_>>()?;
            if !found.is_empty() {
                kept.frames.write(frame, &found)?;
            }
        }
        Ok((kept, folder))
    }

    /// The masks of objects in a frame, in the order in which they were kept.
    pub(super) fn read(&self, objects: &[TrackedObject], frame: &Frame) -> Result<Vec<(ObjectId, Mask)>> {
        let wanted: Vec<ObjectId> = visible(objects, frame).collect();
        if wanted.is_empty() {
            return Ok(Vec::new());
        }
        let kept = self.frames.read(frame.id)?;
        let damaged = |problem| damaged(&self.frames.path(frame.id), problem);
        if !wanted.iter().all(|id| kept.iter().any(|mask| mask.object == *id)) {
            return Err(damaged("masks are missing"));
        }
        let mask = |kept: KeptMask| {
            let mask =
                mask_of_runs(&kept.runs, self.size).ok_or_else(|| damaged("a mask differs in size from its frame"))?;
            Ok((kept.object, mask))
        };
        kept.into_iter().filter(|mask| wanted.contains(&mask.object)).map(mask).collect()
    }
}

fn visible(objects: &[TrackedObject], frame: &Frame) -> impl Iterator<Item = ObjectId> {
    objects.iter().filter(|object| object.is_visible_in(frame.id)).map(|object| object.id)
}
