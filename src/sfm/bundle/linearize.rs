//! Passes over the points: residuals and Jacobians, elimination, back-substitution, cost.
//!
//! All of them cut the points in pieces of a fixed size, which threads take as they come; sums over pieces are taken in
//! order afterwards, so that nothing depends on the number of threads.

use rayon::prelude::*;

use super::layout::{Layout, NONE, POSE_DIM};
use super::residual::{IntrinsicsTarget, Residual, linearize, plain_residual, point_in_cam, robust_cost};
use super::state::{State, View};
use crate::math::RobustLoss;

/// Observations in a piece, about: small enough for the second-level cache, large enough to be worth a task.
const PIECE_SIZE: usize = 1024;
/// Bounds of the diagonal that scales the damping (those of Ceres).
const DIAGONAL_RANGE: (f64, f64) = (1e-6, 1e32);

/// A run of points and what belongs to them.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    pub points: std::ops::Range<usize>,
    pub obs: std::ops::Range<usize>,
    pub slots: std::ops::Range<usize>,
}

/// Cuts the points in pieces.
pub(super) fn pieces(layout: &Layout) -> Vec<Piece> {
    let mut out = Vec::new();
    let mut first = 0;
    for point in 0..layout.points.len() {
        let start = layout.point_start[first] as usize;
        let end = layout.point_start[point + 1] as usize;
        if end - start >= PIECE_SIZE || point + 1 == layout.points.len() {
            let slots = layout.slot_start[first] as usize..layout.slot_start[point + 1] as usize;
            out.push(Piece { points: first..point + 1, obs: start..end, slots });
            first = point + 1;
        }
    }
    out
}

/// Normal equations of one point, and its elimination.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PointTerms {
    /// V (upper triangle, by rows), without damping.
    pub hessian: [f64; 6],
    /// Jₚᵀ r.
    pub gradient: [f64; 3],
    /// L of V + λD = L Lᵀ (lower triangle by rows: 00, 10, 11, 20, 21, 22), with the reciprocals of its diagonal.
    /// All zero for a point that does not move.
    pub factor: [f64; 6],
    /// L⁻¹ times the gradient.
    pub half_step: [f64; 3],
}

/// What a linearisation knows of every observation and point.
pub(super) struct Linearization<const D: usize> {
    pub residuals: Vec<Residual<D>>,
    /// Derivatives by shared intrinsics; empty without shared cameras.
    pub d_shared: Vec<[[f64; 6]; 2]>,
    /// Y = W L⁻ᵀ of every observation, by columns (eq. 9).
    pub eliminated: Vec<[[f64; D]; 3]>,
    /// The same of every slot.
    pub slot_eliminated: Vec<[[f64; 6]; 3]>,
    pub points: Vec<PointTerms>,
}

/// One piece of the above, to be written by one task.
struct PieceMut<'a, const D: usize> {
    piece: &'a Piece,
    residuals: &'a mut [Residual<D>],
    d_shared: &'a mut [[[f64; 6]; 2]],
    eliminated: &'a mut [[[f64; D]; 3]],
    slot_eliminated: &'a mut [[[f64; 6]; 3]],
    points: &'a mut [PointTerms],
}

/// Everything that the passes read.
pub(super) struct Pass<'a> {
    pub layout: &'a Layout,
    pub pieces: &'a [Piece],
    pub loss: RobustLoss,
    pub parallel: bool,
}

impl<const D: usize> Linearization<D> {
    pub fn new(layout: &Layout) -> Self {
        let n = layout.num_obs();
        let none = Residual { value: [0.0; 2], d_view: [[0.0; D]; 2], d_point: [[0.0; 3]; 2] };
        Self {
            residuals: vec![none; n],
            d_shared: vec![[[0.0; 6]; 2]; if layout.shared.is_empty() { 0 } else { n }],
            eliminated: vec![[[0.0; D]; 3]; n],
            slot_eliminated: vec![[[0.0; 6]; 3]; layout.slots.len()],
            points: vec![PointTerms::default(); layout.points.len()],
        }
    }

