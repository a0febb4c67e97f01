//! Dates of a run: the clock of a receiver's log, or the EXIF blocks of photographs.

use std::collections::BTreeMap;

use super::aligned::Aligned;
use crate::math::median;
use crate::metric::UtcOffset;
use crate::pipeline::MetricOptions;
use crate::pipeline::driver::run::Run;
use crate::pipeline::inputs::telemetry::Telemetry;
use crate::scene::{ClockZone, Dates};
use crate::telemetry::{self, ClockKind, Fix, Log};
use crate::video::{self, CaptureTime, Kind};

/// 6 January 1980, the epoch of satellite time: no receiver states an earlier one, so a smaller time is relative to the
/// video's start.
const EARLIEST_S: f64 = 315_964_800.0;

/// Dates of the run; `None` if no input states any.
pub(super) fn find(run: &Run, telemetry: Option<&Telemetry>, aligned: Option<&Aligned>) -> Option<Dates> {
    let utc_offset = run.options.metric.utc_offset;
    if run.info().kind == Kind::Folder
        && let Some(dates) = of_photographs(run, utc_offset)
    {
        return Some(dates);
    }
    let telemetry = telemetry.filter(|telemetry| !telemetry.origin.is_of_images())?;
    of_log(&telemetry.log, aligned.and_then(|aligned| aligned.clock_offset_s), &run.options.metric)
}

/// Dates by the clock of a log.
///
/// * `fitted_s` – the log's time minus the video's, seconds; `None` if the log does not fit the video.
pub fn of_log(log: &Log, fitted_s: Option<f64>, options: &MetricOptions) -> Option<Dates> {
    let zone = match log.clock {
        ClockKind::Utc => ClockZone::Utc,
        ClockKind::Local => ClockZone::Local,
        ClockKind::TimeOfDay | ClockKind::Absent => return None,
    };
    let stated_s = options.time_offset.map_or(0.0, |offset| offset.mean_s);
    let log_from_video_s = fitted_s.unwrap_or(stated_s);
    let start_s = match clock_from_log_s(&log.fixes) {
        Some(clock_from_log_s) => log_from_video_s + clock_from_log_s,
        // Times of the log are those of its clock.
        None => fitted_s?,
    };
    (start_s >= EARLIEST_S).then(|| match (zone, options.utc_offset) {
        (ClockZone::Local, Some(offset)) => dated(start_s - offset.seconds(), ClockZone::Utc),
        _ => dated(start_s, zone),
    })
}

fn dated(start_s: f64, zone: ClockZone) -> Dates {
    Dates { start_s: Some(start_s), zone, images: BTreeMap::new() }
}

/// Clock time minus video time in a log that states both for its fixes: the median, since their steps differ.
fn clock_from_log_s(fixes: &[Fix]) -> Option<f64> {
    let by_video = fixes.iter().all(|fix| fix.video_s.is_some());
    median(fixes.iter().filter_map(|fix| Some(fix.clock_s? - fix.video_s?)).collect()).filter(|_| by_video)
}

/// Dates of photographs; `None` if none states a date.
fn of_photographs(run: &Run, utc_offset: Option<UtcOffset>) -> Option<Dates> {
    let frames = run.frames().ok()?;
    let taken = |name: &str| Some((name.to_owned(), video::capture_time(&run.input().join(name))?));
    let taken: Vec<(String, CaptureTime)> = frames.iter().filter_map(|frame| taken(&frame.name)).collect();
    let images: BTreeMap<String, String> =
        taken.into_iter().map(|(name, taken)| (name, spelled(&taken, utc_offset))).collect();
    (!images.is_empty()).then_some(Dates { start_s: None, zone: ClockZone::PerImage, images })
}

/// Date in ISO 8601: with `Z` if the time zone is known, else local time without a zone.
fn spelled(taken: &CaptureTime, utc_offset: Option<UtcOffset>) -> String {
    let stated = taken.utc_offset.as_deref().and_then(|text| text.parse::<UtcOffset>().ok());
    let offset = stated.or(utc_offset);
    let Some(offset) = offset else { return taken.local.clone() };
    let utc = telemetry::clock_s(&taken.local).and_then(|local_s| telemetry::date(local_s - offset.seconds(), true));
    utc.unwrap_or_else(|| taken.local.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(utc_offset: Option<&str>) -> CaptureTime {
        CaptureTime { local: "2014-05-01T10:00:00.25".into(), utc_offset: utc_offset.map(str::to_owned) }
    }

    #[test]
    fn photographs_keep_local_time_until_a_zone_is_known() {
        assert_eq!(spelled(&taken(None), None), "2014-05-01T10:00:00.25");
        assert_eq!(spelled(&taken(Some("+02:00")), None), "2014-05-01T08:00:00.25Z");
        assert_eq!(spelled(&taken(None), "-03:30".parse().ok()), "2014-05-01T13:30:00.25Z");
        assert_eq!(spelled(&taken(Some("+02:00")), "-03:30".parse().ok()), "2014-05-01T08:00:00.25Z", "stated wins");
        assert_eq!(spelled(&taken(Some("  :  ")), None), "2014-05-01T10:00:00.25");
    }
}
