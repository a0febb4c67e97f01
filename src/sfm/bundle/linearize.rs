//! Passes over the points: residuals and Jacobians, elimination, back-substitution, cost.
//!
//! All of them cut the points in pieces of a fixed size, which threads take as they come; sums over pieces are taken in
//! order afterwards, so that nothing depends on the number of threads.

use rayon::prelude::*;

use super::layout::{Layout, NONE, POSE_DIM};
use super::point::PointTerms;
use super::residual::{Derivatives, Residual, linearize, plain_residual, point_in_cam, robust_cost};
use super::simd::{Fused, Task, wide};
use super::state::State;
use crate::math::RobustLoss;

/// Observations in a piece, about: small enough for the second-level cache, large enough to be worth a task.
const PIECE_SIZE: usize = 1024;

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

/// What a linearisation knows of every observation and point.
pub(super) struct Linearization<const D: usize> {
    pub residuals: Vec<Residual<D>>,
    /// Jₚ of every observation.
    pub d_points: Vec<[[f64; 3]; 2]>,
    /// Derivatives by shared intrinsics; empty without shared cameras.
    pub d_shared: Vec<[[f64; 6]; 2]>,
    /// L⁻¹ Jₚᵀ J_c of every slot, summed over the slot's observations (eq. 9).
    pub slot_eliminated: Vec<[[f64; 6]; 3]>,
    pub points: Vec<PointTerms>,
}

/// One piece of the above, to be written by one task.
struct PieceMut<'a, const D: usize> {
    piece: &'a Piece,
    residuals: &'a mut [Residual<D>],
    d_points: &'a mut [[[f64; 3]; 2]],
    d_shared: &'a mut [[[f64; 6]; 2]],
    slot_eliminated: &'a mut [[[f64; 6]; 3]],
    points: &'a mut [PointTerms],
}

/// Everything that the passes read.
#[derive(Clone, Copy)]
pub(super) struct Pass<'a> {
    pub layout: &'a Layout,
    pub pieces: &'a [Piece],
    pub loss: RobustLoss,
    pub parallel: bool,
}

impl<const D: usize> Linearization<D> {
    pub fn new(layout: &Layout) -> Self {
        let n = layout.num_obs();
        let none = Residual { value: [0.0; 2], d_view: [[0.0; D]; 2], eliminated: [[0.0; 3]; 2] };
        Self {
            residuals: vec![none; n],
            d_points: vec![[[0.0; 3]; 2]; n],
            d_shared: vec![[[0.0; 6]; 2]; if layout.shared.is_empty() { 0 } else { n }],
            slot_eliminated: vec![[[0.0; 6]; 3]; layout.slots.len()],
            points: vec![PointTerms::default(); layout.points.len()],
        }
    }

    fn split<'a>(&'a mut self, pieces: &'a [Piece]) -> Vec<PieceMut<'a, D>> {
        let mut residuals = self.residuals.as_mut_slice();
        let mut d_points = self.d_points.as_mut_slice();
        let mut d_shared = self.d_shared.as_mut_slice();
        let mut slot_eliminated = self.slot_eliminated.as_mut_slice();
        let mut points = self.points.as_mut_slice();
        let mut out = Vec::with_capacity(pieces.len());
        for piece in pieces {
            let num_shared = if d_shared.is_empty() { 0 } else { piece.obs.len() };
            out.push(PieceMut {
                piece,
                residuals: take(&mut residuals, piece.obs.len()),
                d_points: take(&mut d_points, piece.obs.len()),
                d_shared: take(&mut d_shared, num_shared),
                slot_eliminated: take(&mut slot_eliminated, piece.slots.len()),
                points: take(&mut points, piece.points.len()),
            });
        }
        out
    }

    /// Residuals, Jacobians and the points' normal equations at a state (eqs. 1–6), then their elimination with
    /// damping λ. Returns the cost.
    pub fn evaluate(&mut self, pass: &Pass, state: &State, damping: f64) -> f64 {
        let work = |mut piece: PieceMut<D>| {
            let cost = wide(Evaluate { pass, state, piece: &mut piece });
            wide(Eliminate { layout: pass.layout, damping, piece: &mut piece });
            cost
        };
        0.5 * in_order(pass.parallel, self.split(pass.pieces), work)
    }