    fn split<'a>(&'a mut self, pieces: &'a [Piece]) -> Vec<PieceMut<'a, D>> {
        let mut residuals = self.residuals.as_mut_slice();
        let mut d_shared = self.d_shared.as_mut_slice();
        let mut eliminated = self.eliminated.as_mut_slice();
        let mut slot_eliminated = self.slot_eliminated.as_mut_slice();
        let mut points = self.points.as_mut_slice();
        let mut out = Vec::with_capacity(pieces.len());
        for piece in pieces {
            let num_shared = if d_shared.is_empty() { 0 } else { piece.obs.len() };
            out.push(PieceMut {
                piece,
                residuals: take(&mut residuals, piece.obs.len()),
                d_shared: take(&mut d_shared, num_shared),
                eliminated: take(&mut eliminated, piece.obs.len()),
                slot_eliminated: take(&mut slot_eliminated, piece.slots.len()),
                points: take(&mut points, piece.points.len()),
            });
        }
        out
    }

    /// Residuals, Jacobians and the points' normal equations at a state (eqs. 1–7), then their elimination with
    /// damping λ. Returns the cost.
    pub fn evaluate(&mut self, pass: &Pass, state: &State, damping: f64) -> f64 {
        let work = |mut piece: PieceMut<D>| {
            let cost = evaluate_piece(pass, state, &mut piece);
            eliminate_piece(pass, damping, &mut piece);
            cost
        };
        0.5 * in_order(pass.parallel, self.split(pass.pieces), work)
    }

    /// The elimination alone, for another damping.
    pub fn eliminate(&mut self, pass: &Pass, damping: f64) {
        let work = |mut piece: PieceMut<D>| {
            eliminate_piece(pass, damping, &mut piece);
            0.0
        };
        in_order(pass.parallel, self.split(pass.pieces), work);
    }

    /// Steps of the points for a step of the reduced system (eq. 11), written to `steps`; returns Σ (λ δᵀDδ − δᵀg) over
    /// the points, their part of twice the predicted decrease (eq. 13).
    pub fn back_substitute(&self, pass: &Pass, step: &[f64], damping: f64, steps: &mut [[f64; 3]]) -> f64 {
        let mut rest = steps;
        let items: Vec<_> = pass.pieces.iter().map(|piece| (piece, take(&mut rest, piece.points.len()))).collect();
        let work = |(piece, out): (&Piece, &mut [[f64; 3]])| {
            let mut decrease = 0.0;
            for (point, delta) in piece.points.clone().zip(out) {
                *delta = self.point_step(pass.layout, point, step);
                decrease += predicted(&self.points[point], delta, damping);
            }
            decrease
        };
        in_order(pass.parallel, items, work)
    }

    #[inline(always)]
    fn point_step(&self, layout: &Layout, point: usize, step: &[f64]) -> [f64; 3] {
        let terms = &self.points[point];
        if terms.factor[0] == 0.0 {
            return [0.0; 3];
        }
        let mut t = terms.half_step;
        for o in layout.obs_of_point(point) {
            let block = layout.obs_block[o];
            if block != NONE {
                let delta: &[f64] = &step[block as usize * D..(block as usize + 1) * D];
                add_products(&mut t, &self.eliminated[o], delta);
            }
        }
        let border = layout.num_blocks() * D;
        for slot in layout.slots_of_point(point) {
            let first = border + layout.slots[slot] as usize * 6;
            add_products(&mut t, &self.slot_eliminated[slot], &step[first..first + 6]);
        }
        back_solve(&terms.factor, &t).map(|v| -v)
    }
}

