//! File formats: COLMAP, OpenMVG, PLY, masks, the contract's JSON files and ground-truth sequences.
//!
//! Every reader takes hostile input: what is wrong is an [`IoError`] that names file, place and field, never a panic, and
//! no count in a file is believed before the bytes behind it are there. Everything is written through [`atomic`].
//! `docs/formats.md` describes the formats.

pub mod atomic;
pub mod bal;
mod bytes;
pub mod colmap;
mod error;
pub mod ground;
pub mod json;
pub mod masks;
pub mod model;
pub mod openmvg;
pub mod ply;
mod sequence;
pub mod trajectories;

pub use error::IoError;
pub use sequence::{GROUND_LABEL, Sequence, SequenceFrame, TARGET_LABEL};
