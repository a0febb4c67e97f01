//! Accuracy of a feature's position, in each direction.

use nalgebra::{Matrix2, SymmetricEigen, Vector2};
use serde::{Deserialize, Serialize};

/// The symmetric matrix W = C^(−1/2) of a position's covariance C, stored as w_xx, w_xy, w_yy.
///
/// Residuals times W have unit covariance. W expresses that a point on an edge is located well across the edge and
/// badly along it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Whitening(pub [f64; 3]);

impl Whitening {
    /// Standard deviation of one pixel in every direction.
    pub const IDENTITY: Self = Self([1.0, 0.0, 1.0]);

    /// The same standard deviation in every direction.
    pub fn isotropic(sigma: f64) -> Self {
        Self([1.0 / sigma, 0.0, 1.0 / sigma])
    }

    /// Whitening from a covariance, whose standard deviations are first clamped between `least` and `most`.
    pub fn from_covariance(covariance: Matrix2<f64>, least: f64, most: f64) -> Self {
        let eigen = SymmetricEigen::new(covariance);
        let inverse = eigen.eigenvalues.map(|variance| 1.0 / variance.max(0.0).sqrt().clamp(least, most));
        let w = eigen.eigenvectors * Matrix2::from_diagonal(&inverse) * eigen.eigenvectors.transpose();
        Self([w.m11, w.m12, w.m22])
    }

    /// W times a residual.
    #[inline(always)]
    pub fn apply(&self, v: [f64; 2]) -> [f64; 2] {
        let [xx, xy, yy] = self.0;
        [xx * v[0] + xy * v[1], xy * v[0] + yy * v[1]]
    }

    /// Squared length of a whitened residual.
    pub fn norm_sq(&self, v: Vector2<f64>) -> f64 {
        let [x, y] = self.apply([v.x, v.y]);
        x * x + y * y
    }

    /// Returns true if all entries are finite and W is positive definite.
    pub fn is_valid(&self) -> bool {
        let [xx, xy, yy] = self.0;
        self.0.iter().all(|v| v.is_finite()) && xx > 0.0 && xx * yy - xy * xy > 0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whitened_residuals_have_unit_covariance() {
        let (sin, cos) = 0.4f64.sin_cos();
        let turn = Matrix2::new(cos, -sin, sin, cos);
        let covariance = turn * Matrix2::new(0.04, 0.0, 0.0, 9.0) * turn.transpose();
        let w = Whitening::from_covariance(covariance, 0.01, 10.0);
        let matrix = Matrix2::new(w.0[0], w.0[1], w.0[1], w.0[2]);
        assert!((matrix * covariance * matrix - Matrix2::identity()).norm() < 1e-12);
        assert!((w.norm_sq(turn * Vector2::new(0.2, 3.0)) - 2.0).abs() < 1e-12 && w.is_valid());
        let held = Whitening::from_covariance(covariance, 0.5, 2.0);
        assert!((held.norm_sq(turn * Vector2::new(0.5, 2.0)) - 2.0).abs() < 1e-12);
        assert_eq!(Whitening::from_covariance(Matrix2::zeros(), 0.5, 2.0), Whitening::isotropic(0.5));
        assert!(!Whitening([f64::NAN, 0.0, 1.0]).is_valid() && !Whitening::isotropic(0.0).is_valid());
    }
}