/// Σ ρ / 2 at a state; infinite where any residual is not finite.
pub(super) fn cost(pass: &Pass, state: &State) -> f64 {
    let layout = pass.layout;
    let work = |piece: &Piece| {
        let mut sum = 0.0;
        for point in piece.points.clone() {
            let position = &state.points[point];
            for o in layout.obs_of_point(point) {
                let view = &state.views[layout.obs_pose[o] as usize];
                let r = plain_residual(view, position, &layout.obs_pixel[o], layout.obs_weight[o]);
                sum += robust_cost(&pass.loss, &r);
            }
        }
        sum
    };
    let sum = 0.5 * in_order(pass.parallel, pass.pieces.iter().collect(), work);
    if sum.is_finite() { sum } else { f64::INFINITY }
}

/// Observations whose point lies behind its camera.
pub(super) fn count_behind(layout: &Layout, state: &State) -> usize {
    let behind = |o: &usize| {
        let view = &state.views[layout.obs_pose[*o] as usize];
        point_in_cam(view, &state.points[layout.obs_point[*o] as usize])[2] <= 0.0
    };
    (0..layout.num_obs()).filter(behind).count()
}

fn evaluate_piece<const D: usize>(pass: &Pass, state: &State, piece: &mut PieceMut<D>) -> f64 {
    let layout = pass.layout;
    let (first_point, first_obs) = (piece.piece.points.start, piece.piece.obs.start);
    let mut cost = 0.0;
    for point in piece.piece.points.clone() {
        let mut terms = PointTerms::default();
        for o in layout.obs_of_point(point) {
            let pose = layout.obs_pose[o] as usize;
            let view: &View = &state.views[pose];
            let target = intrinsics_target(layout, o, view);
            let shared = piece.d_shared.get_mut(o - first_obs);
            let (rho, mut residual) = linearize::<D>(
                view,
                &state.points[point],
                &layout.obs_pixel[o],
                layout.obs_weight[o],
                &pass.loss,
                target,
                shared,
            );
            apply_mask(layout, o, &mut residual);
            cost += rho;
            accumulate_point(&mut terms, &residual);
            piece.residuals[o - first_obs] = residual;
        }
        piece.points[point - first_point] = terms;
    }
    cost
}

#[inline(always)]
fn intrinsics_target(layout: &Layout, o: usize, view: &View) -> IntrinsicsTarget {
    if view.columns.len == 0 {
        IntrinsicsTarget::Nowhere
    } else if layout.obs_slot.get(o).is_some_and(|slot| *slot != NONE) {
        IntrinsicsTarget::Shared
    } else if layout.obs_block[o] != NONE {
        IntrinsicsTarget::ViewBlock
    } else {
        IntrinsicsTarget::Nowhere
    }
}

#[inline(always)]
fn apply_mask<const D: usize>(layout: &Layout, o: usize, residual: &mut Residual<D>) {
    let block = layout.obs_block[o];
    if block == NONE {
        return;
    }
    let mask = &layout.pose_mask[block as usize];
    if *mask == [true; POSE_DIM] {
        return;
    }
    for (k, free) in mask.iter().enumerate() {
        if !free {
            residual.d_view[0][k] = 0.0;
            residual.d_view[1][k] = 0.0;
        }
    }
}

#[inline(always)]
fn accumulate_point<const D: usize>(terms: &mut PointTerms, residual: &Residual<D>) {
    let [a, b] = &residual.d_point;
    let [r, s] = residual.value;
    let v = &mut terms.hessian;
    v[0] += a[0] * a[0] + b[0] * b[0];
    v[1] += a[0] * a[1] + b[0] * b[1];
    v[2] += a[0] * a[2] + b[0] * b[2];
    v[3] += a[1] * a[1] + b[1] * b[1];
    v[4] += a[1] * a[2] + b[1] * b[2];
    v[5] += a[2] * a[2] + b[2] * b[2];
    for k in 0..3 {
        terms.gradient[k] += a[k] * r + b[k] * s;
    }
}

