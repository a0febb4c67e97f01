//! Prior on a pose: a plane known in the camera frame passes through a world point, and is level there (eq. 15).

use nalgebra::{Matrix3, RowVector3, Vector3};

use super::prior_terms::{PriorTerms, empty};
use super::problem::PlanePrior;
use crate::math::Rigid3;

impl PlanePrior {
    /// Residuals of distance and tilt in standard deviations: (n · (R p + t) + h) / σ_d and n × R u / σ_t.
    pub fn residual(&self, cam_from_world: &Rigid3) -> (f64, Vector3<f64>) {
        let distance = self.normal_in_cam.dot(&(*cam_from_world * self.point).coords) + self.camera_height;
        let tilt = self.normal_in_cam.cross(&(cam_from_world.rotation * self.up));
        (distance / self.sigma_distance, tilt / self.sigma_tilt)
    }
}

/// ∂ of the distance by ω and v, and of the tilt by ω.
pub(super) fn jacobians(
    prior: &PlanePrior,
    cam_from_world: &Rigid3,
) -> (RowVector3<f64>, RowVector3<f64>, Matrix3<f64>) {
    let n = prior.normal_in_cam;
    // p' = exp(ω) p + v: n · (ω × p) = (p × n) · ω.
    let by_turn = (*cam_from_world * prior.point).coords.cross(&n).transpose() / prior.sigma_distance;
    let up = cam_from_world.rotation * prior.up;
    (by_turn, n.transpose() / prior.sigma_distance, -n.cross_matrix() * up.cross_matrix() / prior.sigma_tilt)
}

/// Σ ρ of the two residuals.
pub(super) fn cost(prior: &PlanePrior, cam_from_world: &Rigid3) -> f64 {
    let (distance, tilt) = prior.residual(cam_from_world);
    prior.loss.evaluate(distance * distance)[0] + prior.loss.evaluate(tilt.norm_squared())[0]
}

/// H and g, weighted by ρ'.
pub(super) fn terms(prior: &PlanePrior, cam_from_world: &Rigid3) -> PriorTerms {
    let (distance, tilt) = prior.residual(cam_from_world);
    let (by_turn, by_shift, tilt_by_turn) = jacobians(prior, cam_from_world);
    let weight = prior.loss.evaluate(distance * distance)[1];
    let tilt_weight = prior.loss.evaluate(tilt.norm_squared())[1];
    let mut terms = empty();
    let row: [f64; 6] = std::array::from_fn(|k| if k < 3 { by_turn[k] } else { by_shift[k - 3] });
    for i in 0..6 {
        terms.gradient[i] = weight * row[i] * distance;
        for j in 0..6 {
            terms.hessian[i][j] = weight * row[i] * row[j];
        }
    }
    let hessian = tilt_by_turn.transpose() * tilt_by_turn * tilt_weight;
    let gradient = tilt_by_turn.transpose() * tilt * tilt_weight;
    for i in 0..3 {
        terms.gradient[i] += gradient[i];
        for j in 0..3 {
            terms.hessian[i][j] += hessian[(i, j)];
        }
    }
    terms
}
