//! Intrinsics from the motion, with their priors.
//!
//! The focal length of a map has a posterior: what the observations tell, and a prior round the guess. Both are terms
//! of the same sum, so that a weak motion ends near the guess and a strong one does not feel it.
//!
//! *What the observations tell.* A focal length f e^(± δ) is held, and everything else is adjusted to it (a profile of
//! the cost). With C(δ) = ½ Σ ρ, the curvature is H = (C(δ) + C(−δ) − 2 C(0)) / δ², and the points p, in groups g
//! that may err together, each pull with s_g = Σ_p (C_p(δ) − C_p(−δ)) / 2 δ. Were errors independent from group to
//! group, the deviation of ln f would be √(Σ s_g²) / H (the sandwich of P. Huber, *The behavior of maximum likelihood
//! estimates under nonstandard conditions*, 1967, for the profile). It is so whatever the errors within a group have in
//! common: that a track slides, that a part of the picture is bent.

use super::adjustment::{self, Freedom, Scope, Stretch};
use super::intrinsics_prior::off_initial;
use super::map::Map;
use super::windows::{self, LensEvidence};
use super::{Noise, Options};
use crate::bundle::{self, COMMON_ERROR_FACTOR, Problem};
use crate::mapper::MapperError;
use crate::math::{RobustLoss, bin};

/// Less noise is rounding, of tracks without any.
const MIN_SIGMA_PX: f64 = 1e-6;

/// Focal length by the observations alone.
#[derive(Clone, Copy, Debug)]
pub(super) struct FocalEvidence {
    /// Standard deviation of ln f if all observations err together ([`COMMON_ERROR_FACTOR`]); infinite where the motion
    /// leaves it open.
    pub together: f64,
    /// The same if they err together within groups only (the sandwich above).
    in_groups: f64,
    /// Shift of ln f that the used observations, some in every part of every view, would cause from its present value;
    /// with the prior.
    shift: f64,
}

impl FocalEvidence {
    /// Standard deviation of ln f with what is known beforehand (deviation `guess`).
    ///
    /// Errors that groups have in common with one another do not show in the sandwich; a factor of two covers them on
    /// the sequences of docs/benchmarks/focal-length.md. Beyond a factor of e nothing is known at all.
    pub fn deviation(&self, guess: f64) -> f64 {
        let information = (2.0 * self.in_groups).powi(-2) + guess.powi(-2);
        information.sqrt().recip().hypot(self.shift).min(1.0)
    }
}

/// Of the cameras that are looked for, the one with most registered views.
pub(super) fn leading_camera(map: &Map<'_>) -> Option<usize> {
    let counts = map.num_views_of_cameras();
    map.unknown_cameras().max_by_key(|&camera| (counts[camera], usize::MAX - camera))
}

/// The cameras that are asked for their deviation: of those that are looked for and see something, the first one, and
/// those with most views, as far as it costs no more than the last adjustments do.
pub(super) fn asked_cameras(map: &Map<'_>) -> Vec<usize> {
    let counts = map.num_views_of_cameras();
    let is_asked = |&camera: &usize| counts[camera] > 0 && map.known.of(camera).focal > 0.0;
    let mut asked: Vec<usize> = map.unknown_cameras().filter(is_asked).collect();
    asked.sort_by_key(|&camera| (camera > 0, usize::MAX - counts[camera], camera));
    // Photographs come from one or two cameras; more would multiply the cost of the last adjustment.
    asked.truncate(8);
    asked
}

/// Asks what the observations tell of the focal length of a camera, or of a factor of those of several, by holding them
/// off on both sides.
///
/// * `freedom` – what else of the intrinsics is adjusted.
pub(super) fn focal_evidence(
    map: &Map<'_>,
    asked: &[usize],
    freedom: Freedom,
    sigma_px: f64,
    options: &Options,
) -> Result<FocalEvidence, MapperError> {
    // Beyond the noise of a converged cost, within the range where the cost is quadratic.
    const CHANGE: f64 = 0.03;
    let sigma_px = sigma_px.max(MIN_SIGMA_PX);
    let nothing = FocalEvidence { together: f64::INFINITY, in_groups: f64::INFINITY, shift: 0.0 };
    let Some(&first) = asked.first() else { return Ok(nothing) };
    let probe = Probe::new(map, sigma_px, options);
    let held = |change: f64| {
        probe.adjusted(map, freedom, &|trial| {
            // Of the others' focal lengths what is known beforehand counts as before.
            trial.priors.intrinsics.retain(|prior| !asked.contains(&prior.camera));
            for &camera in asked {
                let block = &mut trial.cameras[camera];
                block.camera.focal = block.camera.focal.map(|f| f * change.exp());
                (block.free[0], block.free[1]) = (false, false);
            }
        })
    };
    let (less, here, more) = (held(-CHANGE)?, held(0.0)?, held(CHANGE)?);
    let curvature = (more.cost + less.cost - 2.0 * here.cost) / CHANGE.powi(2);
    if !(curvature > 0.0 && curvature.is_finite()) {
        return Ok(nothing);
    }
    let slope = (more.cost - less.cost) / (2.0 * CHANGE);
    let weight = (COMMON_ERROR_FACTOR * sigma_px).powi(-2);
    let off = off_initial(&map.cameras[first], &map.guess[first]);
    let stiffness = map.known.of(first).focal.powi(-2);
    let pulls = more.by_group.iter().zip(&less.by_group).map(|(more, less)| (more - less) / (2.0 * CHANGE));
    // What is left of the slope is the prior's and the shift, and no group's own.
    let mean = slope / NUM_GROUPS as f64;
    let spread: f64 = pulls.map(|pull| (pull - mean).powi(2)).sum();
    Ok(FocalEvidence {
        together: COMMON_ERROR_FACTOR * sigma_px / curvature.sqrt(),
        in_groups: spread.sqrt() / curvature,
        shift: -(weight * slope + stiffness * off) / (weight * curvature + stiffness),
    })
}

