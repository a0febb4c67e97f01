//! Summary of a telemetry file, as text and JSON.

use std::collections::BTreeMap;
use std::fmt::Write;

use serde::Serialize;

use super::fix::{ClockKind, Fix, HeightDatum, Log, SkippedEntry};
use super::geodesy::{Geodetic, LocalFrame};
use super::gpmf::Lens;
use super::local::DEGREE_M;
use super::time;

/// Minimum and maximum of a quantity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Range {
    /// Minimum.
    pub least: f64,
    /// Maximum.
    pub most: f64,
}

impl Range {
    /// Extends a range by a value.
    pub(super) fn with(range: Option<Self>, value: f64) -> Self {
        let range = range.unwrap_or(Self { least: value, most: value });
        Self { least: range.least.min(value), most: range.most.max(value) }
    }

    fn of(values: impl Iterator<Item = f64>) -> Option<Self> {
        values.fold(None, |range, value| Some(Self::with(range, value)))
    }
}

/// Summary of a log.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Number of fixes by format or dialect.
    pub dialects: BTreeMap<&'static str, usize>,
    /// Number of fixes.
    pub num_fixes: usize,
    /// First and last video time, seconds.
    pub video_s: Option<Range>,
    /// Kind of clock.
    pub clock: ClockKind,
    /// First time on the clock.
    pub first_clock: Option<String>,
    /// Last time on the clock.
    pub last_clock: Option<String>,
    /// Fixes per second, counting only fixes whose position differs from the previous one.
    pub rate_hz: Option<f64>,
    /// Longitudes, degrees.
    pub longitude_deg: Option<Range>,
    /// Latitudes, degrees.
    pub latitude_deg: Option<Range>,
    /// Coarsest value of the last digit of longitude and latitude on the ground (north–south), meters.
    pub resolution_m: Option<f64>,
    /// Diagonal of the ground area covered by the fixes, meters.
    pub extent_m: f64,
    /// Absolute heights, meters.
    pub gps_height_m: Option<Range>,
    /// Reference of the absolute heights.
    pub height_datum: HeightDatum,
    /// Heights above take-off, meters.
    pub relative_height_m: Option<Range>,
    /// Horizontal standard deviation, stated or typical, meters.
    pub horizontal_std_m: Option<Range>,
    /// Number of fixes with a speed.
    pub num_speeds: usize,
    /// Number of fixes with the camera's attitude.
    pub num_gimbals: usize,
    /// Number of gravity directions in the image.
    pub num_gravities: usize,
    /// Number of camera attitudes relative to the start.
    pub num_rotations: usize,
    /// Exposure times, seconds.
    pub exposure_s: Option<Range>,
    /// Camera and lens.
    pub lens: Option<Lens>,
    /// 35 mm equivalent focal lengths, millimeters.
    pub film_focal_mm: Option<Range>,
    /// Number of lines without a usable fix.
    pub num_passed_over: usize,
    /// The first of these lines.
    pub passed_over: Vec<SkippedEntry>,
}

impl Log {
    /// Summarizes the log.
    pub fn summary(&self) -> Summary {
        let range = |value: fn(&Fix) -> Option<f64>| Range::of(self.fixes.iter().filter_map(value));
        let clock = range(|fix| fix.clock_s);
        let spelled = |clock_s: Option<f64>| clock_s.and_then(time::spelled);
        Summary {
            dialects: self.dialects(),
            num_fixes: self.fixes.len(),
            video_s: range(|fix| fix.video_s),
            clock: self.clock,
            first_clock: spelled(clock.map(|range| range.least)),
            last_clock: spelled(clock.map(|range| range.most)),
            rate_hz: self.rate_hz(),
            longitude_deg: range(|fix| Some(fix.longitude_deg)),
            latitude_deg: range(|fix| Some(fix.latitude_deg)),
            resolution_m: range(|fix| Some(fix.resolution_deg * DEGREE_M)).map(|range| range.most),
            extent_m: self.extent_m(),
            gps_height_m: range(|fix| fix.gps_height_m),
            height_datum: self.height_datum,
            relative_height_m: range(|fix| fix.relative_height_m),
            horizontal_std_m: range(|fix| Some(fix.horizontal_std_m)),
            num_speeds: self.fixes.iter().filter(|fix| fix.speed_m_s.is_some()).count(),
            num_gimbals: self.fixes.iter().filter(|fix| fix.gimbal.is_some()).count(),
            num_gravities: self.camera.iter().filter(|sample| sample.down_in_image.is_some()).count(),
            num_rotations: self.camera.iter().filter(|sample| sample.image_from_start.is_some()).count(),
            exposure_s: self.exposure_s,
            lens: self.lens.clone(),
            film_focal_mm: self.film_focal_mm,
            num_passed_over: self.num_passed_over,
            passed_over: self.passed_over.clone(),
        }
    }

