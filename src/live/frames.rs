//! Frames of the growing recording: the newest one is queued, older ones are dropped.

use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use ::image::RgbImage;

use super::{PATIENCE, lock};
use crate::files::Growth;
use crate::pipeline::PipelineError;
use crate::scene::Frame;
use crate::video::{Frames, VideoError};

/// A decoded frame.
pub(super) struct Arrived {
    pub(super) frame: Frame,
    pub(super) picture: RgbImage,
    /// When it was decoded.
    pub(super) at: Instant,
}

/// Result of waiting for a frame.
pub(super) enum Next<T> {
    Frame(T),
    /// None came in time.
    Nothing,
    /// The recording has ended.
    Over,
}

/// Frames of a recording, and their pacing.
pub(super) struct Input {
    pub(super) frames: Frames,
    /// True if frames come at the pace of their time stamps, false if the source sets the pace.
    pub(super) is_paced: bool,
    /// Of the recording.
    pub(super) growth: Arc<Growth>,
}

/// Frames that a decoder holds back at most, and gives at once when the source has ended: reordering of H.264.
const MAX_HELD_BACK: usize = 16;

/// A queue of length one between decoder and perception.
pub(super) struct Newest {
    slot: Arc<(Mutex<Slot>, Condvar)>,
}

#[derive(Default)]
struct Slot {
    frame: Option<Box<Arrived>>,
    /// True once frames come at their own rate.
    has_begun: bool,
    num_dropped: u64,
    is_over: bool,
    error: Option<VideoError>,
}

impl Newest {
    /// Decodes on a thread of its own.
    ///
    /// # Errors
    /// [`PipelineError::Thread`].
    pub(super) fn start(input: Input) -> Result<Self, PipelineError> {
        let begun = Slot { has_begun: input.is_paced, ..Slot::default() };
        let slot = Arc::new((Mutex::new(begun), Condvar::new()));
        let filled = slot.clone();
        let work = move || {
            let Input { frames, is_paced, growth } = input;
            let (mut start, mut num_held_back) = (None, 0);
            for item in frames {
                match item {
                    Ok((frame, picture)) => {
                        if is_paced {
                            wait_until(&mut start, frame.time_s);
                        } else if num_held_back < MAX_HELD_BACK && growth.is_finished() {
                            num_held_back += 1;
                            wait_until_taken(&filled);
                        }
                        put(&filled, Arrived { frame, picture, at: Instant::now() });
                    }
                    Err(error) => lock(&filled.0).error = Some(error),
                }
            }
            lock(&filled.0).is_over = true;
            filled.1.notify_all();
        };
        thread::Builder::new().name("newest".into()).spawn(work).map_err(PipelineError::Thread)?;
        Ok(Self { slot })
    }

    /// Takes the newest frame; waits for one up to `patience`.
    pub(super) fn take(&self, patience: Duration) -> Next<Box<Arrived>> {
        let mut slot = lock(&self.slot.0);
        if slot.frame.is_none() && !slot.is_over {
            slot = self.slot.1.wait_timeout(slot, patience).unwrap_or_else(PoisonError::into_inner).0;
        }
        if slot.frame.is_some() && !slot.has_begun {
            // Those that were read to determine the format come at once: a gap would follow the first of them.
            slot.has_begun = true;
            drop(slot);
            thread::sleep(PATIENCE);
            slot = lock(&self.slot.0);
        }
        match (slot.frame.take(), slot.is_over) {
            (Some(frame), _) => {
                self.slot.1.notify_all();
                Next::Frame(frame)
            }
            (None, true) => Next::Over,
            (None, false) => Next::Nothing,
        }
    }

    /// Frames that a newer one replaced so far.
    pub(super) fn num_dropped(&self) -> u64 {
        lock(&self.slot.0).num_dropped
    }

    /// The last frame that could not be decoded, once.
    pub(super) fn take_error(&self) -> Option<VideoError> {
        lock(&self.slot.0).error.take()
    }
}

fn put((slot, changed): &(Mutex<Slot>, Condvar), arrived: Arrived) {
    let mut slot = lock(slot);
    slot.num_dropped += u64::from(slot.frame.replace(Box::new(arrived)).is_some());
    changed.notify_all();
}

/// Waits until the queue is empty, or the receiver is dropped.
fn wait_until_taken(shared: &Arc<(Mutex<Slot>, Condvar)>) {
    let mut slot = lock(&shared.0);
    while slot.frame.is_some() && Arc::strong_count(shared) > 1 {
        slot = shared.1.wait_timeout(slot, PATIENCE).unwrap_or_else(PoisonError::into_inner).0;
    }
}

/// Waits until a time of the video, which began when its first frame was decoded.
fn wait_until(start: &mut Option<(Instant, f64)>, time_s: f64) {
    let (began, first_s) = *start.get_or_insert((Instant::now(), time_s));
    let wanted = Duration::try_from_secs_f64(time_s - first_s).unwrap_or_default();
    thread::sleep(wanted.saturating_sub(began.elapsed()));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::FrameId;

    #[test]
    fn the_newest_frame_replaces_a_waiting_one() {
        let slot: Arc<(Mutex<Slot>, Condvar)> = Arc::default();
        let newest = Newest { slot: slot.clone() };
        for id in 0..3 {
            let frame = Frame { id: FrameId(id), name: String::new(), time_s: f64::from(id) };
            put(&slot, Arrived { frame, picture: RgbImage::new(1, 1), at: Instant::now() });
        }
        let Next::Frame(taken) = newest.take(Duration::ZERO) else { panic!("a frame waits") };
        assert_eq!((taken.frame.id, newest.num_dropped()), (FrameId(2), 2));
        assert!(matches!(newest.take(Duration::ZERO), Next::Nothing));
        lock(&slot.0).is_over = true;
        assert!(matches!(newest.take(Duration::ZERO), Next::Over));
    }

    #[test]
    fn frames_held_back_by_the_decoder_wait_until_they_are_taken() {
        let slot: Arc<(Mutex<Slot>, Condvar)> = Arc::default();
        let newest = Newest { slot: slot.clone() };
        let arrived = |id| {
            let frame = Frame { id: FrameId(id), name: String::new(), time_s: f64::from(id) };
            Arrived { frame, picture: RgbImage::new(1, 1), at: Instant::now() }
        };
        put(&slot, arrived(0));
        let held_back = thread::spawn(move || {
            for id in 1..3 {
                wait_until_taken(&slot);
                put(&slot, arrived(id));
            }
            wait_until_taken(&slot);
        });
        for id in 0..2 {
            let Next::Frame(taken) = newest.take(Duration::from_secs(10)) else { panic!("frame {id} waits") };
            assert_eq!((taken.frame.id, newest.num_dropped()), (FrameId(id), 0));
        }
        // The receiver of the last frame is dropped.
        drop(newest);
        held_back.join().unwrap();
    }
}
