//! Linearization and elimination of a single point.

use std::ops::Range;

use super::layout::{Layout, NONE, POSE_DIM};
use super::piece::Pass;
use super::point::PointTerms;
use super::residual::{Derivatives, Residual, linearize};
use super::simd::Fused;
use super::state::State;

/// Data of the point being processed: residuals, Jacobians, elimination.
pub(super) struct OnePoint<const D: usize> {
    /// First observation of the point.
    pub first_obs: usize,
    /// Its first slot.
    pub first_slot: usize,
    /// One per observation of the point, followed by stale entries of other points.
    pub residuals: Vec<Residual<D>>,
    /// Jₚ of its observations.
    d_points: Vec<[[f64; 3]; 2]>,
    /// Derivatives by shared intrinsics; empty without shared cameras.
    pub d_shared: Vec<[[f64; 6]; 2]>,
    /// L⁻¹ Jₚᵀ J_c of its slots, summed over a slot's observations (eq. 9).
    pub slot_eliminated: Vec<[[f64; 6]; 3]>,
    /// Its normal equations.
    pub terms: PointTerms,
}

/// Data of one point needed for its step.
#[derive(Clone, Copy)]
pub(super) struct Eliminated<'a, const D: usize> {
    /// Residuals of its observations.
    pub residuals: &'a [Residual<D>],
    /// L⁻¹ Jₚᵀ J_c of its slots (eq. 9).
    pub slots: &'a [[[f64; 6]; 3]],
    /// Its normal equations.
    pub terms: &'a PointTerms,
}

impl<const D: usize> OnePoint<D> {
    /// Buffers large enough for each of a range of points.
    pub fn new(layout: &Layout, points: Range<usize>) -> Self {
        let none = Residual { value: [0.0; 2], d_view: [[0.0; D]; 2], eliminated: [[0.0; 3]; 2] };
        let longest = points.clone().map(|point| layout.obs_of_point(point).len()).max().unwrap_or(0);
        let most_slots = points.map(|point| layout.slots_of_point(point).len()).max().unwrap_or(0);
        Self {
            first_obs: 0,
            first_slot: 0,
            residuals: vec![none; longest],
            d_points: vec![[[0.0; 3]; 2]; longest],
            d_shared: vec![[[0.0; 6]; 2]; if layout.shared.is_empty() { 0 } else { longest }],
            slot_eliminated: vec![[[0.0; 6]; 3]; most_slots],
            terms: PointTerms::default(),
        }
    }

    /// Linearizes and eliminates a point at a state; returns Σ ρ.
    #[inline(always)]
    pub fn work_out<F: Fused>(&mut self, pass: &Pass, state: &State, point: usize, damping: f64) -> f64 {
        self.first_obs = pass.layout.obs_of_point(point).start;
        self.first_slot = pass.layout.slots_of_point(point).start;
        let cost = self.linearize::<F>(pass, state, point);
        self.eliminate::<F>(pass.layout, point, damping);
        cost
    }

    /// Data needed for the step of the current point.
    #[inline(always)]
    pub fn eliminated(&self, layout: &Layout, point: usize) -> Eliminated<'_, D> {
        Eliminated {
            residuals: &self.residuals[..layout.obs_of_point(point).len()],
            slots: &self.slot_eliminated[..layout.slots_of_point(point).len()],
            terms: &self.terms,
        }
    }

    /// Residuals, Jacobians and normal equations; returns Σ ρ.
    #[inline(always)]
    fn linearize<F: Fused>(&mut self, pass: &Pass, state: &State, point: usize) -> f64 {
        let layout = pass.layout;
        let mut terms = PointTerms::default();
        let mut cost = 0.0;
        for (k, o) in layout.obs_of_point(point).enumerate() {
            let measured = pass.measured(o);
            let view = &state.views[measured.pose as usize];
            let is_shared = layout.obs_slot.get(o).is_some_and(|slot| *slot != NONE);
            let d_shared = if is_shared { self.d_shared.get_mut(k) } else { None };
            let derivatives = Derivatives { d_point: &mut self.d_points[k], d_shared };
            let (rho, mut residual) = linearize::<D, F>(view, &state.points[point], measured, &pass.loss, derivatives);
            hold_masked(layout, layout.obs_block[o], &mut residual.d_view);
            cost += rho;
            terms.add::<F>(&self.d_points[k], residual.value);
            self.residuals[k] = residual;
        }
        if let Some(known) = layout.point_priors.get(point) {
            terms.add_prior(known, &state.points[point]);
            cost += known.cost(&state.points[point]);
        }
        self.terms = terms;
        cost
    }

    /// Elimination of the point (eq. 9).
    #[inline(always)]
    fn eliminate<F: Fused>(&mut self, layout: &Layout, point: usize, damping: f64) {
        self.slot_eliminated[..layout.slots_of_point(point).len()].fill([[0.0; 6]; 3]);
        self.terms.eliminate(layout.point_fixed[point], damping);
        for (k, o) in layout.obs_of_point(point).enumerate() {
            let [a, b] = &self.d_points[k];
            let q = [self.terms.forward_solve(a), self.terms.forward_solve(b)];
            self.residuals[k].eliminated = q;
            if layout.obs_slot.get(o).is_some_and(|slot| *slot != NONE) {
                let y = &mut self.slot_eliminated[layout.obs_slot[o] as usize - self.first_slot];
                let d = &self.d_shared[k];
                for r in 0..3 {
                    for c in 0..6 {
                        y[r][c] = F::mul_add(d[0][c], q[0][r], F::mul_add(d[1][c], q[1][r], y[r][c]));
                    }
                }
            }
        }
    }
}

/// Zeroes the columns of constant degrees of freedom.
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
