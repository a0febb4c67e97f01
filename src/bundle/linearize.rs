//! Linearisation: residuals and Jacobians, elimination of the points, and their sums in the reduced system.
//!
//! The points are cut in a few parts. A part keeps everything that belongs to its points, and a thread goes through it
//! point by point from the projection to the reduced system, while the point's Jacobians are still in the nearest
//! cache. The cut depends on the problem alone and sums are taken in the order of the parts, so that nothing depends on
//! the number of threads.

use std::ops::Range;

use super::accumulate::{Sums, reach};
use super::layout::{Layout, NONE, POSE_DIM};
use super::parallel::in_order;
use super::pattern::Pattern;
use super::point::PointTerms;
use super::residual::{Derivatives, Residual, linearize};
use super::simd::{Fused, Task, wide};
use super::state::State;
use crate::math::RobustLoss;

/// Most parts.
const MAX_PARTS: usize = 8;
/// Least work in a part, in rank-2 updates of one block: less is not worth a task.
const PART_WORK: usize = 15_000;
/// Work that linearising one observation is worth, likewise.
const OBSERVATION_WORK: usize = 5;
/// Rank-2 updates for which a part may have one more block to clear and to add up.
const WORK_PER_BLOCK: usize = 60;

/// A run of points and what belongs to them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Piece {
    pub points: Range<usize>,
    pub obs: Range<usize>,
    pub slots: Range<usize>,
}

/// Cuts the points in parts of about the same work: as many as there can be without each losing too much by blocks of
/// the reduced system that others have, too, and without these taking more memory than the system itself.
pub(super) fn pieces(layout: &Layout, pattern: &Pattern) -> Vec<Piece> {
    let work: Vec<usize> = (0..layout.points.len())
        .scan(0, |sum, point| {
            let count = layout.obs_of_point(point).len();
            *sum += count * OBSERVATION_WORK + count * (count + 1) / 2;
            Some(*sum)
        })
        .collect();
    let total = work.last().copied().unwrap_or(0);
    let mut count = MAX_PARTS;
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

/// What a linearisation knows of the observations and points of one piece.
pub(super) struct Part<const D: usize> {
    pub piece: Piece,
    pub residuals: Vec<Residual<D>>,
    /// Jₚ of every observation of the point that is being worked on.
    d_points: Vec<[[f64; 3]; 2]>,
    /// Its derivatives by shared intrinsics; empty without shared cameras.
    pub d_shared: Vec<[[f64; 6]; 2]>,
    /// L⁻¹ Jₚᵀ J_c of every slot, summed over the slot's observations (eq. 9).
    pub slot_eliminated: Vec<[[f64; 6]; 3]>,
    pub points: Vec<PointTerms>,
}

/// One part and its sums.
pub(super) struct Share<const D: usize> {
    pub part: Part<D>,
    pub sums: Sums<D>,
}

/// All parts, in order.
pub(super) struct Linearization<const D: usize> {
    pub parts: Vec<Share<D>>,
    /// The largest entry of the gradients of points that move.
    pub largest_point_gradient: f64,
}

/// Everything that the passes read.
#[derive(Clone, Copy)]
pub(super) struct Pass<'a> {
    pub layout: &'a Layout,
    pub loss: RobustLoss,
    pub parallel: bool,
}

impl<const D: usize> Linearization<D> {
    pub fn new(pass: &Pass, pattern: &Pattern) -> Self {
        // Made by the threads that will use them: memory belongs to who touches it first.
        let share =
            |piece: Piece| Share { sums: Sums::new(pass.layout, pattern, &piece), part: Part::new(pass.layout, piece) };
        Self { parts: in_order(pass.parallel, pieces(pass.layout, pattern), share), largest_point_gradient: 0.0 }
    }

    /// Residuals, Jacobians and the points' normal equations at a state (eqs. 1–6), their elimination with damping λ,
    /// and the sums for the reduced system. Returns the cost. Another damping is another evaluation: what it could
    /// reuse would take as much memory again as all that is kept.
    pub fn evaluate(&mut self, pass: &Pass, pattern: &Pattern, state: &State, damping: f64) -> f64 {
        let work = |share: &mut Share<D>| wide(Evaluate { pass, pattern, state, damping, share });
        let found = in_order(pass.parallel, self.parts.iter_mut().collect(), work);
        self.largest_point_gradient = found.iter().fold(0.0, |m, part| m.max(part.largest_gradient));
        0.5 * found.iter().map(|part| part.cost).sum::<f64>()
    }

    #[cfg(test)]
    fn of_obs(&self, o: usize) -> (&Part<D>, usize) {
        let share = self.parts.iter().find(|share| share.part.piece.obs.contains(&o));
        let part = &share.expect("every observation is in a part").part;
        (part, o - part.piece.obs.start)
    }

    /// Residual of an observation.
    #[cfg(test)]
    pub fn residual(&self, o: usize) -> &Residual<D> {
        let (part, place) = self.of_obs(o);
        &part.residuals[place]
    }
}

