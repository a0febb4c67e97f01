//! Formats of other programs: COLMAP, OpenMVG, OpenSfM, nerfstudio, NVM, Bundler, BAL, camera trajectories and PLY.

pub(super) mod assembly;
pub mod bal;
pub mod bundler;
mod bytes;
pub mod camera_path;
mod centered;
pub mod colmap;
#[cfg(feature = "database")]
pub mod database;
pub mod model;
pub mod nerfstudio;
pub mod nvm;
pub mod openmvg;
pub mod opensfm;
pub mod ply;
mod words;
