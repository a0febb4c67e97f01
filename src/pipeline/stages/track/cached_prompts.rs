//! Cache of prompted masks until the stage is done: an interrupted run prompts for none twice.
//!
//! The prompts of a tracker in a frame follow from its input alone, so the same run repeats them. A cached answer
//! counts only for the very same boxes.

use std::path::PathBuf;

use ::image::RgbImage;
use serde::{Deserialize, Serialize};

use crate::networks::{BoxMask, BoxSegmenter, PerceptionError};
use crate::pipeline::driver::intermediate;
use crate::scene::{FrameId, Rect};

/// Direction in which the frames are processed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pass {
    /// From the first frame to the last.
    Forward,
    /// Backward from first masks.
    Backward,
}

/// Segmenter whose answers are cached in a folder.
pub(super) struct CachedSegmenter {
    segmenter: Box<dyn BoxSegmenter>,
    folder: PathBuf,
    frame: FrameId,
    pass: Pass,
    /// Number of calls in this frame.
    num_calls: usize,
}

#[derive(Serialize, Deserialize)]
struct CachedPrompts {
    boxes: Vec<Rect>,
    answers: Vec<Option<BoxMask>>,
}

impl CachedSegmenter {
    pub(super) fn new(segmenter: Box<dyn BoxSegmenter>, folder: PathBuf) -> Self {
        Self { segmenter, folder, frame: FrameId(0), pass: Pass::Forward, num_calls: 0 }
    }

    /// Sets the next frame.
    pub(super) fn begin(&mut self, frame: FrameId, pass: Pass) {
        (self.frame, self.pass, self.num_calls) = (frame, pass, 0);
    }

    fn path(&self) -> PathBuf {
        let pass = match self.pass {
            Pass::Forward => "f",
            Pass::Backward => "b",
        };
        self.folder.join(format!("{:06}-{pass}{}.bin", self.frame.0, self.num_calls))
    }

    /// Cached answers; `None` if the file is damaged or of other boxes.
    fn read_cached(&self, size: (u32, u32), boxes: &[Rect]) -> Option<Vec<Option<BoxMask>>> {
        let cached: CachedPrompts = intermediate::read(&self.path()).ok()?;
        let is_of_frame = cached.answers.iter().flatten().all(|answer| answer.mask.size() == size);
        (is_of_frame && cached.boxes == boxes && cached.answers.len() == boxes.len()).then_some(cached.answers)
    }

    /// Caches an answer. A failure costs only the cached answer; the masks themselves are written elsewhere.
    fn write_cached(&self, boxes: &[Rect], answers: &[Option<BoxMask>]) {
        let cached = CachedPrompts { boxes: boxes.to_vec(), answers: answers.to_vec() };
        let written = intermediate::write(&self.path(), &cached);
        if written.is_err() {
            tracing::debug!("{}: not kept", self.path().display());
        }
    }
}

impl BoxSegmenter for CachedSegmenter {
    fn masks(&mut self, image: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError> {
        self.num_calls += 1;
        if let Some(answers) = self.read_cached(image.dimensions(), boxes) {
            return Ok(answers);
        }
        let answers = self.segmenter.masks(image, boxes)?;
        self.write_cached(boxes, &answers);
        Ok(answers)
    }

    fn is_coarse(&self) -> bool {
        self.segmenter.is_coarse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Mask;

    /// Answers with the box itself, and counts the calls.
    struct CountingSegmenter<'a>(&'a std::cell::Cell<usize>);

    impl BoxSegmenter for CountingSegmenter<'_> {
        fn masks(&mut self, image: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError> {
            self.0.set(self.0.get() + 1);
            let (width, height) = image.dimensions();
            let mask = |rect: &Rect| Mask::from_fn(width, height, |x, y| rect.contains(x.into(), y.into()));
            Ok(boxes
                .iter()
                .map(|rect| Some(BoxMask { mask: mask(rect), quality: 0.5 }))
                .chain([None])
                .take(boxes.len())
                .collect())
        }

        fn is_coarse(&self) -> bool {
            true
        }
    }

    #[test]
    fn repeated_prompts_are_cached_and_others_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let image = RgbImage::new(8, 6);
        let rect = Rect { x0: 1.0, y0: 2.0, x1: 5.0, y1: 4.0 };
        let counts: &'static std::cell::Cell<usize> = Box::leak(Box::default());
        let cached = || CachedSegmenter::new(Box::new(CountingSegmenter(counts)), folder.path().to_owned());
        let first = cached().masks(&image, &[rect]).unwrap();
        let mut again = cached();
        assert_eq!(again.masks(&image, &[rect]).unwrap(), first);
        assert_eq!(counts.get(), 1);
        again.masks(&image, &[rect]).unwrap();
        again.begin(FrameId(1), Pass::Forward);
        again.masks(&image, &[rect]).unwrap();
        cached().masks(&image, &[Rect { x1: 6.0, ..rect }]).unwrap();
        assert_eq!(counts.get(), 4);
        std::fs::write(again.path(), b"damaged").unwrap();
        again.begin(FrameId(1), Pass::Forward);
        assert_eq!(again.masks(&image, &[rect]).unwrap(), first);
        assert_eq!(counts.get(), 5);
    }
}
