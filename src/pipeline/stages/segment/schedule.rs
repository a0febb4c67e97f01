//! Schedule of the networks: they are the slowest part, and little changes between nearby frames.
//!
//! The detector runs in every `detector`-th frame, the mask network in every `masks`-th. Unless the user chooses, the
//! detector runs in these frames as well. Both run in the last frame. Between, their results are propagated by optical
//! flow.

use crate::math::upper_median;
use crate::pipeline::Result;
use crate::pipeline::driver::run::Run;
use crate::scene::Frame;

/// Time between two runs of the detector, seconds.
const DETECTOR_S: f64 = 0.2;
/// Time between two runs of the mask network, seconds.
const MASKS_S: f64 = 0.4;
/// Maximum interval of the detector, frames.
const MAX_DETECTOR: usize = 6;
/// Maximum interval of the mask network, frames.
const MAX_MASKS: usize = 12;

/// Frames in which the networks run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::pipeline) struct Schedule {
    /// Interval of the detector, frames.
    pub(in crate::pipeline) detector: usize,
    /// Interval of the mask network, frames.
    pub(in crate::pipeline) masks: usize,
    num_frames: usize,
}

impl Schedule {
    /// The schedule of a run, whose frames must be known.
    pub(in crate::pipeline) fn of(run: &Run) -> Result<Self> {
        let frames = run.frames()?;
        Ok(Self::new(step_s(frames), run.options.vehicles.segment_every, frames.len()))
    }

    /// * `step_s` – time from one frame to the next, seconds; `None` for a single frame.
    /// * `chosen` – interval of the mask network chosen by the user, frames.
    fn new(step_s: Option<f64>, chosen: Option<u32>, num_frames: usize) -> Self {
        let step_s = step_s.filter(|step_s| *step_s > 0.0).unwrap_or(f64::INFINITY);
        let detector = ((DETECTOR_S / step_s).round() as usize).clamp(1, MAX_DETECTOR);
        let ratio = ((MASKS_S / (step_s * detector as f64)).round() as usize).max(1);
        let masks = (ratio * detector).clamp(2, MAX_MASKS);
        Self { detector, masks: chosen.map_or(masks, |chosen| chosen.max(1) as usize), num_frames }
    }

    /// Returns true if the detector runs on the `index`-th frame.
    pub(in crate::pipeline) fn is_detected(&self, index: usize) -> bool {
        index.is_multiple_of(self.detector) || index + 1 == self.num_frames
    }

    /// Returns true if the mask network runs on the `index`-th frame.
    pub(in crate::pipeline) fn is_segmented(&self, index: usize) -> bool {
        index.is_multiple_of(self.masks) || index + 1 == self.num_frames
    }
}

/// Median time from one frame to the next, seconds; `None` for a single frame.
fn step_s(frames: &[Frame]) -> Option<f64> {
    upper_median(frames.windows(2).map(|pair| pair[1].time_s - pair[0].time_s).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_follow_the_frame_rate() {
        let of = |step_s| {
            let rhythm = Schedule::new(step_s, None, 100);
            (rhythm.detector, rhythm.masks)
        };
        let steps = [Some(0.1), Some(0.1 + 1e-9), Some(0.04), Some(1.0 / 30.0), Some(1.0), Some(0.001), None];
        assert_eq!(steps.map(of), [(2, 4), (2, 4), (5, 10), (6, 12), (1, 2), (6, 12), (1, 2)]);
        assert_eq!(of(Some(0.0)), (1, 2));
    }

    #[test]
    fn masks_are_drawn_in_detector_frames_and_the_last_frame() {
        let rhythm = Schedule::new(Some(0.1), None, 8);
        let scheduled = |is: fn(&Schedule, usize) -> bool| (0..8).filter(|k| is(&rhythm, *k)).collect::<Vec<_>>();
        assert_eq!(scheduled(Schedule::is_detected), [0, 2, 4, 6, 7]);
        assert_eq!(scheduled(Schedule::is_segmented), [0, 4, 7]);
        let chosen = Schedule::new(Some(0.1), Some(3), 8);
        assert_eq!((0..8).filter(|k| chosen.is_segmented(*k)).collect::<Vec<_>>(), [0, 3, 6, 7]);
        assert!((0..8).all(|k| chosen.is_detected(k) == rhythm.is_detected(k)));
    }
}
