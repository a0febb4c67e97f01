//! File formats: COLMAP, OpenMVG, OpenSfM, nerfstudio, NVM, Bundler, camera trajectories, PLY, masks, the contract's
//! JSON files and ground-truth sequences.
//!
//! Every reader accepts hostile input: a problem is an [`IoError`] that names file, position and field, never a panic,
//! and no count in a file is trusted before the bytes for it are there. Everything is written through [`atomic`].
//! `docs/formats.md` describes the formats.
//!
//! ```
//! use tractrix::io::interchange::{colmap, model};
//!
//! // Recognized by content: COLMAP, an output folder, OpenMVG, OpenSfM, nerfstudio, NVM, Bundler, TUM, KITTI.
//! let (from_openmvg, _) = model::read("tests/golden/models/openmvg/sfm_data.json".as_ref())?;
//! let from_colmap = colmap::read("tests/golden/models/colmap_binary".as_ref())?;
//! assert_eq!(from_openmvg.cameras, from_colmap.cameras);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod atomic;
mod error;
mod export_folder;
mod extent;
pub mod ground;
pub mod interchange;
pub mod json;
pub mod masks;
mod owned_folder;
mod run_folder;
mod sequence;
#[cfg(test)]
pub(crate) mod testing;
pub mod tracks;
pub mod trajectories;

pub use error::IoError;
pub use export_folder::ExportFolder;
pub use interchange::assembly::Losses;
pub use owned_folder::{FolderError, InputIdentity, OwnedFolder, PathRole, refuse_own_input, refuse_place_of_results};
pub use run_folder::RunFolder;
pub use sequence::{GROUND_LABEL, Sequence, SequenceFrame, TARGET_LABEL};
