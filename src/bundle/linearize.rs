//! Linearisation: residuals and Jacobians, elimination of the points, and their sums in the reduced system.
//!
//! The points are cut in a few pieces. A thread goes through a piece point by point from the projection to the reduced
//! system, while the point's Jacobians are still in the nearest cache. What the step of the points ([`super::trial`])
//! needs of them is kept where it fits ([`super::kept`]), else forgotten and worked out again: then an observation
//! takes no memory beyond its index. The cut depends on the problem alone and sums are taken in the order of the
//! pieces, so that nothing depends on the number of threads.

use std::ops::Range;

use super::accumulate::{Sums, reach};
use super::kept::{Eliminated, Kept};
use super::layout::{Layout, NONE, POSE_DIM};
use super::parallel::in_order;
use super::pattern::Pattern;
use super::point::PointTerms;
use super::problem::Observation;
use super::residual::{Derivatives, Residual, linearize};
use super::schur::Reduced;
use super::simd::{Fused, Task, wide};
use super::state::State;
use crate::math::RobustLoss;

/// Pieces that are worked on at a time at most, each with sums of its own.
const MAX_DESKS: usize = 8;
/// There may be so many pieces more for every so many blocks of the reduced system: then the sums of those that are
/// worked on at a time stay small.
const BLOCKS_PER_WAVE: usize = 1 << 17;
/// Least work in a piece, in rank-2 updates of one block: less is not worth a task.
const PART_WORK: usize = 15_000;
/// Work that linearising one observation is worth, likewise.
const OBSERVATION_WORK: usize = 5;
/// Rank-2 updates for which a piece may have one more block to clear and to add up.
const WORK_PER_BLOCK: usize = 60;

/// A run of points and what belongs to them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Piece {
    pub points: Range<usize>,
    pub obs: Range<usize>,
    pub slots: Range<usize>,
}

/// Cuts the points in pieces of about the same work: as many as there can be without each losing too much by blocks of
/// the reduced system that others have, too, and without these taking more memory than the system itself.
pub(super) fn pieces(layout: &Layout, pattern: &Pattern) -> Vec<Piece> {
    let work: Vec<usize> = (0..layout.points.len())
        .scan(0, |sum, point| {
            let count = layout.obs_of_point(point).len();
            let pairs = if pattern.is_of_single_views() { count } else { count * (count + 1) / 2 };
            *sum += count * OBSERVATION_WORK + pairs;
            Some(*sum)
        })
        .collect();
    let total = work.last().copied().unwrap_or(0);
    let mut count = MAX_DESKS * (1 + pattern.len() / BLOCKS_PER_WAVE);
    while count > 1 {
        let pieces = cut(layout, &work, count);
        let blocks = |piece: &Piece| {
            let views = reach(layout, piece);
            pattern.start[views.end] - pattern.start[views.start]
        };
        let doubled = pieces.iter().map(blocks).sum::<usize>().saturating_sub(pattern.len());
        if total >= count * PART_WORK && total >= doubled * WORK_PER_BLOCK && doubled <= pattern.len() {
            return pieces;
        }
        count /= 2;
    }
    cut(layout, &work, 1)
}

/// At most `count` pieces; `work` is that of all points up to each.
fn cut(layout: &Layout, work: &[usize], count: usize) -> Vec<Piece> {
    let total = work.last().copied().unwrap_or(0);
    let mut first = 0;
    let mut out = Vec::with_capacity(count);
    for k in 1..=count {
        let end = if k == count { work.len() } else { work.partition_point(|sum| sum * count <= total * k) };
        if end > first {
            let obs = layout.point_start[first] as usize..layout.point_start[end] as usize;
            let slots = layout.slot_start[first] as usize..layout.slot_start[end] as usize;
            out.push(Piece { points: first..end, obs, slots });
            first = end;
        }
    }
    out
}

/// Data of the point that is being processed: residuals, Jacobians, elimination.
pub(super) struct OnePoint<const D: usize> {
    /// First observation of the point.
    pub first_obs: usize,
    /// Its first slot.
    pub first_slot: usize,
    /// By its observations; behind these are those of other points.
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

/// Where a thread works on one piece after the other.
struct Desk<const D: usize> {
    point: OnePoint<D>,
    sums: Sums<D>,
}

/// The passes over all points.
pub(super) struct Linearization<const D: usize> {
    /// In order.
    pub pieces: Vec<Piece>,
    /// Kept data of each piece.
    pub kept: Vec<Option<Kept<D>>>,
    desks: Vec<Desk<D>>,
    /// The largest entry of the gradients of points that move.
    pub largest_point_gradient: f64,
}

/// Everything that the passes read.
#[derive(Clone, Copy)]
pub(super) struct Pass<'a> {
    pub layout: &'a Layout,
    /// Those of the problem, in its order.
    pub observations: &'a [Observation],
    pub loss: RobustLoss,
    pub parallel: bool,
}

impl Pass<'_> {
    /// Measurement, by the order of the layout.
    #[inline(always)]
    pub fn measured(&self, o: usize) -> &Observation {
        &self.observations[self.layout.obs[o] as usize]
    }
}

impl<const D: usize> Linearization<D> {
    pub fn new(pass: &Pass, pattern: &Pattern) -> Self {
        let pieces = pieces(pass.layout, pattern);
        let count = if pass.parallel { pieces.len().clamp(1, MAX_DESKS) } else { 1 };
        // Made by the threads that will use them: memory belongs to who touches it first.
        let desk =
            |_| Desk { sums: Sums::new(pass.layout), point: OnePoint::new(pass.layout, 0..pass.layout.points.len()) };
        let desks = in_order(pass.parallel, (0..count).collect(), desk);
        let kept = pieces.iter().map(|_| None).collect();
        Self { pieces, kept, desks, largest_point_gradient: 0.0 }
    }

