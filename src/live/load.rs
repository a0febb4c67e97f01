//! Workload: what is reduced when processing does not keep up, in a fixed order.

/// Reductions in the order in which they come into force.
const REDUCTIONS: [&str; 4] = ["masks at 1 Hz", "detector at 1 Hz", "every second frame", "every fourth frame"];
/// Time from one look of the detector to the next, and of the mask network, seconds: those of a run.
const DETECTOR_S: f64 = 0.2;
const MASKS_S: f64 = 0.4;
/// The same where it is reduced.
const REDUCED_S: f64 = 1.0;
/// Time over which load is measured before another reduction, seconds: two looks of the detector and more.
const REACTION_S: f64 = 1.0;
/// Time without overload after which the last reduction is taken back, seconds.
const RECOVERY_S: f64 = 5.0;
/// Share of the time between frames that processing may take: beyond, frames are dropped soon.
const OVERLOAD: f64 = 1.0;
/// Share below which there is room for more work: what a reduction saves is at most a half.
const ROOM: f64 = 0.6;

/// Decides what is done in a frame.
#[derive(Debug, Default)]
pub(super) struct Load {
    level: usize,
    /// Time of the last change, or of the last overload, seconds.
    since_s: f64,
    /// Since then: times of processing and of the frames, seconds.
    busy_s: f64,
    spent_s: f64,
    last_s: Option<f64>,
    count: u64,
}

impl Load {
    /// Counts a frame; returns true if it is to be skipped.
    pub(super) fn skips(&mut self) -> bool {
        let every = [1, 1, 1, 2, 4][self.level];
        self.count += 1;
        !self.count.is_multiple_of(every)
    }

    /// Seconds between looks of the detector, and of the mask network.
    pub(super) fn periods_s(&self) -> [f64; 2] {
        let period_s = |usual: f64, reduced_at: usize| if self.level >= reduced_at { REDUCED_S } else { usual };
        [period_s(DETECTOR_S, 2), period_s(MASKS_S, 1)]
    }

    pub(super) fn level(&self) -> usize {
        self.level
    }

    pub(super) fn reductions(&self) -> Vec<&'static str> {
        REDUCTIONS[..self.level].to_vec()
    }

    /// Takes the time of a frame and that of its processing; gives the reason of a change.
    pub(super) fn note(&mut self, time_s: f64, busy_s: f64) -> Option<String> {
        let step_s = self.last_s.map_or(0.0, |last| time_s - last);
        self.last_s = Some(time_s);
        self.busy_s += busy_s;
        self.spent_s += step_s;
        if self.spent_s < REACTION_S {
            return None;
        }
        let share = self.busy_s / self.spent_s;
        let percent = 100.0 * share;
        (self.busy_s, self.spent_s) = (0.0, 0.0);
        if share > OVERLOAD {
            self.since_s = time_s;
            if self.level == REDUCTIONS.len() {
                return None;
            }
            self.level += 1;
            return Some(format!("processing takes {percent:.0} % of the time"));
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

    /// Runs frames of 0.1 s from a time on; gives the changes of level.
    fn run(load: &mut Load, from_s: f64, to_s: f64, busy_s: f64) -> Vec<usize> {
        let times = (0..).map(|k| from_s + 0.1 * f64::from(k)).take_while(|time| *time < to_s);
        times.filter_map(|time| load.note(time, busy_s).map(|_| load.level())).collect()
    }

    #[test]
    fn work_is_reduced_in_order_and_taken_back() {
        let mut load = Load::default();
        assert!(run(&mut load, 0.0, 3.0, 0.09).is_empty());
        assert_eq!(run(&mut load, 3.0, 8.5, 0.2), [1, 2, 3, 4]);
        assert_eq!(load.periods_s(), [1.0, 1.0]);
        assert_eq!((0..8).filter(|_| !load.skips()).count(), 2);
        assert!(run(&mut load, 8.5, 12.0, 0.03).is_empty(), "not before 5 s without lag");
        assert_eq!(run(&mut load, 12.0, 40.0, 0.03), [3, 2, 1, 0]);
        assert_eq!((load.periods_s(), load.skips()), ([0.2, 0.4], false));
    }
}
