//! Summary of an adjustment.

use serde::{Deserialize, Serialize};

/// Why the iterations ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Termination {
    /// A step changed the cost by less than the function tolerance: converged.
    FunctionTolerance,
    /// The gradient fell below its tolerance: converged.
    GradientTolerance,
    /// A step was shorter than the parameter tolerance: converged.
    ParameterTolerance,
    /// The iterations ran out first.
    MaxIterations,
    /// No damping gave a step that lowered the cost; the result is the best state seen.
    NoProgress,
    /// Nothing is free, or nothing usable is observed: the problem is unchanged.
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
    /// Why it ended.
    pub termination: Termination,
    /// Observations used.
    pub num_residuals: usize,
    /// Observations left out: their point lay behind the camera, or its projection was not finite, at the start.
    pub num_ignored: usize,
    /// Used observations whose point lies behind its camera at the end.
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
