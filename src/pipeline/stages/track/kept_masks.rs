//! Masks of all objects by frame for later stages, run-length encoded, so that the PNG images are decoded once.

use std::path::{Path, PathBuf};

use crate::pipeline::driver::intermediate::damaged;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::stages::segment::detections::FrameFolder;
use crate::pipeline::{Result, Stage};
use crate::scene::{Frame, Mask, ObjectId, TrackedObject};

/// Cached masks by frame.
pub(super) struct KeptMasks {
    frames: FrameFolder<(ObjectId, Mask)>,
    size: (u32, u32),
}

impl KeptMasks {
    fn new(run: &Run, folder: PathBuf) -> Self {
        Self { frames: FrameFolder::new(folder), size: run.size() }
    }

    /// The masks of the stage, which must be done.
    pub(super) fn done(run: &Run) -> Self {
        Self::new(run, run.folder(Stage::Track))
    }

    /// Caches the masks of the stage's folder; each image is decoded once.
    pub(super) fn keep(run: &Run, images: &Path, objects: &[TrackedObject], outcome: &mut Outcome) -> Result<Self> {
        let folder = run.workspace.intermediate(Stage::Track, &outcome.fingerprint)?;
        let kept = Self::new(run, folder.clone());
        outcome.outputs.push(folder);
        for frame in run.frames()? {
            let mask = |id| Ok((id, super::mask_in(run, images, id, frame)?));
            let found: Vec<(ObjectId, Mask)> = visible(objects, frame).map(mask).collect::<Result<_>>()?;
            if !found.is_empty() {
                kept.frames.write(frame, &found)?;
            }
        }
        Ok(kept)
    }

    /// The masks of objects in a frame, in the order in which they were cached.
    pub(super) fn read(&self, objects: &[TrackedObject], frame: &Frame) -> Result<Vec<(ObjectId, Mask)>> {
        let wanted: Vec<ObjectId> = visible(objects, frame).collect();
        if wanted.is_empty() {
            return Ok(Vec::new());
        }
        let mut kept = self.frames.read_masks(frame.id, self.size, |(_, mask)| mask)?;
        kept.retain(|(id, _)| wanted.contains(id));
        match kept.len() == wanted.len() {
            true => Ok(kept),
            false => Err(damaged(&self.frames.path(frame.id), "masks are missing")),
        }
    }
}

fn visible(objects: &[TrackedObject], frame: &Frame) -> impl Iterator<Item = ObjectId> {
    objects.iter().filter(|object| object.is_visible_in(frame.id)).map(|object| object.id)
}
