//! Kalman filter and Rauch–Tung–Striebel smoother over a chain of states (H. Rauch, F. Tung, C. Striebel, *Maximum
//! likelihood estimates of linear dynamic systems*, AIAA Journal 3, 1965).

use nalgebra::{DMatrix, DVector};

/// Mean and covariance.
#[derive(Clone, Debug)]
pub(super) struct Gaussian {
    pub(super) mean: DVector<f64>,
    pub(super) covariance: DMatrix<f64>,
}

/// Transition to a state, and the model of its observation.
#[derive(Clone, Debug)]
pub(super) struct Step {
    /// Transition from the previous state; not used in the first step.
    pub(super) transition: DMatrix<f64>,
    /// Covariance of the process noise.
    pub(super) process: DMatrix<f64>,
    /// Observation matrix.
    pub(super) observation: DMatrix<f64>,
    /// Covariance of the observation.
    pub(super) noise: DMatrix<f64>,
}

/// Smoothed states.
#[derive(Clone, Debug)]
pub(super) struct Smoothed {
    pub(super) states: Vec<Gaussian>,
    /// Smoother gains G_k, one fewer than states: Cov(x_k, x_{k+1}) = G_k Cov(x_{k+1}).
    pub(super) gains: Vec<DMatrix<f64>>,
}

/// States of the forward pass.
struct Filtered {
    predicted: Vec<Gaussian>,
    updated: Vec<Gaussian>,
    log_likelihood: f64,
}

fn filter(first: &Gaussian, steps: &[Step], observed: &[DVector<f64>]) -> Option<Filtered> {
    let mut found = Filtered { predicted: Vec::new(), updated: Vec::new(), log_likelihood: 0.0 };
    let mut state = first.clone();
    for (k, (step, seen)) in steps.iter().zip(observed).enumerate() {
        if k > 0 {
            state = Gaussian {
                mean: &step.transition * &state.mean,
                covariance: &step.transition * &state.covariance * step.transition.transpose() + &step.process,
            };
        }
        found.predicted.push(state.clone());
        let innovation = seen - &step.observation * &state.mean;
        let spread = &step.observation * &state.covariance * step.observation.transpose() + &step.noise;
        let cholesky = spread.cholesky()?;
        let half = &step.observation * &state.covariance;
        let gain = cholesky.solve(&half).transpose();
        // The first observations determine the diffuse initial state, and do not contribute to the likelihood.
        if k >= 3 {
            let determinant: f64 = cholesky.l_dirty().diagonal().iter().map(|d| 2.0 * d.ln()).sum();
            found.log_likelihood -= 0.5 * (innovation.dot(&cholesky.solve(&innovation)) + determinant);
        }
        let covariance = &state.covariance - &gain * half;
        let symmetric = (&covariance + covariance.transpose()) * 0.5;
        state = Gaussian { mean: &state.mean + gain * innovation, covariance: symmetric };
        found.updated.push(state.clone());
    }
    found.log_likelihood.is_finite().then_some(found)
}

/// Logarithm of the likelihood of the observations, up to a constant.
pub(super) fn log_likelihood(first: &Gaussian, steps: &[Step], observed: &[DVector<f64>]) -> Option<f64> {
    filter(first, steps, observed).map(|found| found.log_likelihood)
}

/// States given all observations; `None` if a covariance is not positive definite by rounding.
pub(super) fn smooth(first: &Gaussian, steps: &[Step], observed: &[DVector<f64>]) -> Option<Smoothed> {
    let Filtered { predicted, mut updated, .. } = filter(first, steps, observed)?;
    let mut gains = Vec::new();
    for k in (0..updated.len().saturating_sub(1)).rev() {
        let ahead = &predicted[k + 1];
        let cross = &steps[k + 1].transition * &updated[k].covariance;
        let gain = ahead.covariance.clone().cholesky()?.solve(&cross).transpose();
        let mean = &updated[k].mean + &gain * (&updated[k + 1].mean - &ahead.mean);
        let covariance =
            &updated[k].covariance + &gain * (&updated[k + 1].covariance - &ahead.covariance) * gain.transpose();
        updated[k] = Gaussian { mean, covariance: (&covariance + covariance.transpose()) * 0.5 };
        gains.push(gain);
    }
    gains.reverse();
    let is_finite = |g: &Gaussian| g.mean.iter().chain(g.covariance.iter()).all(|x| x.is_finite());
    updated.iter().all(is_finite).then_some(Smoothed { states: updated, gains })
}
