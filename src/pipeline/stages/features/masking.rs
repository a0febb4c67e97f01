//! Which pixels are background: it keeps away from all that moves or may move.

use crate::pipeline::driver::run::Run;
use crate::pipeline::inputs::given_masks::MaskFolder;
use crate::pipeline::stages::segment;
use crate::pipeline::{Instances, Result};
use crate::scene::{Frame, FrameId, Mask};

/// Where something is that may move by itself.
enum Movable {
    /// Nobody looked.
    Nothing,
    /// Masks that the user gives.
    Given(MaskFolder),
    /// Instances by a network, also those that are not tracked: a parked car may leave, and a person walks.
    Masks(segment::DetectionFolder),
    /// The same as boxes, in the frames at which the detector looked, ascending.
    Boxes(segment::BoxFolder, Vec<FrameId>),
}

/// Gives the background's masks of frames.
pub(in crate::pipeline) struct Masking {
    movable: Movable,
    dilation_px: u32,
}

impl Masking {
    /// The stage `segment` must be done.
    pub(in crate::pipeline) fn new(run: &Run) -> Result<Self> {
        let dilation_px = run.options.masking.dilation_px(run.size());
        let movable = match &run.options.instances {
            Instances::None => Movable::Nothing,
            Instances::Masks(folder) => Movable::Given(MaskFolder::open(folder, run.frames()?, run.info())?),
            Instances::Model(_) => Movable::Masks(segment::finished(run)),
            Instances::Vehicles => {
                let boxes = segment::finished_boxes(run);
                let looked = run.frames()?.iter().filter(|frame| boxes.has(frame)).map(|frame| frame.id).collect();
                Movable::Boxes(boxes, looked)
            }
        };
        Ok(Self { movable, dilation_px })
    }

    /// Where nothing moves in a frame, whose picture has a size.
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
            Movable::Boxes(folder, looked) => {
                for near in nearest(looked, frame.id) {
                    folder.read(near)?.iter().for_each(|found| movable.fill_rect(&found.rect, true));
                }
            }
        }
        Ok(movable)
    }
}

/// A frame itself if it is among those that were looked at, else the ones before and after it: what moves between two
/// looks lies between two boxes that overlap or nearly do.
///
/// * `looked` – ascending.
fn nearest(looked: &[FrameId], frame: FrameId) -> Vec<FrameId> {
    match looked.binary_search(&frame) {
        Ok(_) => vec![frame],
        Err(after) => looked[after.saturating_sub(1)..looked.len().min(after + 1)].to_vec(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn between_two_looks_both_count() {
        let looked = [2, 4, 9].map(FrameId);
        assert_eq!(nearest(&looked, FrameId(4)), [FrameId(4)]);
        assert_eq!(nearest(&looked, FrameId(3)), [FrameId(2), FrameId(4)]);
        assert_eq!(nearest(&looked, FrameId(0)), [FrameId(2)]);
        assert_eq!(nearest(&looked, FrameId(11)), [FrameId(9)]);
        assert_eq!(nearest(&[], FrameId(1)), []);
    }
}
