//! Telemetry: camera positions from a receiver.
//!
//! A file of any known format becomes one [`Log`]: fixes in order of time, and skipped entries with their line and the
//! reason. Formats are recognized by their content, not by the file name or the drone model: drone subtitle files (a
//! registry of dialects), GPX, KML, IGC, NMEA 0183, ArduPilot's text logs, tables, GPMF, GPS data in photographs.
//! `foreign` names the converters of unsupported formats. `docs/telemetry.md` describes each.
//!
//! Two kinds of heights are distinguished: absolute heights, from a receiver or its fusion with a barometer, and
//! heights above the take-off point. Longitudes and latitudes are decimal degrees, as in all these files, so that no
//! digit changes; other angles are radians.
//!
//! [`LocalFrame`] converts positions on the ellipsoid to local meters east, north and up, and back.
//!
//! No input causes a panic. Time and memory are linear in the length of a file, which is limited.

mod ardupilot;
mod bytes;
mod coordinate;
mod csv;
mod dji;
mod error;
mod fix;
mod foreign;
mod geodesy;
mod gpmf;
mod gpx;
mod igc;
mod kind;
mod kml;
mod local;
mod nmea;
mod order;
mod photographs;
mod read;
mod srt;
mod summary;
mod text;
mod time;
mod xml;

#[cfg(test)]
pub(crate) use gpmf::made;

#[cfg(test)]
mod real_files;
#[cfg(test)]
mod tests;

pub use error::TelemetryError;
pub use fix::{Angles, CameraSample, ClockKind, Fix, HeightDatum, Log, Receiver, SkippedEntry};
pub use geodesy::{Geodetic, LocalFrame};
pub use gpmf::Lens;
pub use kind::Kind;
pub use local::{Heights, LocalFixes, TimeBase};
pub use photographs::read_photographs;
pub use read::{read, read_bytes, read_gpmf, read_subtitles, read_within};
pub use summary::{Range, Summary};
pub use time::{clock_s, date};
