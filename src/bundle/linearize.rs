//! Linearization: residuals and Jacobians, elimination of the points, and accumulation of the reduced system.
//!
//! The points are split into a few pieces. A thread processes a piece point by point, from the projection to the
//! reduced system, while the point's Jacobians are still in the nearest cache. The data needed for the step of the
//! points ([`super::trial`]) are cached if they fit ([`super::kept`]), otherwise recomputed: then an observation takes
//! no memory beyond its index. The split depends on the problem only, and sums are taken in the order of the pieces, so
//! the result does not depend on the number of threads.

use super::accumulate::Sums;
use super::kept::Kept;
use super::layout::Layout;
use super::one_point::OnePoint;
use super::parallel::in_order;
use super::pattern::Pattern;
use super::piece::{MAX_DESKS, Pass, Piece, pieces};
use super::schur::Reduced;
use super::simd::{Fused, Task, wide};
use super::state::State;

/// Workspace of a thread, reused for one piece after the other.
struct Desk<const D: usize> {
    point: OnePoint<D>,
    sums: Sums<D>,
}

/// The passes over all points.
pub(super) struct Linearization<const D: usize> {
    /// Pieces in order.
    pub pieces: Vec<Piece>,
    /// Cached data of each piece.
    pub kept: Vec<Option<Kept<D>>>,
    desks: Vec<Desk<D>>,
    /// The largest entry of the gradients of points that move.
    pub largest_point_gradient: f64,
}

impl<const D: usize> Linearization<D> {
    pub fn new(pass: &Pass, pattern: &Pattern) -> Self {
        let pieces = pieces(pass.layout, pattern);
        let count = if pass.parallel { pieces.len().clamp(1, MAX_DESKS) } else { 1 };
        // Allocated by the threads that use them: memory is local to the first thread that touches it.
        let desk =
            |_| Desk { sums: Sums::new(pass.layout), point: OnePoint::new(pass.layout, 0..pass.layout.points.len()) };
        let desks = in_order(pass.parallel, (0..count).collect(), desk);
        let kept = pieces.iter().map(|_| None).collect();
        Self { pieces, kept, desks, largest_point_gradient: 0.0 }
    }

    /// Enables the cache for the step of the points, if it takes at most `most_bytes`.
    pub fn keep_within(mut self, layout: &Layout, most_bytes: usize) -> Self {
        let fits = Kept::<D>::bytes(layout) <= most_bytes;
        self.kept = self.pieces.iter().map(|_| fits.then(Kept::default)).collect();
        self
    }

    /// Linearizes at a state (eqs. 1–6), eliminates the points with damping λ, and fills the reduced system.
    ///
    /// Returns the cost. Another damping requires another evaluation.
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
    use std::ops::Range;

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
