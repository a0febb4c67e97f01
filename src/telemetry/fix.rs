//! Telemetry data types: a fix, a log of fixes, and the accuracy of a receiver.

use std::collections::BTreeMap;
use std::fmt;

use nalgebra::{UnitQuaternion, Vector3};
use serde::Serialize;

use super::gpmf::Lens;
use super::summary::Range;

use crate::memory::MemoryLimit;

/// One position of the receiver.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Fix {
    /// Format or dialect of the fix.
    pub dialect: &'static str,
    /// Line in the file, from 1; for photographs the number of the file, for GPMF the number of the payload.
    pub line: usize,
    /// File name of the photograph with this fix.
    pub photograph: Option<String>,
    /// Seconds after the video's start, where the file is tied to a video.
    pub video_s: Option<f64>,
    /// Seconds after 1970-01-01T00:00:00 on the file's clock, whose kind is in the [`Log`].
    pub clock_s: Option<f64>,
    /// East of Greenwich, degrees, −180 to 180.
    pub longitude_deg: f64,
    /// North of the equator, degrees, −90 to 90.
    pub latitude_deg: f64,
    /// Value of the last digit of longitude and latitude, degrees.
    pub resolution_deg: f64,
    /// Absolute height, meters; the [`Log`] states its reference.
    pub gps_height_m: Option<f64>,
    /// Barometric height above the take-off point, meters.
    pub relative_height_m: Option<f64>,
    /// Standard deviation of the position in either horizontal direction, meters: as stated, otherwise the receiver's.
    pub horizontal_std_m: f64,
    /// Standard deviation of the absolute height, meters.
    pub vertical_std_m: f64,
    /// Attitude of the vehicle that carries the camera.
    pub attitude: Option<Angles>,
    /// Attitude of the camera.
    pub gimbal: Option<Angles>,
    /// Horizontal speed stated by the receiver, meters per second.
    pub speed_m_s: Option<f64>,
}

impl Fix {
    /// Creates a fix of a plain receiver with a position only.
    pub(super) fn at(line: usize, position: Position) -> Self {
        let (horizontal_std_m, vertical_std_m) = Receiver::Plain.std_m();
        let Position { longitude_deg, latitude_deg, resolution_deg } = position;
        Self { line, longitude_deg, latitude_deg, resolution_deg, horizontal_std_m, vertical_std_m, ..Self::default() }
    }

    /// Takes the standard deviations of a kind of receiver, scaled by its dilution of precision where that is stated.
    pub(super) fn received_by(mut self, receiver: Receiver, dilution: Option<f64>) -> Self {
        let (horizontal, vertical) = receiver.std_m();
        // A dilution above 50 is hardly a fix at all.
        let factor = dilution.map_or(1.0, |dilution| dilution.clamp(1.0, 50.0));
        (self.horizontal_std_m, self.vertical_std_m) = (horizontal * factor, vertical * factor);
        self
    }
}

/// Validated longitude and latitude.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Position {
    pub(super) longitude_deg: f64,
    pub(super) latitude_deg: f64,
    /// Value of the last digit.
    pub(super) resolution_deg: f64,
}

/// Attitude of a body, radians: yaw, then pitch, then roll (DJI's order ZYX).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Angles {
    /// Clockwise from north, seen from above.
    pub yaw: f64,
    /// Nose up; −π/2 points straight down.
    pub pitch: f64,
    /// To the right.
    pub roll: f64,
}

impl Angles {
    pub(super) fn from_degrees(yaw: f64, pitch: f64, roll: f64) -> Self {
        Self { yaw: yaw.to_radians(), pitch: pitch.to_radians(), roll: roll.to_radians() }
    }
}

/// Kind of receiver, by its accuracy.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Receiver {
    /// Corrected by a base station, carrier phases resolved.
    RtkFixed,
    /// Corrected by a base station, carrier phases not resolved.
    RtkFloat,
    /// Corrected by satellites (SBAS) or a coarse base station.
    Differential,
    /// No correction.
    Plain,
}

impl Receiver {
    /// Horizontal (either direction) and vertical standard deviation under an open sky, meters. `docs/telemetry.md` has
    /// the sources.
    pub fn std_m(self) -> (f64, f64) {
        match self {
            Self::RtkFixed => (0.02, 0.04),
            Self::RtkFloat => (0.4, 0.6),
            Self::Differential => (1.0, 2.0),
            Self::Plain => (3.4, 6.6),
        }
    }
}