fn eliminate_piece<const D: usize>(pass: &Pass, damping: f64, piece: &mut PieceMut<D>) {
    let layout = pass.layout;
    let first_obs = piece.piece.obs.start;
    let first_slot = piece.piece.slots.start;
    for (place, point) in piece.piece.points.clone().enumerate() {
        let terms = &mut piece.points[place];
        terms.factor = if layout.point_fixed[point] { [0.0; 6] } else { factor(&terms.hessian, damping) };
        terms.half_step = forward_solve(&terms.factor, &terms.gradient);
        for slot in layout.slots_of_point(point) {
            piece.slot_eliminated[slot - first_slot] = [[0.0; 6]; 3];
        }
        for o in layout.obs_of_point(point) {
            let residual = &piece.residuals[o - first_obs];
            let [a, b] = residual.d_point.map(|row| forward_solve(&terms.factor, &row));
            let y = &mut piece.eliminated[o - first_obs];
            for k in 0..3 {
                for c in 0..D {
                    y[k][c] = residual.d_view[0][c] * a[k] + residual.d_view[1][c] * b[k];
                }
            }
            if layout.obs_slot.get(o).is_some_and(|slot| *slot != NONE) {
                let y = &mut piece.slot_eliminated[layout.obs_slot[o] as usize - first_slot];
                let d = &piece.d_shared[o - first_obs];
                for k in 0..3 {
                    for c in 0..6 {
                        y[k][c] += d[0][c] * a[k] + d[1][c] * b[k];
                    }
                }
            }
        }
    }
}

/// A diagonal entry of the normal equations as the damping sees it.
#[inline(always)]
pub(super) fn damping_scale(diagonal: f64) -> f64 {
    diagonal.clamp(DIAGONAL_RANGE.0, DIAGONAL_RANGE.1)
}

/// Cholesky of V + λD with the diagonal's reciprocals; zero where V is not positive definite.
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

#[inline(always)]
fn forward_solve(l: &[f64; 6], v: &[f64; 3]) -> [f64; 3] {
    let x = v[0] * l[0];
    let y = (v[1] - l[1] * x) * l[2];
    [x, y, (v[2] - l[3] * x - l[4] * y) * l[5]]
}

#[inline(always)]
fn back_solve(l: &[f64; 6], v: &[f64; 3]) -> [f64; 3] {
    let z = v[2] * l[5];
    let y = (v[1] - l[4] * z) * l[2];
    [(v[0] - l[1] * y - l[3] * z) * l[0], y, z]
}

#[inline(always)]
fn add_products<const D: usize>(t: &mut [f64; 3], y: &[[f64; D]; 3], delta: &[f64]) {
    for k in 0..3 {
        t[k] += y[k].iter().zip(delta).map(|(a, b)| a * b).sum::<f64>();
    }
}

#[inline(always)]
fn predicted(terms: &PointTerms, delta: &[f64; 3], damping: f64) -> f64 {
    let diagonal = [terms.hessian[0], terms.hessian[3], terms.hessian[5]];
    (0..3).map(|k| delta[k] * (damping * damping_scale(diagonal[k]) * delta[k] - terms.gradient[k])).sum()
}

/// The first `count` of a slice, cutting them off it.
fn take<'a, T>(slice: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let (head, tail) = std::mem::take(slice).split_at_mut(count);
    *slice = tail;
    head
}

/// Σ work(item), on all threads of the pool or on this one; the order of the sum is that of the items.
pub(super) fn in_order<T: Send>(parallel: bool, items: Vec<T>, work: impl Fn(T) -> f64 + Sync + Send) -> f64 {
    if parallel {
        let parts: Vec<f64> = items.into_par_iter().map(work).collect();
        parts.iter().sum()
    } else {
        items.into_iter().map(work).sum()
    }
}

/// The largest entry of the points' gradients.
pub(super) fn largest_point_gradient<const D: usize>(linearization: &Linearization<D>, layout: &Layout) -> f64 {
    let moving = linearization.points.iter().zip(&layout.point_fixed).filter(|(_, fixed)| !**fixed);
    moving.flat_map(|(p, _)| p.gradient).fold(0.0, |m: f64, g| m.max(g.abs()))
}
