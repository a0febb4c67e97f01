//! Solvers of the reduced camera system: dense, band and sparse Cholesky.

mod by_points;
mod dense;
mod skyline;
mod sparse;

use by_points::PointsSolver;
use dense::DenseSolver;
use faer::Par;
use skyline::SkylineSolver;
use sparse::SparseSolver;

use super::options::LinearSolver;
use super::schur::Reduced;

/// Size below which a dense factorization costs less than a symbolic sparse one.
const DENSE_SIZE: usize = 300;
/// Fraction of all pairs of views above which the factor fills up, and a dense factorization is faster.
const DENSE_FILL: f64 = 0.4;
/// The same for a band, which has no fill outside of it.
const DENSE_BAND_FILL: f64 = 0.7;
/// Size above which even a filled system uses the sparse solver, which stores nonzero blocks only.
const LARGEST_DENSE: usize = 12_000;
/// Size from which two threads factorize a dense matrix faster than one.
const PARALLEL_SIZE: usize = 1_000;

/// One of the solvers, with its state from one iteration to the next.
// One instance exists per problem, so its size does not matter.
#[allow(clippy::large_enum_variant)]
pub(super) enum Solver {
    Dense(DenseSolver),
    Skyline(SkylineSolver),
    Sparse(SparseSolver),
    /// Solver of a system that is not formed.
    Points(PointsSolver),
}

