//! Bundle adjustment: camera poses, intrinsics and points that minimize the reprojection error.
//!
//! ```text
//! min ½ Σ ρ( ‖π(θ_c, T_i X_j) − u_ij‖² / σ_ij² )  +  priors
//! ```
//!
//! over the free poses T_i (`cam_from_world`), the free points X_j and the free intrinsics θ_c, by Levenberg–Marquardt.
//! Every step eliminates the points (Schur complement), or the views where points are few, and solves the rest by dense
//! or sparse Cholesky. `docs/maths/bundle.md` derives everything; its equation numbers are cited in the code.
//!
//! The same problem gives the same bytes at every number of threads, because work is split independently of the number
//! of threads and sums are taken in a fixed order. The exception is a large dense reduced system, which several threads
//! factorize.
//!
//! Entry points: [`adjust`], [`covariances`], [`center_deviations`].
//!
//! ```
//! use tractrix::bundle::{CameraBlock, Options, Problem, adjust};
//! use tractrix::io::interchange::colmap;
//!
//! let mut model = colmap::read("tests/golden/models/colmap_text".as_ref())?;
//! let mut problem = Problem::from_reconstruction(&model, |_, camera| CameraBlock::fixed(*camera));
//! let summary = adjust(&mut problem, &Options::default())?;
//! assert!(summary.converged() && summary.final_cost < summary.initial_cost);
//! problem.store(&mut model);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod accumulate;
mod camera_sums;
mod clustered;
mod coupling;
mod covariance;
mod intrinsics_share;
mod kept;
mod layout;
mod levenberg_marquardt;
mod linearize;
mod model;
mod one_point;
mod options;
mod parallel;
mod pattern;
mod piece;
mod plane_prior;
mod point;
mod prior_terms;
mod priors;
mod problem;
mod residual;
mod schur;
mod simd;
mod solver;
mod state;
mod summary;
mod ties;
mod trial;
mod uncertainty;
mod whitening;

#[cfg(test)]
mod tests;

pub use covariance::{Covariances, PoseCovariance, Wanted, covariances};
pub use levenberg_marquardt::adjust;
pub use options::{Behind, Gauge, LinearSolver, Options};
pub use problem::{
    BundleError, CameraBlock, IntrinsicsPrior, Observation, PlanePrior, PointBlock, PointPrior, PoseBlock, Priors,
    Problem,
};
pub use summary::{Summary, Termination};
pub use uncertainty::{COMMON_ERROR_FACTOR, CenterDeviations, center_deviations};
pub use whitening::Whitening;
