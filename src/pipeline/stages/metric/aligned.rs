//! The camera's path on the fixes of the telemetry.

use std::collections::BTreeMap;

use nalgebra::UnitQuaternion;

use super::sources::{Ground, MAX_TILT};
use crate::metric::{
    self, Alignment, CameraPath, Gravity, Offset, Orientation, Refusal, Source, Support, align_to_fixes,
    metric_from_cam,
};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::telemetry::{Origin, Telemetry};
use crate::scene::{Frame, Image, MapOrigin, Reconstruction, TimeBase, Topic};
use crate::telemetry::{self, ClockKind, Fix, LocalFixes, LocalFrame};
use crate::video::{self, Kind};

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
        let name = match self.origin {
            Origin::Photographs => "positions of the photographs",
            Origin::Named | Origin::Beside | Origin::Inside => "telemetry",
        };
        Source {
            name: name.to_owned(),
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

/// Deviation of camera centres, as a share of the way: what reconstructions drift by.
const DRIFT: f64 = 0.002;

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
    if telemetry.origin != Origin::Photographs && run.info().time_base() == TimeBase::Frames {
        return Err("frames without times; give --fps RATE".to_owned());
    }
    let (LocalFixes { frame: map, knows_height, mut fixes, times, .. }, epoch_s) = local_fixes(telemetry, frames)?;
    fixes.iter_mut().for_each(|fix| fix.time_s -= epoch_s);
    let path = camera_path(background, frames)?;
    let offsets = offsets(run, telemetry, times, epoch_s);
    let mut refusal = None;
    for offset in offsets {
        let support = support(background, frames, telemetry, ground, offset, epoch_s, outcome);
        match align_to_fixes(&path, &fixes, &support) {
            Ok(alignment) if !is_finite(&alignment) => return Err("fit is not finite".to_owned()),
            Ok(alignment) => {
                let aligned = Aligned { alignment, map, knows_height, epoch_s, origin: telemetry.origin };
                warn_of_other_clock(telemetry, &aligned, refusal.as_ref(), outcome);
                return Ok(aligned);
            }
            Err(reason) => refusal = refusal.or(Some(reason)),
        }
    }
    Err(refusal.as_ref().map_or_else(String::new, Refusal::to_string))
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

fn is_finite(alignment: &Alignment) -> bool {
    let Alignment { metric_from_world, covariance, offset_s, offset_std_s, .. } = alignment;
    let numbers = [metric_from_world.scale, *offset_s, *offset_std_s];
    let values = numbers.iter().chain(metric_from_world.translation.iter()).chain(covariance.iter());
    values.into_iter().all(|value| value.is_finite())
}

/// The fixes in metres, and the time from which the log's clock is to be counted: seconds after 1970 have too few
/// digits for a step of milliseconds.
fn local_fixes(telemetry: &Telemetry, frames: &[Frame]) -> Result<(LocalFixes, f64), String> {
    let by_name: BTreeMap<&str, f64> = frames.iter().map(|frame| (frame.name.as_str(), frame.time_s)).collect();
    let of_photograph = |fix: &Fix| by_name.get(fix.photograph.as_deref()?).copied();
    let local = match telemetry.origin {
        Origin::Photographs => telemetry.log.local_fixes_at(telemetry::TimeBase::Video, of_photograph),
        Origin::Named | Origin::Beside | Origin::Inside => telemetry.log.local_fixes(),
    };
    let local = local.ok_or("no position with a time")?;
    let first_s = local.fixes.first().map_or(0.0, |fix| fix.time_s);
    let epoch_s = if local.times == telemetry::TimeBase::Clock { first_s } else { 0.0 };
    Ok((local, epoch_s))
}

/// The camera's centres in the order of time.
fn camera_path(background: &Reconstruction, frames: &[Frame]) -> Result<CameraPath, String> {
    let seen = registered(background, frames);
    let poses: Vec<_> = seen.iter().map(|(frame, image)| (frame.time_s, image.cam_from_world.center())).collect();
    let way: f64 = poses.windows(2).map(|pair| (pair[1].1 - pair[0].1).norm()).filter(|step| step.is_finite()).sum();
    CameraPath::new(poses, DRIFT * way).ok_or_else(|| "fewer than two frames registered".to_owned())
}

pub(super) fn registered<'a>(background: &'a Reconstruction, frames: &'a [Frame]) -> Vec<(&'a Frame, &'a Image)> {
    let by_name: BTreeMap<&str, &Image> =
        background.images.values().map(|image| (image.name.as_str(), image)).collect();
    frames.iter().filter_map(|frame| Some((frame, *by_name.get(frame.name.as_str())?))).collect()
}

/// Columns of times are meant to count from the video's start: as well as people press two buttons at once, seconds.
const TWO_BUTTONS_S: f64 = 2.0;

/// Standard deviation of a container's start time, seconds: whole seconds, and the delay until the camera records.
const STATED_START_S: f64 = 5.0;

/// Candidates for the offset between log and video, the most certain first.
fn offsets(run: &Run, telemetry: &Telemetry, times: telemetry::TimeBase, epoch_s: f64) -> Vec<Offset> {
    let known = |mean_s, std_s| Offset::Known { mean_s, std_s };
    let of_camera = |dialect: &&str| dialect.starts_with("dji") || dialect.starts_with("gpmf");
    let is_of_camera = telemetry.log.dialects().keys().any(of_camera);
    match (run.options.metric.time_offset, telemetry.origin, times) {
        (_, Origin::Photographs, _) => vec![known(0.0, 1e-3)],
        (Some(offset), _, _) => vec![known(offset.mean_s, offset.std_s)],
        (None, _, telemetry::TimeBase::Clock) => {
            let stated = stated_start_s(run, telemetry).map(|start_s| known(start_s - epoch_s, STATED_START_S));
            stated.into_iter().chain([Offset::Unknown]).collect()
        }
        (None, _, telemetry::TimeBase::Video) if is_of_camera => vec![Offset::SAME_FILE],
        (None, _, telemetry::TimeBase::Video) => vec![known(0.0, TWO_BUTTONS_S), Offset::Unknown],
    }
}

/// When the video was begun by its own account, seconds after 1970; `None` where the log's clock is another one.
fn stated_start_s(run: &Run, telemetry: &Telemetry) -> Option<f64> {
    /// Cameras without a clock begin in 1970 or 1904.
    const FIRST_CAMERAS_S: f64 = 1e9;
    let utc_offset_s = match telemetry.log.clock {
        ClockKind::Utc => 0.0,
        ClockKind::Local => run.options.metric.utc_offset?.seconds(),
        ClockKind::TimeOfDay | ClockKind::Absent => return None,
    };
    let stated = (run.info().kind == Kind::Video).then(|| video::stated_start(run.input())).flatten()?;
    telemetry::clock_s(&stated).filter(|start_s| *start_s > FIRST_CAMERAS_S).map(|start_s| start_s + utc_offset_s)
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
