//! A fast segmenter, and an exact one for the boxes of which the fast one is unsure.

use ::image::RgbImage;

use super::{BoxMask, BoxSegmenter};
use crate::networks::PerceptionError;
use crate::scene::Rect;

/// Quality from which a mask of the fast segmenter counts. On five real clips masks above it overlap with `MobileSAM`'s
/// by 0.90 on average, those below by 0.80 (models/box_masks.md).
const SURE: f64 = 0.85;

/// Loads the exact segmenter.
type Load = Box<dyn Fn() -> Result<Box<dyn BoxSegmenter>, PerceptionError>>;

/// Two segmenters, one after the other.
pub struct Cascade {
    fast: Box<dyn BoxSegmenter>,
    /// Loaded when it is needed first: it takes ten times the memory.
    exact: Option<Box<dyn BoxSegmenter>>,
    load: Load,
}

impl Cascade {
    /// * `load` – loads the exact segmenter.
    pub fn new(
        fast: Box<dyn BoxSegmenter>,
        load: impl Fn() -> Result<Box<dyn BoxSegmenter>, PerceptionError> + 'static,
    ) -> Self {
        Self { fast, exact: None, load: Box::new(load) }
    }
}

impl BoxSegmenter for Cascade {
    fn masks(&mut self, image: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError> {
        let mut found = self.fast.masks(image, boxes)?;
        let is_unsure = |answer: &Option<BoxMask>| answer.as_ref().is_none_or(|mask| mask.quality < SURE);
        let unsure: Vec<usize> = (0..found.len()).filter(|&k| is_unsure(&found[k])).collect();
        if unsure.is_empty() {
            return Ok(found);
        }
        let exact = match &mut self.exact {
            Some(exact) => exact,
            exact => exact.insert((self.load)()?),
        };
        let boxes: Vec<Rect> = unsure.iter().map(|&k| boxes[k]).collect();
        unsure.into_iter().zip(exact.masks(image, &boxes)?).for_each(|(k, answer)| found[k] = answer);
        Ok(found)
    }

    fn is_coarse(&self) -> bool {
        self.fast.is_coarse()
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::rc::Rc;

    use super::*;
    use crate::scene::Mask;

    /// Answers with one quality per box, and none below 0; counts boxes.
    struct Fixed(Vec<f64>, Rc<Cell<usize>>);

    impl BoxSegmenter for Fixed {
        fn masks(&mut self, _: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError> {
            self.1.set(self.1.get() + boxes.len());
            let mask = |quality: f64| (quality >= 0.0).then(|| BoxMask { mask: Mask::empty(4, 4), quality });
            Ok(self.0[..boxes.len()].iter().map(|&quality| mask(quality)).collect())
        }

        fn is_coarse(&self) -> bool {
            false
        }
    }

    #[test]
    fn the_exact_segmenter_is_asked_where_the_fast_one_is_unsure() {
        let (asked, loaded) = (Rc::new(Cell::new(0)), Rc::new(Cell::new(0)));
        let exact = (asked.clone(), loaded.clone());
        let fast = Box::new(Fixed(vec![0.95, 0.6, -1.0, 0.9], Rc::default()));
        let mut cascade = Cascade::new(fast, move || {
            exact.1.set(exact.1.get() + 1);
            Ok(Box::new(Fixed(vec![0.7, -1.0], exact.0.clone())))
        });
        let (image, rect) = (RgbImage::new(4, 4), Rect { x0: 0.0, y0: 0.0, x1: 4.0, y1: 4.0 });
        let mut qualities = |count: usize| {
            let found = cascade.masks(&image, &vec![rect; count]).unwrap();
            found.into_iter().map(|found| found.map(|mask| mask.quality)).collect::<Vec<_>>()
        };
        assert_eq!(qualities(1), [Some(0.95)]);
        assert_eq!((asked.get(), loaded.get()), (0, 0), "it is not even loaded");
        assert_eq!(qualities(4), [Some(0.95), Some(0.7), None, Some(0.9)]);
        qualities(4);
        assert_eq!((asked.get(), loaded.get()), (4, 1));
    }
}
