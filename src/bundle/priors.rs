//! Priors on poses and intrinsics: small dense terms of the normal equations (eqs. 14–15). Those on points are in
//! [`super::layout::KnownPoint`].

use nalgebra::{Matrix3, Vector3};

use super::layout::{Columns, IntrinsicsUse, Layout, NONE};
use super::plane_prior;
use super::prior_terms::{PriorTarget, PriorTerms, empty};
use super::problem::{IntrinsicsPrior, PosePrior, Problem};
use super::state::State;
use crate::camera::NUM_INTRINSICS;
use crate::math::Rigid3;

/// ½ Σ r² of all priors.
pub(super) fn cost(problem: &Problem, state: &State) -> f64 {
    let poses: f64 = problem
        .priors
        .poses
        .iter()
        .map(|prior| {
            let (rotation, center) = pose_residual(prior, &state.poses[prior.pose]);
            prior.loss.evaluate(rotation.norm_squared())[0] + prior.loss.evaluate(center.norm_squared())[0]
        })
        .sum();
    let intrinsics: f64 = problem
        .priors
        .intrinsics
        .iter()
        .flat_map(|prior| intrinsics_residual(prior, &state.cameras[prior.camera].intrinsics()))
        .map(|r| r * r)
        .sum();
    let planes: f64 =
        problem.priors.planes.iter().map(|prior| plane_prior::cost(prior, &state.poses[prior.pose])).sum();
    0.5 * (poses + intrinsics + planes)
}

/// Normal equations of all priors on blocks that move.
pub(super) fn terms(problem: &Problem, layout: &Layout, state: &State) -> Vec<PriorTerms> {
    let mut out = Vec::new();
    let of_poses = problem.priors.poses.iter().map(|prior| (prior.pose, pose_terms(prior, &state.poses[prior.pose])));
    let of_planes =
        problem.priors.planes.iter().map(|prior| (prior.pose, plane_prior::terms(prior, &state.poses[prior.pose])));
    for (pose, mut terms) in of_poses.chain(of_planes) {
        let block = layout.block_of_pose[pose];
        if block != NONE {
            terms.target = PriorTarget::Block(block as usize);
            hold(&mut terms, &layout.pose_mask[block as usize]);
            out.push(terms);
        }
    }
    for prior in &problem.priors.intrinsics {
        let columns = &layout.columns[prior.camera];
        let mut terms = intrinsics_terms(prior, columns, &state.cameras[prior.camera].intrinsics());
        match layout.intrinsics_use[prior.camera] {
            IntrinsicsUse::Fixed => continue,
            IntrinsicsUse::Shared(place) => terms.target = PriorTarget::Shared(place as usize),
            IntrinsicsUse::Fused => {
                let Some(block) = block_of_camera(problem, layout, prior.camera) else { continue };
                terms.target = PriorTarget::Block(block);
                terms.offset = super::layout::POSE_DIM;
            }
        }
        out.push(terms);
    }
    out
}

fn block_of_camera(problem: &Problem, layout: &Layout, camera: usize) -> Option<usize> {
    layout.pose_of_block.iter().position(|pose| problem.poses[*pose as usize].camera == camera)
}

fn hold(terms: &mut PriorTerms, mask: &[bool; 6]) {
    for k in (0..6).filter(|k| !mask[*k]) {
        terms.gradient[k] = 0.0;
        for j in 0..6 {
            terms.hessian[k][j] = 0.0;
            terms.hessian[j][k] = 0.0;
        }
    }
}

/// log(R R₀ᵀ) / σ_R and (c − c₀) / σ_c.
pub(super) fn pose_residual(prior: &PosePrior, cam_from_world: &Rigid3) -> (Vector3<f64>, Vector3<f64>) {
    let turn = cam_from_world.rotation * prior.cam_from_world.rotation.inverse();
    let center = cam_from_world.center() - prior.cam_from_world.center();
    (turn.scaled_axis() / prior.sigma_rotation, center.component_div(&prior.sigma_center))
}

/// ∂ of the rotation residual by ω, and of the centre residual by v (eq. 14).
pub(super) fn pose_jacobians(prior: &PosePrior, cam_from_world: &Rigid3) -> (Matrix3<f64>, Matrix3<f64>) {
    let turn = (cam_from_world.rotation * prior.cam_from_world.rotation.inverse()).scaled_axis();
    let center = -cam_from_world.rotation.inverse().to_rotation_matrix().into_inner();
    let weight = Matrix3::from_diagonal(&prior.sigma_center.map(f64::recip));
    (inverse_left_jacobian(&turn) / prior.sigma_rotation, weight * center)
}

/// d log(exp(ω) R) / dω at ω = 0 for log R = φ: I − [φ]ₓ/2 + (1/θ² − (1 + cos θ)/(2 θ sin θ)) [φ]ₓ².
fn inverse_left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
    let theta = phi.norm();
    let cross = phi.cross_matrix();
    let factor = if theta < 1e-4 {
        1.0 / 12.0
    } else {
        1.0 / (theta * theta) - (1.0 + theta.cos()) / (2.0 * theta * theta.sin())
    };
    let factor = if factor.is_finite() { factor } else { 0.0 };
    Matrix3::identity() - cross * 0.5 + cross * cross * factor
}

fn pose_terms(prior: &PosePrior, pose: &Rigid3) -> PriorTerms {
    let (rotation, center) = pose_residual(prior, pose);
    let (d_rotation, d_center) = pose_jacobians(prior, pose);
    let mut terms = empty();
    for (first, residual, jacobian) in [(0, rotation, d_rotation), (3, center, d_center)] {
        let weight = prior.loss.evaluate(residual.norm_squared())[1];
        let hessian = jacobian.transpose() * jacobian * weight;
        let gradient = jacobian.transpose() * residual * weight;
        for i in 0..3 {
            terms.gradient[first + i] = gradient[i];
            for j in 0..3 {
                terms.hessian[first + i][first + j] = hessian[(i, j)];
            }
        }
    }
    terms
}

fn intrinsics_residual(prior: &IntrinsicsPrior, values: &[f64; NUM_INTRINSICS]) -> [f64; NUM_INTRINSICS] {
    std::array::from_fn(|k| (values[k] - prior.values[k]) / prior.sigma[k])
}

/// Eq. 15.
fn intrinsics_terms(prior: &IntrinsicsPrior, columns: &Columns, values: &[f64; NUM_INTRINSICS]) -> PriorTerms {
    let residual = intrinsics_residual(prior, values);
    let mut terms = empty();
    for (k, source) in columns.source[..columns.len].iter().enumerate() {
        let mut add = |parameter: usize, slope: f64| {
            let d = slope / prior.sigma[parameter];
            terms.hessian[k][k] += d * d;
            terms.gradient[k] += d * residual[parameter];
        };
        add(*source, 1.0);
        if *source == 0 && columns.aspect != 0.0 {
            add(1, columns.aspect);
        }
    }
    terms
}
