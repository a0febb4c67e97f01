//! Path length and displacement of a smoothed trajectory.
//!
//! The sum of the steps between frames grows with their noise: the path of a stationary vehicle would grow without
//! limit. Lengths are therefore measured at the resolution of the trajectory's own uncertainty. Knots k₀ = first frame,
//! k_{j+1} = the first frame after k_j with ‖d‖ > 3 σ(d), where d = x̂(k_{j+1}) − x̂(k_j); the last knot is the last
//! frame.
//!
//! ```text
//! L = Σ_j ‖x̂(k_{j+1}) − x̂(k_j)‖,    σ²(L) = gᵀ Cov(x̂) g + (gᵀ ∂x̂/∂ln r · σ_r)² + (L σ_s)²                   (4, 5)
//! ```
//!
//! with g = ∂L/∂x̂, the posterior covariance between all frames, the scale ratio's standard deviation σ_r and that of
//! meters per unit σ_s (of logarithms). For contact points σ(d) includes the errors of both points: masks change
//! slowly, which smoothing interprets as motion. A single segment that is not resolved, ‖d‖ ≤ 3 σ(d), has the length
//! √max(0, ‖d‖² − tr Cov(d)): for a stationary vehicle E‖d‖² is tr Cov(d). docs/maths/smoother.md, section *Travel*.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::{SIGNIFICANT_STDS, Tracks};
use crate::scene::Estimate;

/// Length of a vector with its covariance; corrected for noise where it is not resolved.
fn resolved_length(d: &Vector3<f64>, covariance: &Matrix3<f64>) -> Estimate {
    let length = d.norm();
    if is_resolved(d, covariance) {
        return Estimate { value: length, std: std_along(d, covariance) };
    }
    let value = (length * length - covariance.trace()).max(0.0).sqrt();
    Estimate { value, std: covariance.symmetric_eigenvalues().max().max(0.0).sqrt() }
}

/// Magnitude of a number with its standard deviation; corrected for noise where it is not resolved.
pub(super) fn resolved_amount(value: f64, std: f64) -> Estimate {
    let value =
        if value.abs() > SIGNIFICANT_STDS * std { value.abs() } else { (value * value - std * std).max(0.0).sqrt() };
    Estimate { value, std }
}

fn is_resolved(d: &Vector3<f64>, covariance: &Matrix3<f64>) -> bool {
    d.norm() > SIGNIFICANT_STDS * std_along(d, covariance)
}

fn std_along(d: &Vector3<f64>, covariance: &Matrix3<f64>) -> f64 {
    d.try_normalize(0.0).map_or(0.0, |u| (u.transpose() * covariance * u)[0].max(0.0).sqrt())
}

