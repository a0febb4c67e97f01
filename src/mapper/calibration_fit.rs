//! Agreement of a calibration with a model: residuals with the calibration held and with it adjusted.
//!
//! A calibration error of a percent deforms a map at residuals that are hardly larger, so the residuals alone do not
//! reveal it. With C_held and C_adjusted, ½ Σ ρ of the observations at the two minima, and correlated errors of the
//! observations ([`COMMON_ERROR_FACTOR`] F), the gain
//!
//! ```text
//! 2 (C_held − C_adjusted) / (F σ)²
//! ```
//!
//! is at most χ² with as many degrees of freedom as there are intrinsics, if the calibration is correct. The prior
//! determines the position of the second minimum, but is not part of its cost: it would hide an error of two of its
//! standard deviations.
//!
//! An error of a single parameter is diluted among five. Each of the focal length, the principal point and the first
//! distortion coefficient is therefore tested separately, too. With C the covariance of the adjusted intrinsics, P the
//! information of the prior, and δ the change of these parameters,
//!
//! ```text
//! δᵀ (C − C P C)⁻¹ δ
//! ```
//!
//! is χ² with as many degrees of freedom as δ has elements, if the calibration is correct. Parameters that the prior
//! determines more than the observations do are no evidence.

use nalgebra::{Matrix6, Vector6};

use super::focal_changes::{longest_tracks, noise, options, problem_of};
use super::{Intrinsics, intrinsics_prior};
use crate::bundle::{self, BundleError, COMMON_ERROR_FACTOR, CameraBlock, Problem, Wanted};
use crate::camera::Camera;
use crate::scene::{CameraId, Image, ImageId, Reconstruction};

/// Maximum number of adjusted views: those in the middle.
const MAX_VIEWS: usize = 200;
/// Minimum number of views.
const MIN_VIEWS: usize = 3;
/// Gain of five intrinsics at three standard deviations: chance exceeds it in 0.27 % of the cases.
const SIGNIFICANT: f64 = 18.2;
/// Groups of parameters that are tested separately, as indices among fx, fy, cx, cy, k1, k2, with their χ² at three
/// standard deviations: fx and fy are one focal length.
const GROUPS: [(&[usize], f64); 3] = [(&[0], 9.0), (&[2, 3], 11.8), (&[4], 9.0)];
/// Share of the prior's variance above which the prior determines a parameter more than the observations do.
const MAX_PRIOR_SHARE: f64 = 0.5;

/// Result of comparing a calibration with a model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibrationFit {
    /// Mean reprojection error with the calibration held, pixels.
    pub given_px: f64,
    /// Mean reprojection error with the calibration adjusted, pixels.
    pub adjusted_px: f64,
    /// Gain of the adjustment, χ²; see the module.
    pub gain: f64,
    /// Largest change of the focal length, the principal point or k1: χ² over the limit of each.
    pub change: f64,
    /// The adjusted camera.
    pub adjusted: Camera,
    /// Standard deviation of its focal length as a share of it.
    pub focal_std: f64,
}

impl CalibrationFit {
    /// Returns true if the calibration does not fit.
    pub fn is_bad(&self) -> bool {
        self.gain > SIGNIFICANT || self.change > 1.0
    }
}

/// Compares the calibration of a camera with a model; `None` if the model has too few views or points of this camera.
///
/// * `given` – the calibration.
/// * `known` – its standard deviations.
///
/// # Errors
/// Those of [`bundle::adjust`].
pub fn calibration_fit(
    model: &Reconstruction,
    id: CameraId,
    given: &Camera,
    known: Intrinsics,
) -> Result<Option<CalibrationFit>, BundleError> {
    let Some(here) = model.cameras.get(&id).filter(|_| model.can_project(id)) else { return Ok(None) };
    let problem = sample(model, id, here);
    if problem.poses.len() < MIN_VIEWS || problem.points.is_empty() {
        return Ok(None);
    }
    let adjusted = |block: CameraBlock, known: Option<Intrinsics>, sigma_px: f64| {
        let mut problem = problem.clone();
        let prior =
            known.map(|known| intrinsics_prior::about(given, known, &block.camera, COMMON_ERROR_FACTOR * sigma_px));
        problem.cameras = vec![block];
        problem.priors.intrinsics.extend(prior);
        let cost = bundle::adjust(&mut problem, &options(sigma_px))?.final_cost;
        Ok::<_, BundleError>((problem, cost))
    };
    let free = CameraBlock { camera: *here, free: known.may_change(), tie_focal: true };
    let (rough, _) = adjusted(free, Some(known), noise(&problem))?;
    let sigma_px = noise(&rough);
    let (freed, freed_cost) = adjusted(CameraBlock { camera: rough.cameras[0].camera, ..free }, Some(known), sigma_px)?;
    let (held, held_cost) = adjusted(CameraBlock::fixed(*given), None, sigma_px)?;
    let unit_px = COMMON_ERROR_FACTOR * sigma_px;
    let adjusted = freed.cameras[0].camera;
    let covariance = covariance(&freed, sigma_px).map(|covariance| unit_px.powi(2) * covariance);
    let focal_std = covariance.map(|covariance| covariance[(0, 0)].sqrt() / adjusted.focal[0]);
    Ok(Some(CalibrationFit {
        given_px: mean_error_px(&held),
        adjusted_px: mean_error_px(&freed),
        gain: 2.0 * (held_cost - freed_cost) / unit_px.powi(2) + prior_cost(given, known, &adjusted),
        change: covariance.map_or(0.0, |covariance| change(given, known, &adjusted, &covariance)),
        adjusted,
        focal_std: focal_std.filter(|std| std.is_finite()).unwrap_or(known.focal),
    }))
}

