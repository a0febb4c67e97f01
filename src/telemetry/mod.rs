//! Telemetry: where a receiver says that the camera was.
//!
//! A file of any known format becomes one [`Log`]: fixes in order of time, and what was skipped with its line and
//! the reason. Formats are distinguished by their content, never by name or by the name of a drone: subtitle files of
//! drones (a registry of dialects), GPX, KML, IGC, NMEA 0183, ArduPilot's text logs, tables, GPMF, GPS data in
//! photographs. `foreign` names the converter of what is not read.
//! `docs/telemetry.md` describes each.
//!
//! Heights of two kinds are kept apart: absolute ones, which a receiver or a fusion with air pressure gives, and those
//! above the place of take-off. Longitudes and latitudes are decimal degrees, as in all these files, so that no digit
//! changes on the way; other angles are radians.
//!
//! [`LocalFrame`] turns positions on the ellipsoid into metres east, north and up of a place, and back.
//!
//! Nothing here panics on any input, and time and memory are linear in the length of a file, which is limited.

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
