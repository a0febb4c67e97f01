//! Options of an adjustment.

use serde::{Deserialize, Serialize};

use super::BundleError;
use crate::math::RobustLoss;

/// Solver of the reduced camera system.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum LinearSolver {
    /// Dense for few cameras or where most pairs of cameras see common points, sparse otherwise.
    #[default]
    Auto,
    /// Dense Cholesky.
    Dense,
    /// Sparse supernodal Cholesky: in the order of the poses where that is a band (video), else in AMD order.
    Sparse,
}

/// Treatment of the seven gauge degrees of freedom (rotation, translation, scale), which images do not determine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Gauge {
    /// Minimal constraints: if no pose is fixed, the first one is held. If fewer than two poses and no points are
    /// fixed, the distance between the centers of the held pose and of the pose farthest from it is held, too.
    #[default]
    Auto,
    /// No constraints beyond the blocks marked as fixed; the damping keeps the system regular (as in Ceres).
    Free,
}

/// Treatment of an observation whose point lies behind its camera at the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Behind {
    /// Ignored, and counted in [`super::Summary::num_ignored`].
    #[default]
    Ignore,
    /// Used, with its projection through the center (as in the BAL benchmark).
    Project,
}

/// Options of [`super::adjust`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Robust loss on the residual's length, in units of the observations' standard deviation.
    pub loss: RobustLoss,
    /// Maximum number of steps tried, rejected ones included.
    pub max_iterations: usize,
    /// Stop when a step changes the cost by less than this fraction of it.
    pub function_tolerance: f64,
    /// Stop when the largest entry of the gradient is below this (cost per radian, unit of length, or intrinsic).
    pub gradient_tolerance: f64,
    /// Stop when a step is shorter than this fraction of the norm of all parameters.
    pub parameter_tolerance: f64,
    /// Initial damping λ, relative to the diagonal of the normal equations. A small value trusts the first step.
    pub initial_damping: f64,
    /// Threads; 0 uses the rayon pool of the caller.
    pub threads: usize,
    /// Solver of the reduced camera system.
    pub linear_solver: LinearSolver,
    /// Choice of the gauge.
    pub gauge: Gauge,
    /// True to fix all camera rotations.
    pub hold_rotations: bool,
    /// Treatment of points behind a camera at the start.
    pub behind: Behind,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            loss: RobustLoss::Squared,
            max_iterations: 50,
            function_tolerance: 1e-6,
            gradient_tolerance: 1e-10,
            parameter_tolerance: 1e-8,
            initial_damping: 1e-4,
            threads: 0,
            linear_solver: LinearSolver::Auto,
            gauge: Gauge::Auto,
            hold_rotations: false,
            behind: Behind::Ignore,
        }
    }
}

impl Options {
    /// Rejects invalid values.
    ///
    /// # Errors
    /// [`BundleError::Option`] names the field.
    pub fn check(&self) -> Result<(), BundleError> {
        let fields = [
            ("function_tolerance", self.function_tolerance, self.function_tolerance >= 0.0),
            ("gradient_tolerance", self.gradient_tolerance, self.gradient_tolerance >= 0.0),
            ("parameter_tolerance", self.parameter_tolerance, self.parameter_tolerance >= 0.0),
            ("initial_damping", self.initial_damping, self.initial_damping > 0.0 && self.initial_damping.is_finite()),
        ];
        for (name, value, good) in fields {
            if !good {
                return Err(BundleError::Option { name, value });
            }
        }
        match self.loss {
            RobustLoss::Huber { scale } | RobustLoss::Cauchy { scale } | RobustLoss::SoftL1 { scale }
                if !(scale > 0.0 && scale.is_finite()) =>
            {
                Err(BundleError::Option { name: "loss.scale", value: scale })
            }
            _ => Ok(()),
        }
    }
}
