//! The camera's attitude from a log: the vertical by its own sensors, its orientation by the gimbal angles, and the
//! agreement of its rotations with the reconstruction.

use nalgebra::{UnitQuaternion, Vector3};

use super::alignment::registered;
use super::telemetry::Telemetry;
use crate::metric::{self, Orientation, metric_from_cam};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::scene::{Frame, Image, Reconstruction, Topic};
use crate::telemetry::{CameraSample, Fix};

/// Standard deviation of the gravity direction in a camera's log, radians (a degree): as that of a gimbal's pitch and
/// roll.
const GRAVITY_STD: f64 = 0.017;

/// Maximum RMS angle of the gravity samples to their mean in the world frame, radians; beyond it they belong to another
/// camera.
const MAX_SPREAD: f64 = 0.1;

/// Maximum age of a sample, seconds: there is one per frame, and an older one belongs to another frame.
const MAX_AGE_S: f64 = 0.1;

/// Up direction in the world frame by the samples nearest in time to each frame, and its standard deviation, radians.
pub(in crate::pipeline) fn vertical(
    run: &Run,
    seen: &[(&Frame, &Image)],
    telemetry: &Telemetry,
    outcome: &mut Outcome,
) -> Option<(Vector3<f64>, f64)> {
    let clockwise = f64::from(run.info().rotation_deg).to_radians();
    let upright = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), clockwise);
    let pairs = pairs(run, seen, telemetry);
    describe_rotations(&pairs, upright, outcome);
    let down = |(sample, image): &(CameraSample, &Image)| {
        Some(image.cam_from_world.rotation.inverse() * (upright * sample.down_in_image?))
    };
    let downs: Vec<Vector3<f64>> = pairs.iter().filter_map(down).collect();
    let mean = downs.iter().sum::<Vector3<f64>>().try_normalize(f64::EPSILON)?;
    let squares: f64 = downs.iter().map(|down| down.angle(&mean).powi(2)).sum();
    let spread = (squares / downs.len() as f64).sqrt();
    outcome.figure("gravity", serde_json::json!({ "num": downs.len(), "spread_deg": spread.to_degrees() }));
    if spread > MAX_SPREAD {
        let text = format!(
            "telemetry: the camera's gravity turns by {:.1}° against its images; gravity ignored",
            spread.to_degrees()
        );
        outcome.warn(Topic::CameraAttitudeIgnored.warning(text));
        return None;
    }
    // Orientation errors of the sensor persist over a recording: they do not average out.
    Some((-mean, GRAVITY_STD.max(spread)))
}

/// Images with the sample nearest in time to each.
fn pairs<'a>(run: &Run, seen: &[(&'a Frame, &'a Image)], telemetry: &Telemetry) -> Vec<(CameraSample, &'a Image)> {
    let offset_s = run.options.metric.time_offset.map_or(0.0, |offset| offset.mean_s);
    let pair = |(frame, image): &(&Frame, &'a Image)| {
        let sample = nearest(&telemetry.log.camera, frame.time_s + offset_s, MAX_AGE_S, |sample| sample.video_s)?;
        Some((*sample, *image))
    };
    seen.iter().filter_map(pair).collect()
}

/// Returns the sample nearest to a time, within a maximum age; samples ascend in time.
fn nearest<T>(samples: &[T], time_s: f64, max_age_s: f64, at_s: impl Fn(&T) -> f64) -> Option<&T> {
    let age_s = |sample: &&T| (at_s(sample) - time_s).abs();
    let after = samples.partition_point(|sample| at_s(sample) < time_s);
    let near = [after.saturating_sub(1), after].into_iter().filter_map(|at| samples.get(at));
    near.min_by(|a, b| age_s(a).total_cmp(&age_s(b))).filter(|sample| age_s(sample) <= max_age_s)
}

/// Reports the RMS angle between the camera's own rotations and those of the reconstruction.
///
/// * `upright` – rotates the stored image upright.
fn describe_rotations(pairs: &[(CameraSample, &Image)], upright: UnitQuaternion<f64>, outcome: &mut Outcome) {
    let rotation = |(sample, image): &(CameraSample, &Image)| {
        Some(((upright * sample.image_from_start?).inverse(), image.cam_from_world.rotation))
    };
    let rotations: Vec<_> = pairs.iter().filter_map(rotation).collect();
    let Some(found) = metric::orientation(&rotations) else { return };
    let angle = |(start, world): &(UnitQuaternion<f64>, UnitQuaternion<f64>)| {
        (start * world).angle_to(&found.metric_from_world).powi(2)
    };
    let rms = (rotations.iter().map(angle).sum::<f64>() / rotations.len() as f64).sqrt();
    outcome.figure("rotations", serde_json::json!({ "num": rotations.len(), "residual_deg": rms.to_degrees() }));
}

/// Orientation of the background by the gimbal angles of the fixes nearest in time to each frame.
pub fn orientation(
    background: &Reconstruction,
    frames: &[Frame],
    fixes: &[Fix],
    log_from_video_s: f64,
) -> Option<Orientation> {
    /// Maximum age of gimbal angles, seconds: older ones belong to another view.
    const MAX_AGE_S: f64 = 0.5;
    let by_video = fixes.iter().all(|fix| fix.video_s.is_some());
    let timed: Vec<_> = fixes
        .iter()
        .filter_map(|fix| Some((if by_video { fix.video_s? } else { fix.clock_s? }, fix.gimbal?)))
        .collect();
    let pair = |(frame, image): (&Frame, &Image)| -> Option<(UnitQuaternion<f64>, UnitQuaternion<f64>)> {
        let time_s = frame.time_s + log_from_video_s;
        let (_, angles) = nearest(&timed, time_s, MAX_AGE_S, |(at, _)| *at)?;
        Some((metric_from_cam(angles.yaw, angles.pitch, angles.roll), image.cam_from_world.rotation))
    };
    let pairs: Vec<_> = registered(background, frames).into_iter().filter_map(pair).collect();
    metric::orientation(&pairs)
}
