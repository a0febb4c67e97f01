//! The 3 × 3 normal equations of one point.

use super::layout::KnownPoint;
use super::simd::Fused;

/// Bounds of the diagonal that scales the damping (those of Ceres).
const DIAGONAL_RANGE: (f64, f64) = (1e-6, 1e32);

/// Normal equations of one point, and its elimination.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PointTerms {
    /// V (upper triangle, by rows), without damping (eq. 6).
    pub hessian: [f64; 6],
    /// Jₚᵀ r.
    pub gradient: [f64; 3],
    /// L of V + λD = L Lᵀ (lower triangle by rows: 00, 10, 11, 20, 21, 22), with the reciprocals of its diagonal.
    /// All zero for a point that does not move.
    pub factor: [f64; 6],
    /// z = L⁻¹ Jₚᵀ r (eq. 9).
    pub half_step: [f64; 3],
}

impl PointTerms {
    /// Adds one observation, given the rows of its Jacobian and its residual.
    #[inline(always)]
    pub fn add<F: Fused>(&mut self, [a, b]: &[[f64; 3]; 2], [r, s]: [f64; 2]) {
        let mut cell = 0;
        for i in 0..3 {
            for j in i..3 {
                self.hessian[cell] = F::mul_add(a[i], a[j], F::mul_add(b[i], b[j], self.hessian[cell]));
                cell += 1;
            }
            self.gradient[i] = F::mul_add(a[i], r, F::mul_add(b[i], s, self.gradient[i]));
        }
    }

    /// Adds a prior on the point, at its current position.
    pub fn add_prior(&mut self, known: &KnownPoint, position: &[f64; 3]) {
        for cell in [0, 3, 5] {
            self.hessian[cell] += known.weight;
        }
        for (gradient, offset) in self.gradient.iter_mut().zip(known.offset(position)) {
            *gradient += known.weight * offset;
        }
    }

    /// Factorizes V + λD; a point whose V is not positive definite is treated as one that does not move.
    #[inline(always)]
    pub fn eliminate(&mut self, fixed: bool, damping: f64) {
        self.factor = if fixed { [0.0; 6] } else { factor(&self.hessian, damping) };
        self.half_step = self.forward_solve(&self.gradient);
    }

    /// Returns true if the point is held.
    #[inline(always)]
    pub fn is_held(&self) -> bool {
        self.factor[0] == 0.0
    }

    /// L⁻¹ v.
    #[inline(always)]
    pub fn forward_solve(&self, v: &[f64; 3]) -> [f64; 3] {
        let l = &self.factor;
        let x = v[0] * l[0];
        let y = (v[1] - l[1] * x) * l[2];
        [x, y, (v[2] - l[3] * x - l[4] * y) * l[5]]
    }

    /// L⁻ᵀ v.
    #[inline(always)]
    pub fn back_solve(&self, v: &[f64; 3]) -> [f64; 3] {
        let l = &self.factor;
        let z = v[2] * l[5];
        let y = (v[1] - l[4] * z) * l[2];
        [(v[0] - l[1] * y - l[3] * z) * l[0], y, z]
    }

    /// λ δᵀDδ − δᵀg, this point's part of twice the predicted decrease (eq. 13).
    #[inline(always)]
    pub fn predicted_decrease(&self, delta: &[f64; 3], damping: f64) -> f64 {
        let diagonal = [self.hessian[0], self.hessian[3], self.hessian[5]];
        (0..3).map(|k| delta[k] * (damping * damping_scale(diagonal[k]) * delta[k] - self.gradient[k])).sum()
    }
}

/// A diagonal entry of the normal equations, clamped for the damping (eq. 12).
#[inline(always)]
pub(super) fn damping_scale(diagonal: f64) -> f64 {
    diagonal.max(DIAGONAL_RANGE.0).min(DIAGONAL_RANGE.1)
}

#[inline(always)]
fn factor(v: &[f64; 6], damping: f64) -> [f64; 6] {
    let damped = |d: f64| d + damping * damping_scale(d);
    let d0 = damped(v[0]);
    let i0 = 1.0 / d0.sqrt();
    let (l10, l20) = (v[1] * i0, v[2] * i0);
    let d1 = damped(v[3]) - l10 * l10;
    let i1 = 1.0 / d1.sqrt();
    let l21 = (v[4] - l20 * l10) * i1;
    let d2 = damped(v[5]) - l20 * l20 - l21 * l21;
    let i2 = 1.0 / d2.sqrt();
    if d0 > 0.0 && d1 > 0.0 && d2 > 0.0 && i2.is_finite() { [i0, l10, i1, l20, l21, i2] } else { [0.0; 6] }
}
