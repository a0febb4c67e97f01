//! Export of results to formats of other programs: tables, maps, poses, scenes, a video, a COLMAP workspace.
//!
//! [`Results`] is the content of an output folder, read once; each format is written from it alone, by its own module.
//! [`write()`] writes the requested formats into a [`Target`]: the folder `export/` of the output folder, or a separate
//! folder. Files are written atomically, and files of other programs are never replaced.
//!
//! Lengths are meters where they are known, else units of the background's reconstruction; every file states the unit.
//! Formats that need georeferenced positions ([`Need::Map`]) are refused without them. `docs/export.md` describes every
//! format.

mod annotate;
mod clock;
mod cot;
pub mod crossings;
mod error;
mod facts;
mod format;
mod geojson;
mod gltf;
mod gpx;
mod kml;
mod poses;
#[cfg(test)]
mod real_folders;
mod resample;
mod results;
pub mod summary;
mod table;
mod target;
#[cfg(test)]
mod testing;
mod traffic;
mod units;
mod workspace;
mod write;
mod xml;

pub use clock::Clock;
pub use cot::{CotEvent, CotTrack};
pub use error::ExportError;
pub use facts::Facts;
pub use format::{Format, Need};
pub use resample::RATES;
pub use results::{RegisteredFrame, Results};
pub use target::Target;
pub use units::Units;
pub use write::{Exported, MissingFormats, Pictures, SkippedFormat, Written, write};
