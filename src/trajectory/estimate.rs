//! Scale ratio of one object by all estimators, with its determinacy.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_1_SQRT_2;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::estimators::{estimate, needs_climb};
use super::views::mean_normal;
use super::{Estimate, Joint, JointOptions, LeastSquares, LeastSquaresOptions, ScaleError, Views, least_squares};
use crate::checks::{Checked, under, within};
use crate::math::centroid;
use crate::math::rounding::percent;
use crate::scene::{
    Ratios, Reference, References, ScaleEstimate, ScaleMethod, ScaleShares, ScaleSupport, StationaryVehicles,
};

/// Options of the scale estimation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Method of the scale ratio; the others are reported as alternatives.
    pub method: ScaleMethod,
    /// True to compute the reference methods of the literature, too, for comparison, as the benchmark does.
    pub references: bool,
    /// True for the chosen method alone: no substitute where it has no ratio, no frames dropped, no ground tracks.
    pub method_only: bool,
    /// Robust fit over all frames.
    pub least_squares: LeastSquaresOptions,
    /// Adjustment with the ground.
    pub joint: JointOptions,
    /// Maximum relative standard deviation of a ratio that counts as determined.
    #[schemars(extend("unit" = "share of the ratio"))]
    pub max_relative_std: f64,
    /// Vehicles whose ratio comes from the camera path, since they are stationary.
    pub stationary: StationaryVehicles,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            method: ScaleMethod::Joint,
            references: false,
            method_only: false,
            least_squares: LeastSquaresOptions::default(),
            joint: JointOptions::default(),
            max_relative_std: 0.1,
            stationary: StationaryVehicles::default(),
        }
    }
}

impl Options {
    /// Rejects unusable values.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        under("joint", self.joint.check())?;
        within("max_relative_std", self.max_relative_std, 0.0..=1000.0)
    }
}

/// Runs every estimator that does not change the reconstruction, and returns the ratio of `wanted`.
///
/// [`ScaleMethod::Joint`] is not among them, since it adjusts the reconstruction ([`joint`](super::joint()));
/// [`place`](super::place()) chooses between the two.
///
/// For methods that depend on the camera's change of height, `degenerate` means that the motion does not determine r:
/// the camera's height over the ground does not change, or by too little for its noise. If the requested method fails,
/// `intersection` replaces it, or else the first other method with a result; `method` and `reason` report that. With
/// [`Options::method_only`] there is no replacement.
///
/// # Errors
/// The requested method's [`ScaleError`], if no method has a result.
pub fn estimate_scale(views: &Views, wanted: ScaleMethod, options: &Options) -> Result<ScaleEstimate, ScaleError> {
    let results = results(views, wanted, options);
    let of = |method: &ScaleMethod| results.get(method).and_then(|result| result.as_ref().ok());
    // Contact is the first replacement: it does not need a climb, which the other two lack when they fail.
    let others = [ScaleMethod::Intersection].into_iter().chain(ScaleMethod::ALL).filter(|_| !options.method_only);
    let chosen = [wanted].into_iter().chain(others);
    let found = chosen.filter_map(|method| Some((method, of(&method)?))).next();
    let failure = results.get(&wanted).and_then(|result| result.as_ref().err());
    let Some((method, &Estimate { ratio, std, .. })) = found else {
        return Err(failure.cloned().unwrap_or(ScaleError::NoAnswer(wanted)));
    };
    let replacement =
        |failure: &ScaleError| format!("{} instead of {}, which failed: {failure}", method.name(), wanted.name());
    let mut reasons: Vec<String> = failure.map(replacement).into_iter().collect();
    // Contact does not need the camera to climb: if it was requested, its result is not judged by the climb.
    if [method, wanted].iter().any(|method| needs_climb(*method)) {
        reasons.extend(degeneracy(&least_squares(views, &options.least_squares), options.max_relative_std));
    } else {
        reasons.extend(std.and_then(|std| too_uncertain(std / ratio, options.max_relative_std)));
    }
    let (reason, alternatives) = (joined(&reasons), ratios_by_method(&results));
    Ok(ScaleEstimate {
        std,
        degenerate: reason.is_some(),
        reason,
        // These methods only use the variation from frame to frame.
        shares: std.map(|std| ScaleShares { frames: std / ratio, ..ScaleShares::default() }),
        support: Some(support(views, ratio, method, &alternatives)),
        alternatives,
        references: references(views, options),
        ..ScaleEstimate::new(ratio, method)
    })
}

fn joined(reasons: &[String]) -> Option<String> {
    (!reasons.is_empty()).then(|| reasons.join("; "))
}