    /// Keeps from now on what the step of the points needs, if it takes at most so many bytes.
    pub fn keep_within(mut self, layout: &Layout, most_bytes: usize) -> Self {
        let fits = Kept::<D>::bytes(layout) <= most_bytes;
        self.kept = self.pieces.iter().map(|_| fits.then(Kept::new)).collect();
        self
    }

    /// Residuals, Jacobians and the points' normal equations at a state (eqs. 1–6), their elimination with damping λ,
    /// and the sums in the reduced system. Returns the cost. Another damping is another evaluation.
    pub fn evaluate(&mut self, pass: &Pass, state: &State, damping: f64, reduced: &mut Reduced<D>) -> f64 {
        reduced.clear();
        self.largest_point_gradient = 0.0;
        let mut cost = 0.0;
        let at_a_time = self.desks.len();
        for (wave, kept) in self.pieces.chunks(at_a_time).zip(self.kept.chunks_mut(at_a_time)) {
            let pattern = &reduced.pattern;
            let work = |((piece, kept), desk): ((_, &mut Option<Kept<D>>), _)| {
                wide(Evaluate { pass, pattern, state, damping, piece, desk, kept: kept.as_mut() })
            };
            let found = in_order(pass.parallel, wave.iter().zip(kept).zip(&mut self.desks).collect(), work);
            for (desk, part) in self.desks.iter().zip(found) {
                reduced.add(&desk.sums, pass.parallel);
                cost += part.cost;
                self.largest_point_gradient = self.largest_point_gradient.max(part.largest_gradient);
            }
        }
        0.5 * cost
    }
}

impl<const D: usize> OnePoint<D> {
    /// With room for each of some points.
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

    /// Works out everything of a point at a state; returns Σ ρ.
    #[inline(always)]
    pub fn work_out<F: Fused>(&mut self, pass: &Pass, state: &State, point: usize, damping: f64) -> f64 {
        self.first_obs = pass.layout.obs_of_point(point).start;
        self.first_slot = pass.layout.slots_of_point(point).start;
        let cost = self.linearize::<F>(pass, state, point);
        self.eliminate::<F>(pass.layout, point, damping);
        cost
    }

    /// Data that the step of the current point needs.
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

/// Results of a piece.
struct Evaluated {
    /// Σ ρ.
    cost: f64,
    /// The largest entry of the gradients of points that move.
    largest_gradient: f64,
}

struct Evaluate<'a, const D: usize> {
    pass: &'a Pass<'a>,
    pattern: &'a Pattern,
    state: &'a State,
    damping: f64,
    piece: &'a Piece,
    desk: &'a mut Desk<D>,
    kept: Option<&'a mut Kept<D>>,
}

impl<const D: usize> Task for Evaluate<'_, D> {
    type Output = Evaluated;

    #[inline(always)]
    fn run<F: Fused>(self) -> Evaluated {
        let Self { pass, pattern, state, damping, piece, desk, mut kept } = self;
        let Desk { point: one, sums } = desk;
        let layout = pass.layout;
        sums.begin(layout, pattern, piece);
        if let Some(kept) = &mut kept {
            kept.begin(piece);
        }
        let mut found = Evaluated { cost: 0.0, largest_gradient: 0.0 };
        for point in piece.points.clone() {
            found.cost += one.work_out::<F>(pass, state, point, damping);
            if !layout.point_fixed[point] {
                let gradient = one.terms.gradient;
                found.largest_gradient = gradient.iter().fold(found.largest_gradient, |m, g| m.max(g.abs()));
            }
            sums.add_point::<F>(layout, pattern, one, point);
            if !layout.shared.is_empty() {
                sums.cameras.add_point(layout, one, point);
            }
            if let Some(kept) = &mut kept {
                kept.push(one.eliminated(layout, point));
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::super::options::Options;
    use super::super::problem::Problem;
    use super::*;

    #[test]
    fn parts_cover_all_points_once_and_are_alike() {
        let layout = Layout::of_world(20, 3000);
        let pieces = pieces(&layout, &Pattern::new(&layout));
        assert!(pieces.len() > 1 && pieces.len() <= MAX_DESKS, "{}", pieces.len());
        let ends = |of: fn(&Piece) -> &Range<usize>| {
            pieces.iter().fold(0, |end, piece| {
                assert_eq!(of(piece).start, end);
                of(piece).end
            })
        };
        assert_eq!(ends(|piece| &piece.points), layout.points.len());
        assert_eq!(ends(|piece| &piece.obs), layout.num_obs());
        assert_eq!(ends(|piece| &piece.slots), layout.slots.len());
        let sizes: Vec<_> = pieces.iter().map(|piece| piece.obs.len()).collect();
        assert!(sizes.iter().max() < Some(&(2 * sizes.iter().min().unwrap())), "{sizes:?}");
    }

    #[test]
    fn small_problems_are_one_part_and_empty_ones_none() {
        let small = Layout::of_world(5, 40);
        assert_eq!(pieces(&small, &Pattern::new(&small)).len(), 1);
        let empty = Layout::new(&Problem::default(), &Options::default(), false);
        assert!(pieces(&empty, &Pattern::new(&empty)).is_empty());
    }
}
