//! Alignment of a telemetry log with the camera trajectory of a run.

use std::collections::BTreeMap;

use super::clock_offsets;
use super::telemetry::{Origin, Telemetry};
use crate::metric::{Alignment, CameraPath, DRIFT, Offset, Refusal, Support, align_to_fixes};
use crate::pipeline::driver::run::Run;
use crate::scene::{Frame, Image, Reconstruction, TimeBase};
use crate::telemetry::{self, Fix, LocalFixes, LocalFrame};

/// A log aligned with the camera trajectory.
pub(in crate::pipeline) struct FittedLog {
    pub(in crate::pipeline) alignment: Alignment,
    pub(in crate::pipeline) map: LocalFrame,
    /// Epoch of the log's times, seconds of its clock.
    pub(in crate::pipeline) epoch_s: f64,
    /// Reason why the log does not fit at its stated offset.
    pub(in crate::pipeline) refusal: Option<Refusal>,
}

/// Aligns a log with the camera trajectory of the background.
///
/// * `support` – evidence from other sources, by offset and epoch of the log's times.
///
/// # Errors
/// The reason why the log cannot be aligned.
pub(in crate::pipeline) fn fit(
    run: &Run,
    background: &Reconstruction,
    telemetry: &Telemetry,
    mut support: impl FnMut(Offset, f64) -> Support,
) -> Result<FittedLog, String> {
    let frames = run.frames().map_err(|error| error.to_string())?;
    if !telemetry.origin.is_of_images() && run.info().time_base() == TimeBase::Frames {
        return Err("frames without times; give --fps RATE".to_owned());
    }
    let LocalFixes { frame: map, fixes, times, epoch_s, .. } = local_fixes(telemetry, frames)?;
    let path = camera_path(background, frames)?;
    let log_s = fixes.iter().map(|fix| fix.time_s).fold(0.0, f64::max);
    let mut refusal = None;
    for candidates in clock_offsets::candidates(run, telemetry, times, epoch_s, log_s) {
        let mut fitting: Vec<Alignment> = Vec::new();
        for offset in candidates {
            match align_to_fixes(&path, &fixes, &support(offset, epoch_s)) {
                Ok(alignment) if !is_finite(&alignment) => return Err("fit is not finite".to_owned()),
                Ok(alignment) if fitting.iter().any(|other| clock_offsets::is_same(other, &alignment)) => {}
                Ok(alignment) => fitting.push(alignment),
                Err(reason) => refusal = refusal.or(Some(reason)),
            }
        }
        if let [_] = fitting[..] {
            let alignment = fitting.swap_remove(0);
            return Ok(FittedLog { alignment, map, epoch_s, refusal });
        }
    }
    Err(refusal.as_ref().map_or_else(String::new, Refusal::to_string))
}

fn is_finite(alignment: &Alignment) -> bool {
    let Alignment { metric_from_world, covariance, offset_s, offset_std_s, .. } = alignment;
    let numbers = [metric_from_world.scale, *offset_s, *offset_std_s];
    let values = numbers.iter().chain(metric_from_world.translation.iter()).chain(covariance.iter());
    values.into_iter().all(|value| value.is_finite())
}

/// The fixes in metres.
pub(super) fn local_fixes(telemetry: &Telemetry, frames: &[Frame]) -> Result<LocalFixes, String> {
    let by_name: BTreeMap<&str, f64> = frames.iter().map(|frame| (frame.name.as_str(), frame.time_s)).collect();
    let of_photograph = |fix: &Fix| by_name.get(fix.photograph.as_deref()?).copied();
    let local = match telemetry.origin {
        Origin::Photographs | Origin::ByName => telemetry.log.local_fixes_at(telemetry::TimeBase::Video, of_photograph),
        Origin::Named | Origin::Beside | Origin::Inside => telemetry.log.local_fixes(),
    };
    Ok(local.ok_or("no position with a time")?)
}

/// The camera centers in temporal order.
fn camera_path(background: &Reconstruction, frames: &[Frame]) -> Result<CameraPath, String> {
    let seen = registered(background, frames);
    let poses = seen.iter().map(|(frame, image)| (frame.time_s, image.cam_from_world.center())).collect();
    CameraPath::with_drift(poses, DRIFT).ok_or_else(|| "fewer than two frames registered".to_owned())
}

pub(in crate::pipeline) fn registered<'a>(
    background: &'a Reconstruction,
    frames: &'a [Frame],
) -> Vec<(&'a Frame, &'a Image)> {
    frames.iter().filter_map(|frame| Some((frame, background.images.get(&frame.id.into())?))).collect()
}
