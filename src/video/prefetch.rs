//! Decoding on a separate thread, a fixed number of images ahead of the caller.

use std::collections::BTreeSet;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{self, JoinHandle};

use ::image::RgbImage;

use super::VideoError;
use super::decode::{Decoder, next_chosen};
use super::options::Selection;
use crate::scene::{Frame, FrameId};

/// Number of images decoded ahead of the caller.
///
/// With the one being decoded and the one held by the caller, at most four images are in memory.
const AHEAD: usize = 2;

/// Selected frames with their images, in order.
///
/// A frame that cannot be decoded is an `Err`; the iteration continues after it.
pub struct Frames {
    items: Option<Receiver<Result<(Frame, RgbImage), VideoError>>>,
    thread: Option<JoinHandle<()>>,
}

impl Frames {
    /// Starts decoding on a separate thread; `only`, if given, restricts the frames whose images are decoded.
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
                let item = decoder.image().map(|image| (frame, image));
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
