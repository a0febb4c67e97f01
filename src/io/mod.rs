//! File formats: COLMAP, OpenMVG, PLY, masks, the contract's JSON files and ground-truth sequences.
//!
//! Every reader takes hostile input: what is wrong is an [`IoError`] that names file, place and field, never a panic,
//! and no count in a file is believed before the bytes behind it are there. Everything is written through [`atomic`].
//! `docs/formats.md` describes the formats.
//!
//! ```
//! use tractrix::io::{colmap, model};
//!
//! // Recognised by what is there: a COLMAP folder, text or binary, an output folder, or OpenMVG's sfm_data.json.
//! let (from_openmvg, _) = model::read("tests/golden/models/openmvg/sfm_data.json".as_ref())?;
//! let from_colmap = colmap::read("tests/golden/models/colmap_binary".as_ref())?;
//! assert_eq!(from_openmvg.cameras, from_colmap.cameras);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

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
mod owned_folder;
pub mod ply;
mod run_folder;
mod sequence;
#[cfg(test)]
pub(crate) mod testing;
pub mod tracks;
pub mod trajectories;

pub use error::IoError;
pub use owned_folder::{FolderError, InputIdentity, OwnedFolder, Place, refuse_own_input};
pub use run_folder::RunFolder;
pub use sequence::{GROUND_LABEL, Sequence, SequenceFrame, TARGET_LABEL};
