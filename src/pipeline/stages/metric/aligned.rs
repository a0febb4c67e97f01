//! Alignment of the camera trajectory with the fixes of the telemetry.

use super::super::background;
use super::sources::{Ground, MAX_TILT};
use crate::metric::{Alignment, Gravity, Kind, Offset, Source, Support};
use crate::pipeline::Result;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::alignment::{FittedLog, fit};
use crate::pipeline::inputs::attitude::orientation;
use crate::pipeline::inputs::hovering::{self, OnMap};
use crate::pipeline::inputs::telemetry::Telemetry;
use crate::scene::{Frame, Reconstruction, Topic, Warning};
use crate::telemetry::LocalFrame;

/// An aligned camera trajectory, with the map frame.
pub(super) struct Aligned {
    pub(super) alignment: Alignment,
    pub(super) map: LocalFrame,
    /// Meters per unit by the alignment, if it determines the scale.
    pub(super) source: Option<Source>,
    /// The log's clock minus the video's time; `None` without a log.
    pub(super) clock_offset_s: Option<f64>,
}

/// Aligns the camera trajectory with the fixes; a failure is reported.
pub(super) fn align(
    run: &Run,
    background: &Reconstruction,
    ground: &Ground,
    telemetry: &Telemetry,
    outcome: &mut Outcome,
) -> Option<Aligned> {
    let aligned = try_align(run, background, ground, telemetry, outcome);
    let aligned =
        aligned.map_err(|reason| outcome.warn(does_not_fit(telemetry, "positions give no scale:", &reason))).ok()?;
    describe(&aligned.alignment, outcome);
    Some(aligned)
}

fn does_not_fit(telemetry: &Telemetry, problem: &str, reason: &str) -> Warning {
    let text = format!("{}: {problem} {reason}", telemetry.path.display());
    Topic::TelemetryDoesNotFit.warning(text)
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
    let FittedLog { alignment, map, epoch_s, refusal } = fit(run, background, telemetry, support)?;
    let clock_offset_s = epoch_s + alignment.offset_s;
    if let Some(reason) = refusal {
        outcome.warn(Topic::TelemetryAtAnotherTime.warning(format!(
            "{}: stated time does not fit the video ({reason}); by its trajectory the log's clock is \
             {clock_offset_s:.1} s ahead of the video's; give --time-offset SECONDS if that is wrong, --no-telemetry \
             if it is the log of another flight",
            telemetry.path.display()
        )));
    }
    let source = alignment.source(telemetry.origin.source_name(), Kind::Telemetry);
    Ok(Aligned { alignment, map, source: Some(source), clock_offset_s: Some(clock_offset_s) })
}

/// A camera that does not translate, by map points or by a log; with the height above take-off as that above ground.
///
/// # Errors
/// Map points from which no camera pose follows.
pub(super) fn hovering(
    run: &Run,
    background: &Reconstruction,
    ground: &Ground,
    telemetry: Option<&Telemetry>,
    outcome: &mut Outcome,
) -> Result<(Option<Aligned>, Option<Source>)> {
    let focal_std = background::focal_deviation(run)?.unwrap_or(0.0);
    let of_map = hovering::on_map_points(&run.options.metric, background, focal_std)?;
    let of_map = of_map.map(|OnMap { alignment, map, .. }| {
        describe(&alignment, outcome);
        let source = Some(alignment.source("map points", Kind::Surveyed));
        Aligned { alignment, map, source, clock_offset_s: None }
    });
    let station = telemetry.and_then(|log| {
        let found = hovering::station(run, background, log);
        found.map_err(|reason| outcome.warn(does_not_fit(log, "positions give no map:", &reason))).ok()
    });
    let of_height =
        station.as_ref().zip(ground.height().ok()).and_then(|(station, height)| station.source_of_height(&height));
    let of_log = || {
        let station = station?;
        let (alignment, clock_offset_s) = (station.alignment()?, Some(station.clock_offset_s()));
        Some(Aligned { alignment, map: station.map, source: None, clock_offset_s })
    };
    Ok((of_map.or_else(of_log), of_height))
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
    let gravity = ground.normal.map(|(up_in_world, std)| Gravity { up_in_world, std });
    let by_ground = Support { offset, gravity, orientation: None };
    let Offset::Known { mean_s, .. } = offset else { return by_ground };
    let Some(found) = orientation(background, frames, &telemetry.log.fixes, epoch_s + mean_s) else {
        return by_ground;
    };
    let up = found.metric_from_world.inverse() * nalgebra::Vector3::z();
    if ground.normal.is_none_or(|(normal, _)| up.angle(&normal) <= MAX_TILT) {
        return Support { offset, gravity: None, orientation: Some(found) };
    }
    let text = "telemetry: camera attitude does not fit the ground; attitude ignored";
    outcome.warn(Topic::CameraAttitudeIgnored.warning(text));
    by_ground
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
