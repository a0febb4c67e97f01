//! Candidates for the offset between the clocks of a log and of the video.

use super::telemetry::{Origin, Telemetry};
use crate::metric::{Alignment, Offset};
use crate::pipeline::driver::run::Run;
use crate::telemetry::{self, ClockKind};
use crate::video::{self, Kind};

/// Standard deviation of a container's start time, seconds: rounding to whole seconds, and the delay until recording
/// starts.
const STATED_START_S: f64 = 5.0;

/// Granularity of time zones, seconds: quarters of an hour.
const ZONE_STEP_S: f64 = 900.0;

/// Maximum difference of local time from universal time in these steps: 14 hours.
const MAX_ZONE_STEPS: i32 = 56;

/// Candidates for the offset between log and video, the most certain first. At most one of each list is correct.
///
/// * `log_s` – duration of the log, which begins at `epoch_s`.
pub(super) fn candidates(
    run: &Run,
    telemetry: &Telemetry,
    times: telemetry::TimeBase,
    epoch_s: f64,
    log_s: f64,
) -> Vec<Vec<Offset>> {
    let known = |mean_s, std_s| Offset::Known { mean_s, std_s };
    match (run.options.metric.time_offset, telemetry.origin, times) {
        (_, Origin::Photographs | Origin::ByName, _) => vec![vec![known(0.0, 1e-3)]],
        (Some(offset), _, _) => vec![vec![known(offset.mean_s, offset.std_s)]],
        (None, _, telemetry::TimeBase::Clock) => {
            let stated = stated_start_s(run);
            let utc_offset_s = match telemetry.log.clock {
                ClockKind::Utc => Some(0.0),
                ClockKind::Local => run.options.metric.utc_offset.map(|offset| offset.seconds()),
                ClockKind::TimeOfDay | ClockKind::Absent => None,
            };
            let frames = run.frames().unwrap_or_default();
            let duration_s = frames.last().map_or(0.0, |frame| frame.time_s);
            let as_stated =
                stated.zip(utc_offset_s).map(|(start, zone)| vec![known(start + zone - epoch_s, STATED_START_S)]);
            let has_date = matches!(telemetry.log.clock, ClockKind::Utc | ClockKind::Local);
            let elsewhere = stated.filter(|_| has_date).map(|start| {
                let offsets = in_other_zones(start - epoch_s, duration_s, log_s);
                offsets.into_iter().map(|mean_s| known(mean_s, STATED_START_S)).collect()
            });
            as_stated.into_iter().chain(elsewhere).chain([vec![Offset::Unknown]]).collect()
        }
        (None, _, telemetry::TimeBase::Video) if telemetry.log.is_of_camera() => vec![vec![Offset::SAME_FILE]],
        (None, _, telemetry::TimeBase::Video) => vec![vec![Offset::TWO_BUTTONS], vec![Offset::Unknown]],
    }
}

/// Offsets under the assumptions that the stated time is local, or that of the recording's end, as many dash cameras
/// and drones write it, where the log then covers the video.
fn in_other_zones(stated_s: f64, duration_s: f64, log_s: f64) -> Vec<f64> {
    let starts = [0.0, -duration_s].into_iter().flat_map(|end_s| {
        let steps = -MAX_ZONE_STEPS..=MAX_ZONE_STEPS;
        steps.map(move |step| stated_s + end_s + f64::from(step) * ZONE_STEP_S)
    });
    starts.filter(|start_s| *start_s >= -STATED_START_S && start_s + duration_s <= log_s + STATED_START_S).collect()
}

/// Returns true if two alignments have the same offset: candidates overlap.
pub(super) fn is_same(a: &Alignment, b: &Alignment) -> bool {
    (a.offset_s - b.offset_s).abs() <= 1.0 + 3.0 * a.offset_std_s.hypot(b.offset_std_s)
}

/// Start time of the video by its container, seconds after 1970.
fn stated_start_s(run: &Run) -> Option<f64> {
    /// Cameras without a clock start in 1970 or 1904.
    const FIRST_CAMERAS_S: f64 = 1e9;
    let stated = (run.info().kind == Kind::Video).then(|| video::stated_start(run.input())).flatten()?;
    telemetry::clock_s(&stated).filter(|start_s| *start_s > FIRST_CAMERAS_S)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn zones_and_ends_are_tried_where_the_log_covers_the_video() {
        // The clip begins at second 60 of the log and lasts six seconds.
        assert_eq!(in_other_zones(60.0 + 7200.0, 6.0, 124.0), [60.0, 54.0]);
        assert_eq!(in_other_zones(66.0, 6.0, 124.0), [66.0, 60.0]);
        assert_eq!(in_other_zones(60.0 + 60_000.0, 6.0, 124.0), [0.0; 0]);
    }
}
