//! The camera's path on the fixes of the telemetry.

use nalgebra::UnitQuaternion;

use super::sources::{Ground, MAX_TILT};
use crate::metric::{self, Alignment, Gravity, Offset, Orientation, Refusal, Source, Support, metric_from_cam};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::alignment::{FittedLog, fit, registered};
use crate::pipeline::inputs::telemetry::{Origin, Telemetry};
use crate::scene::{Frame, Image, MapOrigin, Reconstruction, Topic};
use crate::telemetry::{self, LocalFrame};

/// A path on its fixes, with the map under it.
pub(super) struct Aligned {
    pub(super) alignment: Alignment,
    pub(super) map: LocalFrame,
    knows_height: bool,
    /// Epoch of the log's times, seconds of its clock.
    epoch_s: f64,
    origin: Origin,
}

impl Aligned {
    pub(super) fn source(&self) -> Source {
        Source {
            name: self.origin.source_name().to_owned(),
            kind: metric::Kind::Telemetry,
            log_scale: self.alignment.metric_from_world.scale.ln(),
            std: self.alignment.log_scale_std(),
        }
    }

    /// Where the metric frame lies.
    pub(super) fn origin(&self) -> MapOrigin {
        let telemetry::Geodetic { longitude_deg: longitude, latitude_deg: latitude, height_m } = self.map.origin;
        MapOrigin { longitude, latitude, height_m, knows_height: self.knows_height }
    }

    /// The log's clock minus the video's time.
    pub(super) fn clock_offset_s(&self) -> f64 {
        self.epoch_s + self.alignment.offset_s
    }
}

/// Lays the path onto the fixes; why that cannot be is reported.
pub(super) fn align(
    run: &Run,
    background: &Reconstruction,
    ground: &Ground,
    telemetry: &Telemetry,
    outcome: &mut Outcome,
) -> Option<Aligned> {
    match try_align(run, background, ground, telemetry, outcome) {
        Ok(aligned) => {
            describe(&aligned.alignment, outcome);
            Some(aligned)
        }
        Err(reason) => {
            let text = format!("{}: positions give no scale: {reason}", telemetry.path.display());
            outcome.warn(Topic::TelemetryDoesNotFit.warning(text));
            None
        }
    }
}

fn try_align(
    run: &Run,
    background: &Reconstruction,
    ground: &Ground,
    telemetry: &Telemetry,
    outcome: &mut Outcome,
) -> Result<Aligned, String> {
    let frames = run.frames().map_err(|error| error.to_string())?;
    let support = |offset, epoch_s| support(background, frames, telemetry, ground, offset, epoch_s, outcome);
    let FittedLog { alignment, map, knows_height, epoch_s, refusal, .. } = fit(run, background, telemetry, support)?;
    let aligned = Aligned { alignment, map, knows_height, epoch_s, origin: telemetry.origin };
    warn_of_other_clock(telemetry, &aligned, refusal.as_ref(), outcome);
    Ok(aligned)
}

/// Says where the log fits only at another time than it states.
fn warn_of_other_clock(telemetry: &Telemetry, aligned: &Aligned, refusal: Option<&Refusal>, outcome: &mut Outcome) {
    let Some(reason) = refusal else { return };
    outcome.warn(Topic::TelemetryAtAnotherTime.warning(format!(
        "{}: stated time does not fit the video ({reason}); by its trajectory the log's clock is {:.1} s ahead of the \
         video's; give --time-offset SECONDS if that is wrong, --no-telemetry if it is the log of another flight",
        telemetry.path.display(),
        aligned.clock_offset_s()
    )));
}

/// The vertical from the camera's attitude in the log, else from the ground.
fn support(
    background: &Reconstruction,
    frames: &[Frame],
    telemetry: &Telemetry,
    ground: &Ground,
    offset: Offset,
    epoch_s: f64,
    outcome: &mut Outcome,
) -> Support {
    let gravity = ground.gravity();
    let mean_s = match offset {
        Offset::Known { mean_s, .. } => mean_s,
        Offset::Unknown => return Support { offset, gravity, orientation: None },
    };
    let orientation = orientation(background, frames, telemetry, epoch_s + mean_s);
    let agrees = |orientation: &Orientation| {
        let up = orientation.metric_from_world.inverse() * nalgebra::Vector3::z();
        gravity.is_none_or(|gravity| up.angle(&gravity.up_in_world) <= MAX_TILT)
    };
    match orientation {
        Some(found) if agrees(&found) => Support { offset, gravity: None, orientation: Some(found) },
        Some(_) => {
            let text = "telemetry: camera attitude does not fit the ground; attitude ignored";
            outcome.warn(Topic::CameraAttitudeIgnored.warning(text));
            Support { offset, gravity, orientation: None }
        }
        None => Support { offset, gravity, orientation: None },
    }
}

/// Orientation of the background by the gimbal angles of the fixes nearest in time to each frame.
fn orientation(
    background: &Reconstruction,
    frames: &[Frame],
    telemetry: &Telemetry,
    log_from_video_s: f64,
) -> Option<Orientation> {
    /// Angles that are older than this are those of another view, seconds.
    const MAX_AGE_S: f64 = 0.5;
    let by_video = telemetry.log.fixes.iter().all(|fix| fix.video_s.is_some());
    let timed = telemetry
        .log
        .fixes
        .iter()
        .filter_map(|fix| Some((if by_video { fix.video_s? } else { fix.clock_s? }, fix.gimbal?)));
    let timed: Vec<_> = timed.collect();
    let pair = |(frame, image): (&Frame, &Image)| -> Option<(UnitQuaternion<f64>, UnitQuaternion<f64>)> {
        let time_s = frame.time_s + log_from_video_s;
        let after = timed.partition_point(|(at, _)| *at < time_s);
        let near = [after.saturating_sub(1), after];
        let near = near.into_iter().filter_map(|i| timed.get(i).copied());
        let (at, angles) = near.min_by(|a, b| (a.0 - time_s).abs().total_cmp(&(b.0 - time_s).abs()))?;
        let is_recent = (at - time_s).abs() <= MAX_AGE_S;
        is_recent.then(|| (metric_from_cam(angles.yaw, angles.pitch, angles.roll), image.cam_from_world.rotation))
    };
    let pairs: Vec<_> = registered(background, frames).into_iter().filter_map(pair).collect();
    metric::orientation(&pairs)
}

impl Ground {
    /// The ground's normal as the vertical.
    fn gravity(&self) -> Option<Gravity> {
        self.normal.map(|(up_in_world, std)| Gravity { up_in_world, std })
    }
}

fn describe(alignment: &Alignment, outcome: &mut Outcome) {
    outcome.figure(
        "alignment",
        serde_json::json!({
            "num_fixes": alignment.num_fixes,
            "rejected_share": alignment.rejected_share,
            "noise_factor": alignment.noise_factor,
            "offset_s": alignment.offset_s,
            "offset_std_s": alignment.offset_std_s,
            "tilt_std_deg": alignment.tilt_std().to_degrees(),
            "heading_std_deg": alignment.heading_std().to_degrees(),
        }),
    );
}
