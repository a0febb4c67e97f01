//! Search for the ratio of least cost.

use super::motion::positive;
use crate::trajectory::ScaleError;

/// Grid of ratios, even in their logarithm, around a first guess.
#[derive(Clone, Copy, Debug)]
pub(super) struct Grid {
    /// First and last ratio, as factors of the guess.
    pub(super) factors: [f64; 2],
    /// Number of ratios.
    pub(super) num: usize,
}

impl Grid {
    /// Contact of the lowest points, the guess, is a third off at most (the paper's own worst case); five is beyond any
    /// doubt. One percent from ratio to ratio sees every valley of a criterion; forty rounds narrow it by 10⁻⁸.
    pub(super) const FINE: Self = Self { factors: [0.2, 5.0], num: 321 };

    fn ratio(&self, guess: f64, k: usize) -> f64 {
        let [first, last] = self.factors.map(f64::ln);
        guess * (first + (last - first) * k as f64 / (self.num - 1) as f64).exp()
    }

    /// Index and cost of the ratio of the grid of least cost; `None` if no cost is finite.
    pub(super) fn best(&self, guess: f64, cost: impl Fn(f64) -> f64) -> Option<(usize, f64)> {
        let costs = (0..self.num).map(|k| (k, cost(self.ratio(guess, k)))).filter(|(_, cost)| cost.is_finite());
        costs.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The ratio of least cost, by golden section search between the neighbors of the best one of the grid.
    ///
    /// # Errors
    /// [`ScaleError::Undetermined`] if the cost is least at an end of the range: it has no minimum there.
    pub(super) fn least(&self, guess: f64, cost: impl Fn(f64) -> f64) -> Result<f64, ScaleError> {
        let best = self.best(guess, &cost).map(|(k, _)| k);
        let Some(best) = best.filter(|k| (1..self.num - 1).contains(k)) else {
            return Err(ScaleError::Undetermined("the cost is least at the end of the search range"));
        };
        let (mut low, mut high) = (self.ratio(guess, best - 1), self.ratio(guess, best + 1));
        for _ in 0..40 {
            let (a, b) = (low + 0.382 * (high - low), low + 0.618 * (high - low));
            if cost(a) < cost(b) { high = b } else { low = a }
        }
        positive(0.5 * (low + high))
    }
}
