//! Minimal solvers, one per file, named by what they consume.

mod essential_five_point;
mod homography_four_point;
mod p3p;

pub use essential_five_point::essential_five_point;
pub use homography_four_point::homography_from_points;
pub use p3p::p3p;
