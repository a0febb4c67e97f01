//! Fixes of a receiver in metres, grouped for the alignment with a path.

use nalgebra::{Point3, Vector2};

/// Position of a receiver, in metres east, north and up of an origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionFix {
    /// Time on the log's clock, seconds.
    pub time_s: f64,
    /// Metres east and north.
    pub east_north_m: Vector2<f64>,
    /// Metres up; all fixes of a log count from one level, by one kind of instrument.
    pub up_m: Option<f64>,
    /// Standard deviation in either horizontal direction, metres.
    pub horizontal_std_m: f64,
    /// Standard deviation of `up_m`, metres.
    pub vertical_std_m: f64,
    /// Resolution of the position, meters: the value of its last digit.
    pub rounding_m: f64,
}

impl PositionFix {
    fn is_finite(&self) -> bool {
        let numbers = [self.time_s, self.east_north_m.x, self.east_north_m.y, self.up_m.unwrap_or(0.0)];
        let deviations = [self.horizontal_std_m, self.vertical_std_m];
        numbers.iter().all(|value| value.is_finite())
            && deviations.iter().all(|std| std.is_finite() && *std > 0.0)
            && self.rounding_m.is_finite()
    }
}

/// Share of slowly varying noise in the variance of a receiver's error; the rest is independent between fixes: 1.5 m
/// next to 3 m. Receivers that smooth have less independent noise, which is estimated from the fixes.
pub(super) const WANDER_SHARE: f64 = 0.8;

/// Neighbouring fixes as one: their mean.
#[derive(Clone, Debug)]
pub(super) struct Group {
    /// Times of the fixes.
    pub(super) times_s: Vec<f64>,
    /// Mean of the positions; up is 0 where it is unknown.
    pub(super) position_m: Point3<f64>,
    /// True if `position_m.z` is valid.
    pub(super) has_up: bool,
    /// Variance of the independent noise of the mean, horizontal and vertical.
    pub(super) noise_m2: [f64; 2],
    /// Standard deviation of the correlated noise, horizontal and vertical.
    pub(super) wander_m: [f64; 2],
}

impl Group {
    fn of(fixes: &[PositionFix]) -> Self {
        let n = fixes.len() as f64;
        let mean = |value: &dyn Fn(&PositionFix) -> f64| fixes.iter().map(value).sum::<f64>() / n;
        let has_up = fixes.iter().all(|fix| fix.up_m.is_some());
        let rounding_m2 = mean(&|fix| fix.rounding_m * fix.rounding_m / 12.0);
        let variance = [mean(&|fix| fix.horizontal_std_m.powi(2)), mean(&|fix| fix.vertical_std_m.powi(2))];
        let new = |variance: f64, rounding: f64| ((1.0 - WANDER_SHARE) * variance + rounding) / n;
        Self {
            times_s: fixes.iter().map(|fix| fix.time_s).collect(),
            position_m: Point3::new(
                mean(&|fix| fix.east_north_m.x),
                mean(&|fix| fix.east_north_m.y),
                mean(&|fix| fix.up_m.unwrap_or(0.0)),
            ),
            has_up,
            noise_m2: [new(variance[0], rounding_m2), new(variance[1], 0.0)],
            wander_m: variance.map(|variance| (WANDER_SHARE * variance).sqrt()),
        }
    }

    /// The middle of its times.
    pub(super) fn time_s(&self) -> f64 {
        self.times_s.iter().sum::<f64>() / self.times_s.len() as f64
    }
}

/// Finite fixes in order of time. Consecutive equal positions are one fix at the middle of their times: the receiver
/// repeated or rounded a position.
pub(super) fn distinct(fixes: &[PositionFix]) -> Vec<PositionFix> {
    let mut fixes: Vec<PositionFix> = fixes.iter().copied().filter(PositionFix::is_finite).collect();
    fixes.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    let same = |a: &PositionFix, b: &PositionFix| a.east_north_m == b.east_north_m;
    let runs = fixes.chunk_by(same);
    runs.map(|run| {
        let middle = 0.5 * (run[0].time_s + run[run.len() - 1].time_s);
        let ups: Option<Vec<f64>> = run.iter().map(|fix| fix.up_m).collect();
        let up_m = ups.map(|ups| ups.iter().sum::<f64>() / ups.len() as f64);
        PositionFix { time_s: middle, up_m, ..run[0] }
    })
    .collect()
}

/// Groups of neighbors. More than 120 cost time and add no information: neighbors share their correlated noise.
pub(super) fn groups(fixes: &[PositionFix]) -> Vec<Group> {
    fixes.chunks(fixes.len().div_ceil(120).max(1)).map(Group::of).collect()
}

#[cfg(test)]
mod tests {
    use nalgebra::vector;

    use super::*;

    fn fix(time_s: f64, east: f64) -> PositionFix {
        PositionFix {
            time_s,
            east_north_m: vector![east, 0.0],
            up_m: Some(time_s),
            horizontal_std_m: 3.0,
            vertical_std_m: 5.0,
            rounding_m: 0.0,
        }
    }

    #[test]
    fn positions_that_are_held_count_once() {
        let fixes = [fix(2.0, 5.0), fix(0.0, 1.0), fix(1.0, 1.0), fix(f64::NAN, 1.0), fix(3.0, 1.0)];
        let found: Vec<_> = distinct(&fixes).iter().map(|fix| (fix.time_s, fix.up_m)).collect();
        assert_eq!(found, [(0.5, Some(0.5)), (2.0, Some(2.0)), (3.0, Some(3.0))]);
    }

    #[test]
    fn many_fixes_make_few_groups_whose_noise_is_less() {
        let fixes: Vec<_> = (0..1000).map(|i| fix(f64::from(i), f64::from(i))).collect();
        let groups = groups(&fixes);
        assert_eq!((groups.len(), groups[0].times_s.len()), (112, 9));
        assert!((groups[0].time_s() - 4.0).abs() < 1e-12 && (groups[0].position_m.x - 4.0).abs() < 1e-12);
        assert!((groups[0].noise_m2[0] - 0.2 * 9.0 / 9.0).abs() < 1e-12);
        assert!((groups[0].wander_m[1] - (0.8f64 * 25.0).sqrt()).abs() < 1e-12);
    }
}
