//! Focal lengths from the motion and their priors, with standard deviations.
//!
//! The posterior of the focal length combines the observations and a prior about the initial value. Both are terms of
//! the same cost: under weak motion the estimate stays near the initial value, under strong motion the prior has hardly
//! any influence.
//!
//! *Evidence of the observations.* The focal length is fixed at f e^(± δ), and everything else is adjusted (a profile
//! of the cost). With C(δ) = ½ Σ ρ, the curvature is H = (C(δ) + C(−δ) − 2 C(0)) / δ². The points p of a group g, whose
//! errors may be correlated, have the slope s_g = Σ_p (C_p(δ) − C_p(−δ)) / 2 δ. If errors are independent between
//! groups, the standard deviation of ln f is √(Σ s_g²) / H (the sandwich estimator of P. Huber, *The behavior of
//! maximum likelihood estimates under nonstandard conditions*, 1967, for the profile). This holds for any common error
//! within a group, such as a drifting track or a distorted part of the image.

use super::adjustment::{self, Freedom, Scope, Segment};
use super::intrinsics_prior::off_initial;
use super::map::Map;
use super::windows::{self, IntrinsicsEvidence};
use super::{Noise, Options};
use crate::bundle::{self, COMMON_ERROR_FACTOR, Problem};
use crate::mapper::MapperError;
use crate::math::{RobustLoss, bin};

/// Minimum noise, pixels: that of exact tracks is rounding.
const MIN_SIGMA_PX: f64 = 1e-6;

/// Evidence of the observations for the focal length.
#[derive(Clone, Copy, Debug)]
pub(super) struct FocalEvidence {
    /// Standard deviation of ln f if the errors of all observations are correlated ([`COMMON_ERROR_FACTOR`]); infinite
    /// if the motion does not determine it.
    pub fully_correlated: f64,
    /// Standard deviation of ln f if errors are correlated within groups only (the sandwich estimator above).
    group_correlated: f64,
    /// Change of ln f from its present value to the minimum of the sampled observations with the prior.
    shift: f64,
}

impl FocalEvidence {
    /// Posterior standard deviation of ln f with a prior of standard deviation `prior_std`.
    ///
    /// Errors that groups have in common do not appear in the sandwich estimate; a factor of two covers them on the
    /// sequences of docs/benchmarks/focal-length.md. Beyond a factor of e the focal length is unknown.
    pub fn std(&self, prior_std: f64) -> f64 {
        let information = (2.0 * self.group_correlated).powi(-2) + prior_std.powi(-2);
        information.sqrt().recip().hypot(self.shift).min(1.0)
    }
}

/// Camera with the most registered views among those whose intrinsics are adjusted.
pub(super) fn leading_camera(map: &Map<'_>) -> Option<usize> {
    let counts = map.num_views_of_cameras();
    map.unknown_cameras().max_by_key(|&camera| (counts[camera], usize::MAX - camera))
}

/// Cameras whose focal length gets a standard deviation.
///
/// Of those with an adjusted focal length and registered views: the first camera, and those with the most views, as
/// many as cost no more than the last adjustments do.
pub(super) fn evaluated_cameras(map: &Map<'_>) -> Vec<usize> {
    let counts = map.num_views_of_cameras();
    let is_evaluated = |&camera: &usize| counts[camera] > 0 && map.known.of(camera).focal > 0.0;
    let mut evaluated: Vec<usize> = map.unknown_cameras().filter(is_evaluated).collect();
    evaluated.sort_by_key(|&camera| (camera > 0, usize::MAX - counts[camera], camera));
    // Photographs come from one or two cameras; more would multiply the cost of the last adjustment.
    evaluated.truncate(8);
    evaluated
}

