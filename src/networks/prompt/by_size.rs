//! Selection between two segmenters by the size of the box.

use ::image::RgbImage;

use super::{BoxMask, BoxSegmenter};
use crate::networks::PerceptionError;
use crate::scene::Rect;

/// Maximum longer side of a box for the small network, pixels: on rendered vehicles of 17 pixels its IoU with the truth
/// is 0.93 instead of 0.87 (`models/box_masks.md`). With 40 real clips lose a fifth of their masks.
const SMALL_PX: f64 = 20.0;

/// Segmenter that uses one segmenter for small boxes and another for large ones.
pub struct BySize {
    /// Segmenter for small boxes.
    pub small: Box<dyn BoxSegmenter>,
    /// Segmenter for large boxes.
    pub large: Box<dyn BoxSegmenter>,
}

impl BoxSegmenter for BySize {
    fn masks(&mut self, image: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError> {
        let mut masks = vec![None; boxes.len()];
        for (segmenter, is_small) in [(&mut self.small, true), (&mut self.large, false)] {
            let own: Vec<usize> = (0..boxes.len()).filter(|&k| (boxes[k].extent_px() < SMALL_PX) == is_small).collect();
            if !own.is_empty() {
                let prompts: Vec<Rect> = own.iter().map(|&k| boxes[k]).collect();
                own.into_iter().zip(segmenter.masks(image, &prompts)?).for_each(|(k, mask)| masks[k] = mask);
            }
        }
        Ok(masks)
    }

    fn is_coarse(&self) -> bool {
        self.large.is_coarse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Mask;

    /// Segmenter with a fixed quality (first) for boxes wider than a limit (second).
    struct FixedQuality(f64, f64);

    impl BoxSegmenter for FixedQuality {
        fn masks(&mut self, image: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError> {
            let (width, height) = image.dimensions();
            let mask = |rect: &Rect| Mask::from_fn(width, height, |x, y| rect.contains(x.into(), y.into()));
            let box_mask = |rect: &Rect| (rect.width() > self.1).then(|| BoxMask { mask: mask(rect), quality: self.0 });
            Ok(boxes.iter().map(box_mask).collect())
        }

        fn is_coarse(&self) -> bool {
            false
        }
    }

    #[test]
    fn each_box_has_the_mask_of_the_segmenter_for_its_size() {
        let mut by_size = BySize { small: Box::new(FixedQuality(0.1, 12.0)), large: Box::new(FixedQuality(0.9, 5.0)) };
        let boxes = [60.0, 10.0, 19.0, 21.0, 4.0].map(|side| Rect { x0: 0.0, y0: 0.0, x1: side, y1: 3.0 });
        let masks = by_size.masks(&RgbImage::new(80, 20), &boxes).unwrap();
        let found: Vec<Option<f64>> = masks.into_iter().map(|mask| mask.map(|mask| mask.quality)).collect();
        assert_eq!(found, [Some(0.9), None, Some(0.1), Some(0.9), None]);
        assert!(by_size.masks(&RgbImage::new(80, 20), &[]).unwrap().is_empty());
    }
}
