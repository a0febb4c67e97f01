//! Masks that were asked for, kept until the stage is done: a run that was stopped asks for none twice.
//!
//! What a tracker asks for in a frame follows from its input alone, so the same run asks the same again. An answer
//! counts only for the very same boxes.

use std::path::PathBuf;

use ::image::RgbImage;
use serde::{Deserialize, Serialize};

use crate::networks::{BoxMask, BoxSegmenter, PerceptionError};
use crate::pipeline::driver::intermediate;
use crate::scene::{FrameId, Rect};

/// Which way the frames are gone through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Pass {
    /// From the first to the last.
    Forward,
    /// From first masks back.
    Backward,
}

/// A prompter whose answers are kept in a folder.
pub(super) struct CachedSegmenter {
    prompter: Box<dyn BoxSegmenter>,
    folder: PathBuf,
    frame: FrameId,
    pass: Pass,
    /// Number of box prompts in this frame.
    num_asked: usize,
}

#[derive(Serialize, Deserialize)]
struct CachedPrompts {
    boxes: Vec<Rect>,
    answers: Vec<Option<BoxMask>>,
}

impl CachedSegmenter {
    pub(super) fn new(prompter: Box<dyn BoxSegmenter>, folder: PathBuf) -> Self {
        Self { prompter, folder, frame: FrameId(0), pass: Pass::Forward, num_asked: 0 }
    }

    /// Says which frame is next.
    pub(super) fn begin(&mut self, frame: FrameId, pass: Pass) {
        (self.frame, self.pass, self.num_asked) = (frame, pass, 0);
    }

    fn path(&self) -> PathBuf {
        let pass = match self.pass {
            Pass::Forward => "f",
            Pass::Backward => "b",
        };
        self.folder.join(format!("{:06}-{pass}{}.bin", self.frame.0, self.num_asked))
    }

    /// Earlier answers; `None` if the file is damaged or of other boxes.
    fn recall(&self, size: (u32, u32), boxes: &[Rect]) -> Option<Vec<Option<BoxMask>>> {
        let asked: CachedPrompts = intermediate::read(&self.path()).ok()?;
        let is_of_frame = asked.answers.iter().flatten().all(|answer| answer.mask.size() == size);
        (is_of_frame && asked.boxes == boxes && asked.answers.len() == boxes.len()).then_some(asked.answers)
    }

    /// Keeps an answer. Where that fails there is one less to go on with; the masks themselves are written elsewhere.
    fn keep(&self, boxes: &[Rect], answers: &[Option<BoxMask>]) {
        let asked = CachedPrompts { boxes: boxes.to_vec(), answers: answers.to_vec() };
        let written = intermediate::write(&self.path(), &asked);
        if written.is_err() {
            tracing::debug!("{}: not kept", self.path().display());
        }
    }
}

impl BoxSegmenter for CachedSegmenter {
    fn masks(&mut self, image: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError> {
        self.num_asked += 1;
        if let Some(answers) = self.recall(image.dimensions(), boxes) {
            return Ok(answers);
        }
        let answers = self.prompter.masks(image, boxes)?;
        self.keep(boxes, &answers);
        Ok(answers)
    }

    fn is_coarse(&self) -> bool {
        self.prompter.is_coarse()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Mask;

    /// Answers with the box itself, and counts.
    struct Counting<'a>(&'a std::cell::Cell<usize>);

    impl BoxSegmenter for Counting<'_> {
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
    fn the_same_question_is_asked_once_and_another_anew() {
        let folder = tempfile::tempdir().unwrap();
        let image = RgbImage::new(8, 6);
        let rect = Rect { x0: 1.0, y0: 2.0, x1: 5.0, y1: 4.0 };
        let counts: &'static std::cell::Cell<usize> = Box::leak(Box::default());
        let kept = || CachedSegmenter::new(Box::new(Counting(counts)), folder.path().to_owned());
        let first = kept().masks(&image, &[rect]).unwrap();
        let mut again = kept();
        assert_eq!(again.masks(&image, &[rect]).unwrap(), first);
        assert_eq!(counts.get(), 1);
        again.masks(&image, &[rect]).unwrap();
        again.begin(FrameId(1), Pass::Forward);
        again.masks(&image, &[rect]).unwrap();
        kept().masks(&image, &[Rect { x1: 6.0, ..rect }]).unwrap();
        assert_eq!(counts.get(), 4);
        std::fs::write(again.path(), b"damaged").unwrap();
        again.begin(FrameId(1), Pass::Forward);
        assert_eq!(again.masks(&image, &[rect]).unwrap(), first);
        assert_eq!(counts.get(), 5);
    }
}