/// Ratio of an adjustment with the ground, with its determinacy and the ratios of the other methods.
///
/// * `views` – of [`Joint::object`], the adjusted reconstruction.
/// * `focal_std` – relative standard deviation of the focal length, where that is not known exactly. With a focal
///   length 10 % too long the ratios differed by 4.1 to 17.9 % from the reference ratios of the same reconstructions,
///   on five rendered sequences (root mean square 9.3 %).
pub(super) fn joint_estimate(views: &Views, found: &Joint, options: &Options, focal_std: Option<f64>) -> ScaleEstimate {
    let mut alternatives = ratios_of(views, options);
    alternatives.insert(ScaleMethod::Joint, found.ratio);
    let all_frames = least_squares(views, &options.least_squares).ok();
    let shares = ScaleShares {
        focal: focal_std.unwrap_or(0.0),
        disagreement: disagreement(found, all_frames.filter(|_| !views.camera_hovers).as_ref()),
        ..found.shares
    };
    let reason = uncertainty_reason(&shares, options.max_relative_std);
    ScaleEstimate {
        std: Some(shares.total() * found.ratio),
        degenerate: reason.is_some(),
        reason,
        shares: Some(shares),
        support: Some(ScaleSupport {
            frames_with_outline: found.contact.num_frames,
            ..support(views, found.ratio, ScaleMethod::Joint, &alternatives)
        }),
        alternatives,
        ..ScaleEstimate::new(found.ratio, ScaleMethod::Joint)
    }
}

/// Reason for an uncertainty of the ratio beyond the accepted one, in words; `None` within it.
fn uncertainty_reason(shares: &ScaleShares, accepted: f64) -> Option<String> {
    if shares.given_focal() <= accepted {
        return focal_length_reason(shares, accepted);
    }
    let why = match shares.disagreement > FRAC_1_SQRT_2 * shares.given_focal() {
        true => {
            "adjustment with the ground and least squares over all frames contradict one another; give ground masks or \
             a shorter clip"
        }
        false => {
            "camera height above ground hardly changes, and outlines do not help; give a longer clip or one with \
             changing height"
        }
    };
    Some(format!("{}: {why}", with_limit(shares.given_focal(), accepted)))
}

/// "±18 % (limit ±10 %)".
fn with_limit(std: f64, limit: f64) -> String {
    format!("±{} (limit ±{})", percent(std), percent(limit))
}

/// Reason, in words, if the focal length leaves a ratio undetermined.
fn focal_length_reason(shares: &ScaleShares, accepted: f64) -> Option<String> {
    // The limit for the focal length is three times as large: its error is common to all vehicles, and does not affect
    // the determinacy by their motion.
    let (total, accepted) = (shares.total(), 3.0 * accepted);
    let is_open = !(total <= accepted) && shares.focal > shares.given_focal();
    let known = || format!("focal length known to ±{} only; give --intrinsics", percent(shares.focal));
    is_open.then(|| format!("{}: {}", with_limit(total, accepted), known()))
}

/// The estimate with the uncertainty of the focal length included.
///
/// * `accepted` – maximum standard deviation, as a share of the ratio.
pub(super) fn with_focal(scale: ScaleEstimate, focal_std: Option<f64>, accepted: f64) -> ScaleEstimate {
    let (Some(focal_std), Some(shares)) = (focal_std, scale.shares) else { return scale };
    let shares = ScaleShares { focal: focal_std, ..shares };
    let reasons: Vec<String> = scale.reason.into_iter().chain(focal_length_reason(&shares, accepted)).collect();
    let reason = joined(&reasons);
    ScaleEstimate {
        std: Some(shares.total() * scale.ratio),
        degenerate: scale.degenerate || reason.is_some(),
        reason,
        shares: Some(shares),
        ..scale
    }
}

/// Standard deviation by the difference from least squares on the same model, beyond the reported ones.
///
/// Its variance is half of the squared difference beyond the variances of both (two estimates with a random effect;
/// R. DerSimonian and N. Laird, *Meta-analysis in clinical trials*, 1986). Least squares is assumed to have twice its
/// reported standard deviation (decision 7), and its ratio may be any between those for noise in one kind of heights or
/// the other.
fn disagreement(found: &Joint, all_frames: Option<&LeastSquares>) -> f64 {
    let Some(other) = all_frames else { return 0.0 };
    let (least, most) = (other.ratio.min(other.ratio_by_object_noise), other.ratio.max(other.ratio_by_object_noise));
    let nearest = found.ratio.max(least).min(most) / found.ratio;
    let (difference, own) = (nearest - 1.0, 2.0 * nearest * other.std / other.ratio);
    let excess = difference * difference - own * own - found.shares.total().powi(2);
    if excess > 0.0 && excess.is_finite() { (0.5 * excess).sqrt() } else { 0.0 }
}

