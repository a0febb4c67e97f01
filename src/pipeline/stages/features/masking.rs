//! Background masks: they exclude all movable objects.

use crate::pipeline::driver::run::Run;
use crate::pipeline::inputs::given_masks::MaskFolder;
use crate::pipeline::stages::segment;
use crate::pipeline::{Instances, Result};
use crate::scene::{Frame, FrameId, Mask};

/// Source of the masks of movable objects.
enum Movable {
    /// No source.
    Nothing,
    /// Masks given by the user.
    Given(MaskFolder),
    /// Instances by a network, including untracked ones: a parked car may leave, and a person walks.
    Masks(segment::DetectionFolder),
    /// Boxes of the detector, and the frames in which it ran, ascending.
    Boxes(segment::BoxFolder, Vec<FrameId>),
}

/// Source of the background masks of frames.
pub(in crate::pipeline) struct Masking {
    movable: Movable,
    dilation_px: u32,
}

impl Masking {
    /// Opens the source of the masks; the stage `segment` must be done.
    pub(in crate::pipeline) fn new(run: &Run) -> Result<Self> {
        let dilation_px = run.options.masking.dilation_px(run.size());
        let movable = match &run.options.instances {
            Instances::None => Movable::Nothing,
            Instances::Masks(folder) => Movable::Given(MaskFolder::open(folder, run.frames()?, run.info())?),
            Instances::Model(_) => Movable::Masks(segment::finished(run)),
            Instances::Vehicles => {
                let boxes = segment::finished_boxes(run);
                let detected = run.frames()?.iter().filter(|frame| boxes.has(frame)).map(|frame| frame.id).collect();
                Movable::Boxes(boxes, detected)
            }
        };
        Ok(Self { movable, dilation_px })
    }

    /// The background mask of a frame, at the size of its image.
    pub(in crate::pipeline) fn background(&self, frame: &Frame, size: (u32, u32)) -> Result<Mask> {
        Ok(self.movable(frame, size)?.dilated(self.dilation_px).complement())
    }

    fn movable(&self, frame: &Frame, (width, height): (u32, u32)) -> Result<Mask> {
        let mut movable = Mask::empty(width, height);
        match &self.movable {
            Movable::Nothing => {}
            Movable::Given(folder) => return Ok(folder.labels(frame.id)?.map_or(movable, |labels| labels.any())),
            Movable::Masks(folder) => {
                let found = folder.read_masks(frame.id, (width, height), |found| &found.mask)?;
                found.iter().for_each(|found| movable.union_with(&found.mask));
            }
            Movable::Boxes(folder, detected) => {
                for near in nearest(detected, frame.id) {
                    folder.read(near)?.iter().for_each(|found| movable.fill_rect(&found.rect, true));
                }
            }
        }
        Ok(movable)
    }
}

/// A frame itself if the detector ran in it, else the nearest such frames before and after it: an object that moves
/// between two detections is inside two boxes that overlap or nearly do.
///
/// * `detected` – frames in which the detector ran, ascending.
fn nearest(detected: &[FrameId], frame: FrameId) -> Vec<FrameId> {
    match detected.binary_search(&frame) {
        Ok(_) => vec![frame],
        Err(after) => detected[after.saturating_sub(1)..detected.len().min(after + 1)].to_vec(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_two_detections_both_count() {
        let detected = [2, 4, 9].map(FrameId);
        assert_eq!(nearest(&detected, FrameId(4)), [FrameId(4)]);
        assert_eq!(nearest(&detected, FrameId(3)), [FrameId(2), FrameId(4)]);
        assert_eq!(nearest(&detected, FrameId(0)), [FrameId(2)]);
        assert_eq!(nearest(&detected, FrameId(11)), [FrameId(9)]);
        assert_eq!(nearest(&[], FrameId(1)), []);
    }
}
