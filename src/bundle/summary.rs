//! Summary of an adjustment.

use serde::{Deserialize, Serialize};

/// Reason for the end of the iterations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Termination {
    /// A step changed the cost by less than the function tolerance: converged.
    FunctionTolerance,
    /// The gradient fell below its tolerance: converged.
    GradientTolerance,
    /// A step was shorter than the parameter tolerance: converged.
    ParameterTolerance,
    /// The maximum number of iterations was reached.
    MaxIterations,
    /// No damping gave a step that lowered the cost; the result is the best state found.
    NoProgress,
    /// No free parameter or no usable observation: the problem is unchanged.
    #[default]
    NothingToDo,
}

/// Result of an adjustment.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// ½ Σ ρ at the start, priors included.
    pub initial_cost: f64,
    /// ½ Σ ρ at the end.
    pub final_cost: f64,
    /// Steps tried, rejected ones included.
    pub iterations: usize,
    /// Steps that lowered the cost.
    pub accepted: usize,
    /// Reason for termination.
    pub termination: Termination,
    /// Number of observations used.
    pub num_residuals: usize,
    /// Number of ignored observations: point behind the camera, or projection not finite, at the start.
    pub num_ignored: usize,
    /// Number of used observations whose point is behind its camera at the end.
    pub num_behind: usize,
    /// Size of the reduced camera system.
    pub reduced_size: usize,
    /// Seconds to set up the structure.
    pub setup_s: f64,
    /// Seconds for residuals, Jacobians and the elimination of points.
    pub linearize_s: f64,
    /// Seconds to form the reduced system.
    pub schur_s: f64,
    /// Seconds to solve it.
    pub solve_s: f64,
    /// Seconds for trial steps and their costs.
    pub step_s: f64,
    /// Wall-clock seconds in all.
    pub total_s: f64,
}

impl Summary {
    /// Returns true if one of the tolerances ended the iterations.
    pub fn converged(&self) -> bool {
        !matches!(self.termination, Termination::MaxIterations | Termination::NoProgress)
    }
}
