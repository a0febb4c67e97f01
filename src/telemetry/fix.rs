//! The nouns: a fix, a log of fixes, and what a receiver can do.

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
    /// Format or dialect in which it is written.
    pub dialect: &'static str,
    /// Line of the file where it stands, from 1; of photographs the number of the file, of GPMF that of the payload.
    pub line: usize,
    /// File name of the photograph that it belongs to.
    pub photograph: Option<String>,
    /// Seconds after the video's start, where the file is tied to a video.
    pub video_s: Option<f64>,
    /// Seconds after 1970-01-01T00:00:00 on the file's clock, whose kind the [`Log`] says.
    pub clock_s: Option<f64>,
    /// East of Greenwich, degrees, −180 to 180.
    pub longitude_deg: f64,
    /// North of the equator, degrees, −90 to 90.
    pub latitude_deg: f64,
    /// Value of the last digit of longitude and latitude, degrees.
    pub resolution_deg: f64,
    /// Absolute height, metres; the [`Log`] says above what.
    pub gps_height_m: Option<f64>,
    /// Height above the place of take-off, by air pressure, metres.
    pub relative_height_m: Option<f64>,
    /// Standard deviation of the position in either horizontal direction, metres: stated, else that of the receiver.
    pub horizontal_std_m: f64,
    /// Standard deviation of the absolute height, metres.
    pub vertical_std_m: f64,
    /// Attitude of the vehicle that carries the camera.
    pub attitude: Option<Angles>,
    /// Attitude of the camera.
    pub gimbal: Option<Angles>,
    /// Horizontal speed as the receiver states it, metres per second.
    pub speed_m_s: Option<f64>,
}

impl Fix {
    /// A position of a plain receiver, nothing else known.
    pub(super) fn at(line: usize, position: Position) -> Self {
        let (horizontal_std_m, vertical_std_m) = Receiver::Plain.std_m();
        let Position { longitude_deg, latitude_deg, resolution_deg } = position;
        Self { line, longitude_deg, latitude_deg, resolution_deg, horizontal_std_m, vertical_std_m, ..Self::default() }
    }

    /// Takes the deviations of a kind of receiver, widened by its dilution of precision where that is stated.
    pub(super) fn received_by(mut self, receiver: Receiver, dilution: Option<f64>) -> Self {
        let (horizontal, vertical) = receiver.std_m();
        // Above 50 there is hardly a fix at all.
        let factor = dilution.map_or(1.0, |dilution| dilution.clamp(1.0, 50.0));
        (self.horizontal_std_m, self.vertical_std_m) = (horizontal * factor, vertical * factor);
        self
    }
}

/// Longitude and latitude that were checked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Position {
    pub(super) longitude_deg: f64,
    pub(super) latitude_deg: f64,
    /// Value of the last digit.
    pub(super) resolution_deg: f64,
}

/// Attitude of a body: first turned by yaw, then by pitch, then by roll (DJI's order ZYX), radians.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Angles {
    /// Clockwise from north, seen from above.
    pub yaw: f64,
    /// Nose up; −π/2 looks straight down.
    pub pitch: f64,
    /// To the right.
    pub roll: f64,
}

impl Angles {
    pub(super) fn from_degrees(yaw: f64, pitch: f64, roll: f64) -> Self {
        Self { yaw: yaw.to_radians(), pitch: pitch.to_radians(), roll: roll.to_radians() }
    }
}

/// A kind of receiver, by how well it knows its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Receiver {
    /// Corrected by a base station, carrier phases resolved.
    RtkFixed,
    /// Corrected by a base station, carrier phases not resolved.
    RtkFloat,
    /// Corrected by satellites (SBAS) or a coarse base station.
    Differential,
    /// Neither.
    Plain,
}

impl Receiver {
    /// Horizontal (either direction) and vertical standard deviation under an open sky, metres. `docs/telemetry.md` has
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

/// Above what absolute heights are counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum HeightDatum {
    /// The ellipsoid of WGS 84.
    Ellipsoid,
    /// The sea, by a model of the geoid.
    SeaLevel,
    /// The file does not say.
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
    /// Nothing.
    #[default]
    Absent,
}

/// Something in a file that gave no fix.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct SkippedEntry {
    /// Line, from 1; of photographs the number of the file, of GPMF that of the payload.
    pub line: usize,
    /// Why.
    pub reason: String,
}

impl fmt::Display for SkippedEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "line {}: {}", self.line, self.reason)
    }
}

/// State of the camera at a time of its video, in axes of the image as it is stored: x right, y down, z forward.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraSample {
    /// Seconds after the video's start.
    pub video_s: f64,
    /// Direction of gravity, unit vector.
    pub down_in_image: Option<Vector3<f64>>,
    /// Axes of the image from those of the camera at the start of the recording.
    pub image_from_start: Option<UnitQuaternion<f64>>,
}

/// Content of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Log {
    /// Fixes in order of time; those without any time in order of the file.
    pub fixes: Vec<Fix>,
    /// Kind of clock.
    pub clock: ClockKind,
    /// Above what `gps_height_m` is counted.
    pub height_datum: HeightDatum,
    /// The first things that were skipped, in order of the file.
    pub passed_over: Vec<SkippedEntry>,
    /// Number of skipped lines.
    pub num_passed_over: usize,
    /// Gravity and attitude of the camera, in order of time.
    pub camera: Vec<CameraSample>,
    /// Shortest and longest exposure, seconds.
    pub exposure_s: Option<Range>,
    /// Camera and lens.
    pub lens: Option<Lens>,
    /// Shortest and longest focal length that would show as much on film, millimeters.
    pub film_focal_mm: Option<Range>,
    /// Number of fixes that it can hold.
    pub(super) room: Room,
}

/// Number of fixes that a log holds while it is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Room {
    /// Maximum number of fixes.
    pub(super) most: usize,
    /// True if there were more.
    pub(super) is_exceeded: bool,
}

impl Default for Room {
    fn default() -> Self {
        Self { most: MOST_FIXES, is_exceeded: false }
    }
}

impl Room {
    /// Room for as many fixes as half of a limit holds, twice: they are copied when they are put in order.
    pub(super) fn within(limit: MemoryLimit) -> Self {
        let most = usize::try_from(limit.bytes() / 4).unwrap_or(usize::MAX) / size_of::<Fix>();
        Self { most: most.min(MOST_FIXES), is_exceeded: false }
    }
}

/// Ten hours of a drone that writes at 60 Hz.
const MOST_FIXES: usize = 10 * 3600 * 60;

impl Log {
    /// Adds a fix, if there is room for it.
    pub(super) fn push(&mut self, dialect: &'static str, fix: Fix) {
        match self.fixes.len() < self.room.most {
            true => self.fixes.push(Fix { dialect, ..fix }),
            false => self.room.is_exceeded = true,
        }
    }

    /// Adds a state of the camera, if there is room for it.
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

    /// Notes what gave no fix.
    pub(super) fn pass_over(&mut self, line: usize, reason: impl Into<String>) {
        self.num_passed_over += 1;
        // A broken file repeats itself.
        if self.passed_over.len() < 100 {
            self.passed_over.push(SkippedEntry { line, reason: reason.into() });
        }
    }
}