    /// Rate of fixes; `None` if the log is shorter than the resolution of its times.
    fn rate_hz(&self) -> Option<f64> {
        let place = |fix: &Fix| (fix.longitude_deg, fix.latitude_deg);
        let moves = self.fixes.windows(2).filter(|pair| place(&pair[0]) != place(&pair[1])).count();
        let time_s = |fix: &Fix| fix.video_s.or(fix.clock_s);
        let (first, last) = (time_s(self.fixes.first()?)?, time_s(self.fixes.last()?)?);
        // Logs write times to a millisecond.
        (last - first >= 1e-3 && moves > 0).then(|| moves as f64 / (last - first))
    }

    fn extent_m(&self) -> f64 {
        let Some(first) = self.fixes.first() else { return 0.0 };
        let place =
            |fix: &Fix| Geodetic { longitude_deg: fix.longitude_deg, latitude_deg: fix.latitude_deg, height_m: 0.0 };
        let frame = LocalFrame::at(place(first));
        let points: Vec<_> = self.fixes.iter().map(|fix| frame.from_geodetic(place(fix))).collect();
        let side = |axis: usize| {
            Range::of(points.iter().map(|point| point[axis])).map_or(0.0, |range| range.most - range.least)
        };
        side(0).hypot(side(1))
    }
}

impl Summary {
    /// Formats the summary as a few lines of text.
    pub fn as_text(&self) -> String {
        let mut text = String::new();
        let mut line = |name: &str, value: String| {
            let _ = writeln!(text, "{name:<16}{value}");
        };
        let names = self.dialects.iter().map(|(name, count)| format!("{name} ({count})")).collect::<Vec<_>>();
        line("dialect", names.join(", "));
        let rate = self.rate_hz.map_or(String::new(), |rate| format!(", position rate {rate:.2} Hz"));
        line("fixes", format!("{}{rate}", self.num_fixes));
        let shown = |range: Option<Range>, digits: usize, unit: &str| match range {
            None => "none".to_owned(),
            Some(Range { least, most }) => format!("{least:.digits$} to {most:.digits$}{unit}"),
        };
        line("time in video", shown(self.video_s, 3, " s"));
        let zone = match self.clock {
            ClockKind::Utc => " UTC",
            ClockKind::Local => " (unknown zone)",
            ClockKind::TimeOfDay => " (no date)",
            ClockKind::Absent => "",
        };
        let clock = self.first_clock.as_ref().zip(self.last_clock.as_ref());
        line("clock", clock.map_or("none".to_owned(), |(first, last)| format!("{first} to {last}{zone}")));
        line("longitude", shown(self.longitude_deg, 7, "°"));
        line("latitude", shown(self.latitude_deg, 7, "°"));
        let resolution = self.resolution_m.map_or(String::new(), |metres| format!(", last digit {metres:.2} m"));
        line("extent", format!("{:.1} m{resolution}", self.extent_m));
        let datum = match self.height_datum {
            HeightDatum::Ellipsoid => " m above the ellipsoid",
            HeightDatum::SeaLevel => " m above sea level",
            HeightDatum::Unstated => " m, datum unknown",
        };
        line("GPS height", shown(self.gps_height_m, 2, datum));
        line("above take-off", shown(self.relative_height_m, 2, " m"));
        line("deviation", shown(self.horizontal_std_m, 2, " m horizontally"));
        line("also", format!("{} speeds, {} attitudes of the camera", self.num_speeds, self.num_gimbals));
        if self.num_gravities + self.num_rotations > 0 {
            line("camera", format!("{} directions of gravity, {} rotations", self.num_gravities, self.num_rotations));
        }
        if let Some(Range { least, most }) = self.exposure_s {
            line("exposure", format!("{:.3} to {:.3} ms", 1e3 * least, 1e3 * most));
        }
        if let Some(lens) = &self.lens {
            line("lens", lens.as_text());
        }
        if let Some(Range { least, most }) = self.film_focal_mm {
            line("focal length", format!("{least} to {most} mm (35 mm equivalent)"));
        }
        line("skipped", self.num_passed_over.to_string());
        self.passed_over.iter().for_each(|passed| line("", passed.to_string()));
        text
    }
}