/// Standard deviation of ln f of a camera if all observations err together, from the normal equations where the map
/// stands: what [`focal_evidence`] finds by adjusting three times over, as far as the problem is linear. Infinite where
/// the motion leaves it open.
pub(super) fn focal_deviation_here(
    map: &Map<'_>,
    camera: usize,
    sigma_px: f64,
    options: &Options,
) -> Result<f64, MapperError> {
    let sigma_px = sigma_px.max(MIN_SIGMA_PX);
    let probe = Probe::new(map, sigma_px, options);
    let bundle_options = bundle::Options { loss: options.loss(probe.noise), ..bundle::Options::default() };
    let mut told: Option<LensEvidence> = None;
    for (scope, _) in &probe.parts {
        let mut problem = adjustment::build(map, scope, Freedom::FocalAndRadial, probe.noise, options);
        problem.priors.intrinsics.retain(|prior| prior.camera != camera);
        told.get_or_insert_with(|| LensEvidence::none(camera, &problem)).add(&problem, &bundle_options)?;
    }
    let deviation_px = told.and_then(|told| told.first_deviation()).unwrap_or(f64::INFINITY);
    Ok(COMMON_ERROR_FACTOR * sigma_px * deviation_px / map.cameras[camera].mean_focal())
}

/// Gain of the first coefficient of distortion, in units of the common errors squared, where it is the only one.
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

/// Adjustments on trial, of some points in every part of every view.
struct Probe<'a> {
    /// The whole map, or the stretches of a long video, each with its beginning and length as shares of the whole.
    parts: Vec<(Scope, [f64; 2])>,
    noise: Noise,
    options: &'a Options,
}

/// A problem after adjustment.
struct Adjusted {
    /// ½ Σ ρ.
    cost: f64,
    /// The same by group of points.
    by_group: Vec<f64>,
}

/// Groups of points: parts of the image, across and down, and of the time.
const GROUPS: [usize; 3] = [4, 3, 4];
/// Number of groups of points.
const NUM_GROUPS: usize = GROUPS[0] * GROUPS[1] * GROUPS[2];

impl<'a> Probe<'a> {
    fn new(map: &Map<'_>, sigma_px: f64, options: &'a Options) -> Self {
        let length = map.poses.len().max(1) as f64;
        let in_time = |stretch: Stretch| {
            let time = [stretch.views.start, stretch.views.len()].map(|views| views as f64 / length);
            (Scope::Stretch(stretch), time)
        };
        let parts = match windows::is_long(map, options) {
            true => windows::apart(map).into_iter().map(in_time).collect(),
            false => vec![(Scope::Selected, [0.0, 1.0])],
        };
        Self { parts, noise: Some(sigma_px), options }
    }

    /// All parts after adjustment, each from what `change` makes of it.
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

/// Adds ½ Σ ρ of the points of each group; a point belongs where the middle of its observations lies.
fn add_costs_by_group(problem: &Problem, loss: RobustLoss, [start, length]: [f64; 2], costs: &mut [f64]) {
    let mut points = vec![(0.0, [0.0; 3], 0.0); problem.points.len()];
    for o in &problem.observations {
        let camera = &problem.cameras[problem.poses[o.pose as usize].camera].camera;
        let (cost, place, count) = &mut points[o.point as usize];
        *cost += 0.5 * loss.evaluate(o.whitening.norm_sq(problem.residual_px(o)))[0];
        *count += 1.0;
        let [width, height] = [camera.width, camera.height].map(f64::from);
        let time = start + length * f64::from(o.pose) / problem.poses.len() as f64;
        let at = [o.pixel.x / width, o.pixel.y / height, time];
        place.iter_mut().zip(at).for_each(|(sum, at)| *sum += at);
    }
    for (cost, place, count) in points.into_iter().filter(|(cost, ..)| cost.is_finite()) {
        let cell = |k: usize| bin(place[k] / f64::max(count, 1.0), GROUPS[k]);
        costs[(cell(2) * GROUPS[1] + cell(1)) * GROUPS[0] + cell(0)] += cost;
    }
}