/// Ratios by all estimators that do not change the reconstruction; those without a result are absent.
pub fn ratios_of(views: &Views, options: &Options) -> Ratios {
    ratios_by_method(&results(views, options.method, options))
}

/// Results of the reference methods for an unchanged reconstruction; empty unless they are requested.
pub(super) fn references(views: &Views, options: &Options) -> References {
    let wanted = ScaleMethod::ALL.into_iter().filter(|method| options.references && method.is_reference());
    wanted.map(|method| (method, reference(method, views, options))).collect()
}

fn reference(method: ScaleMethod, views: &Views, options: &Options) -> Reference {
    match estimate(method, views, options) {
        Ok(Estimate { ratio, std, .. }) => {
            let undetermined = std.and_then(|std| too_uncertain(std / ratio, options.max_relative_std));
            Reference { ratio: Some(ratio), std, undetermined }
        }
        Err(error) => Reference { undetermined: Some(error.to_string()), ..Reference::default() },
    }
}

fn too_uncertain(relative_std: f64, accepted: f64) -> Option<String> {
    (!(relative_std <= accepted)).then(|| format!("scale undetermined: {}", with_limit(relative_std, accepted)))
}

type Results = BTreeMap<ScaleMethod, Result<Estimate, ScaleError>>;

/// Results of `wanted` and of all methods but references, for an unchanged reconstruction.
fn results(views: &Views, wanted: ScaleMethod, options: &Options) -> Results {
    let requested = ScaleMethod::ALL.into_iter().filter(|method| *method == wanted || !method.is_reference());
    let result = |method: ScaleMethod| match views.camera_hovers && needs_climb(method) {
        true => Err(ScaleError::CameraHovers),
        false => estimate(method, views, options),
    };
    requested.map(|method| (method, result(method))).collect()
}

fn ratios_by_method(results: &Results) -> Ratios {
    results.iter().filter_map(|(method, result)| Some((*method, result.as_ref().ok()?.ratio))).collect()
}

/// Evidence for and against a ratio, from the views.
fn support(views: &Views, ratio: f64, method: ScaleMethod, ratios: &Ratios) -> ScaleSupport {
    let others = ratios.iter().filter(|(other, _)| **other != method);
    ScaleSupport {
        num_points: views.points.len(),
        num_views: views.views.len(),
        frames_with_outline: 0,
        tilt: mean_normal(views).map_or(0.0, |(_, angle)| angle),
        ground_residual: ground_residual(views, ratio),
        disagreement: others.map(|(_, other)| (other / ratio - 1.0).abs()).reduce(f64::max),
    }
}

/// Standard deviation over the frames of the height of the points' center, as a share of the camera's mean height.
fn ground_residual(views: &Views, ratio: f64) -> f64 {
    let count = views.views.len().max(1) as f64;
    let center = centroid(&views.points);
    let distances = || views.views.iter().map(|view| view.camera_height + ratio * view.offset(&center));
    let mean = distances().sum::<f64>() / count;
    let variance = distances().map(|distance| (distance - mean).powi(2)).sum::<f64>() / count;
    let height = views.views.iter().map(|view| view.camera_height.abs()).sum::<f64>() / count;
    let residual = variance.sqrt() / height;
    if residual.is_finite() { residual } else { 0.0 }
}

