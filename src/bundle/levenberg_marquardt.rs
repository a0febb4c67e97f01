//! Levenberg–Marquardt iterations: damping, acceptance, termination (eqs. 12–13).

use std::time::Instant;

use super::kept::KEPT_BYTES;
use super::layout::Layout;
use super::linearize::Linearization;
use super::options::{LinearSolver, Options};
use super::piece::Pass;
use super::point::damping_scale;
use super::priors;
use super::problem::{BundleError, Problem};
use super::schur::Reduced;
use super::solver::Solver;
use super::state::State;
use super::summary::{Summary, Termination};
use super::trial::{Trial, cost, count_behind, try_step};

/// Minimum damping: with a free gauge the system is singular without it.
const SMALLEST_DAMPING: f64 = 1e-16;
/// Maximum damping: beyond it a step is indistinguishable from zero.
const LARGEST_DAMPING: f64 = 1e32;

/// Adjusts a problem in place.
///
/// On return the free blocks contain the best state found; constant blocks are unchanged, bit for bit. Poses, points
/// and cameras that no used observation refers to are unchanged.
///
/// # Errors
/// [`BundleError`] for indices, values and options out of range; the problem is then unchanged. A problem that cannot
/// be improved is no error: see [`Summary::termination`].
pub fn adjust(problem: &mut Problem, options: &Options) -> Result<Summary, BundleError> {
    options.check()?;
    problem.check()?;
    with_threads(options.threads, |parallel| dispatch(problem, options, parallel))
}

/// Runs `work` with a number of threads; its argument is true if there is more than one.
pub(super) fn with_threads<T: Send>(threads: usize, work: impl FnOnce(bool) -> T + Send) -> Result<T, BundleError> {
    match threads {
        1 => Ok(work(false)),
        // Within the scope one thread of the pool starts all tasks, and has their data in its caches.
        0 => Ok(rayon::scope(|_| work(rayon::current_num_threads() > 1))),
        n if n == rayon::current_num_threads() => Ok(rayon::scope(|_| work(true))),
        n => {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build();
            let pool = pool.map_err(|e| BundleError::Threads { threads: n, message: e.to_string() })?;
            Ok(pool.install(|| work(true)))
        }
    }
}

fn dispatch(problem: &mut Problem, options: &Options, parallel: bool) -> Summary {
    let start = Instant::now();
    let layout = Layout::new(problem, options, parallel);
    // Taken out of the problem: observations are read while the parameters are written.
    let observations = std::mem::take(&mut problem.observations);
    let pass = Pass { layout: &layout, observations: &observations, loss: options.loss, parallel };
    // One compiled copy for each common block size: poses only, with f k1 k2, with all intrinsics.
    let mut summary = match layout.largest_block() {
        ..=6 => Run::<6>::new(problem, options, pass).minimize(start),
        7..=9 => Run::<9>::new(problem, options, pass).minimize(start),
        _ => Run::<12>::new(problem, options, pass).minimize(start),
    };
    problem.observations = observations;
    summary.total_s = start.elapsed().as_secs_f64();
    tracing::trace!(
        views = problem.poses.len(),
        points = problem.points.len(),
        observations = problem.observations.len(),
        iterations = summary.iterations,
        cost = summary.final_cost,
        linearize_s = summary.linearize_s,
        solve_s = summary.solve_s,
        total_s = summary.total_s,
        "adjusted"
    );
    summary
}

/// One adjustment in progress.
struct Run<'a, const D: usize> {
    problem: &'a mut Problem,
    options: &'a Options,
    layout: &'a Layout,
    pass: Pass<'a>,
    state: State,
    trial: State,
    lin: Linearization<D>,
    reduced: Reduced<D>,
    solver: Solver,
    step: Vec<f64>,
    /// Norm of the vector of all parameters.
    norm: f64,
    damping: f64,
    /// Factor by which the next rejection raises the damping.
    raise: f64,
    summary: Summary,
}

impl<'a, const D: usize> Run<'a, D> {
    fn new(problem: &'a mut Problem, options: &'a Options, pass: Pass<'a>) -> Self {
        let layout = pass.layout;
        let state = State::new(problem, layout);
        let reduced = match options.linear_solver {
            LinearSolver::Auto => Reduced::for_steps(layout),
            _ => Reduced::new(layout),
        };
        let solver = Solver::new(options.linear_solver, &reduced, pass.parallel);
        Self {
            trial: state.clone(),
            lin: Linearization::new(&pass, &reduced.pattern).keep_within(layout, KEPT_BYTES),
            step: vec![0.0; reduced.size()],
            norm: (state.cameras_norm_sq() + state.points_norm_sq()).sqrt(),
            damping: options.initial_damping,
            raise: 2.0,
            summary: Summary {
                num_residuals: layout.num_obs(),
                num_ignored: layout.num_ignored,
                reduced_size: reduced.size(),
                ..Summary::default()
            },
            problem,
            options,
            layout,
            pass,
            state,
            reduced,
            solver,
        }
    }

