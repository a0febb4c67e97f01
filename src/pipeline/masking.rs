//! Which pixels belong to which target: the background keeps away from all that moves, an object to its own mask.

use super::PipelineError;
use super::detections::DetectionFolder;
use super::run::Run;
use super::segment;
use super::track::{self, TrackedObject};
use crate::scene::{Frame, Mask, ObjectId};

/// The masks of one frame.
pub(super) struct FrameMasks {
    /// Where nothing moves.
    pub(super) background: Mask,
    /// Where the tracked objects are.
    pub(super) objects: Vec<(ObjectId, Mask)>,
}

/// Gives the masks of frames.
pub(super) struct Masking<'a> {
    run: &'a Run<'a>,
    objects: &'a [TrackedObject],
    detections: Option<DetectionFolder>,
    dilation_px: u32,
}

impl<'a> Masking<'a> {
    pub(super) fn new(run: &'a Run<'a>, objects: &'a [TrackedObject]) -> Self {
        let longer_px = run.info().width.max(run.info().height);
        let dilation_px = (run.options.masking.dilation * f64::from(longer_px)).round() as u32;
        Self { run, objects, detections: segment::finished(run), dilation_px }
    }

    /// Everything that was detected counts as moving, tracked or not: a parked car may leave, and a person walks.
    pub(super) fn of(&self, frame: &Frame) -> Result<FrameMasks, PipelineError> {
        let objects = track::masks_of(self.run, self.objects, frame)?;
        let mut movable = Mask::empty(self.run.info().width, self.run.info().height);
        for (_, mask) in &objects {
            movable.union_with(mask);
        }
        if let Some(detections) = &self.detections {
            for detection in detections.read(frame.id)? {
                movable.union_with(&detection.mask);
            }
        }
        Ok(FrameMasks { background: movable.dilated(self.dilation_px).complement(), objects })
    }
}
