//! `tractrix bal`: bundle adjustment alone, on a problem of *Bundle Adjustment in the Large*.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Context;
use serde_json::json;

use super::output::{Failure, Form, show};
use crate::bundle::{Behind, CameraBlock, Gauge, LinearSolver, Options, Problem, adjust};
use crate::io::interchange::bal;
use crate::pipeline::{MOST_THREADS, process_cpu_s};

/// Solve a "Bundle Adjustment in the Large" problem (each camera with its own f, k1, k2) and print the result
#[derive(clap::Args, Clone, Debug)]
pub(super) struct Args {
    /// "Bundle Adjustment in the Large" problem, text format
    pub(super) problem: PathBuf,
    /// Threads; 0 uses all
    #[arg(long, default_value_t = 1, value_parser = threads)]
    pub(super) threads: usize,
    /// Maximum number of iterations
    #[arg(long, default_value_t = 50)]
    pub(super) max_iterations: usize,
    /// Relative change of the cost below which iteration stops
    #[arg(long, default_value_t = 1e-6)]
    pub(super) function_tolerance: f64,
    /// Solver of the reduced camera system
    #[arg(long, value_enum, default_value_t = SolverArg::Auto)]
    pub(super) solver: SolverArg,
}

/// [`LinearSolver`] by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum SolverArg {
    /// Dense or sparse, by size and fill
    Auto,
    /// Dense Cholesky
    Dense,
    /// Sparse Cholesky
    Sparse,
}

/// A number of threads that helps anybody.
fn threads(text: &str) -> Result<usize, String> {
    let number = text.parse().ok().filter(|number| *number <= MOST_THREADS);
    number.ok_or_else(|| format!("'{text}': expected a number from 0 to {MOST_THREADS}"))
}

/// Reads, adjusts, prints.
///
/// # Errors
/// What is wrong with the file, with its line; or with an option.
pub(super) fn run(args: &Args, form: Form) -> Result<(), Failure> {
    let model = bal::read(&args.problem)?;
    let mut problem = Problem::from_reconstruction(&model, |_, camera| CameraBlock::free_focal_and_radial(*camera));
    let options = Options {
        max_iterations: args.max_iterations,
        function_tolerance: args.function_tolerance,
        threads: args.threads,
        linear_solver: match args.solver {
            SolverArg::Auto => LinearSolver::Auto,
            SolverArg::Dense => LinearSolver::Dense,
            SolverArg::Sparse => LinearSolver::Sparse,
        },
        // What the benchmark's other solvers do.
        gauge: Gauge::Free,
        behind: Behind::Project,
        ..Options::default()
    };
    let (wall, cpu) = (Instant::now(), process_cpu_s());
    let summary =
        adjust(&mut problem, &options).with_context(|| format!("cannot adjust {}", args.problem.display()))?;
    let (solve_cpu_s, solve_wall_s) = (process_cpu_s() - cpu, wall.elapsed().as_secs_f64());
    let (num_images, num_points, s) = (problem.poses.len(), problem.points.len(), &summary);
    let output = json!({
        "initial_cost": s.initial_cost,
        "final_cost": s.final_cost,
        "iterations": s.iterations,
        "solve_cpu_s": solve_cpu_s,
        "solve_wall_s": solve_wall_s,
        "num_images": num_images,
        "num_points": num_points,
        "summary": s,
    });
    show(form, &output, || {
        format!(
            "{num_images} images, {num_points} points, {} observations\n\
             cost {:.3} → {:.3} in {} iterations ({:?})\n\
             CPU {solve_cpu_s:.3} s, wall {solve_wall_s:.3} s\n\
             set-up {:.3}, linearization {:.3}, reduced system {:.3}, its solution {:.3}, steps {:.3} s\n",
            s.num_residuals,
            s.initial_cost,
            s.final_cost,
            s.iterations,
            s.termination,
            s.setup_s,
            s.linearize_s,
            s.schur_s,
            s.solve_s,
            s.step_s
        )
    })
}
