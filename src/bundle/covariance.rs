//! Covariance of chosen poses and intrinsics.

use nalgebra::{Matrix3, Matrix6};

use super::camera_sums::CAMERA_DIM;
use super::layout::{IntrinsicsUse, Layout, NONE, POSE_DIM};
use super::levenberg_marquardt::with_threads;
use super::linearize::Linearization;
use super::one_point::OnePoint;
use super::options::Options;
use super::piece::Pass;
use super::priors;
use super::problem::{BundleError, Problem};
use super::schur::Reduced;
use super::simd::Two;
use super::solver::Solver;
use super::state::State;

/// Beyond this the digits of a double are used up, and a variance means nothing.
const LARGEST_INFLATION: f64 = 1e12;

/// Blocks whose covariance is wanted, as indices in the lists of [`Problem`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Poses.
    pub poses: Vec<usize>,
    /// Sets of intrinsics.
    pub cameras: Vec<usize>,
}

/// Uncertainty of each, given that of everything else that is free; in the order of [`Wanted`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Covariances {
    /// Of poses.
    pub poses: Vec<PoseCovariance>,
    /// Of fx, fy, cx, cy, k1, k2; held ones have zero rows and columns.
    pub cameras: Vec<Matrix6<f64>>,
}

/// Uncertainty of one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseCovariance {
    /// Of the perturbation (ω, v) of `cam_from_world`: R' = exp(ω) R, t' = exp(ω) t + v; radians and world units.
    /// Freedoms that the gauge holds have zero rows and columns.
    pub pose: Matrix6<f64>,
    /// Of the camera centre in the world.
    pub center: Matrix3<f64>,
}

/// Covariances at the current state: blocks of the inverse of the normal equations with the gauge held as
/// [`Options::gauge`] says (eq. 16). Observations count with their own standard deviations; multiply by the
/// variance factor where those are only relative.
///
/// # Errors
/// As [`super::adjust`]; [`BundleError::NoCovariance`] for a block that is held or unobserved,
/// [`BundleError::Singular`] where the gauge is free or something is not determined by what is observed.
pub fn covariances(problem: &Problem, options: &Options, wanted: &Wanted) -> Result<Covariances, BundleError> {
    options.check()?;
    problem.check()?;
    with_threads(options.threads, |parallel| {
        let layout = Layout::new(problem, options, parallel);
        match layout.largest_block() {
            ..=6 => System::<6>::new(problem, options, &layout, parallel)?.covariances(wanted),
            7..=9 => System::<9>::new(problem, options, &layout, parallel)?.covariances(wanted),
            _ => System::<12>::new(problem, options, &layout, parallel)?.covariances(wanted),
        }
    })?
}

/// The normal equations without damping, eliminated and factorised.
pub(super) struct System<'a, const D: usize> {
    pub problem: &'a Problem,
    pub layout: &'a Layout,
    pass: Pass<'a>,
    state: State,
    pub reduced: Reduced<D>,
    pub solver: Solver,
}

impl<'a, const D: usize> System<'a, D> {
    pub fn new(
        problem: &'a Problem,
        options: &Options,
        layout: &'a Layout,
        parallel: bool,
    ) -> Result<Self, BundleError> {
        let state = State::new(problem, layout);
        let pass = Pass { layout, observations: &problem.observations, loss: options.loss, parallel };
        let mut reduced = Reduced::new(layout);
        let mut lin = Linearization::<D>::new(&pass, &reduced.pattern);
        lin.evaluate(&pass, &state, 0.0, &mut reduced);
        reduced.finish(&priors::terms(problem, layout, &state), 0.0);
        let mut solver = Solver::new(options.linear_solver, &reduced, parallel);
        solver.factor(&reduced).map_err(|pivot| BundleError::Singular { pivot })?;
        Ok(Self { problem, layout, pass, state, reduced, solver })
    }

    /// Room to work on any point.
    pub fn one_point(&self) -> OnePoint<D> {
        OnePoint::new(self.layout, 0..self.layout.points.len())
    }

