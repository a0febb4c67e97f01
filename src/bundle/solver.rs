//! Solving the reduced camera system: dense Cholesky, sparse supernodal Cholesky, or conjugate gradients.

mod dense;
mod iterative;
mod sparse;

use dense::DenseSolver;
use faer::Par;
use iterative::IterativeSolver;
use sparse::SparseSolver;

use super::options::LinearSolver;
use super::schur::Reduced;

/// Below this size a dense factorisation costs less than finding a sparse one.
const DENSE_SIZE: usize = 300;
/// Above this part of all pairs of views the factor fills up, and a dense factorisation is faster.
const DENSE_FILL: f64 = 0.4;
/// The same where the views lie in a band, which has no fill outside of it.
const DENSE_BAND_FILL: f64 = 0.7;
/// Above this size even a filled system is left to the sparse solver, which stores only what is there.
const LARGEST_DENSE: usize = 12_000;
/// From this size on, two threads factorise a dense matrix faster than one.
const PARALLEL_SIZE: usize = 1_000;

/// One of the solvers, with what it keeps from one iteration to the next.
// There is one of them per problem, so that its size does not matter.
#[allow(clippy::large_enum_variant)]
pub(super) enum Solver {
    Dense(DenseSolver),
    Sparse(SparseSolver),
    Iterative(IterativeSolver),
}

impl Solver {
    pub fn new<const D: usize>(choice: LinearSolver, reduced: &Reduced<D>, parallel: bool) -> Self {
        let size = reduced.size();
        let par = if parallel && size >= PARALLEL_SIZE { Par::rayon(0) } else { Par::Seq };
        match choice {
            LinearSolver::Iterative => Self::Iterative(IterativeSolver::new(size)),
            LinearSolver::Dense => Self::Dense(DenseSolver::new(size, par)),
            LinearSolver::Sparse => Self::sparse(reduced),
            LinearSolver::Auto => {
                let views = reduced.views.len();
                let of_all = 2.0 / (views * (views + 1)).max(1) as f64;
                let is_filled = if reduced.pattern.is_band() {
                    reduced.pattern.envelope() as f64 * of_all > DENSE_BAND_FILL
                } else {
                    reduced.pattern.len() as f64 * of_all > DENSE_FILL
                };
                let (blocks, envelope) = (reduced.pattern.len(), reduced.pattern.envelope());
                tracing::trace!(size, views, blocks, envelope, is_filled, "reduced system");
                if size <= DENSE_SIZE || (is_filled && size <= LARGEST_DENSE) {
                    Self::Dense(DenseSolver::new(size, par))
                } else {
                    Self::sparse(reduced)
                }
            }
        }
    }

    fn sparse<const D: usize>(reduced: &Reduced<D>) -> Self {
        // The symbolic factorisation fails only where memory runs out; the iterative solver needs none.
        match SparseSolver::new(reduced) {
            Some(solver) => Self::Sparse(solver),
            None => Self::Iterative(IterativeSolver::new(reduced.size())),
        }
    }

    /// Solves S δ = −b. `Err` holds the pivot at which S is not positive definite.
    pub fn solve<const D: usize>(&mut self, reduced: &Reduced<D>, step: &mut [f64]) -> Result<(), usize> {
        right_hand_side(reduced, step);
        match self {
            Self::Dense(solver) => solver.factor(reduced).map(|()| solver.solve(step)),
            Self::Sparse(solver) => solver.factor(reduced).map(|()| solver.solve(step)),
            Self::Iterative(solver) => solver.solve(reduced, step),
        }
    }
}

impl Solver {
    /// Factorises S for [`Solver::solve_columns`]; nothing to do for the iterative solver.
    pub fn factor<const D: usize>(&mut self, reduced: &Reduced<D>) -> Result<(), usize> {
        match self {
            Self::Dense(solver) => solver.factor(reduced),
            Self::Sparse(solver) => solver.factor(reduced),
            Self::Iterative(_) => Err(0),
        }
    }

    /// Solves S X = `columns` in place with the last factor; a no-operation for the iterative solver.
    pub fn solve_columns(&mut self, columns: &mut [f64]) {
        match self {
            Self::Dense(solver) => solver.solve(columns),
            Self::Sparse(solver) => solver.solve(columns),
            Self::Iterative(_) => {}
        }
    }
}

/// −b.
fn right_hand_side<const D: usize>(reduced: &Reduced<D>, out: &mut [f64]) {
    let values = reduced.views.iter().flat_map(|v| v.reduced).chain(reduced.camera_reduced.iter().copied());
    for (cell, value) in out.iter_mut().zip(values) {
        *cell = -value;
    }
}
