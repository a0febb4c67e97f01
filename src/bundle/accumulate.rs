//! Contribution of the points of one piece to the reduced system (eq. 10).
//!
//! Every piece has separate accumulators, so that threads neither wait for each other nor read each other's recent
//! writes. [`super::schur::Reduced::add`] adds the pieces up in order.

use std::ops::Range;

use super::camera_sums::{CAMERA_DIM, CameraSums, add_border};
use super::layout::{Layout, NONE};
use super::one_point::OnePoint;
use super::pattern::Pattern;
use super::piece::{Piece, reach};
use super::residual::Residual;
use super::simd::Fused;

/// Right-hand side, gradient, and diagonal before elimination and damping, of one view.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewTerms<const D: usize> {
    pub reduced: [f64; D],
    pub gradient: [f64; D],
    pub diagonal: [f64; D],
}

impl<const D: usize> ViewTerms<D> {
    pub const ZERO: Self = Self { reduced: [0.0; D], gradient: [0.0; D], diagonal: [0.0; D] };

    pub fn add(&mut self, other: &Self) {
        for k in 0..D {
            self.reduced[k] += other.reduced[k];
            self.gradient[k] += other.gradient[k];
            self.diagonal[k] += other.diagonal[k];
        }
    }
}

/// Sums over the points of one piece, for the range of views that observe them.
pub(super) struct Sums<const D: usize> {
    /// Range of views that the piece covers.
    pub view_range: Range<usize>,
    /// Range, in the pattern, of the blocks of these views' panels.
    pub block_range: Range<usize>,
    pub blocks: Vec<[[f64; D]; D]>,
    pub views: Vec<ViewTerms<D>>,
    pub border: Vec<[[f64; CAMERA_DIM]; D]>,
    pub cameras: CameraSums,
    /// Observations of the piece.
    pub obs_range: Range<usize>,
    /// JᵀQ of each observation if the reduced system is not formed; otherwise empty.
    pub coupling: Vec<[[f64; 3]; D]>,
}

/// Resets a list to `len` zeros.
fn zeros<T: Clone>(list: &mut Vec<T>, len: usize, zero: T) {
    list.clear();
    list.resize(len, zero);
}

impl<const D: usize> Sums<D> {
    /// Empty sums.
    pub fn new(layout: &Layout) -> Self {
        Self {
            blocks: Vec::new(),
            views: Vec::new(),
            border: Vec::new(),
            cameras: CameraSums::new(layout.shared.len() * CAMERA_DIM),
            view_range: 0..0,
            block_range: 0..0,
            obs_range: 0..0,
            coupling: Vec::new(),
        }
    }

    /// Clears the sums and resizes them for a piece.
    pub fn begin(&mut self, layout: &Layout, pattern: &Pattern, piece: &Piece) {
        self.view_range = reach(layout, piece);
        self.block_range = pattern.start[self.view_range.start]..pattern.start[self.view_range.end];
        zeros(&mut self.blocks, self.block_range.len(), [[0.0; D]; D]);
        zeros(&mut self.views, self.view_range.len(), ViewTerms::ZERO);
        zeros(&mut self.border, self.view_range.len() * layout.shared.len(), [[0.0; CAMERA_DIM]; D]);
        self.cameras.clear();
        self.obs_range = piece.obs.clone();
        self.coupling.clear();
    }

    /// Adds one point, whose observations are linearized and eliminated. Observations are sorted by view, those without
    /// a view block last.
    #[inline(always)]
    pub fn add_point<F: Fused>(&mut self, layout: &Layout, pattern: &Pattern, one: &OnePoint<D>, point: usize) {
        if pattern.is_of_single_views() {
            return self.couple_point::<F>(layout, one, point);
        }
        let obs = layout.obs_of_point(point);
        let residuals = &one.residuals[..obs.len()];
        let views = &layout.obs_block[obs.clone()];
        let half_step = &one.terms.half_step;
        let num_shared = layout.shared.len();
        for (k, (mine, j)) in residuals.iter().zip(views).enumerate() {
            if *j == NONE {
                break;
            }
            let j = *j as usize;
            let view = j - self.view_range.start;
            let own = pattern.start[j + 1] - 1 - self.block_range.start;
            add_own::<D, F>(&mut self.blocks[own], &mut self.views[view], mine, half_step);
            if num_shared > 0 {
                let border = &mut self.border[view * num_shared..(view + 1) * num_shared];
                add_border::<D, F>(layout, one, k, point, border);
            }
            if layout.point_fixed[point] {
                continue;
            }
            for (other, i) in residuals[..k].iter().zip(views) {
                if *i as usize == j {
                    // The same point twice in one image: both orders fall on the diagonal block.
                    subtract_pair::<D, F>(&mut self.blocks[own], other, mine);
                    subtract_pair::<D, F>(&mut self.blocks[own], mine, other);
                } else {
                    let place = pattern.place(*i as usize, j) - self.block_range.start;
                    subtract_pair::<D, F>(&mut self.blocks[place], other, mine);
                }
            }
        }
    }