/// Reference of absolute heights.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum HeightDatum {
    /// The ellipsoid of WGS 84.
    Ellipsoid,
    /// Mean sea level, by a geoid model.
    SeaLevel,
    /// Not stated in the file.
    #[default]
    Unstated,
}

/// Kind of a log's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum ClockKind {
    /// Universal time.
    Utc,
    /// Time of an unknown zone.
    Local,
    /// Time of day alone: no date.
    TimeOfDay,
    /// No clock.
    #[default]
    Absent,
}

/// Entry of a file without a usable fix.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SkippedEntry {
    /// Line, from 1; for photographs the number of the file, for GPMF the number of the payload.
    pub line: usize,
    /// Reason.
    pub reason: String,
}

impl fmt::Display for SkippedEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.reason)
    }
}

/// Camera state at a video time, in the axes of the stored image: x right, y down, z forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraSample {
    /// Seconds after the video's start.
    pub video_s: f64,
    /// Direction of gravity, unit vector.
    pub down_in_image: Option<Vector3<f64>>,
    /// Axes of the image from those of the camera at the start of the recording.
    pub image_from_start: Option<UnitQuaternion<f64>>,
}

/// Content of a telemetry file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Log {
    /// Fixes in order of time; fixes without a time in order of the file.
    pub fixes: Vec<Fix>,
    /// Kind of clock.
    pub clock: ClockKind,
    /// Reference of `gps_height_m`.
    pub height_datum: HeightDatum,
    /// The first skipped entries, in order of the file.
    pub passed_over: Vec<SkippedEntry>,
    /// Number of skipped lines.
    pub num_passed_over: usize,
    /// Gravity and camera attitude, in order of time.
    pub camera: Vec<CameraSample>,
    /// Shortest and longest exposure, seconds.
    pub exposure_s: Option<Range>,
    /// Camera and lens.
    pub lens: Option<Lens>,
    /// Shortest and longest 35 mm equivalent focal length, millimeters.
    pub film_focal_mm: Option<Range>,
    /// Maximum number of fixes.
    pub(super) room: Room,
}

/// Maximum number of fixes in a log during reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Room {
    /// Maximum number of fixes.
    pub(super) most: usize,
    /// True if the file had more.
    pub(super) is_exceeded: bool,
}

impl Default for Room {
    fn default() -> Self {
        Self { most: MAX_FIXES, is_exceeded: false }
    }
}

impl Room {
    /// Limits the fixes to a quarter of the memory limit: sorting copies them, so both copies fit into half of it.
    pub(super) fn within(limit: MemoryLimit) -> Self {
        let most = usize::try_from(limit.bytes() / 4).unwrap_or(usize::MAX) / size_of::<Fix>();
        Self { most: most.min(MAX_FIXES), is_exceeded: false }
    }
}

/// Ten hours of a drone that writes at 60 Hz.
const MAX_FIXES: usize = 10 * 3600 * 60;

impl Log {
    /// Adds a fix unless the log is full.
    pub(super) fn push(&mut self, dialect: &'static str, fix: Fix) {
        match self.fixes.len() < self.room.most {
            true => self.fixes.push(Fix { dialect, ..fix }),
            false => self.room.is_exceeded = true,
        }
    }

    /// Adds a camera state unless the log is full.
    pub(super) fn push_camera(&mut self, sample: CameraSample) {
        match self.camera.len() < self.room.most {
            true => self.camera.push(sample),
            false => self.room.is_exceeded = true,
        }
    }

    /// Number of fixes by format or dialect.
    pub fn dialects(&self) -> BTreeMap<&'static str, usize> {
        let mut counts = BTreeMap::new();
        self.fixes.iter().for_each(|fix| *counts.entry(fix.dialect).or_default() += 1);
        counts
    }

    /// Returns true if the camera itself wrote positions.
    pub fn is_of_camera(&self) -> bool {
        self.fixes.iter().any(|fix| fix.dialect.starts_with("dji") || fix.dialect.starts_with("gpmf"))
    }

    /// Records an entry without a usable fix.
    pub(super) fn skip_line(&mut self, line: usize, reason: impl Into<String>) {
        self.num_passed_over += 1;
        // A damaged file repeats the same problem.
        if self.passed_over.len() < 100 {
            self.passed_over.push(SkippedEntry { line, reason: reason.into() });
        }
    }
}