/// Cost of the prior at the adjusted camera, χ²: squared residuals in standard deviations of the prior.
fn prior_cost(given: &Camera, known: Intrinsics, adjusted: &Camera) -> f64 {
    let prior = intrinsics_prior::about(given, known, adjusted, 1.0);
    let residuals = adjusted.intrinsics().into_iter().zip(prior.values).zip(prior.sigma);
    residuals.map(|((value, mean), sigma)| ((value - mean) / sigma).powi(2)).sum()
}

/// Posterior covariance of the intrinsics if observations have a standard deviation of one pixel.
fn covariance(problem: &Problem, sigma_px: f64) -> Option<Matrix6<f64>> {
    let wanted = Wanted { cameras: vec![0], ..Wanted::default() };
    bundle::covariances(problem, &options(sigma_px), &wanted).ok()?.cameras.first().copied()
}

/// Largest change of a group of parameters, χ² over its limit; see the module.
///
/// * `covariance` – of the adjusted intrinsics.
fn change(given: &Camera, known: Intrinsics, adjusted: &Camera, covariance: &Matrix6<f64>) -> f64 {
    let change = Vector6::from(adjusted.intrinsics()) - Vector6::from(given.intrinsics());
    let information = |std: f64| if std > 0.0 { std.powi(-2) } else { 0.0 };
    let mut prior = Matrix6::from_diagonal(&Vector6::from(known.std_of(given).map(information)));
    // The tied focal length has one prior.
    prior[(1, 1)] = 0.0;
    let by_chance = covariance - covariance * prior * covariance;
    let is_observed = |k: &usize| covariance[(*k, *k)] * prior[(*k, *k)] < MAX_PRIOR_SHARE;
    let of_group = |(parameters, limit): &(&[usize], f64)| {
        let block = by_chance.select_rows(*parameters).select_columns(*parameters);
        let change = change.select_rows(*parameters);
        Some(change.dot(&block.cholesky()?.solve(&change)) / limit)
    };
    let observed = GROUPS.iter().filter(|(parameters, _)| parameters.iter().all(is_observed));
    observed.filter_map(of_group).filter(|change| change.is_finite()).fold(0.0, f64::max)
}

/// Samples the longest tracks in the middle views of a camera.
fn sample(model: &Reconstruction, id: CameraId, camera: &Camera) -> Problem {
    let all: Vec<(ImageId, &Image)> =
        model.images.iter().filter(|(_, image)| image.camera == id).map(|(id, image)| (*id, image)).collect();
    let first = all.len().saturating_sub(MAX_VIEWS) / 2;
    let views = &all[first..all.len().min(first + MAX_VIEWS)];
    let points = longest_tracks(model, camera, views.iter().map(|(_, image)| *image));
    Problem { cameras: vec![CameraBlock::fixed(*camera)], ..problem_of(model, views, &points, |_| true) }
}

fn mean_error_px(problem: &Problem) -> f64 {
    let errors: Vec<f64> = problem.errors_px().collect();
    errors.iter().sum::<f64>() / errors.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_of_one_parameter_is_significant() {
        let given = Camera::with_focal(960, 540, 900.0);
        let known = Intrinsics::GIVEN;
        // Posterior standard deviations of 0.3 % of the focal length, 2 px and 0.01.
        let std = Vector6::new(2.7, 2.7, 2.0, 2.0, 0.01, 0.01);
        let mut covariance = Matrix6::from_diagonal(&std.component_mul(&std));
        (covariance[(0, 1)], covariance[(1, 0)]) = (covariance[(0, 0)], covariance[(0, 0)]);
        let of = |factor: f64, center: f64, covariance: &Matrix6<f64>| {
            let adjusted =
                Camera { principal: [480.0 + center, 270.0], ..Camera::with_focal(960, 540, factor * 900.0) };
            change(&given, known, &adjusted, covariance)
        };
        assert_eq!(of(1.0, 0.0, &covariance), 0.0);
        assert!(of(1.006, 3.0, &covariance) < 1.0);
        assert!(of(1.012, 0.0, &covariance) > 1.5 && of(1.0, 9.0, &covariance) > 1.5);
        // Where the prior determines a parameter, its change is no evidence.
        covariance[(2, 2)] = 0.9 * (known.principal * 960.0).powi(2);
        assert_eq!(of(1.0, 9.0, &covariance), 0.0);
    }
}
