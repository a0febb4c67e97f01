//! Frames of the growing recording: the newest one waits, older ones are dropped.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use ::image::RgbImage;

use super::LiveError;
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

/// A queue of length one between decoder and perception.
pub(super) struct Newest {
    slot: Arc<(Mutex<Slot>, Condvar)>,
}

#[derive(Default)]
struct Slot {
    frame: Option<Box<Arrived>>,
    num_dropped: u64,
    is_over: bool,
    error: Option<VideoError>,
}

impl Newest {
    /// Decodes on a thread of its own.
    ///
    /// * `is_paced` – true if frames come at the pace of their time stamps, false if the source sets the pace.
    ///
    /// # Errors
    /// [`LiveError::Thread`].
    pub(super) fn start(frames: Frames, is_paced: bool) -> Result<Self, LiveError> {
        let slot: Arc<(Mutex<Slot>, Condvar)> = Arc::default();
        let filled = slot.clone();
        let work = move || {
            let mut start = None;
            for item in frames {
                match item {
                    Ok((frame, picture)) => {
                        if is_paced {
                            wait_until(&mut start, frame.time_s);
                        }
                        put(&filled, Arrived { frame, picture, at: Instant::now() });
                    }
                    Err(error) => lock(&filled.0).error = Some(error),
                }
            }
            lock(&filled.0).is_over = true;
            filled.1.notify_all();
        };
        thread::Builder::new().name("newest".into()).spawn(work).map_err(LiveError::Thread)?;
        Ok(Self { slot })
    }

    /// Takes the newest frame; waits for one up to `patience`.
    pub(super) fn take(&self, patience: Duration) -> Next<Box<Arrived>> {
        let mut slot = lock(&self.slot.0);
        if slot.frame.is_none() && !slot.is_over {
            slot = self.slot.1.wait_timeout(slot, patience).unwrap_or_else(PoisonError::into_inner).0;
        }
        match (slot.frame.take(), slot.is_over) {
            (Some(frame), _) => Next::Frame(frame),
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

fn lock(slot: &Mutex<Slot>) -> MutexGuard<'_, Slot> {
    slot.lock().unwrap_or_else(PoisonError::into_inner)
}

fn put((slot, changed): &(Mutex<Slot>, Condvar), arrived: Arrived) {
    let mut slot = lock(slot);
    slot.num_dropped += u64::from(slot.frame.replace(Box::new(arrived)).is_some());
    changed.notify_all();
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
}
