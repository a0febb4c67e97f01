//! Trial step of the points, and its cost.

use super::kept::{Kept, Source};
use super::layout::{Layout, NONE};
use super::linearize::Linearization;
use super::one_point::Eliminated;
use super::parallel::in_order;
use super::piece::{Pass, Piece};
use super::residual::{plain_residual, point_in_cam, robust_cost, robust_cost_and_root};
use super::simd::{Fused, Task, wide};
use super::state::{State, View};

/// Predicted decrease and cost of a trial step, of the points or of all parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Trial {
    /// Twice the predicted decrease (eq. 13).
    pub decrease: f64,
    /// Square of the length of the step.
    pub step_sq: f64,
    /// Sum of the squares of the parameters at the new state.
    pub norm_sq: f64,
    /// Σ ρ / 2 at the new state; infinite if any residual is not finite.
    pub cost: f64,
}

/// Computes the step of the points (eq. 11) for a step of the reduced system.
///
/// Reads the points of `from` and writes those of `to`, whose cameras are already updated. The linearization must be at
/// `from` with the same damping.
pub(super) fn try_step<const D: usize>(
    lin: &Linearization<D>,
    pass: &Pass,
    step: &[f64],
    damping: f64,
    from: &State,
    to: &mut State,
) -> Trial {
    let State { views, points, .. } = to;
    let mut rest = points.as_mut_slice();
    let mut items = Vec::with_capacity(lin.pieces.len());
    for (piece, kept) in lin.pieces.iter().zip(&lin.kept) {
        let (mine, others) = rest.split_at_mut(piece.points.len());
        rest = others;
        items.push((piece, kept.as_ref(), mine));
    }
    let work = |(piece, kept, points): (_, _, &mut [[f64; 3]])| {
        wide(MovePoints::<D> { pass, piece, kept, step, damping, views, from, points })
    };
    let mut total = Trial::default();
    for part in in_order(pass.parallel, items, work) {
        total.decrease += part.decrease;
        total.step_sq += part.step_sq;
        total.norm_sq += part.norm_sq;
        total.cost += part.cost;
    }
    total.cost = finite_or_infinite(0.5 * total.cost);
    total
}

/// Σ ρ / 2 at a state; infinite if any residual is not finite.
pub(super) fn cost(pass: &Pass, state: &State) -> f64 {
    finite_or_infinite(0.5 * wide(Cost { pass, state }))
}

fn finite_or_infinite(cost: f64) -> f64 {
    if cost.is_finite() { cost } else { f64::INFINITY }
}

/// Number of observations whose point is behind its camera.
pub(super) fn count_behind(pass: &Pass, state: &State) -> usize {
    let behind =
        |position: &[f64; 3], o: usize| point_in_cam(&state.views[pass.measured(o).pose as usize], position)[2] <= 0.0;
    let count = |(point, position)| pass.layout.obs_of_point(point).filter(|o| behind(position, *o)).count();
    state.points.iter().enumerate().map(count).sum()
}

struct MovePoints<'a, const D: usize> {
    pass: &'a Pass<'a>,
    piece: &'a Piece,
    kept: Option<&'a Kept<D>>,
    step: &'a [f64],
    damping: f64,
    views: &'a [View],
    from: &'a State,
    points: &'a mut [[f64; 3]],
}

impl<const D: usize> Task for MovePoints<'_, D> {
    type Output = Trial;

    #[inline(always)]
    fn run<F: Fused>(self) -> Trial {
        let Self { pass, piece, kept, step, damping, views, from, points } = self;
        let mut out = Trial::default();
        let mut source = Source::new(pass.layout, piece, kept);
        for (place, point) in piece.points.clone().enumerate() {
            let before = from.points[point];
            let one = source.point::<F>(pass, piece, from, point, damping);
            let mut delta = [0.0; 3];
            if !one.terms.is_held() {
                delta = back_substitute::<D, F>(pass.layout, one, step, point);
                out.decrease += one.terms.predicted_decrease(&delta, damping);
            }
            let moved = [before[0] + delta[0], before[1] + delta[1], before[2] + delta[2]];
            let (position, cost) = refined_point::<D, F>(pass, one, views, point, moved);
            points[place] = position;
            out.cost += cost;
            for k in 0..3 {
                out.step_sq += (position[k] - before[k]).powi(2);
                out.norm_sq += position[k] * position[k];
            }
        }
        out
    }
}

