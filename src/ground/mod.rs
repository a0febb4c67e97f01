//! Which background points are ground, and what plane the ground is near an object.
//!
//! [`label_points`] lets the labels under a point's observations vote (eq. 2 of `docs/maths/ground.md`);
//! [`dominant_plane_points`] stands in where there are no labels (eq. 9 to 12). [`local_planes`] fits one plane per
//! frame to the ground round the object (eq. 3 to 8). Everything is scale free: a background reconstruction has a unit
//! of its own, so that tolerances are pixels, turned into lengths by the depth at which a point is seen (eq. 1).

mod dominant;
mod labels;
mod local;
mod plane;

use serde::{Deserialize, Serialize};

pub use dominant::{DominantPlane, GroundError, dominant_plane_points};
pub use labels::label_points;
pub use local::{LocalPlanes, SkipReason, SkippedFrame, local_planes};
pub use plane::PlaneFailure;

/// How the ground is found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Options {
    /// Observations that make a background point stable enough to be ground (the paper's four).
    pub min_observations: usize,
    /// Ground points gathered round the object in each frame (the paper's num_b, 50).
    pub num_neighbors: usize,
    /// Fewest points that a local plane is fitted to: with less than ten, RANSAC cannot tell a plane from chance.
    pub min_points: usize,
    /// Tolerance of the plane, pixels: a point belongs to it if it lies no further away than this many pixels are at
    /// its depth (`max_error_px · depth / focal length`, eq. 1). Four pixels is what reconstructions let an observation
    /// be off, so that any point they kept may be off by as much.
    pub max_error_px: f64,
    /// Most RANSAC samples; it stops as soon as a better plane is unlikely (1 in 10,000).
    pub max_samples: usize,
    /// For the dominant plane: how far the camera may be rolled against the ground on average, degrees.
    pub max_roll_deg: f64,
    /// For the dominant plane: how steep the ground may rise against it where it is grown over hills, degrees.
    pub max_slope_deg: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            min_observations: 4,
            num_neighbors: 50,
            min_points: 10,
            max_error_px: 4.0,
            max_samples: 1000,
            max_roll_deg: 30.0,
            max_slope_deg: 25.0,
        }
    }
}
