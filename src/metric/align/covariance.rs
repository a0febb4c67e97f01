//! Covariance of a receiver's errors along one axis: correlated and independent noise.
//!
//! `C_jk = w_j w_k exp(−|τ_j − τ_k| / T) + d_j δ_jk` (docs/maths/metric.md, eq. 2).

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Correlation time of a receiver's bias, seconds. Measured correlation times of single receivers range from one
/// minute (multipath, moving receiver) to an hour (atmosphere). The shorter ones let the fixes of a short video drift
/// more, and are the conservative choice.
pub(in crate::metric) const WANDER_TIME_S: f64 = 120.0;

/// Covariance of the errors of groups, factorised.
pub(super) struct Errors {
    factor: Cholesky<f64, Dyn>,
    /// Variance of the noise of each, with the weights.
    pub(super) noise: DVector<f64>,
}

impl Errors {
    /// Covariance of groups at these times with these standard deviations of the correlated noise and variances of the
    /// independent noise. `None` if the factorisation fails, which requires values that are not finite.
    pub(super) fn new(times_s: &[f64], wander_m: &[f64], noise: DVector<f64>) -> Option<Self> {
        let covariance = DMatrix::from_fn(times_s.len(), times_s.len(), |j, k| {
            let apart_s = (times_s[j] - times_s[k]).abs();
            let drift = wander_m[j] * wander_m[k] * (-apart_s / WANDER_TIME_S).exp();
            if j == k { drift + noise[j] } else { drift }
        });
        Some(Self { factor: Cholesky::new(covariance)?, noise })
    }

    /// `C⁻¹ a`, column by column.
    pub(super) fn solve(&self, a: &DMatrix<f64>) -> DMatrix<f64> {
        self.factor.solve(a)
    }

    /// `C⁻¹`.
    pub(super) fn inverse(&self) -> DMatrix<f64> {
        self.factor.inverse()
    }
}
