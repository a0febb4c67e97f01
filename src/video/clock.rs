//! Time stamps for frames whose container has none, or none that increase.

use std::collections::VecDeque;

/// Rebuilds missing or non-increasing time stamps, frame by frame.
///
/// Rebuilt stamps continue at the recent frame interval.
#[derive(Debug)]
pub(super) struct Clock {
    nominal_step_s: f64,
    /// Most recent frame intervals of the container, seconds.
    recent_s: VecDeque<f64>,
    last_s: Option<f64>,
    /// Container's time stamp of the last frame.
    stated_s: Option<f64>,
    num_rebuilt: u32,
    num_trailing: u32,
}

/// Frame rate if the container has no plausible one.
const FALLBACK_FPS: f64 = 25.0;
/// Number of recent frame intervals whose median is the step of rebuilt time stamps.
const NUM_RECENT: usize = 7;
/// Latest plausible time, seconds: thirty years. Beyond it, the resolution of times is too coarse for them to increase.
const LATEST_S: f64 = 1e9;
/// Relative difference of frame intervals below which the rate counts as constant; containers round to ticks.
const STEADY: f64 = 0.05;

impl Clock {
    pub(super) fn new(fps: Option<f64>) -> Self {
        let nominal_step_s = 1.0 / fps.unwrap_or(FALLBACK_FPS);
        let recent_s = VecDeque::new();
        Self { nominal_step_s, recent_s, last_s: None, stated_s: None, num_rebuilt: 0, num_trailing: 0 }
    }

    /// Returns the time of the next frame, given the container's time stamp.
    pub(super) fn advance(&mut self, stated_s: Option<f64>) -> f64 {
        let stated_s = stated_s.filter(|time_s| (0.0..=LATEST_S).contains(time_s));
        let before_s = std::mem::replace(&mut self.stated_s, stated_s);
        if let Some(stated_s) = stated_s.filter(|time_s| self.last_s.is_none_or(|last| *time_s > last)) {
            if let Some(last) = self.last_s.filter(|_| self.num_trailing == 0) {
                self.note(stated_s - last);
            }
            self.num_trailing = 0;
            self.last_s = Some(stated_s);
            return stated_s;
        }
        // Time stamps earlier than the rebuilt ones still give the frame interval. Without them, an assumed step that
        // is too long would keep every later time stamp behind.
        if let Some((stated_s, before_s)) = stated_s.zip(before_s).filter(|(stated_s, before_s)| stated_s > before_s) {
            self.note(stated_s - before_s);
        }
        self.num_rebuilt += 1;
        self.num_trailing += 1;
        // A step may be below the floating-point resolution of a late time.
        let time_s = self.last_s.map_or(0.0, |last| (last + self.step_s()).max(last.next_up()));
        self.last_s = Some(time_s);
        time_s
    }

    fn note(&mut self, interval_s: f64) {
        self.recent_s.truncate(NUM_RECENT - 1);
        self.recent_s.push_front(interval_s);
    }

    /// Number of guessed time stamps.
    ///
    /// At a constant rate, frames after the last time stamp of the container do not count: decoders give no time stamps
    /// for the frames that they buffer at the end of a file, and the rate is known.
    pub(super) fn num_guessed(&self) -> u32 {
        self.num_rebuilt - if self.is_steady() { self.num_trailing } else { 0 }
    }

    /// Median of the recent intervals.
    fn step_s(&self) -> f64 {
        let mut sorted: Vec<f64> = self.recent_s.iter().copied().collect();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(self.nominal_step_s)
    }

    fn is_steady(&self) -> bool {
        let shortest = self.recent_s.iter().copied().fold(f64::INFINITY, f64::min);
        let longest = self.recent_s.iter().copied().fold(0.0, f64::max);
        longest > 0.0 && longest - shortest <= STEADY * longest
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn times_are_finite_and_increase_for_all_stamps(
            fps in proptest::option::of(1e-3..1000.0),
            stated in prop::collection::vec(proptest::option::of(prop_oneof![0.0..10.0, any::<f64>()]), 1..60),
        ) {
            let mut clock = Clock::new(fps);
            let times: Vec<f64> = stated.into_iter().map(|stated_s| clock.advance(stated_s)).collect();
            prop_assert!(times.iter().all(|time| time.is_finite()) && times.is_sorted_by(|a, b| a < b), "{times:?}");
            prop_assert!(clock.num_guessed() as usize <= times.len());
        }
    }

    #[test]
    fn missing_and_repeated_stamps_are_rebuilt() {
        let mut clock = Clock::new(Some(10.0));
        let stated = [Some(0.0), Some(0.1), Some(0.1), None, Some(0.05), Some(0.7), Some(-1.0)];
        let times: Vec<f64> = stated.iter().map(|&s| clock.advance(s)).collect();
        let expected = [0.0, 0.1, 0.2, 0.3, 0.4, 0.7, 0.8];
        for (time, expected) in times.iter().zip(expected) {
            assert!((time - expected).abs() < 1e-12, "{times:?}");
        }
        assert_eq!(clock.num_guessed(), 3);
    }

    #[test]
    fn stamps_earlier_than_rebuilt_ones_give_the_interval() {
        let mut clock = Clock::new(Some(8.0));
        let times: Vec<f64> =
            [2.3, 2.2, 2.3, 2.4, 2.5, 2.6, 2.7, 2.8].into_iter().map(|s| clock.advance(Some(s))).collect();
        let steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(steps[1..].iter().all(|step| (step - 0.1).abs() < 1e-9), "{times:?}");
    }

    #[test]
    fn a_variable_rate_is_kept_and_its_lost_end_is_a_guess() {
        let mut clock = Clock::new(None);
        for stated in [0.02, 0.05, 0.5, 0.51] {
            assert_eq!(clock.advance(Some(stated)), stated);
        }
        assert_eq!(clock.num_guessed(), 0);
        clock.advance(None);
        assert_eq!(clock.num_guessed(), 1);
    }

    #[test]
    fn the_end_of_a_steady_rate_is_known() {
        let mut clock = Clock::new(Some(30.0));
        let stated = [Some(0.0), Some(0.1), Some(0.2), Some(0.3), None, None];
        let times: Vec<f64> = stated.iter().map(|&s| clock.advance(s)).collect();
        assert!((times[5] - 0.5).abs() < 1e-12);
        assert_eq!(clock.num_guessed(), 0);
    }
}
