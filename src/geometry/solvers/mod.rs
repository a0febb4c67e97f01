//! Minimal solvers, one per file, named by their input.

mod essential_five_point;
mod p3p;

pub use essential_five_point::essential_five_point;
pub use p3p::p3p;

pub use crate::math::homography_from_points;
