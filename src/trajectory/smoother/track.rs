//! One quantity of several axes under white jerk: where it was at every time, with its first two derivatives.
//!
//! What is observed is the quantity, plus errors that wander slowly (see [`Observed`]), plus white noise. How strong
//! the jerk is and how much larger the errors are than stated, the likelihood decides.

use nalgebra::{DMatrix, DVector};

use super::chain::{self, Gaussian, Smoothed, Step};

/// One observation.
#[derive(Clone, Debug)]
pub(super) struct Observed {
    pub(super) time_s: f64,
    pub(super) value: DVector<f64>,
    /// Covariance of what is new in every observation.
    pub(super) noise: DMatrix<f64>,
    /// By how much, and in which direction, each error that wanders moves the value: one standard deviation, a column
    /// each.
    pub(super) drift: DMatrix<f64>,
}

impl Observed {
    /// The same with one more error, that moves the value by one standard deviation as given.
    pub(super) fn with_common(mut self, error: &DVector<f64>) -> Self {
        let columns = self.drift.ncols();
        self.drift = self.drift.insert_column(columns, 0.0);
        self.drift.set_column(columns, error);
        self
    }
}

/// Prior on the change of a quantity.
#[derive(Clone, Copy, Debug)]
pub(super) struct Kind {
    /// Standard deviations of the first value, of the first derivative and of the second.
    pub(super) first: [f64; 3],
    /// Spectral density of the jerk that is usual.
    pub(super) usual_jerk: f64,
    /// That of the last axis as a share of the others'.
    pub(super) last_axis: f64,
    /// Times after which the errors that wander have forgotten where they were, seconds.
    pub(super) drift_s: &'static [f64],
}

/// Parameters that the likelihood determines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level {
    /// Spectral density of the jerk.
    pub(super) jerk: f64,
    /// Factor on the reported errors.
    pub(super) noise: f64,
}

/// A quantity after smoothing.
#[derive(Clone, Debug)]
pub(super) struct Track {
    pub(super) states: Vec<Gaussian>,
    /// See [`Smoothed`].
    pub(super) gains: Vec<DMatrix<f64>>,
    /// Squared deviations of the observations from the smoothed quantity and the smoothed errors that wander, in units
    /// of their noise.
    pub(super) squares: Vec<f64>,
    first: Gaussian,
    steps: Vec<Step>,
}

/// Observations that are rated at most.
const MAX_RATED: usize = 400;
/// Degrees of freedom of Student's distribution, whose tails jumps are expected to come from.
const STUDENT: f64 = 4.0;

impl Kind {
    /// A quantity of so many axes that stays as it is, but for a drift that nobody would notice.
    pub(super) fn at_rest(self, speed: f64) -> Self {
        Self { first: [self.first[0], speed, 1e-3 * speed], usual_jerk: 1e-6 * speed * speed, ..self }
    }

    fn size(&self, axes: usize) -> usize {
        3 * axes + self.drift_s.len()
    }

    fn first(&self, observed: &Observed) -> Gaussian {
        let axes = observed.value.len();
        let size = self.size(axes);
        let mut mean = DVector::zeros(size);
        mean.rows_mut(0, axes).copy_from(&observed.value);
        let variance = |k: usize| self.first.get(k / axes).map_or(1.0, |std| std * std);
        let covariance = DMatrix::from_diagonal(&DVector::from_fn(size, |k, _| variance(k)));
        Gaussian { mean, covariance }
    }

    fn steps(&self, all: &[Observed], weights: &[f64], level: Level) -> Vec<Step> {
        let before = |k: usize| if k == 0 { all[0].time_s } else { all[k - 1].time_s };
        let step =
            |(k, seen): (usize, &Observed)| self.step(seen, (seen.time_s - before(k)).max(0.0), level, weights[k]);
        all.iter().enumerate().map(step).collect()
    }

    /// States are the value, its first and its second derivative, axis by axis, and the errors that wander, in
    /// deviations.
    fn step(&self, seen: &Observed, dt: f64, level: Level, weight: f64) -> Step {
        let axes = seen.value.len();
        let size = self.size(axes);
        let mut transition = DMatrix::identity(size, size);
        let mut process = DMatrix::zeros(size, size);
        let powers = [dt.powi(5) / 20.0, dt.powi(4) / 8.0, dt.powi(3) / 6.0, dt.powi(3) / 3.0, dt * dt / 2.0, dt];
        for axis in 0..axes {
            let [value, first, second] = [axis, axes + axis, 2 * axes + axis];
            transition[(value, first)] = dt;
            transition[(value, second)] = 0.5 * dt * dt;
            transition[(first, second)] = dt;
            let share = if axis + 1 == axes { self.last_axis } else { 1.0 };
            let pairs =
                [(value, value), (value, first), (value, second), (first, first), (first, second), (second, second)];
            for ((row, column), power) in pairs.into_iter().zip(powers) {
                process[(row, column)] = level.jerk * share * power;
                process[(column, row)] = level.jerk * share * power;
            }
        }
        for (k, drift_s) in self.drift_s.iter().enumerate() {
            let (at, kept) = (3 * axes + k, (-dt / drift_s).exp());
            transition[(at, at)] = kept;
            process[(at, at)] = 1.0 - kept * kept;
        }
        let mut observation = DMatrix::zeros(axes, size);
        observation.view_mut((0, 0), (axes, axes)).fill_with_identity();
        observation.columns_mut(3 * axes, self.drift_s.len()).copy_from(&seen.drift);
        Step { transition, process, observation, noise: &seen.noise * (level.noise * level.noise / weight) }
    }