/// Evaluates the evidence for the focal length of a camera, or for a common factor of those of several cameras.
///
/// The focal lengths are fixed on both sides of their values, and everything else is adjusted.
///
/// * `freedom` – the other intrinsics that are adjusted.
pub(super) fn focal_evidence(
    map: &Map<'_>,
    evaluated: &[usize],
    freedom: Freedom,
    sigma_px: f64,
    options: &Options,
) -> Result<FocalEvidence, MapperError> {
    // Change of ln f: above the noise of a converged cost, within the range where the cost is quadratic.
    const CHANGE: f64 = 0.03;
    let sigma_px = sigma_px.max(MIN_SIGMA_PX);
    let undetermined = FocalEvidence { fully_correlated: f64::INFINITY, group_correlated: f64::INFINITY, shift: 0.0 };
    let Some(&first) = evaluated.first() else { return Ok(undetermined) };
    let probe = Probe::new(map, sigma_px, options);
    let held = |change: f64| {
        probe.adjusted(map, freedom, &|trial| {
            // The priors of the other focal lengths stay.
            trial.priors.intrinsics.retain(|prior| !evaluated.contains(&prior.camera));
            for &camera in evaluated {
                let block = &mut trial.cameras[camera];
                block.camera.focal = block.camera.focal.map(|f| f * change.exp());
                (block.free[0], block.free[1]) = (false, false);
            }
        })
    };
    let (less, here, more) = (held(-CHANGE)?, held(0.0)?, held(CHANGE)?);
    let curvature = (more.cost + less.cost - 2.0 * here.cost) / CHANGE.powi(2);
    if !(curvature > 0.0 && curvature.is_finite()) {
        return Ok(undetermined);
    }
    let slope = (more.cost - less.cost) / (2.0 * CHANGE);
    let weight = (COMMON_ERROR_FACTOR * sigma_px).powi(-2);
    let off = off_initial(&map.cameras[first], &map.guess[first]);
    let stiffness = map.known.of(first).focal.powi(-2);
    let pulls = more.by_group.iter().zip(&less.by_group).map(|(more, less)| (more - less) / (2.0 * CHANGE));
    // The remaining slope is that of the prior and the shift, not of single groups.
    let mean = slope / NUM_GROUPS as f64;
    let spread: f64 = pulls.map(|pull| (pull - mean).powi(2)).sum();
    Ok(FocalEvidence {
        fully_correlated: COMMON_ERROR_FACTOR * sigma_px / curvature.sqrt(),
        group_correlated: spread.sqrt() / curvature,
        shift: -(weight * slope + stiffness * off) / (weight * curvature + stiffness),
    })
}

/// Standard deviation of ln f of a camera if all errors are correlated, from the normal equations at the present map.
///
/// It is the linear approximation of [`focal_evidence`], which adjusts three times. Infinite if the motion does not
/// determine it.
pub(super) fn linearized_focal_std(
    map: &Map<'_>,
    camera: usize,
    sigma_px: f64,
    options: &Options,
) -> Result<f64, MapperError> {
    let sigma_px = sigma_px.max(MIN_SIGMA_PX);
    let probe = Probe::new(map, sigma_px, options);
    let bundle_options = bundle::Options { loss: options.loss(probe.noise), ..bundle::Options::default() };
    let mut evidence: Option<IntrinsicsEvidence> = None;
    for (scope, _) in &probe.parts {
        let mut problem = adjustment::build(map, scope, Freedom::FocalAndRadial, probe.noise, options);
        problem.priors.intrinsics.retain(|prior| prior.camera != camera);
        evidence.get_or_insert_with(|| IntrinsicsEvidence::none(camera, &problem)).add(&problem, &bundle_options)?;
    }
    let std_px = evidence.and_then(|evidence| evidence.first_std()).unwrap_or(f64::INFINITY);
    Ok(COMMON_ERROR_FACTOR * sigma_px * std_px / map.cameras[camera].mean_focal())
}

