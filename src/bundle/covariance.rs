//! Covariance of chosen poses and intrinsics.

use nalgebra::{DMatrix, Matrix3, Matrix6};

use super::camera_sums::CAMERA_DIM;
use super::clustered::{Groups, scores};
use super::layout::{IntrinsicsUse, Layout, NONE, POSE_DIM};
use super::levenberg_marquardt::with_threads;
use super::linearize::Linearization;
use super::options::Options;
use super::piece::Pass;
use super::priors;
use super::problem::{BundleError, Problem};
use super::schur::Reduced;
use super::solver::Solver;
use super::state::State;

/// Maximum variance inflation: beyond it the precision of a double is exhausted, and a variance is meaningless.
const LARGEST_INFLATION: f64 = 1e12;

/// Blocks whose covariance is requested, as indices in the lists of [`Problem`].
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// Poses.
    pub poses: Vec<usize>,
    /// Sets of intrinsics.
    pub cameras: Vec<usize>,
}

/// Marginal covariances of the requested blocks, in the order of [`Wanted`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Covariances {
    /// Covariances of poses.
    pub poses: Vec<PoseCovariance>,
    /// Covariances of fx, fy, cx, cy, k1, k2; constant parameters have zero rows and columns.
    pub cameras: Vec<Matrix6<f64>>,
}

/// Uncertainty of one pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseCovariance {
    /// Covariance of the perturbation (ω, v) of `cam_from_world`: R' = exp(ω) R, t' = exp(ω) t + v; radians and world
    /// units. Degrees of freedom fixed by the gauge have zero rows and columns.
    pub pose: Matrix6<f64>,
    /// Covariance of the camera center in the world.
    pub center: Matrix3<f64>,
}

/// Covariances at the current state: blocks of the inverse of the normal equations (eq. 16).
///
/// The gauge is fixed by [`Options::gauge`]. Observations are weighted by their standard deviations; multiply by the
/// variance factor if these are only relative.
///
/// # Errors
/// As [`super::adjust`]; [`BundleError::NoCovariance`] for a block that is constant or unobserved,
/// [`BundleError::Singular`] if the gauge is free or the observations do not determine a parameter.
pub fn covariances(problem: &Problem, options: &Options, wanted: &Wanted) -> Result<Covariances, BundleError> {
    options.check()?;
    problem.check()?;
    with_threads(options.threads, |parallel| {
        let layout = Layout::new(problem, options, parallel);
        let mut system = System::new(problem, options, &layout, parallel, &Groups::default())?;
        Ok(Covariances {
            poses: wanted.poses.iter().map(|pose| system.pose(*pose)).collect::<Result<_, _>>()?,
            cameras: wanted.cameras.iter().map(|camera| system.camera(*camera)).collect::<Result<_, _>>()?,
        })
    })?
}

/// Undamped normal equations with the points eliminated, factorized.
pub(super) struct System<'a> {
    pub problem: &'a Problem,
    pub layout: &'a Layout,
    /// Number of unknowns, constant ones included.
    pub size: usize,
    /// Degrees of freedom of a view block.
    pub dim: usize,
    /// Diagonals of the views' diagonal blocks.
    diagonals: Vec<f64>,
    solver: Solver,
    /// Scores of groups of points; see [`super::clustered`].
    pub scores: Vec<Vec<f64>>,
}

impl<'a> System<'a> {
    /// * `groups` – groups of points for which scores are computed.
    pub fn new(
        problem: &'a Problem,
        options: &Options,
        layout: &'a Layout,
        parallel: bool,
        groups: &Groups,
    ) -> Result<Self, BundleError> {
        match layout.largest_block() {
            ..=6 => Self::with_blocks::<6>(problem, options, layout, parallel, groups),
            7..=9 => Self::with_blocks::<9>(problem, options, layout, parallel, groups),
            _ => Self::with_blocks::<12>(problem, options, layout, parallel, groups),
        }
    }

    fn with_blocks<const D: usize>(
        problem: &'a Problem,
        options: &Options,
        layout: &'a Layout,
        parallel: bool,
        groups: &Groups,
    ) -> Result<Self, BundleError> {
        let state = State::new(problem, layout);
        let pass = Pass { layout, observations: &problem.observations, loss: options.loss, parallel };
        let mut reduced = Reduced::<D>::new(layout);
        Linearization::new(&pass, &reduced.pattern).evaluate(&pass, &state, 0.0, &mut reduced);
        reduced.finish(&priors::terms(problem, layout, &state), 0.0);
        let mut solver = Solver::new(options.linear_solver, &reduced, parallel);
        solver.factor(&reduced).map_err(|pivot| BundleError::Singular { pivot })?;
        let own = |view: usize| &reduced.blocks[reduced.pattern.start[view + 1] - 1];
        let diagonals = (0..layout.num_blocks()).flat_map(|view| (0..D).map(move |k| own(view)[k][k])).collect();
        let scores = scores::<D>(&pass, &state, groups, reduced.size());
        Ok(Self { problem, layout, size: reduced.size(), dim: D, diagonals, solver, scores })
    }

