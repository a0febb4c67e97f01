//! Telemetry log in meters east, north and up of its first fix.

use std::collections::BTreeMap;

use nalgebra::Point3;

use super::fix::{Fix, Log};
use super::geodesy::{Geodetic, LocalFrame};
use crate::math::median;
use crate::metric::PositionFix;
use crate::scene::MapOrigin;

/// Height source of a log; the two kinds are never mixed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heights {
    /// Barometric, above take-off: smoother than the receiver's heights.
    Relative,
    /// Absolute heights.
    Absolute,
    /// No heights.
    Absent,
}

/// Origin of a log's times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeBase {
    /// Start of the video.
    Video,
    /// 1970, on the log's clock.
    Clock,
}

/// Fixes in meters.
#[derive(Clone, Debug, PartialEq)]
pub struct LocalFixes {
    /// Converts meters to longitude, latitude and height.
    pub frame: LocalFrame,
    /// The fixes, in order of time.
    pub fixes: Vec<PositionFix>,
    /// Height source of the fixes.
    pub heights: Heights,
    /// Origin of the fixes' times.
    pub times: TimeBase,
    /// Time offset of the fixes, seconds from the origin: in seconds after 1970 a number has too few digits for steps
    /// of milliseconds.
    pub epoch_s: f64,
}

/// Standard deviation of a barometric height over a flight, meters: weather and wind at the sensor.
const BAROMETER_STD_M: f64 = 1.0;

/// Length of a degree of latitude, meters.
pub(super) const DEGREE_M: f64 = 111_320.0;

/// Minimum share of fixes with a height of some kind for that kind to be used.
const MIN_SHARE: f64 = 0.9;

impl Log {
    /// Fixes with a time, in meters; `None` if there are none. Video time is used if all fixes have it.
    pub fn local_fixes(&self) -> Option<LocalFixes> {
        let by_video = self.fixes.iter().all(|fix| fix.video_s.is_some());
        let times = if by_video { TimeBase::Video } else { TimeBase::Clock };
        self.local_fixes_at(times, |fix| if by_video { fix.video_s } else { fix.clock_s })
    }

    /// As [`Self::local_fixes`], at given times, for example those of photographs by name.
    pub fn local_fixes_at(&self, times: TimeBase, time_s: impl Fn(&Fix) -> Option<f64>) -> Option<LocalFixes> {
        let timed: Vec<(&Fix, f64)> = self.fixes.iter().filter_map(|fix| Some((fix, time_s(fix)?))).collect();
        let (first, first_s) = timed.first()?;
        let heights = self.heights();
        let takeoff_m = self.takeoff_height_m();
        let (height_m, knows_height) = match heights {
            Heights::Relative => (takeoff_m.unwrap_or(0.0), takeoff_m.is_some()),
            Heights::Absolute => (first.gps_height_m.unwrap_or(0.0), true),
            Heights::Absent => (0.0, false),
        };
        let Fix { longitude_deg: longitude, latitude_deg: latitude, .. } = **first;
        let frame = LocalFrame { origin: MapOrigin { longitude, latitude, height_m, knows_height } };
        let epoch_s = if times == TimeBase::Clock { *first_s } else { 0.0 };
        let fixes = timed.iter().map(|(fix, time_s)| local(fix, *time_s - epoch_s, &frame, heights)).collect();
        Some(LocalFixes { frame, fixes, heights, times, epoch_s })
    }

    /// Returns true if every fix is tied to an image by name: the log of a folder, without a clock.
    pub fn is_by_name(&self) -> bool {
        self.fixes.iter().all(|fix| fix.photograph.is_some())
    }

    /// Positions of images by name, meters east, north and up of the first one.
    pub fn positions_by_name(&self) -> BTreeMap<String, Point3<f64>> {
        let Some(local) = self.local_fixes_at(TimeBase::Video, |_| Some(0.0)) else { return BTreeMap::new() };
        let at = |fix: &PositionFix| Point3::new(fix.east_north_m.x, fix.east_north_m.y, fix.up_m.unwrap_or(0.0));
        self.fixes
            .iter()
            .zip(&local.fixes)
            .filter_map(|(fix, place)| Some((fix.photograph.clone()?, at(place))))
            .collect()
    }