/// Reason why the motion does not determine r, with figures; `None` if it does.
fn degeneracy(all_frames: &Result<LeastSquares, ScaleError>, max_relative_std: f64) -> Option<String> {
    let fit = match all_frames {
        Ok(fit) => fit,
        Err(error) => return Some(format!("frames cannot be checked against one another: {error}")),
    };
    let relative = fit.excitation / fit.mean_height.abs();
    if !relative.is_finite() {
        return Some("frames cannot be checked against one another: too few agree on the ground".to_owned());
    }
    let motion = format!("camera height above the vehicle varies by {} only", percent(relative));
    // The frames differ by rounding only: single precision of model files.
    if relative <= 1e-6 {
        return Some("camera and vehicle move parallel to the ground: the scale is undetermined".to_owned());
    }
    let relative_std = fit.std / fit.ratio.abs();
    if fit.ratio > 0.0 && relative_std <= max_relative_std {
        return None;
    }
    if ![fit.residual_std, fit.ratio, fit.std].iter().all(|number| number.is_finite()) {
        return Some(format!("{motion}, and least squares over all frames has no solution"));
    }
    if fit.ratio <= 0.0 {
        return Some(format!("no positive scale: {motion}, or the ground planes are wrong"));
    }
    // A large change of height does not help if the error of the planes is larger: with an error of 1 % of the height,
    // a tenth of the height determines the ratio to 10 %.
    let why = if relative > 0.1 { "the ground planes are too noisy".to_owned() } else { motion };
    Some(format!("{}: {why}", with_limit(relative_std, max_relative_std)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{self, Noise, Terrain, drive};

    fn estimate(world: &drive::Options, seed: u64, wanted: ScaleMethod) -> (ScaleEstimate, f64) {
        let world = drive(world, seed);
        let views = Views::new(&world.background, &world.object, &world.planes, &Options::default());
        (estimate_scale(&views, wanted, &Options::default()).unwrap(), world.ratio)
    }

    const NOISE: Noise = Noise { pixel_px: 0.5, plane_height_m: 0.03, plane_tilt_deg: 0.3, bad_planes: 0.0 };

    #[test]
    fn parallel_motion_is_degenerate_and_says_why() {
        for terrain in [Terrain::Flat, Terrain::Slope { gradient: [0.08, 0.02] }] {
            let world = drive::Options { terrain, camera_climb_m: 0.0, ..Default::default() };
            let (found, truth) = estimate(&world, 1, ScaleMethod::RobustLeastSquares);
            assert!(found.degenerate, "{found:?}");
            assert!(found.reason.unwrap().contains("parallel to the ground"));
            assert!((found.alternatives[&ScaleMethod::Intersection] / truth - 1.0).abs() < 1e-9);
            let (found, truth) = estimate(&world, 1, ScaleMethod::Intersection);
            assert!(!found.degenerate && found.std.is_none() && (found.ratio / truth - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn too_little_climb_for_the_noise_is_degenerate_with_numbers() {
        // Planes with height errors only: tilt errors would change the camera's height over them.
        let noise = Noise { plane_tilt_deg: 0.0, plane_height_m: 0.1, ..NOISE };
        let world = drive::Options { camera_climb_m: 0.1, noise, ..Default::default() };
        for seed in 0..4 {
            let (found, _) = estimate(&world, seed, ScaleMethod::RobustLeastSquares);
            assert!(found.degenerate, "{found:?}");
            let reason = found.reason.unwrap_or_default();
            assert!(
                reason.contains("camera height above the vehicle varies by 0.") && reason.contains(" % only"),
                "{reason}"
            );
        }
    }

    #[test]
    fn a_good_motion_is_not_degenerate_and_its_std_fits_the_error() {
        for method in [ScaleMethod::ConstantDistance, ScaleMethod::RobustLeastSquares] {
            for seed in 0..6 {
                let world = drive::Options { noise: NOISE, ..Default::default() };
                let (found, truth) = estimate(&world, seed, method);
                assert!(!found.degenerate && found.reason.is_none(), "{found:?}");
                assert_eq!((found.method, found.alternatives.len()), (method, 3));
                let std = found.std.unwrap();
                assert!(std > 0.0 && (found.ratio - truth).abs() < 4.0 * std, "{} off, std {std}", found.ratio - truth);
            }
        }
    }

    #[test]
    fn the_reason_for_an_uncertain_ratio_is_named() {
        let shares = |contact, focal| ScaleShares { contact, focal, ..ScaleShares::default() };
        let why = |contact, focal| uncertainty_reason(&shares(contact, focal), 0.1);
        assert_eq!((why(0.05, 0.0), why(0.05, 0.2)), (None, None));
        assert!(why(0.05, 0.4).unwrap().contains("--intrinsics"));
        assert!(why(0.2, 0.4).unwrap().contains("outlines") && why(f64::NAN, 0.0).is_some());
        let contradicting = ScaleShares { contact: 0.05, disagreement: 0.2, ..ScaleShares::default() };
        let text = uncertainty_reason(&contradicting, 0.1).unwrap();
        assert!(text.contains("contradict one another") && text.contains("±21 %"), "{text}");
    }

    #[test]
    fn two_frames_have_a_ratio_that_cannot_be_checked() {
        let world = drive(&drive::Options { num_frames: 2, ..Default::default() }, 3);
        let views = Views::new(&world.background, &world.object, &world.planes, &Options::default());
        let estimate = |views: &Views| estimate_scale(views, ScaleMethod::RobustLeastSquares, &Options::default());
        let found = estimate(&views).unwrap();
        assert!(found.degenerate && found.reason.unwrap().contains("cannot be checked"));
        let none = Views { views: Vec::new(), ..views };
        assert!(matches!(estimate(&none), Err(ScaleError::TooFewViews { usable: 0, .. })));
    }
}
