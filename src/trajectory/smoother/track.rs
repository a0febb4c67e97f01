//! Smoothing of a quantity of several axes under white jerk: its value and first two derivatives at every time.
//!
//! An observation is the quantity, plus slowly correlated errors (see [`Observed`]), plus white noise. The spectral
//! density of the jerk and the factor on the reported errors are those of maximum posterior probability.

use nalgebra::{DMatrix, DVector};

use super::chain::{self, Gaussian, Smoothed, Step};

/// One observation.
#[derive(Clone, Debug)]
pub(super) struct Observed {
    pub(super) time_s: f64,
    pub(super) value: DVector<f64>,
    /// Covariance of the error that is independent in every observation.
    pub(super) noise: DMatrix<f64>,
    /// Displacement of the value by one standard deviation of each correlated error, one column each.
    pub(super) drift: DMatrix<f64>,
}

impl Observed {
    /// The same with one more correlated error.
    ///
    /// * `error` – displacement of the value by one standard deviation.
    pub(super) fn with_common(mut self, error: &DVector<f64>) -> Self {
        let columns = self.drift.ncols();
        self.drift = self.drift.insert_column(columns, 0.0);
        self.drift.set_column(columns, error);
        self
    }
}

/// Prior on the motion of a quantity.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionPrior {
    /// Standard deviations of the initial value and of its first and second derivative.
    pub(super) first: [f64; 3],
    /// Typical spectral density of the jerk.
    pub(super) prior_jerk: f64,
    /// Spectral density of the last axis, as a share of that of the others.
    pub(super) last_axis: f64,
    /// Correlation times of the correlated errors, seconds.
    pub(super) drift_s: &'static [f64],
}

/// Parameters of maximum posterior probability.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Level {
    /// Spectral density of the jerk.
    pub(super) jerk: f64,
    /// Factor on the reported errors.
    pub(super) noise: f64,
}

/// Smoothed quantity.
#[derive(Clone, Debug)]
pub(super) struct Track {
    pub(super) states: Vec<Gaussian>,
    /// See [`Smoothed`].
    pub(super) gains: Vec<DMatrix<f64>>,
    /// Squared residuals of the observations from the smoothed quantity and correlated errors, in units of their noise.
    pub(super) squares: Vec<f64>,
    first: Gaussian,
    steps: Vec<Step>,
}

/// Maximum number of observations used for the parameters.
const MAX_RATED: usize = 400;
/// Degrees of freedom of Student's distribution of the errors, whose tails include jumps.
const STUDENT: f64 = 4.0;

impl MotionPrior {
    /// Prior on a quantity at rest, up to an imperceptible drift at `speed`.
    pub(super) fn at_rest(self, speed: f64) -> Self {
        Self { first: [self.first[0], speed, 1e-3 * speed], prior_jerk: 1e-6 * speed * speed, ..self }
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

    /// Step of the chain. The state is the value, its first and its second derivative, axis by axis, and the correlated
    /// errors in standard deviations.
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

    /// Logarithm of the posterior probability of a level, up to a constant.
    fn posterior(&self, all: &[Observed], weights: &[f64], level: Level) -> Option<f64> {
        let values: Vec<DVector<f64>> = all.iter().map(|seen| seen.value.clone()).collect();
        let likelihood = chain::log_likelihood(&self.first(&all[0]), &self.steps(all, weights, level), &values)?;
        // Deviations from the prior means, in prior standard deviations.
        let off = [(level.jerk / self.prior_jerk).ln() / 2.3, level.noise.ln() / 1.1];
        Some(likelihood - 0.5 * (off[0] * off[0] + off[1] * off[1]))
    }

    /// Level of maximum posterior probability: the errors, then the jerk, and both again.
    ///
    /// For long tracks from the middle observations only.
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
            level = best(&mut multiples.map(|m| Level { jerk: m * self.prior_jerk, ..level }).into_iter());
        }
        level
    }
}

/// Smooths observations at ascending times; `None` for none, or if rounding prevents it.
pub(super) fn track(all: &[Observed], prior: &MotionPrior) -> Option<Track> {
    let first = prior.first(all.first()?);
    let values: Vec<DVector<f64>> = all.iter().map(|seen| seen.value.clone()).collect();
    let mut weights = vec![1.0; all.len()];
    let mut level = Level { jerk: prior.prior_jerk, noise: 1.0 };
    for pass in 0..4 {
        // Jumps are recognized under the typical jerk, before the jerk is adapted to them.
        if pass > 1 {
            level = prior.best_level(all, &weights, level);
        }
        let Smoothed { states, .. } = chain::smooth(&first, &prior.steps(all, &weights, level), &values)?;
        let axes = values[0].len() as f64;
        let weight = |square: f64| ((STUDENT + axes) / (STUDENT + square)).min(1.0);
        weights = prior.squares(all, &states, level).map(weight).collect();
    }
    let steps = prior.steps(all, &weights, level);
    let Smoothed { states, gains } = chain::smooth(&first, &steps, &values)?;
    let squares = prior.squares(all, &states, level).collect();
    Some(Track { states, gains, squares, first, steps })
}

/// Returns true if a quantity at rest is more likely than one that moves.
pub(super) fn is_at_rest(all: &[Observed], moving: &MotionPrior, rest: &MotionPrior) -> bool {
    let weights = vec![1.0; all.len()];
    let rated = |prior: &MotionPrior| {
        let start = Level { jerk: prior.prior_jerk, noise: 1.0 };
        prior.posterior(all, &weights, prior.best_level(all, &weights, start))
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
