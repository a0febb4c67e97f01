//! Workload control: reductions in a fixed order when processing does not keep up.

/// Reductions in the order in which they are applied.
const REDUCTIONS: [&str; 4] = ["masks at 1 Hz", "detector at 1 Hz", "every second frame", "every fourth frame"];
/// Period of the detector and of the mask network, seconds: a run detects twice as often.
const USUAL_S: f64 = 0.4;
/// Reduced period, seconds.
const REDUCED_S: f64 = 1.0;
/// Time over which load is measured before another reduction, seconds: five runs of the detector.
const REACTION_S: f64 = 2.0;
/// Time without overload after which the last reduction is reverted, seconds.
const RECOVERY_S: f64 = 5.0;
/// Maximum share of dropped frames: single drops occur where a map and a run of the detector coincide.
const MAX_DROPPED: f64 = 0.15;
/// Load below which a reduction is reverted: a reduction saves at most a half.
const ROOM: f64 = 0.6;

/// Decides on the work per frame.
#[derive(Debug, Default)]
pub(super) struct Load {
    level: usize,
    /// Time of the last change, or of the last overload, seconds.
    since_s: f64,
    /// Since then: times of processing and of the frames, seconds.
    busy_s: f64,
    spent_s: f64,
    /// Frames processed or skipped, and dropped, since then.
    num_done: u64,
    num_dropped: u64,
    last_s: Option<f64>,
    last_dropped: u64,
    count: u64,
}

impl Load {
    /// Counts a frame; returns true if it is to be skipped.
    pub(super) fn skips(&mut self) -> bool {
        let every = [1, 1, 1, 2, 4][self.level];
        self.count += 1;
        let skips = !self.count.is_multiple_of(every);
        self.num_done += u64::from(skips);
        skips
    }

    /// Seconds between runs of the detector, and of the mask network.
    pub(super) fn periods_s(&self) -> [f64; 2] {
        [2, 1].map(|reduced_at| if self.level >= reduced_at { REDUCED_S } else { USUAL_S })
    }

    pub(super) fn level(&self) -> usize {
        self.level
    }

    pub(super) fn reductions(&self) -> Vec<&'static str> {
        REDUCTIONS[..self.level].to_vec()
    }

    /// Takes the time of a processed frame, the duration of its slower stage, and the number of frames dropped so far;
    /// gives the reason of a change.
    pub(super) fn note(&mut self, time_s: f64, busy_s: f64, num_dropped: u64) -> Option<String> {
        self.spent_s += self.last_s.map_or(0.0, |last| time_s - last);
        self.busy_s += busy_s;
        self.num_done += 1;
        // Frames dropped before the first one are due to the start of the program.
        self.num_dropped += self.last_s.map_or(0, |_| num_dropped - self.last_dropped);
        (self.last_s, self.last_dropped) = (Some(time_s), num_dropped);
        if self.spent_s < REACTION_S {
            return None;
        }
        let (share, dropped) = (self.busy_s / self.spent_s, self.num_dropped);
        let is_overload = dropped as f64 > MAX_DROPPED * (dropped + self.num_done) as f64;
        (self.busy_s, self.spent_s, self.num_done, self.num_dropped) = (0.0, 0.0, 0, 0);
        let percent = 100.0 * share;
        if is_overload {
            self.since_s = time_s;
            if self.level == REDUCTIONS.len() {
                return None;
            }
            self.level += 1;
            return Some(format!("{dropped} frames dropped within {REACTION_S:.0} s"));
        }
        if self.level > 0 && share < ROOM && time_s - self.since_s >= RECOVERY_S {
            (self.level, self.since_s) = (self.level - 1, time_s);
            return Some(format!("{RECOVERY_S:.0} s without lag; processing takes {percent:.0} % of the time"));
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs frames of 0.1 s from a time on, of which every other one is dropped; gives the changes of level.
    fn run(load: &mut Load, from_s: f64, to_s: f64, busy_s: f64, drops: bool) -> Vec<usize> {
        let step_s = if drops { 0.2 } else { 0.1 };
        let times = (0..).map(|k| from_s + step_s * f64::from(k)).take_while(|time| *time < to_s);
        let note = |time: f64| {
            let dropped = load.last_dropped + u64::from(drops);
            load.note(time, busy_s, dropped).map(|_| load.level())
        };
        times.filter_map(note).collect()
    }

    #[test]
    fn reductions_are_applied_in_order_and_reverted() {
        let mut load = Load::default();
        assert!(run(&mut load, 0.0, 4.1, 0.09, false).is_empty());
        assert_eq!(run(&mut load, 4.1, 13.5, 0.2, true), [1, 2, 3, 4]);
        assert_eq!(load.periods_s(), [1.0, 1.0]);
        assert_eq!((0..8).filter(|_| !load.skips()).count(), 2);
        assert!(run(&mut load, 13.5, 16.0, 0.03, false).is_empty(), "not before 5 s without lag");
        assert_eq!(run(&mut load, 16.0, 50.0, 0.03, false), [3, 2, 1, 0]);
        assert_eq!((load.periods_s(), load.skips()), ([USUAL_S; 2], false));
    }

    #[test]
    fn reductions_are_not_reverted_under_load() {
        let mut load = Load::default();
        assert_eq!(run(&mut load, 0.0, 2.3, 0.2, true), [1]);
        assert!(run(&mut load, 2.3, 30.0, 0.08, false).is_empty());
    }
}