    /// See [`Track::squares`].
    fn squares<'a>(
        &'a self,
        all: &'a [Observed],
        states: &'a [Gaussian],
        level: Level,
    ) -> impl Iterator<Item = f64> + 'a {
        all.iter().zip(states).map(move |(seen, state)| {
            let axes = seen.value.len();
            let drift = state.mean.rows(3 * axes, self.drift_s.len());
            let off = &seen.value - state.mean.rows(0, axes) - &seen.drift * drift;
            seen.noise.clone().cholesky().map_or(0.0, |c| off.dot(&c.solve(&off))) / level.noise.powi(2)
        })
    }

    /// Logarithm of the posterior of a level.
    fn posterior(&self, all: &[Observed], weights: &[f64], level: Level) -> Option<f64> {
        let values: Vec<DVector<f64>> = all.iter().map(|seen| seen.value.clone()).collect();
        let likelihood = chain::log_likelihood(&self.first(&all[0]), &self.steps(all, weights, level), &values)?;
        // In standard deviations, before anything is observed.
        let off = [(level.jerk / self.usual_jerk).ln() / 2.3, level.noise.ln() / 1.1];
        Some(likelihood - 0.5 * (off[0] * off[0] + off[1] * off[1]))
    }

    /// The errors, then the jerk, and both again, by the middle of what was observed if that is long.
    fn best_level(&self, all: &[Observed], weights: &[f64], start: Level) -> Level {
        let from = all.len().saturating_sub(MAX_RATED) / 2;
        let until = all.len().min(from + MAX_RATED);
        let (all, weights) = (&all[from..until], &weights[from..until]);
        let best = |levels: &mut dyn Iterator<Item = Level>| {
            let rated = levels.filter_map(|level| Some((self.posterior(all, weights, level)?, level)));
            rated.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(start, |(_, level)| level)
        };
        let multiples = [1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0];
        let mut level = start;
        for _ in 0..2 {
            level = best(&mut [0.5, 0.7, 1.0, 2.0, 4.0, 8.0, 16.0].map(|noise| Level { noise, ..level }).into_iter());
            level = best(&mut multiples.map(|m| Level { jerk: m * self.usual_jerk, ..level }).into_iter());
        }
        level
    }
}

/// Smooths what was observed at ascending times; `None` for nothing at all, or where rounding wins.
pub(super) fn track(all: &[Observed], kind: &Kind) -> Option<Track> {
    let first = kind.first(all.first()?);
    let values: Vec<DVector<f64>> = all.iter().map(|seen| seen.value.clone()).collect();
    let mut weights = vec![1.0; all.len()];
    let mut level = Level { jerk: kind.usual_jerk, noise: 1.0 };
    for pass in 0..4 {
        // A jump is seen against a motion that is usual, before the motion is made to follow it.
        if pass > 1 {
            level = kind.best_level(all, &weights, level);
        }
        let Smoothed { states, .. } = chain::smooth(&first, &kind.steps(all, &weights, level), &values)?;
        let axes = values[0].len() as f64;
        let weight = |square: f64| ((STUDENT + axes) / (STUDENT + square)).min(1.0);
        weights = kind.squares(all, &states, level).map(weight).collect();
    }
    let steps = kind.steps(all, &weights, level);
    let Smoothed { states, gains } = chain::smooth(&first, &steps, &values)?;
    let squares = kind.squares(all, &states, level).collect();
    Some(Track { states, gains, squares, first, steps })
}

/// Returns true if a quantity at rest is more likely than one that moves.
pub(super) fn is_at_rest(all: &[Observed], moving: &Kind, rest: &Kind) -> bool {
    let weights = vec![1.0; all.len()];
    let rated = |kind: &Kind| {
        let start = Level { jerk: kind.usual_jerk, noise: 1.0 };
        kind.posterior(all, &weights, kind.best_level(all, &weights, start))
    };
    matches!((rated(moving), rated(rest)), (Some(moving), Some(rest)) if rest > moving)
}

impl Track {
    /// Effect of smoothing on an error that all observations have in common, given its displacement of each.
    pub(super) fn response(&self, moved: &[DVector<f64>]) -> Option<Vec<DVector<f64>>> {
        let mut first = self.first.clone();
        first.mean.fill(0.0);
        let start = moved.first()?;
        first.mean.rows_mut(0, start.len()).copy_from(start);
        Some(chain::smooth(&first, &self.steps, moved)?.states.into_iter().map(|state| state.mean).collect())
    }
}