impl<const D: usize> Part<D> {
    fn new(layout: &Layout, piece: Piece) -> Self {
        let none = Residual { value: [0.0; 2], d_view: [[0.0; D]; 2], eliminated: [[0.0; 3]; 2] };
        let longest = piece.points.clone().map(|point| layout.obs_of_point(point).len()).max().unwrap_or(0);
        Self {
            residuals: vec![none; piece.obs.len()],
            d_points: vec![[[0.0; 3]; 2]; longest],
            d_shared: vec![[[0.0; 6]; 2]; if layout.shared.is_empty() { 0 } else { longest }],
            slot_eliminated: vec![[[0.0; 6]; 3]; piece.slots.len()],
            points: vec![PointTerms::default(); piece.points.len()],
            piece,
        }
    }

    /// Residuals, Jacobians and normal equations of one point; returns Σ ρ.
    #[inline(always)]
    fn linearize_point<F: Fused>(&mut self, pass: &Pass, state: &State, point: usize) -> f64 {
        let layout = pass.layout;
        let mut terms = PointTerms::default();
        let mut cost = 0.0;
        for (k, o) in layout.obs_of_point(point).enumerate() {
            let view = &state.views[layout.obs_pose[o] as usize];
            let is_shared = layout.obs_slot.get(o).is_some_and(|slot| *slot != NONE);
            let d_shared = if is_shared { self.d_shared.get_mut(k) } else { None };
            let derivatives = Derivatives { d_point: &mut self.d_points[k], d_shared };
            let (pixel, whitening) = (&layout.obs_pixel[o], &layout.obs_whitening[o]);
            let (rho, mut residual) =
                linearize::<D, F>(view, &state.points[point], pixel, whitening, &pass.loss, derivatives);
            hold_masked(layout, layout.obs_block[o], &mut residual.d_view);
            cost += rho;
            terms.add::<F>(&self.d_points[k], residual.value);
            self.residuals[o - self.piece.obs.start] = residual;
        }
        if let Some(known) = layout.point_priors.get(point) {
            terms.add_prior(known, &state.points[point]);
            cost += known.cost(&state.points[point]);
        }
        self.points[point - self.piece.points.start] = terms;
        cost
    }

    /// Elimination of one point (eq. 9).
    #[inline(always)]
    fn eliminate_point<F: Fused>(&mut self, layout: &Layout, point: usize, damping: f64) {
        let first_slot = self.piece.slots.start;
        for slot in layout.slots_of_point(point) {
            self.slot_eliminated[slot - first_slot] = [[0.0; 6]; 3];
        }
        let terms = &mut self.points[point - self.piece.points.start];
        terms.eliminate(layout.point_fixed[point], damping);
        for (k, o) in layout.obs_of_point(point).enumerate() {
            let q = self.d_points[k].map(|row| terms.forward_solve(&row));
            self.residuals[o - self.piece.obs.start].eliminated = q;
            if layout.obs_slot.get(o).is_some_and(|slot| *slot != NONE) {
                let y = &mut self.slot_eliminated[layout.obs_slot[o] as usize - first_slot];
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

/// What a part finds on the way.
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
    share: &'a mut Share<D>,
}

impl<const D: usize> Task for Evaluate<'_, D> {
    type Output = Evaluated;

    #[inline(always)]
    fn run<F: Fused>(self) -> Evaluated {
        let Self { pass, pattern, state, damping, share } = self;
        let Share { part, sums } = share;
        let layout = pass.layout;
        sums.clear();
        let mut found = Evaluated { cost: 0.0, largest_gradient: 0.0 };
        for point in part.piece.points.clone() {
            found.cost += part.linearize_point::<F>(pass, state, point);
            if !layout.point_fixed[point] {
                let gradient = part.points[point - part.piece.points.start].gradient;
                found.largest_gradient = gradient.iter().fold(found.largest_gradient, |m, g| m.max(g.abs()));
            }
            part.eliminate_point::<F>(layout, point, damping);
            sums.add_point::<F>(layout, pattern, part, point);
            if !layout.shared.is_empty() {
                sums.cameras.add_point(layout, part, point);
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::super::options::Options;
    use super::super::problem::{CameraBlock, Problem};
    use super::*;
    use crate::synthetic::scene::{self, static_scene};

    fn layout(num_images: u32, num_points: u32) -> Layout {
        let truth = static_scene(&scene::Options { num_images, num_points, ..Default::default() });
        let problem = Problem::from_reconstruction(&truth, |_, camera| CameraBlock::fixed(*camera));
        Layout::new(&problem, &Options::default(), false)
    }

    #[test]
    fn parts_cover_all_points_once_and_are_alike() {
        let layout = layout(20, 3000);
        let pieces = pieces(&layout, &Pattern::new(&layout));
        assert!(pieces.len() > 1 && pieces.len() <= MAX_PARTS, "{}", pieces.len());
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
        let small = layout(5, 40);
        assert_eq!(pieces(&small, &Pattern::new(&small)).len(), 1);
        let empty = Layout::new(&Problem::default(), &Options::default(), false);
        assert!(pieces(&empty, &Pattern::new(&empty)).is_empty());
    }
}
