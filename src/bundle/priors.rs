//! Priors on planes and intrinsics: small dense terms of the normal equations (eqs. 14–15). Those on points are in
//! [`super::layout::KnownPoint`].

use super::layout::{Columns, IntrinsicsUse, Layout, NONE};
use super::plane_prior;
use super::prior_terms::{PriorTarget, PriorTerms, empty};
use super::problem::{IntrinsicsPrior, Problem};
use super::state::State;
use crate::camera::NUM_INTRINSICS;

/// ½ Σ r² of all priors.
pub(super) fn cost(problem: &Problem, state: &State) -> f64 {
    let intrinsics: f64 = problem
        .priors
        .intrinsics
        .iter()
        .flat_map(|prior| intrinsics_residual(prior, &state.cameras[prior.camera].intrinsics()))
        .map(|r| r * r)
        .sum();
    let planes: f64 =
        problem.priors.planes.iter().map(|prior| plane_prior::cost(prior, &state.poses[prior.pose])).sum();
    0.5 * (intrinsics + planes)
}

/// Normal equations of all priors on free blocks.
pub(super) fn terms(problem: &Problem, layout: &Layout, state: &State) -> Vec<PriorTerms> {
    let mut out = Vec::new();
    for prior in &problem.priors.planes {
        let block = layout.block_of_pose[prior.pose];
        if block != NONE {
            let mut terms = plane_prior::terms(prior, &state.poses[prior.pose]);
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
                let Some(block) = layout.block_of_camera(problem, prior.camera) else { continue };
                terms.target = PriorTarget::Block(block);
                terms.offset = super::layout::POSE_DIM;
            }
        }
        out.push(terms);
    }
    out
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

fn intrinsics_residual(prior: &IntrinsicsPrior, values: &[f64; NUM_INTRINSICS]) -> [f64; NUM_INTRINSICS] {
    std::array::from_fn(|k| (values[k] - prior.values[k]) / prior.sigma[k])
}

/// Eq. 14.
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