    fn minimize(mut self, start: Instant) -> Summary {
        if !self.layout.has_freedom() {
            let cost = cost(&self.pass, &self.state) + priors::cost(self.problem, &self.state);
            (self.summary.initial_cost, self.summary.final_cost) = (cost, cost);
            return self.summary;
        }
        self.summary.setup_s = start.elapsed().as_secs_f64();
        let mut cost = self.linearize();
        self.summary.initial_cost = cost;
        self.summary.termination = loop {
            if self.summary.iterations >= self.options.max_iterations {
                break Termination::MaxIterations;
            }
            self.summary.iterations += 1;
            if let Some(termination) = self.iterate(&mut cost) {
                break termination;
            }
            self.linearize();
        };
        self.summary.final_cost = cost;
        self.summary.num_behind = count_behind(&self.pass, &self.state);
        self.state.write(self.problem, self.layout);
        self.summary
    }

    fn linearize(&mut self) -> f64 {
        let start = Instant::now();
        let cost = self.lin.evaluate(&self.pass, &self.state, self.damping, &mut self.reduced);
        self.summary.linearize_s += start.elapsed().as_secs_f64();
        cost + priors::cost(self.problem, &self.state)
    }

    /// Tries one step from the current linearization; if accepted, updates the state and lowers `cost`.
    ///
    /// Returns the reason for termination if this is the last step.
    fn iterate(&mut self, cost: &mut f64) -> Option<Termination> {
        if !self.solve() {
            return self.reject();
        }
        if self.largest_gradient() <= self.options.gradient_tolerance {
            return Some(Termination::GradientTolerance);
        }
        let start = Instant::now();
        let tried = self.try_step();
        self.summary.step_s += start.elapsed().as_secs_f64();
        let predicted = 0.5 * tried.decrease;
        if !(predicted > 0.0) {
            return self.reject();
        }
        let tolerance = self.options.parameter_tolerance;
        let small = tried.step_sq.sqrt() <= tolerance * (self.norm + tolerance);
        let change = *cost - tried.cost;
        let flat = change.abs() <= self.options.function_tolerance * *cost;
        let ratio = change / predicted;
        let is_accepted = change >= 0.0 && ratio > 1e-3;
        if is_accepted {
            std::mem::swap(&mut self.state, &mut self.trial);
            *cost = tried.cost;
            self.norm = tried.norm_sq.sqrt();
            self.summary.accepted += 1;
            self.accept(ratio);
        }
        match (flat, small) {
            (true, _) => Some(Termination::FunctionTolerance),
            (_, true) => Some(Termination::ParameterTolerance),
            _ if is_accepted => None,
            _ => self.reject(),
        }
    }

    /// Forms and solves the reduced system; false if it is not positive definite.
    fn solve(&mut self) -> bool {
        let start = Instant::now();
        let priors = priors::terms(self.problem, self.layout, &self.state);
        self.reduced.finish(&priors, self.damping);
        let assembled = Instant::now();
        self.summary.schur_s += (assembled - start).as_secs_f64();
        let solved = self.solver.solve(&self.reduced, &mut self.step).is_ok();
        self.summary.solve_s += assembled.elapsed().as_secs_f64();
        solved && self.step.iter().all(|v| v.is_finite())
    }

    /// Updates the trial state; returns the sums over cameras and points.
    fn try_step(&mut self) -> Trial {
        let in_range = self.trial.move_cameras(&self.state, self.problem, self.layout, &self.step, D);
        let mut total = try_step(&self.lin, &self.pass, &self.step, self.damping, &self.state, &mut self.trial);
        total.decrease += self.predicted_by_cameras();
        total.step_sq += self.step.iter().map(|v| v * v).sum::<f64>();
        total.norm_sq += self.trial.cameras_norm_sq();
        total.cost = if in_range { total.cost + priors::cost(self.problem, &self.trial) } else { f64::INFINITY };
        total
    }

    fn predicted_by_cameras(&self) -> f64 {
        let reduced = &self.reduced;
        let diagonal = reduced.views.iter().flat_map(|v| v.diagonal).chain(reduced.cameras.diagonal.iter().copied());
        let gradient = reduced.views.iter().flat_map(|v| v.gradient).chain(reduced.cameras.gradient.iter().copied());
        let terms = self.step.iter().zip(diagonal).zip(gradient);
        terms.map(|((d, diagonal), g)| d * (self.damping * damping_scale(diagonal) * d - g)).sum()
    }

    fn largest_gradient(&self) -> f64 {
        let views = self.reduced.views.iter().flat_map(|v| v.gradient);
        let cameras = views.chain(self.reduced.cameras.gradient.iter().copied());
        cameras.fold(self.lin.largest_point_gradient, |m, g| m.max(g.abs()))
    }

    /// Nielsen's rule (eq. 12).
    fn accept(&mut self, ratio: f64) {
        let factor = (1.0 - (2.0 * ratio - 1.0).powi(3)).max(1.0 / 3.0);
        self.damping = (self.damping * factor).max(SMALLEST_DAMPING);
        self.raise = 2.0;
    }

    fn reject(&mut self) -> Option<Termination> {
        self.damping *= self.raise;
        self.raise *= 2.0;
        (self.damping > LARGEST_DAMPING).then_some(Termination::NoProgress)
    }
}
