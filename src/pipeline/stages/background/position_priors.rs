//! A last adjustment of the background in which the positions of a receiver take part.
//!
//! The path is laid onto the fixes by a similarity, and the adjustment runs in meters: the camera of the image nearest
//! to a fix has its position as a prior, with its standard deviation and a robust loss (as COLMAP's pose_prior_mapper).
//! Over a short path images know the shape better than a plain receiver, whose positions then take no part; those of an
//! RTK receiver take the drift out of a long one.

use std::collections::BTreeMap;

use nalgebra::Point3;
use serde_json::json;

use super::{DEVIATION_IMAGES, map_frame};

use crate::bundle::{self, CameraBlock, PosePrior, Problem};
use crate::camera::NUM_INTRINSICS;
use crate::math::{Rigid3, RobustLoss, median, umeyama};
use crate::metric::{CenterFix, center_fixes};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::driver::threads::on_threads;
use crate::pipeline::inputs::alignment::{self, FittedLog};
use crate::pipeline::inputs::{order, telemetry};
use crate::pipeline::{PipelineError, TelemetryChoice};
use crate::scene::{CameraId, Reconstruction};

/// Scale of the robust loss on positions, standard deviations: fixes that jump are farther away.
const LOSS_SIGMAS: f64 = 3.0;

/// Of a model adjusted with priors the observations fit at most so much worse than before, as a share of the root mean
/// square: more would mean that the positions contradict the images.
const MAX_LOSS_OF_FIT: f64 = 0.1;

/// Inputs of the adjustment, for the stage's cache key.
pub(super) fn cache_key(run: &Run) -> serde_json::Value {
    if !run.options.metric.position_priors {
        return json!(null);
    }
    let files = telemetry::files(run);
    let contents: Vec<_> =
        files.iter().map(|file| crate::pipeline::driver::fingerprint::of_content(file).ok()).collect();
    let metric = &run.options.metric;
    json!({
        "is_wanted": metric.position_priors,
        "is_looked_for": metric.telemetry != TelemetryChoice::None,
        "files": contents,
        "time_offset": metric.time_offset,
        "utc_offset": metric.utc_offset,
    })
}

/// Adjusts a reconstructed background with the positions of its telemetry, if this is wanted and they fit. The stage
/// `metric` reports errors of the log.
pub(super) fn adjust(
    run: &Run,
    model: &mut Reconstruction,
    std: &BTreeMap<CameraId, [f64; NUM_INTRINSICS]>,
    outcome: &mut Outcome,
) -> Result<(), PipelineError> {
    let most_views = order::sfm_options(run)?.0.mapper.max_views_at_once;
    if !run.options.metric.position_priors || model.images.len() > most_views {
        return Ok(());
    }
    match map_frame::fit(run, model) {
        Some((fitted, _)) => with_positions(run, model, &fitted, std, outcome),
        None => Ok(()),
    }
}

/// Adjusts with the positions, where they are precise enough.
fn with_positions(
    run: &Run,
    model: &mut Reconstruction,
    fitted: &FittedLog,
    std: &BTreeMap<CameraId, [f64; NUM_INTRINSICS]>,
    outcome: &mut Outcome,
) -> Result<(), PipelineError> {
    let frames = run.frames()?;
    let Ok(path) = alignment::camera_path(model, frames) else { return Ok(()) };
    let centers = center_fixes(&path, &fitted.fixes, &fitted.alignment);
    let poses = poses_of_path(model, frames, path.centers().len());
    let priors: Vec<(usize, CenterFix)> =
        centers.iter().filter_map(|fix| Some((*poses.get(fix.index)?, *fix))).collect();
    let metric_from_world = fitted.alignment.metric_from_world;
    if !are_informative(model, &priors, std, metric_from_world.scale) {
        tracing::debug!("positions are less precise than the path: they do not take part in the adjustment");
        return Ok(());
    }
    let mut metric = model.clone();
    metric.transform(&metric_from_world);
    let found = on_threads(run.options.threads, || adjusted(&metric, &priors, |id| is_free(std, id)))?;
    let Some(adjusted) = found else { return Ok(()) };
    let moved_m = change_of_shape(&metric, &adjusted).unwrap_or(0.0);
    let std_m = median(priors.iter().map(|(_, fix)| fix.std_m.x).collect());
    tracing::info!("adjusted with {} positions: cameras moved by {moved_m:.4} m (median)", priors.len());
    outcome.figure("position_priors", json!({ "num": priors.len(), "std_m": std_m, "moved_m": moved_m }));
    *model = adjusted;
    model.transform(&metric_from_world.inverse());
    Ok(())
}

/// Returns true if a camera's focal length is not held.
fn is_free(std: &BTreeMap<CameraId, [f64; NUM_INTRINSICS]>, id: CameraId) -> bool {
    std.get(&id).is_some_and(|std| std[0] > 0.0)
}