    /// Works out residuals, Jacobians and elimination of a point.
    pub fn work_out(&self, one: &mut OnePoint<D>, point: usize) {
        one.work_out::<Two>(&self.pass, &self.state, point, 0.0);
    }

    fn covariances(mut self, wanted: &Wanted) -> Result<Covariances, BundleError> {
        Ok(Covariances {
            poses: wanted.poses.iter().map(|pose| self.pose(*pose)).collect::<Result<_, _>>()?,
            cameras: wanted.cameras.iter().map(|camera| self.camera(*camera)).collect::<Result<_, _>>()?,
        })
    }

    /// Six rows and columns of S⁻¹, from `first` on.
    fn six(&mut self, first: usize, count: usize) -> Matrix6<f64> {
        let size = self.reduced.size();
        let mut columns = vec![0.0; size * count];
        for k in 0..count {
            columns[k * size + first + k] = 1.0;
        }
        self.solver.solve_columns(&mut columns);
        let cell = |r: usize, c: usize| if r < count && c < count { columns[c * size + first + r] } else { 0.0 };
        Matrix6::from_fn(|r, c| 0.5 * (cell(r, c) + cell(c, r)))
    }

    fn pose(&mut self, pose: usize) -> Result<PoseCovariance, BundleError> {
        let block = self.layout.block_of_pose.get(pose).copied().unwrap_or(NONE);
        if block == NONE || self.layout.pose_mask[block as usize] == [false; POSE_DIM] {
            return Err(BundleError::NoCovariance { what: "pose", index: pose });
        }
        let block = block as usize;
        let of_pose = self.six(block * D, POSE_DIM);
        let mask = &self.layout.pose_mask[block];
        let of_pose = of_pose.map_with_location(|r, c, value| if mask[r] && mask[c] { value } else { 0.0 });
        // Rounding can hide a zero pivot; a variance so much larger than if all else were known betrays it.
        let own = self.reduced.blocks[self.reduced.pattern.panel(block)].last();
        let inflation = |k: usize| of_pose[(k, k)] * own.map_or(1.0, |own| own[k][k]);
        if let Some(k) = (0..POSE_DIM).find(|k| mask[*k] && !(inflation(*k) < LARGEST_INFLATION)) {
            return Err(BundleError::Singular { pivot: block * D + k });
        }
        // c' = c − Rᵀ v.
        let cam_from_world = self.problem.poses[pose].cam_from_world;
        let world_from_cam = cam_from_world.rotation.inverse().to_rotation_matrix().into_inner();
        let center = world_from_cam * of_pose.fixed_view::<3, 3>(3, 3) * world_from_cam.transpose();
        Ok(PoseCovariance { pose: of_pose, center })
    }

    fn camera(&mut self, camera: usize) -> Result<Matrix6<f64>, BundleError> {
        let none = BundleError::NoCovariance { what: "camera", index: camera };
        let first = match self.layout.intrinsics_use.get(camera) {
            Some(IntrinsicsUse::Shared(place)) => self.layout.num_blocks() * D + *place as usize * CAMERA_DIM,
            Some(IntrinsicsUse::Fused) => {
                let used = |pose: &u32| self.problem.poses[*pose as usize].camera == camera;
                let block = self.layout.pose_of_block.iter().position(used).ok_or(none)?;
                block * D + POSE_DIM
            }
            _ => return Err(none),
        };
        let columns = self.layout.columns[camera];
        let of_columns = self.six(first, columns.len);
        if let Some(k) = (0..columns.len).find(|k| !(of_columns[(*k, *k)] > 0.0 && of_columns[(*k, *k)].is_finite())) {
            return Err(BundleError::Singular { pivot: first + k });
        }
        // How the six intrinsics follow from the free columns (eq. 4).
        let mut intrinsics = Matrix6::zeros();
        for k in 0..columns.len {
            intrinsics[(columns.source[k], k)] = 1.0;
            if columns.source[k] == 0 {
                intrinsics[(1, k)] = columns.aspect;
            }
        }
        Ok(intrinsics * of_columns * intrinsics.transpose())
    }
}