    /// The elimination alone, for another damping.
    pub fn eliminate(&mut self, pass: &Pass, damping: f64) {
        let work = |mut piece: PieceMut<D>| {
            wide(Eliminate { layout: pass.layout, damping, piece: &mut piece });
            0.0
        };
        in_order(pass.parallel, self.split(pass.pieces), work);
    }

    /// Steps of the points for a step of the reduced system (eq. 11), written to `steps`; returns their part of twice the
    /// predicted decrease (eq. 13).
    pub fn back_substitute(&self, pass: &Pass, step: &[f64], damping: f64, steps: &mut [[f64; 3]]) -> f64 {
        let mut rest = steps;
        let items: Vec<_> = pass.pieces.iter().map(|piece| (piece, take(&mut rest, piece.points.len()))).collect();
        let work = |(piece, out): (&Piece, &mut [[f64; 3]])| {
            wide(BackSubstitute { lin: self, layout: pass.layout, step, damping, piece, out })
        };
        in_order(pass.parallel, items, work)
    }

    /// The largest entry of the gradients of points that move.
    pub fn largest_point_gradient(&self, layout: &Layout) -> f64 {
        let moving = self.points.iter().zip(&layout.point_fixed).filter(|(_, fixed)| !**fixed);
        moving.flat_map(|(p, _)| p.gradient).fold(0.0, |m: f64, g| m.max(g.abs()))
    }
}

/// Σ ρ / 2 at a state; infinite where any residual is not finite.
pub(super) fn cost(pass: &Pass, state: &State) -> f64 {
    let work = |piece: &Piece| wide(Cost { pass, state, piece });
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

struct Evaluate<'a, 'b, const D: usize> {
    pass: &'a Pass<'a>,
    state: &'a State,
    piece: &'a mut PieceMut<'b, D>,
}

impl<const D: usize> Task for Evaluate<'_, '_, D> {
    type Output = f64;

    #[inline(always)]
    fn run<F: Fused>(self) -> f64 {
        let Self { pass: Pass { layout, loss, .. }, state, piece } = self;
        let (first_point, first_obs) = (piece.piece.points.start, piece.piece.obs.start);
        let mut cost = 0.0;
        for point in piece.piece.points.clone() {
            let mut terms = PointTerms::default();
            for o in layout.obs_of_point(point) {
                let view = &state.views[layout.obs_pose[o] as usize];
                let place = o - first_obs;
                let is_shared = layout.obs_slot.get(o).is_some_and(|slot| *slot != NONE);
                let d_shared = if is_shared { piece.d_shared.get_mut(place) } else { None };
                let derivatives = Derivatives { d_point: &mut piece.d_points[place], d_shared };
                let (pixel, weight) = (&layout.obs_pixel[o], layout.obs_weight[o]);
                let (rho, mut residual) =
                    linearize::<D, F>(view, &state.points[point], pixel, weight, loss, derivatives);
                hold_masked(layout, layout.obs_block[o], &mut residual.d_view);
                cost += rho;
                terms.add::<F>(&piece.d_points[place], residual.value);
                piece.residuals[place] = residual;
            }
            piece.points[point - first_point] = terms;
        }
        cost
    }
}

/// Freedoms that are held get zero columns.
#[inline(always)]
fn hold_masked<const D: usize>(layout: &Layout, block: u32, d_view: &mut [[f64; D]; 2]) {
    if block == NONE {
        return;
    }
    let mask = &layout.pose_mask[block as usize];
    if *mask == [true; POSE_DIM] {
        return;
    }
    for k in (0..POSE_DIM).filter(|k| !mask[*k]) {
        d_view[0][k] = 0.0;
        d_view[1][k] = 0.0;
    }
}

struct Eliminate<'a, 'b, const D: usize> {
    layout: &'a Layout,
    damping: f64,
    piece: &'a mut PieceMut<'b, D>,
}

impl<const D: usize> Task for Eliminate<'_, '_, D> {
    type Output = ();

    #[inline(always)]
    fn run<F: Fused>(self) {
        let Self { layout, damping, piece } = self;
        let (first_obs, first_slot) = (piece.piece.obs.start, piece.piece.slots.start);
        piece.slot_eliminated.fill([[0.0; 6]; 3]);
        for (place, point) in piece.piece.points.clone().enumerate() {
            let terms = &mut piece.points[place];
            terms.eliminate(layout.point_fixed[point], damping);
            for o in layout.obs_of_point(point) {
                let place = o - first_obs;
                let q = piece.d_points[place].map(|row| terms.forward_solve(&row));
                piece.residuals[place].eliminated = q;
                if layout.obs_slot.get(o).is_some_and(|slot| *slot != NONE) {
                    let y = &mut piece.slot_eliminated[layout.obs_slot[o] as usize - first_slot];
                    let d = &piece.d_shared[place];
                    for k in 0..3 {
                        for c in 0..6 {
                            y[k][c] = F::mul_add(d[0][c], q[0][k], F::mul_add(d[1][c], q[1][k], y[k][c]));
                        }
                    }
                }
            }
        }
    }
}

struct BackSubstitute<'a, const D: usize> {
    lin: &'a Linearization<D>,
    layout: &'a Layout,
    step: &'a [f64],
    damping: f64,
    piece: &'a Piece,
    out: &'a mut [[f64; 3]],
}

