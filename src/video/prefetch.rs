//! Decoding on a thread of its own, a fixed number of pictures ahead of the caller.

use std::collections::BTreeSet;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{self, JoinHandle};

use ::image::RgbImage;

use super::VideoError;
use super::decode::{Decoder, next_chosen};
use super::options::Selection;
use crate::scene::{Frame, FrameId};

/// Pictures that are decoded ahead of the caller. With the one under way and the one in the caller's hands, four frames
/// are in memory at most.
const AHEAD: usize = 2;

/// The chosen frames with their pictures, in order. A frame that cannot be decoded is an `Err` among them, and the
/// next ones follow.
pub struct Frames {
    items: Option<Receiver<Result<(Frame, RgbImage), VideoError>>>,
    thread: Option<JoinHandle<()>>,
}

impl Frames {
    /// Decodes on a thread of its own; `only`, if given, names the frames whose pictures are wanted.
    ///
    /// # Errors
    /// [`VideoError::Thread`].
    pub(super) fn start(
        mut decoder: Box<dyn Decoder>,
        mut selection: Selection,
        only: Option<BTreeSet<FrameId>>,
    ) -> Result<Self, VideoError> {
        let (sender, items) = sync_channel(AHEAD);
        let last = only.as_ref().map(|ids| ids.last().copied());
        let work = move || {
            while let Some(stepped) = next_chosen(decoder.as_mut(), &mut selection).transpose() {
                let frame = match stepped {
                    Ok(frame) => frame,
                    Err(error) => return drop(sender.send(Err(error))),
                };
                if last.is_some_and(|last| last.is_none_or(|last| frame.id > last)) {
                    return;
                }
                if only.as_ref().is_some_and(|ids| !ids.contains(&frame.id)) {
                    continue;
                }
                let item = decoder.picture().map(|picture| (frame, picture));
                if sender.send(item).is_err() {
                    return; // The caller has lost interest.
                }
            }
        };
        let thread = thread::Builder::new().name("decoder".into()).spawn(work).map_err(VideoError::Thread)?;
        Ok(Self { items: Some(items), thread: Some(thread) })
    }
}

impl Iterator for Frames {
    type Item = Result<(Frame, RgbImage), VideoError>;

    fn next(&mut self) -> Option<Self::Item> {
        self.items.as_ref()?.recv().ok()
    }
}

impl Drop for Frames {
    fn drop(&mut self) {
        self.items = None; // The thread's next send fails, and it ends.
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
