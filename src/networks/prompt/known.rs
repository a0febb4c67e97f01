//! Masks of an instance segmentation network, as results of box prompts.

use ::image::RgbImage;

use super::{BoxMask, BoxSegmenter};
use crate::networks::PerceptionError;
use crate::scene::{Detection, Mask, Rect};

/// Minimum IoU of a mask's bounding box with the box prompt.
const MIN_OVERLAP: f64 = 0.5;

/// Segmenter that returns the known masks of one frame.
#[derive(Clone, Debug, Default)]
pub struct KnownMasks {
    masks: Vec<(Rect, Mask)>,
}

impl KnownMasks {
    /// Segmenter with the masks of a frame; detections with empty masks are skipped.
    pub fn new(detections: Vec<Detection>) -> Self {
        let known = |found: Detection| Some((Rect::from(found.mask.bounding_box()?), found.mask));
        Self { masks: detections.into_iter().filter_map(known).collect() }
    }
}

impl BoxSegmenter for KnownMasks {
    /// Returns the mask with the largest IoU of its bounding box. The quality is 1, since the network gives none.
    fn masks(&mut self, _: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError> {
        let best_mask = |prompt: &Rect| {
            let overlaps = self.masks.iter().map(|(rect, mask)| (rect.iou(prompt), mask));
            let best = overlaps.filter(|(overlap, _)| *overlap >= MIN_OVERLAP).max_by(|a, b| a.0.total_cmp(&b.0));
            best.map(|(_, mask)| BoxMask { mask: mask.clone(), quality: 1.0 })
        };
        Ok(boxes.iter().map(best_mask).collect())
    }

    fn is_coarse(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_gets_the_mask_that_agrees_best_or_none() {
        let block = |x0: u32, x1: u32| Mask::from_fn(60, 20, |x, y| (x0..x1).contains(&x) && (5..15).contains(&y));
        let detection = |mask| Detection { class: "car".into(), confidence: 0.4, mask };
        let mut known = KnownMasks::new([block(5, 25), block(8, 30), Mask::empty(60, 20)].map(detection).to_vec());
        let rect = |x0, x1| Rect { x0, y0: 5.0, x1, y1: 15.0 };
        let image = RgbImage::new(60, 20);
        let found = known.masks(&image, &[rect(5.0, 24.0), rect(9.0, 31.0), rect(40.0, 60.0)]).unwrap();
        let masks: Vec<_> = found.into_iter().map(|found| found.map(|found| found.mask)).collect();
        assert_eq!(masks, [Some(block(5, 25)), Some(block(8, 30)), None]);
    }
}