/// Gain of the first distortion coefficient as the only one, in units of the common errors squared.
pub(super) fn first_radial_gain(map: &Map<'_>, sigma_px: f64, options: &Options) -> Result<f64, MapperError> {
    let probe = Probe::new(map, sigma_px, options);
    let without_radial = |trial: &mut Problem| {
        trial.priors.intrinsics.clear();
        let adjusted = trial.cameras.iter_mut().zip(&map.guess).filter(|(block, _)| block.free[0]);
        adjusted.for_each(|(block, guess)| block.camera.radial = guess.radial);
    };
    let cost = |freedom| Ok::<_, MapperError>(probe.adjusted(map, freedom, &without_radial)?.cost);
    let gain = cost(Freedom::Focal)? - cost(Freedom::FocalAndFirstRadial)?;
    Ok(2.0 * gain / (COMMON_ERROR_FACTOR * sigma_px).powi(2))
}

/// Trial adjustments of a sample of points in every part of every view.
struct Probe<'a> {
    /// The whole map, or the segments of a long video, each with its beginning and length as shares of the whole.
    parts: Vec<(Scope, [f64; 2])>,
    noise: Noise,
    options: &'a Options,
}

/// A problem after adjustment.
struct Adjusted {
    /// ½ Σ ρ.
    cost: f64,
    /// ½ Σ ρ by group of points.
    by_group: Vec<f64>,
}

/// Groups of points: columns and rows of the image, and intervals of time.
const GROUPS: [usize; 3] = [4, 3, 4];
/// Number of groups of points.
const NUM_GROUPS: usize = GROUPS[0] * GROUPS[1] * GROUPS[2];

impl<'a> Probe<'a> {
    fn new(map: &Map<'_>, sigma_px: f64, options: &'a Options) -> Self {
        let length = map.poses.len().max(1) as f64;
        let in_time = |segment: Segment| {
            let time = [segment.views.start, segment.views.len()].map(|views| views as f64 / length);
            (Scope::Segment(segment), time)
        };
        let parts = match windows::is_long(map, options) {
            true => windows::disjoint_segments(map).into_iter().map(in_time).collect(),
            false => vec![(Scope::Selected, [0.0, 1.0])],
        };
        Self { parts, noise: Some(sigma_px), options }
    }

    /// Costs of all parts after adjustment, where `change` modifies each problem before it.
    fn adjusted(
        &self,
        map: &Map<'_>,
        freedom: Freedom,
        change: &dyn Fn(&mut Problem),
    ) -> Result<Adjusted, MapperError> {
        let loss = self.options.loss(self.noise);
        let bundle_options =
            bundle::Options { loss, max_iterations: 20, function_tolerance: 1e-5, ..bundle::Options::default() };
        let mut total = Adjusted { cost: 0.0, by_group: vec![0.0; NUM_GROUPS] };
        for (scope, time) in &self.parts {
            let mut problem = adjustment::build(map, scope, freedom, self.noise, self.options);
            change(&mut problem);
            total.cost += bundle::adjust(&mut problem, &bundle_options)?.final_cost;
            add_costs_by_group(&problem, loss, *time, &mut total.by_group);
        }
        Ok(total)
    }
}

/// Adds ½ Σ ρ of the points of each group; a point is in the group of the mean position of its observations.
fn add_costs_by_group(problem: &Problem, loss: RobustLoss, [start, length]: [f64; 2], costs: &mut [f64]) {
    let mut points = vec![(0.0, [0.0; 3], 0.0); problem.points.len()];
    for o in &problem.observations {
        let camera = &problem.cameras[problem.poses[o.pose as usize].camera].camera;
        let (cost, position, count) = &mut points[o.point as usize];
        *cost += 0.5 * loss.evaluate(o.whitening.norm_sq(problem.residual_px(o)))[0];
        *count += 1.0;
        let [width, height] = [camera.width, camera.height].map(f64::from);
        let time = start + length * f64::from(o.pose) / problem.poses.len() as f64;
        let at = [o.pixel.x / width, o.pixel.y / height, time];
        position.iter_mut().zip(at).for_each(|(sum, at)| *sum += at);
    }
    for (cost, position, count) in points.into_iter().filter(|(cost, ..)| cost.is_finite()) {
        let cell = |k: usize| bin(position[k] / f64::max(count, 1.0), GROUPS[k]);
        costs[(cell(2) * GROUPS[1] + cell(1)) * GROUPS[0] + cell(0)] += cost;
    }
}
