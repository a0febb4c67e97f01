//! OpenMVG's `sfm_data.json`.
//!
//! Two conventions differ from this program's and are converted on reading and writing. OpenMVG stores a camera's
//! rotation with its *center*, not its translation (`src/openMVG/geometry/pose3.hpp`). And it puts (0, 0) on the center
//! of the first pixel, so half a pixel is added to principal points and observations (triangulating its tracks with
//! true poses and intrinsics leaves the smallest residual at +0.42 ± 0.1 px). A principal point that its user gave in
//! the other convention stays off by that half pixel.
//!
//! View, structure and intrinsic keys become image, point and camera ids by adding one. Views without a pose are
//! skipped. An image's name is `local_path` and `filename`. The cameras `pinhole`, `pinhole_radial_k1`,
//! `pinhole_radial_k3` and `pinhole_brown_t2` are exact (its t₁, t₂ are p₁, p₂ of OpenCV:
//! `src/openMVG/cameras/Camera_Pinhole_Brown.hpp`); `fisheye` is COLMAP's OPENCV_FISHEYE with one focal length,
//! `spherical` its EQUIRECTANGULAR.
//!
//! The format has no colors and no features without a point. Its JSON is cereal's: a type is named at its first
//! occurrence and then referred to by its number.

mod document;
mod reader;
mod writer;

pub use reader::read;
pub(super) use reader::read_with;
pub use writer::write;

/// Offset from OpenMVG's pixel coordinates to ours.
const PIXEL_OFFSET: f64 = 0.5;

/// Bit of the first use of a type or pointer in cereal's files.
const FIRST_USE: u32 = 1 << 31;

/// Mark of cereal for a pointer of exactly the type that the reader expects.
const SAME_TYPE: u32 = 1 << 30;

/// Key for "none".
const UNDEFINED: u32 = u32::MAX;

#[cfg(test)]
mod tests;