impl Tracks<'_> {
    /// Path length, eq. 4.
    pub(super) fn path(&self) -> Estimate {
        let mut knots = self.resolved_knots();
        // The part after the last resolved knot belongs to the segment before.
        if knots.len() > 1 {
            knots.pop();
        }
        knots.push(self.positions.states.len() - 1);
        if knots.len() == 2 { self.displacement() } else { self.length(&knots) }
    }

    /// Straight-line distance from the first frame to the last.
    pub(super) fn displacement(&self) -> Estimate {
        let last = self.positions.states.len() - 1;
        let covariance = self.covariances_from(0).last().unwrap_or_else(Matrix3::zeros);
        self.with_scale(resolved_length(&self.step(0, last), &covariance))
    }

    fn position(&self, k: usize) -> Vector3<f64> {
        self.positions.states[k].mean.fixed_rows::<3>(0).into_owned()
    }

    /// Displacements of a position by each of the shared errors.
    fn moved(&self, k: usize) -> impl Iterator<Item = Vector3<f64>> {
        self.moved.iter().map(move |moved| moved[k].fixed_rows::<3>(0).into_owned())
    }

    fn step(&self, from: usize, to: usize) -> Vector3<f64> {
        self.position(to) - self.position(from)
    }

    fn with_scale(&self, length: Estimate) -> Estimate {
        Estimate { std: length.std.hypot(self.scale_std * length.value), ..length }
    }

    /// Covariances of the displacements from one frame to each later one, without the share of meters per unit.
    fn covariances_from(&self, from: usize) -> impl Iterator<Item = Matrix3<f64>> + '_ {
        let states = &self.positions.states;
        let position_block = |m: &DMatrix<f64>| m.fixed_view::<3, 3>(0, 0).into_owned();
        let mut gain: Option<DMatrix<f64>> = None;
        (from + 1..states.len()).map(move |k| {
            let step = &self.positions.gains[k - 1];
            // Rows of the position alone: Cov(x_from, x_k) = G_from … G_{k−1} Cov(x_k).
            let product = gain.take().map_or_else(|| step.rows(0, 3).into_owned(), |before| before * step);
            let cross = position_block(&(&product * &states[k].covariance));
            gain = Some(product);
            let own = position_block(&states[from].covariance) + position_block(&states[k].covariance);
            let shared = self.moved(k).zip(self.moved(from)).map(|(to, from)| to - from);
            own - cross - cross.transpose() + shared.map(|by| by * by.transpose()).sum::<Matrix3<f64>>()
        })
    }

    /// The first frame, and every frame whose distance from the knot before is resolved.
    fn resolved_knots(&self) -> Vec<usize> {
        let mut knots = vec![0];
        let mut from = 0;
        let next = |from: usize| {
            let mut later = (from + 1..).zip(self.covariances_from(from));
            let single = |k: usize| self.measurements[k].frame_covariance();
            let is_clear = |&(k, covariance): &(usize, Matrix3<f64>)| {
                is_resolved(&self.step(from, k), &(covariance + single(from) + single(k)))
            };
            later.find(is_clear).map(|(k, _)| k)
        };
        while let Some(k) = next(from) {
            knots.push(k);
            from = k;
        }
        knots
    }

    /// Length of a chain of resolved segments.
    fn length(&self, knots: &[usize]) -> Estimate {
        let mut gradient = vec![Vector3::zeros(); self.positions.states.len()];
        let mut value = 0.0;
        for pair in knots.windows(2) {
            let d = self.step(pair[0], pair[1]);
            let u = d.try_normalize(0.0).unwrap_or_default();
            gradient[pair[0]] -= u;
            gradient[pair[1]] += u;
            value += d.norm();
        }
        let by_shared = |moved: &Vec<DVector<f64>>| {
            let of = |(g, moved): (&Vector3<f64>, &DVector<f64>)| g.dot(&moved.fixed_rows::<3>(0));
            gradient.iter().zip(moved).map(of).sum::<f64>().powi(2)
        };
        let shared: f64 = self.moved.iter().map(by_shared).sum();
        self.with_scale(Estimate { value, std: (self.variance(&gradient).max(0.0) + shared).sqrt() })
    }

    /// Variance of Σ gₖᵀ xₖ over the positions xₖ.
    ///
    /// The smoother's backward chain x_k = G_k x_{k+1} + e_k is traversed forwards, so that each eₖ counts once.
    fn variance(&self, gradient: &[Vector3<f64>]) -> f64 {
        let states = &self.positions.states;
        let size = states[0].mean.len();
        let mut weight = DVector::zeros(size);
        let mut variance = 0.0;
        for (k, g) in gradient.iter().enumerate() {
            let mut head = weight.fixed_rows_mut::<3>(0);
            head += g;
            let of = |weight: &DVector<f64>, k: usize| weight.dot(&(&states[k].covariance * weight));
            variance += of(&weight, k);
            if let Some(gain) = self.positions.gains.get(k) {
                weight = gain.transpose() * weight;
                variance -= of(&weight, k + 1);
            }
        }
        variance
    }
}
