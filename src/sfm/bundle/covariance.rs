//! Covariance of chosen poses.

use nalgebra::{Matrix3, Matrix6};

use super::layout::{Layout, NONE};
use super::levenberg_marquardt::with_threads;
use super::linearize::{Linearization, Pass, pieces};
use super::options::{LinearSolver, Options};
use super::priors;
use super::problem::{BundleError, Problem};
use super::schur::Reduced;
use super::solver::Solver;
use super::state::State;

/// Beyond this the digits of a double are used up, and a variance means nothing.
const LARGEST_INFLATION: f64 = 1e12;

/// Uncertainty of one pose, given that of everything else that is free.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Covariance {
    /// Of the perturbation (ω, v) of `cam_from_world`: R' = exp(ω) R, t' = exp(ω) t + v; radians and world units. Freedoms
    /// that the gauge holds have zero rows and columns.
    pub pose: Matrix6<f64>,
    /// Of the camera centre in the world.
    pub center: Matrix3<f64>,
}

/// Covariances of poses at the current state: the inverse of the normal equations with the gauge held as
/// [`Options::gauge`] says (eq. 16). Observations count with their own standard deviations; multiply by the variance factor
/// where those are only relative.
///
/// # Errors
/// As [`super::adjust`]; [`BundleError::NoCovariance`] for a pose that is held or unobserved, [`BundleError::Singular`]
/// where the gauge is free or something is not determined by what is observed.
pub fn covariance(problem: &Problem, options: &Options, poses: &[usize]) -> Result<Vec<Covariance>, BundleError> {
    options.check()?;
    problem.check()?;
    let layout = Layout::new(problem, options);
    for pose in poses {
        if *pose >= problem.poses.len() || layout.block_of_pose[*pose] == NONE {
            return Err(BundleError::NoCovariance { pose: *pose });
        }
    }
    with_threads(options.threads, |parallel| match layout.largest_block() {
        ..=6 => solve::<6>(problem, options, &layout, parallel, poses),
        7..=9 => solve::<9>(problem, options, &layout, parallel, poses),
        _ => solve::<12>(problem, options, &layout, parallel, poses),
    })?
}

fn solve<const D: usize>(
    problem: &Problem,
    options: &Options,
    layout: &Layout,
    parallel: bool,
    poses: &[usize],
) -> Result<Vec<Covariance>, BundleError> {
    let state = State::new(problem, layout);
    let pieces = pieces(layout);
    let pass = Pass { layout, pieces: &pieces, loss: options.loss, parallel };
    let mut lin = Linearization::<D>::new(layout);
    lin.evaluate(&pass, &state, 0.0);
    let mut reduced = Reduced::new(layout);
    reduced.assemble(&pass, &lin, &priors::terms(problem, layout, &state), 0.0);
    let choice = match options.linear_solver {
        LinearSolver::Iterative => LinearSolver::Auto,
        other => other,
    };
    let mut solver = Solver::new(choice, &reduced, parallel);
    solver.factor(&reduced).map_err(|pivot| BundleError::Singular { pivot })?;
    let one = |pose: &usize| {
        let block = layout.block_of_pose[*pose] as usize;
        pose_covariance(problem, layout, &mut solver, &reduced, *pose, block)
    };
    poses.iter().map(one).collect()
}

/// Six columns of S⁻¹.
fn pose_covariance<const D: usize>(
    problem: &Problem,
    layout: &Layout,
    solver: &mut Solver,
    reduced: &Reduced<D>,
    pose: usize,
    block: usize,
) -> Result<Covariance, BundleError> {
    let size = reduced.size();
    let mut columns = vec![0.0; size * 6];
    for k in 0..6 {
        columns[k * size + block * D + k] = 1.0;
    }
    solver.solve_columns(&mut columns);
    let mask = &layout.pose_mask[block];
    let cell = |r: usize, c: usize| if mask[r] && mask[c] { columns[c * size + block * D + r] } else { 0.0 };
    let of_pose = Matrix6::from_fn(|r, c| 0.5 * (cell(r, c) + cell(c, r)));
    // Rounding can hide a zero pivot; a variance so much larger than if all else were known betrays it.
    let own = reduced.blocks[reduced.pattern.panel(block)].last();
    let inflation = |k: usize| of_pose[(k, k)] * own.map_or(1.0, |own| own[k][k]);
    if let Some(k) = (0..6).find(|k| mask[*k] && !(inflation(*k) < LARGEST_INFLATION)) {
        return Err(BundleError::Singular { pivot: block * D + k });
    }
    // c' = c − Rᵀ v.
    let world_from_cam = problem.poses[pose].cam_from_world.rotation.inverse().to_rotation_matrix().into_inner();
    let center = world_from_cam * of_pose.fixed_view::<3, 3>(3, 3) * world_from_cam.transpose();
    Ok(Covariance { pose: of_pose, center })
}