    fn heights(&self) -> Heights {
        let share = |has: fn(&Fix) -> bool| {
            self.fixes.iter().filter(|fix| has(fix)).count() as f64 / self.fixes.len().max(1) as f64
        };
        if share(|fix| fix.relative_height_m.is_some()) >= MIN_SHARE {
            Heights::Relative
        } else if share(|fix| fix.gps_height_m.is_some()) >= MIN_SHARE {
            Heights::Absolute
        } else {
            Heights::Absent
        }
    }

    /// Absolute height of the take-off point: the median difference of the absolute and the relative heights.
    fn takeoff_height_m(&self) -> Option<f64> {
        let differences = self.fixes.iter().filter_map(|fix| Some(fix.gps_height_m? - fix.relative_height_m?));
        median(differences.collect())
    }
}

fn local(fix: &Fix, time_s: f64, frame: &LocalFrame, heights: Heights) -> PositionFix {
    let height_m = match heights {
        Heights::Relative => fix.relative_height_m.map(|height| frame.origin.height_m + height),
        Heights::Absolute => fix.gps_height_m,
        Heights::Absent => None,
    };
    let Fix { longitude_deg, latitude_deg, .. } = *fix;
    let place = Geodetic { longitude_deg, latitude_deg, height_m: height_m.unwrap_or(frame.origin.height_m) };
    let point_m = frame.from_geodetic(place);
    PositionFix {
        time_s,
        east_north_m: point_m.coords.xy(),
        up_m: height_m.map(|_| point_m.z),
        horizontal_std_m: fix.horizontal_std_m,
        vertical_std_m: if heights == Heights::Relative { BAROMETER_STD_M } else { fix.vertical_std_m },
        rounding_m: fix.resolution_deg * DEGREE_M,
    }
}

#[cfg(test)]
mod tests {
    use super::super::fix::Position;
    use super::*;

    fn fix(i: u32, gps_height_m: Option<f64>, relative_height_m: Option<f64>) -> Fix {
        let position = Position { longitude_deg: 9.2, latitude_deg: 48.1 + 1e-4 * f64::from(i), resolution_deg: 1e-6 };
        let video_s = Some(f64::from(i));
        Fix { video_s, clock_s: video_s, gps_height_m, relative_height_m, ..Fix::at(1, position) }
    }

    fn log(fixes: Vec<Fix>) -> LocalFixes {
        Log { fixes, ..Log::default() }.local_fixes().unwrap()
    }

    #[test]
    fn heights_above_take_off_are_preferred_to_absolute_ones_and_not_mixed() {
        let noise = [3.0, -1.0, 0.0, 2.0, -2.0];
        let fixes = (0..5).map(|i| fix(i, Some(500.0 + noise[i as usize]), Some(10.0))).collect();
        let found = log(fixes);
        assert_eq!(
            (found.heights, found.times, found.frame.origin.knows_height),
            (Heights::Relative, TimeBase::Video, true)
        );
        // The local frame is tangent to the Earth: at 44 m the difference is 0.15 mm.
        assert!(found.fixes.iter().all(|fix| (fix.up_m.unwrap() - 10.0).abs() < 1e-3), "{:?}", found.fixes);
        assert!((found.fixes[4].east_north_m.y - 44.48).abs() < 0.02, "{:?}", found.fixes[4]);
        let PositionFix { east_north_m, up_m, .. } = found.fixes[4];
        let back = found.frame.to_geodetic([east_north_m.x, east_north_m.y, up_m.unwrap()].into());
        assert!((back.latitude_deg - 48.1004).abs() < 1e-9 && (back.height_m - 500.0).abs() < 1e-4, "{back:?}");
    }

    #[test]
    fn logs_with_one_kind_of_height_or_none() {
        let absolute = log((0..3).map(|i| fix(i, Some(500.0 + f64::from(i)), None)).collect());
        assert_eq!((absolute.heights, absolute.frame.origin.knows_height), (Heights::Absolute, true));
        assert!((absolute.fixes[2].up_m.unwrap() - 2.0).abs() < 1e-3 && absolute.fixes[0].up_m == Some(0.0));
        let none = log((0..3).map(|i| fix(i, None, None)).collect());
        assert_eq!((none.heights, none.frame.origin.knows_height, none.fixes[1].up_m), (Heights::Absent, false, None));
        let relative = log((0..3).map(|i| fix(i, None, Some(7.0))).collect());
        assert_eq!((relative.heights, relative.frame.origin.knows_height), (Heights::Relative, false));
        assert_eq!(Log::default().local_fixes(), None);
    }
}
