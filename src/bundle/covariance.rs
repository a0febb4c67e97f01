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
        let mut system = System::new(problem, options, &layout, parallel, &Groups::default())?;
        Ok(Covariances {
            poses: wanted.poses.iter().map(|pose| system.pose(*pose)).collect::<Result<_, _>>()?,
            cameras: wanted.cameras.iter().map(|camera| system.camera(*camera)).collect::<Result<_, _>>()?,
        })
    })?
}

/// The normal equations without damping, eliminated and factorised.
pub(super) struct System<'a> {
    pub problem: &'a Problem,
    pub layout: &'a Layout,
    /// Number of unknowns, held ones included.
    pub size: usize,
    /// Freedoms of a view block.
    pub dim: usize,
    /// Diagonals of the views' own blocks.
    diagonals: Vec<f64>,
    solver: Solver,
    /// Scores of groups of points; see [`super::clustered`].
    pub scores: Vec<Vec<f64>>,
}

impl<'a> System<'a> {
    /// * `groups` – of points, with scores of their own.
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

    /// Columns of S⁻¹, one after the other, and its block of the rows that belong to them.
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

    /// View block of a pose, of which a freedom moves or a camera.
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
        // Rounding can hide a zero pivot; a variance so much larger than if all else were known betrays it.
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
        // How the six intrinsics follow from the free columns (eq. 4).
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
