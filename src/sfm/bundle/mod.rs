//! Bundle adjustment: camera poses, intrinsics and points that minimise the reprojection error.
//!
//! ```text
//! min ½ Σ ρ( ‖π(θ_c, T_i X_j) − u_ij‖² / σ_ij² )  +  priors
//! ```
//!
//! over the free poses T_i (`cam_from_world`), the free points X_j and the free intrinsics θ_c, by Levenberg–Marquardt.
//! Every step eliminates the points (Schur complement) and solves the remaining system by dense or sparse Cholesky, or
//! by conjugate gradients. `docs/maths/bundle.md` derives everything; its equation numbers are cited in the code.
//!
//! The same problem gives the same bytes at every number of threads as long as the reduced system is solved by one
//! thread (see [`Options::threads`]): work is cut in pieces that do not depend on the number of threads, and sums are taken
//! in a fixed order.
//!
//! Entry points: [`adjust`], [`covariance`].

mod covariance;
mod layout;
mod levenberg_marquardt;
mod linearize;
mod model;
mod options;
mod point;
mod priors;
mod problem;
mod residual;
mod schur;
mod simd;
mod solver;
mod state;
mod summary;

#[cfg(test)]
mod tests;

pub use covariance::{Covariance, covariance};
pub use levenberg_marquardt::adjust;
pub use options::{Behind, Gauge, LinearSolver, Options};
pub use problem::{
    BundleError, CameraBlock, IntrinsicsPrior, Observation, PointBlock, PoseBlock, PosePrior, Priors, Problem,
};
pub use summary::{Summary, Termination};
