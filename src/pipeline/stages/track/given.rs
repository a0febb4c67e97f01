//! Tracks from given masks: one object per label.

use std::collections::BTreeMap;
use std::path::Path;

use crate::io::masks;
use crate::pipeline::Result;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::given_masks::MaskFolder;
use crate::scene::{DetectionCounts, FrameId, ObjectId, Outline, TrackedObject};

/// Writes one mask per label of the given label maps into `folder`.
pub(super) fn split(run: &Run, given: &Path, folder: &Path, outcome: &mut Outcome) -> Result<Vec<TrackedObject>> {
    let frames = run.frames()?;
    let files = MaskFolder::open(given, frames, run.info())?;
    if let Some(warning) = files.warning(given, frames) {
        outcome.warn(warning);
    }
    outcome.figure("num_frames_without_mask", files.missing.len());
    run.progress.begin("track", Some(frames.len() as u64));
    let mut seen: BTreeMap<ObjectId, Vec<FrameId>> = BTreeMap::new();
    for frame in frames {
        run.step()?;
        let Some(labels) = files.labels(frame.id)? else { continue };
        for label in labels.present() {
            let id = ObjectId(label.into());
            masks::write_mask(&super::mask_path(folder, id, frame), &labels.mask(label))?;
            seen.entry(id).or_default().push(frame.id);
        }
    }
    Ok(seen.into_iter().map(|(id, frames)| object(id, frames)).collect())
}

fn object(id: ObjectId, frames: Vec<FrameId>) -> TrackedObject {
    TrackedObject {
        id,
        // Given masks have no class.
        class: "vehicle".to_owned(),
        confidence: 1.0,
        found_in: DetectionCounts { given: frames.len(), ..DetectionCounts::default() },
        outline: Outline::Given,
        mask_quality: None,
        movement: super::movement::unknown(),
        left_out: None,
        frames,
        gaps: Vec::new(),
        apart: Vec::new(),
    }
}
