//! File formats: COLMAP, OpenMVG, PLY, masks, the contract's JSON files and ground-truth sequences.
//!
//! Every reader takes hostile input: what is wrong is an [`IoError`] that names file, place and field, never a panic, and
//! no count in a file is believed before the bytes behind it are there. Everything is written through [`atomic`].
//! `docs/formats.md` describes the formats.

pub mod atomic;
mod bytes;
pub mod colmap;
mod error;
pub mod ply;

pub use error::IoError;