/// Returns true if all positions together are more precise than the path: than its largest standard deviation.
///
/// * `scale` – meters per unit of the model.
fn are_informative(
    model: &Reconstruction,
    priors: &[(usize, CenterFix)],
    std: &BTreeMap<CameraId, [f64; NUM_INTRINSICS]>,
    scale: f64,
) -> bool {
    // A model that leaves something undetermined has no such figures.
    let Ok(Some(found)) = bundle::center_deviations(model, DEVIATION_IMAGES, std) else { return false };
    let of_path_m = scale * found.centers.into_values().fold(0.0, f64::max);
    let of_positions_m = median(priors.iter().map(|(_, fix)| fix.std_m.x).collect());
    of_positions_m.is_some_and(|std_m| std_m / (priors.len() as f64).sqrt() <= of_path_m)
}

/// Median distance of the cameras of two models after a similarity.
fn change_of_shape(before: &Reconstruction, after: &Reconstruction) -> Option<f64> {
    let centers = |model: &Reconstruction| -> Vec<Point3<f64>> {
        model.images.values().map(|image| image.cam_from_world.center()).collect()
    };
    let (before, after) = (centers(before), centers(after));
    let before_from_after = umeyama(&after, &before)?;
    median(before.iter().zip(&after).map(|(a, b)| (a - before_from_after * *b).norm()).collect())
}

/// A model in meters, adjusted with positions of its cameras, by place; `None` where the positions contradict the
/// images, or the adjustment fails.
///
/// * `is_free` – true if a camera's focal length is adjusted, too.
fn adjusted(
    metric: &Reconstruction,
    priors: &[(usize, CenterFix)],
    is_free: impl Fn(CameraId) -> bool,
) -> Option<Reconstruction> {
    let pixel_px = noise_px(metric)?;
    let mut problem = Problem::from_reconstruction(metric, |id, camera| match is_free(id) {
        true => CameraBlock { free: [true, true, false, false, false, false], ..CameraBlock::fixed(*camera) },
        false => CameraBlock::fixed(*camera),
    });
    problem.priors.poses = priors.iter().map(|(pose, fix)| prior(*pose, fix, pixel_px)).collect();
    let loss = RobustLoss::SoftL1 { scale: 2.0 * pixel_px };
    if let Err(error) = bundle::adjust(&mut problem, &bundle::Options { loss, ..bundle::Options::default() }) {
        tracing::debug!("adjustment with positions failed: {error}");
        return None;
    }
    let mut adjusted = metric.clone();
    problem.store(&mut adjusted);
    let is_as_good = noise_px(&adjusted)? <= (1.0 + MAX_LOSS_OF_FIT) * pixel_px;
    if !is_as_good {
        tracing::debug!("adjustment with positions contradicts the images");
        return None;
    }
    update_errors(&mut adjusted);
    Some(adjusted)
}

/// The prior of a fix; residuals of a problem are pixels, of which `pixel_px` are a standard deviation.
fn prior(pose: usize, fix: &CenterFix, pixel_px: f64) -> PosePrior {
    let mut cam_from_world = Rigid3::identity();
    cam_from_world.translation = -fix.position_m.coords;
    PosePrior {
        pose,
        cam_from_world,
        sigma_rotation: f64::INFINITY,
        sigma_center: fix.std_m / pixel_px,
        loss: RobustLoss::Cauchy { scale: LOSS_SIGMAS * pixel_px },
    }
}

/// Index in the model, and so in the problem, of each image of the path.
fn poses_of_path(model: &Reconstruction, frames: &[crate::scene::Frame], most: usize) -> Vec<usize> {
    let names: BTreeMap<&str, usize> =
        model.images.values().enumerate().map(|(index, image)| (image.name.as_str(), index)).collect();
    let registered = alignment::registered(model, frames);
    let mut last_s = f64::NEG_INFINITY;
    // A path leaves out images whose time does not rise.
    let rising = registered.into_iter().filter(|(frame, _)| {
        let rises = frame.time_s > last_s;
        last_s = last_s.max(frame.time_s);
        rises
    });
    rising.filter_map(|(_, image)| names.get(image.name.as_str()).copied()).take(most).collect()
}

/// Root mean square of the residuals of all observations, per coordinate, pixels.
fn noise_px(model: &Reconstruction) -> Option<f64> {
    let errors = model.points.values().filter_map(|point| model.errors_of(point)).flatten();
    let (sum, count) = errors.fold((0.0, 0usize), |(sum, count), error| (sum + error * error, count + 1));
    let noise = (sum / (2.0 * count as f64)).sqrt();
    (noise.is_finite() && noise > 0.0).then_some(noise)
}