    /// Columns of S⁻¹, concatenated, and the block of S⁻¹ at the corresponding rows.
    pub fn inverse(&mut self, rows: &[usize]) -> (Vec<f64>, DMatrix<f64>) {
        let (size, count) = (self.size, rows.len());
        let mut columns = vec![0.0; size * count];
        for (k, row) in rows.iter().enumerate() {
            columns[k * size + row] = 1.0;
        }
        self.solver.solve_columns(&mut columns);
        let cell = |r: usize, c: usize| columns[c * size + rows[r]];
        let block = DMatrix::from_fn(count, count, |r, c| 0.5 * (cell(r, c) + cell(c, r)));
        (columns, block)
    }

    /// View block of a pose with a free pose or camera parameter.
    pub fn block_of_pose(&self, pose: usize) -> Result<usize, BundleError> {
        let block = self.layout.block_of_pose.get(pose).copied().filter(|block| *block != NONE);
        block.map(|block| block as usize).ok_or(BundleError::NoCovariance { what: "pose", index: pose })
    }

    /// Rotation from the frame of a camera to the world.
    pub fn world_from_cam(&self, pose: usize) -> Matrix3<f64> {
        self.problem.poses[pose].cam_from_world.rotation.inverse().to_rotation_matrix().into_inner()
    }

    /// Covariance of a pose.
    pub fn pose(&mut self, pose: usize) -> Result<PoseCovariance, BundleError> {
        let block = self.block_of_pose(pose)?;
        let mask = self.layout.pose_mask[block];
        if mask == [false; POSE_DIM] {
            return Err(BundleError::NoCovariance { what: "pose", index: pose });
        }
        let first = block * self.dim;
        let (_, free) = self.inverse(&(first..first + POSE_DIM).collect::<Vec<_>>());
        let of_pose = Matrix6::from_fn(|r, c| if mask[r] && mask[c] { free[(r, c)] } else { 0.0 });
        // Rounding can hide a zero pivot; the variance is then far larger than the conditional one.
        let inflation = |k: usize| of_pose[(k, k)] * self.diagonals[first + k];
        if let Some(k) = (0..POSE_DIM).find(|k| mask[*k] && !(inflation(*k) < LARGEST_INFLATION)) {
            return Err(BundleError::Singular { pivot: first + k });
        }
        // c' = c − Rᵀ v.
        let world_from_cam = self.world_from_cam(pose);
        let center = world_from_cam * of_pose.fixed_view::<3, 3>(3, 3) * world_from_cam.transpose();
        Ok(PoseCovariance { pose: of_pose, center })
    }

    /// Rows of a camera's free intrinsics; `None` where none is free.
    pub fn rows_of_camera(&self, camera: usize) -> Option<Vec<usize>> {
        let first = match self.layout.intrinsics_use.get(camera)? {
            IntrinsicsUse::Fixed => return None,
            IntrinsicsUse::Shared(place) => self.layout.num_blocks() * self.dim + *place as usize * CAMERA_DIM,
            IntrinsicsUse::Fused => self.layout.block_of_camera(self.problem, camera)? * self.dim + POSE_DIM,
        };
        Some((first..first + self.layout.columns[camera].len).collect())
    }

    fn camera(&mut self, camera: usize) -> Result<Matrix6<f64>, BundleError> {
        let rows = self.rows_of_camera(camera).ok_or(BundleError::NoCovariance { what: "camera", index: camera })?;
        let (_, free) = self.inverse(&rows);
        let is_open = |k: &usize| !(free[(*k, *k)] > 0.0 && free[(*k, *k)].is_finite());
        if let Some(k) = (0..rows.len()).find(is_open) {
            return Err(BundleError::Singular { pivot: rows[k] });
        }
        // Derivatives of the six intrinsics by the free columns (eq. 4).
        let columns = self.layout.columns[camera];
        let mut intrinsics = Matrix6::zeros();
        for k in 0..columns.len {
            intrinsics[(columns.source[k], k)] = 1.0;
            if columns.source[k] == 0 {
                intrinsics[(1, k)] = columns.aspect;
            }
        }
        let of_columns = Matrix6::from_fn(|r, c| free.get((r, c)).copied().unwrap_or(0.0));
        Ok(intrinsics * of_columns * intrinsics.transpose())
    }
}