impl<const D: usize> Task for BackSubstitute<'_, D> {
    type Output = f64;

    #[inline(always)]
    fn run<F: Fused>(self) -> f64 {
        let mut decrease = 0.0;
        for (point, delta) in self.piece.points.clone().zip(self.out) {
            let terms = &self.lin.points[point];
            if terms.is_held() {
                *delta = [0.0; 3];
                continue;
            }
            let mut t = terms.half_step;
            for o in self.layout.obs_of_point(point) {
                let block = self.layout.obs_block[o];
                if block != NONE {
                    let residual = &self.lin.residuals[o];
                    let d: &[f64] = &self.step[block as usize * D..][..D];
                    let moved = residual.d_view.map(|row| dot::<D, F>(&row, d));
                    for k in 0..3 {
                        let q = [residual.eliminated[0][k], residual.eliminated[1][k]];
                        t[k] = F::mul_add(q[0], moved[0], F::mul_add(q[1], moved[1], t[k]));
                    }
                }
            }
            for slot in self.layout.slots_of_point(point) {
                let first = self.layout.num_blocks() * D + self.layout.slots[slot] as usize * 6;
                for k in 0..3 {
                    t[k] += dot::<6, F>(&self.lin.slot_eliminated[slot][k], &self.step[first..first + 6]);
                }
            }
            *delta = terms.back_solve(&t).map(|v| -v);
            decrease += terms.predicted_decrease(delta, self.damping);
        }
        decrease
    }
}

#[inline(always)]
fn dot<const N: usize, F: Fused>(a: &[f64; N], b: &[f64]) -> f64 {
    let mut sum = 0.0;
    for k in 0..N {
        sum = F::mul_add(a[k], b[k], sum);
    }
    sum
}

struct Cost<'a> {
    pass: &'a Pass<'a>,
    state: &'a State,
    piece: &'a Piece,
}

impl Task for Cost<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<F: Fused>(self) -> f64 {
        let Pass { layout, loss, .. } = self.pass;
        let mut sum = 0.0;
        for point in self.piece.points.clone() {
            let position = &self.state.points[point];
            for o in layout.obs_of_point(point) {
                let view = &self.state.views[layout.obs_pose[o] as usize];
                let r = plain_residual(view, position, &layout.obs_pixel[o], layout.obs_weight[o]);
                sum += robust_cost(loss, &r);
            }
        }
        sum
    }
}

/// The first `count` of a slice, cutting them off it.
fn take<'a, T>(slice: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let (head, tail) = std::mem::take(slice).split_at_mut(count);
    *slice = tail;
    head
}

/// Σ work(item), on all threads of the pool or on this one; the order of the sum is that of the items.
fn in_order<T: Send>(parallel: bool, items: Vec<T>, work: impl Fn(T) -> f64 + Sync + Send) -> f64 {
    if parallel {
        let parts: Vec<f64> = items.into_par_iter().map(work).collect();
        parts.iter().sum()
    } else {
        items.into_iter().map(work).sum()
    }
}
