//! Results in the files that other programs open: tables, maps, poses, scenes, a video, a workspace of COLMAP's.
//!
//! [`Results`] is what an output folder holds, read once; each format is written from it alone, by a module of its own.
//! [`write()`] puts what was asked for into a [`Target`]: the folder `export/` of the output folder, or a folder of its
//! own. Files appear whole or not at all, and nothing is replaced that the program did not write.
//!
//! Lengths are metres where they are known, else units of the background's reconstruction, and every file says which.
//! What needs a place on the map ([`Need::Map`]) is refused without one. `docs/export.md` describes every format.

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
