//! Part of the reduced system for shared cameras: a dense block, and a border coupling it to the views (eq. 10).

use super::layout::{Layout, NONE};
use super::one_point::OnePoint;
use super::prior_terms::PriorTerms;
use super::simd::Fused;

/// Degrees of freedom reserved for a shared camera.
pub(super) const CAMERA_DIM: usize = 6;

/// Contribution of a point's k-th observation to the blocks between its view and all shared cameras observing the
/// point.
#[inline(always)]
pub(super) fn add_border<const D: usize, F: Fused>(
    layout: &Layout,
    one: &OnePoint<D>,
    k: usize,
    point: usize,
    border: &mut [[[f64; CAMERA_DIM]; D]],
) {
    let residual = &one.residuals[k];
    let own = layout.obs_slot[one.first_obs + k] as usize;
    for slot in layout.slots_of_point(point) {
        let mut b = if own == slot { one.d_shared[k] } else { [[0.0; CAMERA_DIM]; 2] };
        let y = &one.slot_eliminated[slot - one.first_slot];
        for (row, q) in b.iter_mut().zip(&residual.eliminated) {
            for c in 0..CAMERA_DIM {
                row[c] -= F::mul_add(q[0], y[0][c], F::mul_add(q[1], y[1][c], q[2] * y[2][c]));
            }
        }
        let (block, a) = (&mut border[layout.slots[slot] as usize], &residual.d_view);
        for r in 0..D {
            for c in 0..CAMERA_DIM {
                block[r][c] = F::mul_add(a[0][r], b[0][c], F::mul_add(a[1][r], b[1][c], block[r][c]));
            }
        }
    }
}

/// Sums over points for the diagonal block of the shared cameras, row-major, both triangles.
#[derive(Clone, Debug)]
pub(super) struct CameraSums {
    n: usize,
    pub block: Vec<f64>,
    pub reduced: Vec<f64>,
    pub gradient: Vec<f64>,
    pub diagonal: Vec<f64>,
}

impl CameraSums {
    pub fn new(n: usize) -> Self {
        Self { n, block: vec![0.0; n * n], reduced: vec![0.0; n], gradient: vec![0.0; n], diagonal: vec![0.0; n] }
    }

    /// Clears the sums.
    pub fn clear(&mut self) {
        for list in [&mut self.block, &mut self.reduced, &mut self.gradient, &mut self.diagonal] {
            list.fill(0.0);
        }
    }

    /// Adds one point, whose observations are linearized and eliminated.
    pub fn add_point<const D: usize>(&mut self, layout: &Layout, one: &OnePoint<D>, point: usize) {
        for (k, o) in layout.obs_of_point(point).enumerate().filter(|(_, o)| layout.obs_slot[*o] != NONE) {
            let first = layout.slots[layout.obs_slot[o] as usize] as usize * CAMERA_DIM;
            let (d, value) = (&one.d_shared[k], &one.residuals[k].value);
            for r in 0..CAMERA_DIM {
                let g = d[0][r] * value[0] + d[1][r] * value[1];
                self.gradient[first + r] += g;
                self.reduced[first + r] += g;
                self.diagonal[first + r] += d[0][r] * d[0][r] + d[1][r] * d[1][r];
                for c in 0..CAMERA_DIM {
                    self.block[(first + r) * self.n + first + c] += d[0][r] * d[0][c] + d[1][r] * d[1][c];
                }
            }
        }
        if layout.point_fixed[point] {
            return;
        }
        let z = &one.terms.half_step;
        for slot in layout.slots_of_point(point) {
            let y = &one.slot_eliminated[slot - one.first_slot];
            let first = layout.slots[slot] as usize * CAMERA_DIM;
            for r in 0..CAMERA_DIM {
                self.reduced[first + r] -= y[0][r] * z[0] + y[1][r] * z[1] + y[2][r] * z[2];
            }
            for other in layout.slots_of_point(point) {
                let w = &one.slot_eliminated[other - one.first_slot];
                let column = layout.slots[other] as usize * CAMERA_DIM;
                for r in 0..CAMERA_DIM {
                    for c in 0..CAMERA_DIM {
                        self.block[(first + r) * self.n + column + c] -=
                            y[0][r] * w[0][c] + y[1][r] * w[1][c] + y[2][r] * w[2][c];
                    }
                }
            }
        }
    }

    /// Adds the sums of another instance.
    pub fn merge(&mut self, other: &Self) {
        let lists = [
            (&mut self.block, &other.block),
            (&mut self.reduced, &other.reduced),
            (&mut self.gradient, &other.gradient),
            (&mut self.diagonal, &other.diagonal),
        ];
        for (into, from) in lists {
            for (a, b) in into.iter_mut().zip(from) {
                *a += b;
            }
        }
    }

    /// Adds a prior on the camera whose block begins at `first`.
    pub fn add_prior(&mut self, first: usize, prior: &PriorTerms) {
        for r in 0..CAMERA_DIM {
            self.gradient[first + r] += prior.gradient[r];
            self.reduced[first + r] += prior.gradient[r];
            self.diagonal[first + r] += prior.hessian[r][r];
            for c in 0..CAMERA_DIM {
                self.block[(first + r) * self.n + first + c] += prior.hessian[r][c];
            }
        }
    }
}