    /// Adds one point to a system that is not formed: to the blocks of its views, without elimination, and to the
    /// coupling.
    #[inline(always)]
    fn couple_point<F: Fused>(&mut self, layout: &Layout, one: &OnePoint<D>, point: usize) {
        let views = &layout.obs_block[layout.obs_of_point(point)];
        for (residual, j) in one.residuals.iter().zip(views) {
            let mut block = [[0.0; 3]; D];
            if *j != NONE {
                let view = *j as usize - self.view_range.start;
                let ([a, b], [p, q]) = (&residual.d_view, &residual.eliminated);
                add_gradients::<D, F>(&mut self.views[view], residual, &one.terms.half_step);
                add_weighted::<D, F>(
                    &mut self.blocks[view],
                    &residual.d_view,
                    [[1.0, 0.0], [0.0, 1.0]],
                    &residual.d_view,
                );
                for (r, row) in block.iter_mut().enumerate() {
                    for (c, value) in row.iter_mut().enumerate() {
                        *value = F::mul_add(a[r], p[c], b[r] * q[c]);
                    }
                }
            }
            self.coupling.push(block);
        }
    }
}

/// One observation's part of its view's own block, gradients and diagonal (eqs. 7, 10): Jᵀ(I − QQᵀ)J and Jᵀ(r − Qz).
#[inline(always)]
fn add_own<const D: usize, F: Fused>(
    own: &mut [[f64; D]; D],
    view: &mut ViewTerms<D>,
    residual: &Residual<D>,
    z: &[f64; 3],
) {
    add_gradients::<D, F>(view, residual, z);
    let [p, q] = &residual.eliminated;
    let mixed = -dot(p, q);
    add_weighted::<D, F>(own, &residual.d_view, [[1.0 - dot(p, p), mixed], [mixed, 1.0 - dot(q, q)]], &residual.d_view);
}

#[inline(always)]
fn dot(u: &[f64; 3], v: &[f64; 3]) -> f64 {
    u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
}

/// One observation's part of its view's gradients and diagonal.
#[inline(always)]
fn add_gradients<const D: usize, F: Fused>(view: &mut ViewTerms<D>, residual: &Residual<D>, z: &[f64; 3]) {
    let ([a, b], [p, q], [r, s]) = (&residual.d_view, &residual.eliminated, residual.value);
    let (t, u) = (r - dot(p, z), s - dot(q, z));
    for k in 0..D {
        view.gradient[k] = F::mul_add(a[k], r, F::mul_add(b[k], s, view.gradient[k]));
        view.reduced[k] = F::mul_add(a[k], t, F::mul_add(b[k], u, view.reduced[k]));
        view.diagonal[k] = F::mul_add(a[k], a[k], F::mul_add(b[k], b[k], view.diagonal[k]));
    }
}

/// Subtracts one pair's Jᵢᵀ Qᵢ Qⱼᵀ Jⱼ (eq. 8).
#[inline(always)]
fn subtract_pair<const D: usize, F: Fused>(out: &mut [[f64; D]; D], first: &Residual<D>, second: &Residual<D>) {
    let cell = |r: usize, c: usize| {
        let (u, v) = (&first.eliminated[r], &second.eliminated[c]);
        -F::mul_add(u[0], v[0], F::mul_add(u[1], v[1], u[2] * v[2]))
    };
    let weight = [[cell(0, 0), cell(0, 1)], [cell(1, 0), cell(1, 1)]];
    add_weighted::<D, F>(out, &first.d_view, weight, &second.d_view);
}

/// out += aᵀ m b, for two rows each.
#[inline(always)]
fn add_weighted<const D: usize, F: Fused>(
    out: &mut [[f64; D]; D],
    a: &[[f64; D]; 2],
    m: [[f64; 2]; 2],
    b: &[[f64; D]; 2],
) {
    let mut mb = [[0.0; D]; 2];
    for c in 0..D {
        mb[0][c] = F::mul_add(m[0][0], b[0][c], m[0][1] * b[1][c]);
        mb[1][c] = F::mul_add(m[1][0], b[0][c], m[1][1] * b[1][c]);
    }
    for r in 0..D {
        for c in 0..D {
            out[r][c] = F::mul_add(a[0][r], mb[0][c], F::mul_add(a[1][r], mb[1][c], out[r][c]));
        }
    }
}