impl Solver {
    pub fn new<const D: usize>(choice: LinearSolver, reduced: &Reduced<D>, parallel: bool) -> Self {
        let size = reduced.size();
        if let Some(coupling) = &reduced.coupling {
            tracing::trace!(size, points = coupling.num_points, "reduced system is not formed");
            let par = if parallel && 3 * coupling.num_points >= PARALLEL_SIZE { Par::rayon(0) } else { Par::Seq };
            return Self::Points(PointsSolver::new(coupling, par));
        }
        let par = if parallel && size >= PARALLEL_SIZE { Par::rayon(0) } else { Par::Seq };
        match choice {
            LinearSolver::Dense => Self::Dense(DenseSolver::new(size, par)),
            LinearSolver::Sparse => Self::sparse(reduced),
            LinearSolver::Auto => {
                let views = reduced.views.len();
                let of_all = 2.0 / (views * (views + 1)).max(1) as f64;
                let (blocks, envelope) = (reduced.pattern.len(), reduced.pattern.envelope());
                let is_filled = match reduced.pattern.is_band() {
                    true => envelope as f64 * of_all > DENSE_BAND_FILL,
                    false => blocks as f64 * of_all > DENSE_FILL,
                };
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
        // The symbolic factorization fails only if memory runs out; a band, however wide, needs none.
        let sparse = if reduced.pattern.is_band() { None } else { SparseSolver::new(reduced) };
        sparse.map_or_else(|| Self::Skyline(SkylineSolver::new(reduced)), Self::Sparse)
    }

    /// Solves S δ = −b. `Err` contains the pivot at which S is not positive definite.
    pub fn solve<const D: usize>(&mut self, reduced: &Reduced<D>, step: &mut [f64]) -> Result<(), usize> {
        right_hand_side(reduced, step);
        if let (Self::Points(solver), Some(coupling)) = (&mut *self, &reduced.coupling) {
            return solver.solve(reduced, coupling, step);
        }
        self.factor(reduced)?;
        self.solve_columns(step);
        Ok(())
    }

    /// Factorizes S for [`Solver::solve_columns`]; not available for a system that is not formed.
    pub fn factor<const D: usize>(&mut self, reduced: &Reduced<D>) -> Result<(), usize> {
        match self {
            Self::Dense(solver) => solver.factor(reduced),
            Self::Skyline(solver) => solver.factor(reduced),
            Self::Sparse(solver) => solver.factor(reduced),
            Self::Points(_) => Err(0),
        }
    }

    /// Solves S X = `columns` in place with the last factor; no effect without a factor.
    pub fn solve_columns(&mut self, columns: &mut [f64]) {
        match self {
            Self::Dense(solver) => solver.solve(columns),
            Self::Skyline(solver) => solver.solve(columns),
            Self::Sparse(solver) => solver.solve(columns),
            Self::Points(_) => {}
        }
    }
}

/// −b.
fn right_hand_side<const D: usize>(reduced: &Reduced<D>, out: &mut [f64]) {
    let values = reduced.views.iter().flat_map(|v| v.reduced).chain(reduced.cameras.reduced.iter().copied());
    for (cell, value) in out.iter_mut().zip(values) {
        *cell = -value;
    }
}

#[cfg(test)]
mod tests {
    use super::super::layout::Layout;
    use super::super::linearize::Linearization;
    use super::super::options::{Behind, Options};
    use super::super::piece::Pass;
    use super::super::priors;
    use nalgebra::{Point3, Vector2, Vector3};

    use super::super::problem::{CameraBlock, Observation, PlanePrior, PointPrior, Problem};
    use super::super::state::State;
    use super::*;
    use crate::math::RobustLoss;
    use crate::synthetic::scene::{self, CameraMotion, static_scene};

    const DAMPING: f64 = 1e-3;

    /// A flight of `num_images` images with one camera.
    fn flight(num_images: u32) -> Problem {
        let num_points = 12 * num_images;
        let options = scene::Options {
            path: CameraMotion::Flight,
            num_images,
            num_points,
            noise_px: 0.5,
            ..scene::Options::default()
        };
        Problem::from_reconstruction(&static_scene(&options), |_, camera| CameraBlock::free_focal_and_radial(*camera))
    }

    fn reduced(problem: &Problem, layout: &Layout) -> Reduced<6> {
        summed(problem, layout, Reduced::new(layout))
    }

    fn summed(problem: &Problem, layout: &Layout, mut reduced: Reduced<6>) -> Reduced<6> {
        let state = State::new(problem, layout);
        let (observations, loss) = (&problem.observations, Options::default().loss);
        let pass = Pass { layout, observations, loss, parallel: false };
        Linearization::new(&pass, &reduced.pattern).evaluate(&pass, &state, DAMPING, &mut reduced);
        reduced.finish(&priors::terms(problem, layout, &state), DAMPING);
        reduced
    }

    /// Checks that all direct solvers give the same step; returns the fraction of the envelope occupied by blocks.
    fn compare(problem: &Problem, layout: &Layout) -> f64 {
        let reduced = reduced(problem, layout);
        let solved = |mut solver: Solver| {
            let mut step = vec![0.0; reduced.size()];
            solver.solve(&reduced, &mut step).unwrap();
            step
        };
        let dense = solved(Solver::Dense(DenseSolver::new(reduced.size(), Par::Seq)));
        let largest = dense.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        let others =
            [Solver::Skyline(SkylineSolver::new(&reduced)), Solver::Sparse(SparseSolver::new(&reduced).unwrap())];
        for other in others.map(solved) {
            for (a, b) in dense.iter().zip(&other) {
                assert!((a - b).abs() < 1e-6 * largest, "{a} {b}");
            }
        }
        reduced.pattern.len() as f64 / reduced.pattern.envelope() as f64
    }

    #[test]
    fn direct_solvers_agree_on_a_band() {
        for num_images in [3, 64, 101] {
            let problem = flight(num_images);
            compare(&problem, &Layout::new(&problem, &Options::default(), false));
        }
    }

    #[test]
    fn a_place_that_comes_back_becomes_a_border() {
        let mut problem = flight(300);
        let of_place: Vec<_> = problem.observations.iter().filter(|o| o.pose == 16).copied().collect();
        let again = of_place.iter().flat_map(|o| (280..290).map(move |pose| Observation { pose, ..*o }));
        problem.observations.extend(again);
        let options = Options { behind: Behind::Project, ..Options::default() };
        let fill = |problem: &Problem| {
            let layout = Layout::new(problem, &options, false);
            let is_border = !layout.pose_of_block.is_sorted();
            (is_border, compare(problem, &layout))
        };
        problem.thin_ties(96);
        let (is_border, share) = fill(&problem);
        assert!(is_border && share > 0.3, "{share}");
    }

    /// Forty points in a hundred views: one constant, one with a prior, one twice in an image; and a plane prior.
    fn few_points() -> Problem {
        let options = scene::Options { num_images: 100, num_points: 40, noise_px: 0.5, ..Default::default() };
        let mut problem =
            Problem::from_reconstruction(&static_scene(&options), |_, camera| CameraBlock::fixed(*camera));
        problem.points[7].fixed = true;
        problem.priors.points.push(PointPrior { point: 3, position: problem.points[3].position, sigma: 0.02 });
        problem.priors.planes.push(PlanePrior {
            pose: 9,
            normal_in_cam: -Vector3::y(),
            camera_height: 3.0,
            point: Point3::origin(),
            up: Vector3::z(),
            sigma_distance: 0.1,
            sigma_tilt: 0.1,
            loss: RobustLoss::Squared,
        });
        let twice = problem.observations[30];
        problem.observations.push(Observation { pixel: twice.pixel + Vector2::new(0.4, -0.3), ..twice });
        problem
    }

    #[test]
    fn a_system_that_is_not_formed_gives_the_same_step() {
        let problem = few_points();
        let layout = Layout::new(&problem, &Options::default(), false);
        let formed = reduced(&problem, &layout);
        let mut dense = vec![0.0; formed.size()];
        Solver::Dense(DenseSolver::new(formed.size(), Par::Seq)).solve(&formed, &mut dense).unwrap();
        let unformed = summed(&problem, &layout, Reduced::for_steps(&layout));
        assert_eq!(unformed.blocks.len(), 100);
        let mut by_points = vec![0.0; unformed.size()];
        let mut solver = Solver::new(LinearSolver::Auto, &unformed, false);
        assert!(matches!(solver, Solver::Points(_)));
        // Repeated: no state of the first solution remains.
        for _ in 0..2 {
            solver.solve(&unformed, &mut by_points).unwrap();
        }
        let largest = dense.iter().fold(0.0, |m: f64, v| m.max(v.abs()));
        for (k, (a, b)) in dense.iter().zip(&by_points).enumerate() {
            assert!((a - b).abs() < 1e-8 * largest, "{k}: {a} {b}");
        }
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        let problem = flight(80);
        let mut reduced = reduced(&problem, &Layout::new(&problem, &Options::default(), false));
        let last = reduced.pattern.panel(40).end - 1;
        reduced.blocks[last][2][2] = -1.0;
        assert_eq!(SkylineSolver::new(&reduced).factor(&reduced), Err(40 * 6 + 2));
    }
}
