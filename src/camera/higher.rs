//! Distortion beyond k₁ and k₂: the third radial coefficient and the tangential ones.
//!
//! To the radial part of the distorted coordinates they add (D. C. Brown, *Decentering Distortion of Lenses*, 1966, in
//! the notation of OpenCV's `calib3d`; x, y and r² = x² + y² on the plane z = 1)
//!
//! ```text
//! a = k₃ r⁶ x + 2 p₁ x y + p₂ (r² + 2 x²),
//! b = k₃ r⁶ y + p₁ (r² + 2 y²) + 2 p₂ x y.
//! ```

use nalgebra::{Matrix2, Vector2};
use serde::{Deserialize, Serialize};

/// Distortion coefficients k₃, p₁ and p₂.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HigherTerms {
    /// Third radial coefficient.
    pub k3: f64,
    /// Tangential coefficients p₁, p₂.
    pub tangential: [f64; 2],
}

impl HigherTerms {
    /// Zero coefficients: distortion by k₁ and k₂ only.
    pub const ZERO: Self = Self { k3: 0.0, tangential: [0.0; 2] };

    /// Returns true if all terms are zero.
    #[inline(always)]
    pub fn are_zero(&self) -> bool {
        *self == Self::ZERO
    }

    /// Text that follows k₁ and k₂ in a line: k₃, then "p" and p₁, p₂; empty if all are zero.
    pub fn in_figures(&self) -> String {
        let Self { k3, tangential: [p1, p2] } = self;
        if self.are_zero() { String::new() } else { format!(" {k3:.5} p {p1:.5} {p2:.5}") }
    }

    /// (a, b) at undistorted coordinates (x, y).
    pub fn offset(&self, at: Vector2<f64>) -> Vector2<f64> {
        let (x, y, r2) = (at.x, at.y, at.norm_squared());
        let [p1, p2] = self.tangential;
        let tangential =
            Vector2::new(2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x), p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y);
        at * (self.k3 * r2 * r2 * r2) + tangential
    }

    /// ∂(a, b) / ∂(x, y), which is symmetric.
    pub fn jacobian(&self, at: Vector2<f64>) -> Matrix2<f64> {
        let (x, y, r2) = (at.x, at.y, at.norm_squared());
        let [p1, p2] = self.tangential;
        let radial = Matrix2::identity() * (self.k3 * r2 * r2 * r2) + at * at.transpose() * (6.0 * self.k3 * r2 * r2);
        let mixed = 2.0 * (p1 * x + p2 * y);
        radial + Matrix2::new(2.0 * p1 * y + 6.0 * p2 * x, mixed, mixed, 6.0 * p1 * y + 2.0 * p2 * x)
    }
}
