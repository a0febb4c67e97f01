//! Ground points of the background, and local ground planes near an object.
//!
//! [`label_points`] counts the votes of the labels under a point's observations (eq. 2 of `docs/maths/ground.md`).
//! Without labels, [`dominant_plane_points`] finds the ground by its geometry (eq. 9 to 12). [`local_planes`] fits one
//! plane per frame to the ground points around the object (eq. 3 to 8). All of it is scale free: the unit of a
//! background reconstruction is arbitrary, so tolerances are in pixels, converted to lengths by the depth of the
//! observed point (eq. 1).

mod camera_mount;
mod chain;
mod dominant;
mod driven;
#[cfg(test)]
mod fixed_camera_tests;
mod height;
mod hovering;
mod labels;
mod local;
mod observations;
mod plane;
mod relief;
mod road;
mod supports;
mod trajectory_plane;
mod vehicle_trajectory;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{Checked, ordered, within};
pub use camera_mount::{Mount, MountFailure, find_mount};
pub use chain::GroundChain;
pub use dominant::{DominantPlane, GroundError, dominant_plane_points};
pub use height::{CameraHeight, HeightFailure, camera_height};
pub use hovering::{HoveringGround, TiltContradiction, TiltEstimate, TiltKind, hovering_ground};
pub use labels::label_points;
pub use local::{LocalPlanes, SkipReason, SkippedFrame, local_planes};
pub use plane::PlaneFailure;
pub use vehicle_trajectory::BodyShape;

/// Options of the ground estimation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Minimum number of observations of a ground point.
    #[schemars(extend("unit" = "observations"))]
    pub min_observations: usize,
    /// Ground points near the object that give its plane in a frame.
    #[schemars(extend("unit" = "points"))]
    pub num_neighbors: usize,
    /// Minimum number of points of a plane.
    #[schemars(extend("unit" = "points"))]
    pub min_points: usize,
    /// Maximum distance of an inlier from its plane, as a reprojection error.
    pub max_error_px: f64,
    /// Maximum number of RANSAC samples.
    #[schemars(extend("unit" = "samples"))]
    pub max_samples: usize,
    /// Maximum mean roll of the camera against the dominant plane.
    pub max_roll_deg: f64,
    /// Maximum slope of the ground against the dominant plane.
    pub max_slope_deg: f64,
    /// True if points on the vehicle's own path correct its ground planes.
    pub vehicle_path: bool,
    /// True if labeled points are the only source of the ground.
    pub labels_only: bool,
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
            vehicle_path: true,
            labels_only: false,
        }
    }
}

impl Options {
    /// Rejects values out of range.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("min_observations", self.min_observations, 2..=1_000_000)?;
        within("num_neighbors", self.num_neighbors, 3..=100_000)?;
        within("min_points", self.min_points, 3..=100_000)?;
        ordered(("min_points", self.min_points), ("num_neighbors", self.num_neighbors))?;
        within("max_error_px", self.max_error_px, 0.01..=1000.0)?;
        within("max_samples", self.max_samples, 1..=1_000_000)?;
        within("max_roll_deg", self.max_roll_deg, 0.0..=90.0)?;
        within("max_slope_deg", self.max_slope_deg, 0.0..=89.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checks::testing::variations;
    use crate::scene::ObjectId;
    use crate::synthetic::drive::{self, drive};

    #[test]
    fn valid_options_give_a_plane_or_a_reason_for_every_frame() {
        let small =
            drive::Options { num_frames: 4, num_ground_points: 200, num_other_points: 100, ..Default::default() };
        let world = drive(&small, 1);
        let mut num_passed = 0;
        for (changed, options) in variations(&Options::default()) {
            if options.check().is_err() {
                continue;
            }
            num_passed += 1;
            let _ = dominant_plane_points(&world.background, &options, 1);
            let found = local_planes(&world.background, &world.ground_points, ObjectId(1), &world.object, &options, 1);
            assert_eq!(found.planes.len() + found.skipped.len(), 4, "{changed}");
        }
        assert!(num_passed > 20, "{num_passed}");
    }
}