fn update_errors(model: &mut Reconstruction) {
    let mean = |errors: Vec<f64>| errors.iter().sum::<f64>() / errors.len().max(1) as f64;
    let errors: Vec<_> = model.points.values().map(|point| model.errors_of(point).map(mean)).collect();
    for (point, error) in model.points.values_mut().zip(errors) {
        point.error_px = error.unwrap_or(point.error_px);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use rand::Rng as _;
    use rand_distr::StandardNormal;

    use super::*;
    use crate::bundle::adjust as adjust_images;
    use crate::math::{Rng, seeded_rng};
    use crate::synthetic::scene::{self, CameraMotion, static_scene};

    fn centers(model: &Reconstruction) -> Vec<Point3<f64>> {
        model.images.values().map(|image| image.cam_from_world.center()).collect()
    }

    /// Error of the shape: after a similarity, since a receiver's bias moves the whole path.
    fn rmse(model: &Reconstruction, truth: &[Point3<f64>]) -> f64 {
        let truth_from_model = umeyama(&centers(model), truth).unwrap();
        let squares = centers(model).into_iter().zip(truth).map(|(a, b)| (truth_from_model * a - b).norm_squared());
        (squares.sum::<f64>() / truth.len() as f64).sqrt()
    }

    fn normal(rng: &mut Rng) -> Vector3<f64> {
        Vector3::from_fn(|_, _| rng.sample(StandardNormal))
    }

    /// A receiver's positions of a path: nine tenths of the standard deviation wander over two minutes, as
    /// `center_fixes` has it.
    fn fixes(truth: &[Point3<f64>], std_m: f64, rng: &mut Rng) -> Vec<(usize, CenterFix)> {
        const STEP_S: f64 = 0.1;
        let keep = (-STEP_S / 120.0f64).exp();
        let slow_share = 0.8 * (1.0 - (-STEP_S * truth.len() as f64 / 120.0).exp());
        let std = std_m * (0.2 + truth.len() as f64 * slow_share).sqrt();
        let mut wander = normal(rng);
        let fix = |(index, center): (usize, &Point3<f64>)| {
            wander = wander * keep + normal(rng) * (1.0 - keep * keep).sqrt();
            let error = (wander * 0.8f64.sqrt() + normal(rng) * 0.2f64.sqrt()) * std_m;
            (index, CenterFix { index, position_m: center + error, std_m: Vector3::repeat(std) })
        };
        truth.iter().enumerate().map(fix).collect()
    }

    #[test]
    fn precise_positions_take_the_drift_out_of_a_long_path_and_coarse_ones_change_nothing() {
        let options = scene::Options {
            num_images: 200,
            num_points: 3000,
            path: CameraMotion::Flight,
            noise_px: 2.0,
            ..scene::Options::default()
        };
        let mut rng = seeded_rng(7, 0);
        let mut drifted = static_scene(&options);
        let truth = centers(&drifted);
        let mut problem = Problem::from_reconstruction(&drifted, |_, camera| CameraBlock::fixed(*camera));
        adjust_images(&mut problem, &bundle::Options::default()).unwrap();
        problem.store(&mut drifted);
        for (std_m, least_gain, most_gain) in [(0.02, 1.5, f64::INFINITY), (20.0, 0.95, 1.5)] {
            let priors = fixes(&truth, std_m, &mut rng);
            let positions: Vec<_> = priors.iter().map(|(_, fix)| fix.position_m).collect();
            let mut aligned = drifted.clone();
            aligned.transform(&umeyama(&centers(&drifted), &positions).unwrap());
            assert_eq!(are_informative(&aligned, &priors, &BTreeMap::new(), 1.0), std_m < 1.0);
            let found = adjusted(&aligned, &priors, |_| false).unwrap();
            let (before, after) = (rmse(&aligned, &truth), rmse(&found, &truth));
            println!("{std_m} m: {before:.4} m aligned afterwards, {after:.4} m with priors");
            assert!((least_gain..most_gain).contains(&(before / after)), "{std_m}: {before} {after}");
        }
    }

    #[test]
    fn wrong_positions_are_outvoted() {
        let options = scene::Options { num_images: 40, num_points: 800, noise_px: 0.3, ..scene::Options::default() };
        let model = static_scene(&options);
        let truth = centers(&model);
        let mut priors = fixes(&truth, 0.02, &mut seeded_rng(3, 0));
        priors.iter_mut().step_by(10).for_each(|(_, fix)| fix.position_m.x += 5.0);
        let found = adjusted(&model, &priors, |_| true).unwrap();
        assert!(rmse(&found, &truth) < 0.02, "{}", rmse(&found, &truth));
        let mut rng = seeded_rng(4, 0);
        for (_, fix) in &mut priors {
            fix.position_m += normal(&mut rng);
            fix.std_m = Vector3::repeat(1e-3);
        }
        assert!(adjusted(&model, &priors, |_| false).is_none_or(|found| rmse(&found, &truth) < 0.02));
    }
}
