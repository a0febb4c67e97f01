//! Choice of the listed frames among the selected ones.

use std::path::Path;

use super::decode::Inspection;
use super::repeats;
use crate::scene::{Frame, Topic, Warning};

/// Collects the frames of an input during a scan.
#[derive(Debug, Default)]
pub(super) struct Survey {
    frames: Vec<Frame>,
    found: Vec<Inspection>,
}

/// Result of a survey.
#[derive(Debug)]
pub(super) struct Surveyed {
    pub(super) frames: Vec<Frame>,
    pub(super) num_repeated: usize,
    pub(super) warnings: Vec<Warning>,
}

impl Survey {
    pub(super) fn push(&mut self, frame: Frame, found: Inspection) {
        self.frames.push(frame);
        self.found.push(found);
    }

    pub(super) fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Removes frames of another size than the first, and those that repeat their predecessor.
    ///
    /// * `size` – size of the first frame of the input, upright and with square pixels.
    pub(super) fn finish(self, path: &Path, size: (u32, u32)) -> Surveyed {
        let Self { frames, found } = self;
        let (path, count) = (path.display(), frames.len());
        let is_repeated = repeats::repeated(&found.iter().map(|frame| frame.change).collect::<Vec<_>>());
        let mut warnings = Vec::new();
        let other = || frames.iter().zip(&found).filter_map(|(frame, found)| Some((frame, found.other_size?)));
        if let Some((first, (other_width, other_height))) = other().next() {
            let ((width, height), num_other, id) = (size, other().count(), first.id.0);
            warnings.push(Topic::FrameSizeChanges.warning(format!(
                "{path}: {num_other} of {count} frames skipped, other size than the first ({width}x{height}), from \
                 frame {id} ({other_width}x{other_height}) on; cut the video where its size changes (--end {id}f, \
                 --start {id}f)"
            )));
        }
        let num_repeated = is_repeated.iter().filter(|repeated| **repeated).count();
        if num_repeated > 0 {
            warnings.push(Topic::RepeatedFrames.warning(format!(
                "{path}: {num_repeated} of {count} frames skipped: they repeat the one before; indices and times are \
                 those of the video"
            )));
        }
        let num_combed = found.iter().filter(|frame| frame.is_combed).count();
        if num_combed > 0 {
            warnings.push(Topic::InterlacedVideo.warning(format!(
                "{path}: interlaced, the fields of {num_combed} of {count} frames differ; one field of each is used, \
                 with half the rows; for more detail deinterlace it: `ffmpeg -i FILE -vf bwdif=mode=send_frame OUT`"
            )));
        }
        let is_kept = found.iter().zip(&is_repeated).map(|(found, repeated)| found.other_size.is_none() && !repeated);
        let frames = frames.into_iter().zip(is_kept).filter_map(|(frame, kept)| kept.then_some(frame)).collect();
        Surveyed { frames, num_repeated, warnings }
    }
}