/// Refines a point by a further step with the cameras updated (eq. 11a), if that lowers the cost.
///
/// Returns the position and its cost.
#[inline(always)]
fn refined_point<const D: usize, F: Fused>(
    pass: &Pass,
    one: Eliminated<D>,
    views: &[View],
    point: usize,
    position: [f64; 3],
) -> ([f64; 3], f64) {
    let (layout, terms) = (pass.layout, one.terms);
    // L⁻¹ Jₚᵀ r', from Q = Jₚ L⁻ᵀ.
    let (mut cost, mut half_step) = (0.0, [0.0; 3]);
    for (o, residual) in layout.obs_of_point(point).zip(one.residuals) {
        let measured = pass.measured(o);
        let r = plain_residual(&views[measured.pose as usize], &position, measured);
        let (rho, root) = robust_cost_and_root(&pass.loss, &r);
        cost += rho;
        let [a, b] = &residual.eliminated;
        for k in 0..3 {
            half_step[k] = F::mul_add(a[k], r[0] * root, F::mul_add(b[k], r[1] * root, half_step[k]));
        }
    }
    if let Some(known) = layout.point_priors.get(point) {
        cost += known.cost(&position);
        let pull = terms.forward_solve(&known.offset(&position).map(|v| known.weight * v));
        for k in 0..3 {
            half_step[k] += pull[k];
        }
    }
    if terms.is_held() {
        return (position, cost);
    }
    let step = terms.back_solve(&half_step);
    let refined = [position[0] - step[0], position[1] - step[1], position[2] - step[2]];
    let refined_cost = cost_of_point(pass, views, point, &refined);
    if refined_cost < cost { (refined, refined_cost) } else { (position, cost) }
}

/// Step of one point (eq. 11).
#[inline(always)]
fn back_substitute<const D: usize, F: Fused>(
    layout: &Layout,
    one: Eliminated<D>,
    step: &[f64],
    point: usize,
) -> [f64; 3] {
    let mut t = one.terms.half_step;
    for (o, residual) in layout.obs_of_point(point).zip(one.residuals) {
        let block = layout.obs_block[o];
        if block != NONE {
            let d: &[f64] = &step[block as usize * D..][..D];
            let moved = [dot::<D, F>(&residual.d_view[0], d), dot::<D, F>(&residual.d_view[1], d)];
            for k in 0..3 {
                let q = [residual.eliminated[0][k], residual.eliminated[1][k]];
                t[k] = F::mul_add(q[0], moved[0], F::mul_add(q[1], moved[1], t[k]));
            }
        }
    }
    for (slot, eliminated) in layout.slots_of_point(point).zip(one.slots) {
        let first = layout.num_blocks() * D + layout.slots[slot] as usize * 6;
        for k in 0..3 {
            t[k] += dot::<6, F>(&eliminated[k], &step[first..first + 6]);
        }
    }
    let [x, y, z] = one.terms.back_solve(&t);
    [-x, -y, -z]
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
}

impl Task for Cost<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<F: Fused>(self) -> f64 {
        let points = self.state.points.iter().enumerate();
        points.map(|(point, position)| cost_of_point(self.pass, &self.state.views, point, position)).sum()
    }
}

/// Σ ρ over the observations of a point.
#[inline(always)]
fn cost_of_point(pass: &Pass, views: &[View], point: usize, position: &[f64; 3]) -> f64 {
    let layout = pass.layout;
    let mut sum = layout.point_priors.get(point).map_or(0.0, |known| known.cost(position));
    for o in layout.obs_of_point(point) {
        let measured = pass.measured(o);
        let r = plain_residual(&views[measured.pose as usize], position, measured);
        sum += robust_cost(&pass.loss, &r);
    }
    sum
}
