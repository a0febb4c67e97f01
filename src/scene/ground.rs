//! Ground points and local ground planes: the input of the scale estimators.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{FrameId, ObjectId, Point3dId};

/// Source of the ground labels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GroundSource {
    /// Masks given by the user.
    Masks,
    /// A semantic segmentation model.
    Model,
    /// The dominant plane below the camera: there were no labels, and the result is marked.
    Geometric,
}

/// Basis of a local plane: the chain of fallbacks, the most reliable first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PlaneBasis {
    /// Points that the object itself drives over in other frames.
    Path,
    /// Points around the object that are labeled as ground.
    LabelledPoints,
    /// Points around the object that were classified as ground without labels.
    Points,
    /// The one plane that is stationary in the frame of a camera fixed to a vehicle.
    Mount,
    /// The dominant plane of the whole scene, at any distance from the object.
    Dominant,
    /// The plane below a camera that does not translate, from straight lines, vehicle sizes and given values.
    Vehicles,
}

with_names!(PlaneBasis {
    Path = "path",
    LabelledPoints = "labelled-points",
    Points = "points",
    Mount = "mount",
    Dominant = "dominant",
    Vehicles = "vehicles",
});

impl PlaneBasis {
    /// Description for messages.
    pub fn words(self) -> &'static str {
        match self {
            Self::Path => "ground that the object drives over",
            Self::LabelledPoints => "labeled ground around the object",
            Self::Points => "ground around the object, without labels",
            Self::Mount => "one plane below a camera fixed to a vehicle",
            Self::Dominant => "dominant plane of the whole scene",
            Self::Vehicles => "one plane below a camera that does not translate",
        }
    }
}

/// A local plane of the ground near one object in one frame, in the background's frame.
///
/// Its standard deviations refer to the ground below the object, which may be far from the points of the plane.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroundPlane {
    /// Unit normal towards the camera's side.
    #[schemars(with = "[f64; 3]")]
    pub normal: Vector3<f64>,
    /// A point of the plane.
    #[schemars(with = "[f64; 3]")]
    pub point: Point3<f64>,
    /// Ground points used.
    pub num_points: usize,
    /// Ground points within the RANSAC threshold.
    pub num_inliers: usize,
    /// Root mean square distance of the inliers, in units of the background.
    pub rms: f64,
    /// Basis of the plane.
    pub basis: PlaneBasis,
    /// Standard deviation of its height below the object, along the normal, in units of the background.
    pub height_std: f64,
    /// The part of `height_std` that all frames of the object share, which more frames do not reduce; at most
    /// `height_std`.
    pub common_height_std: f64,
    /// Standard deviation of its tilt about any axis in the plane, radians.
    pub tilt_std: f64,
}

impl GroundPlane {
    /// The part of `height_std` that is independent in every frame.
    pub fn own_height_std(&self) -> f64 {
        (self.height_std.powi(2) - self.common_height_std.powi(2)).max(0.0).sqrt()
    }

    /// Signed distance of a point; positive on the camera's side (eq. ground_plane_distance).
    pub fn signed_distance(&self, point_in_background: Point3<f64>) -> f64 {
        self.normal.dot(&(point_in_background - self.point))
    }
}

/// Ground points and local planes.
#[derive(Clone, Debug, PartialEq)]
pub struct Ground {
    /// Source of the labels.
    pub source: GroundSource,
    /// Background points labeled as ground, ascending.
    pub point_ids: Vec<Point3dId>,
    /// The local plane of each object in each frame; frames without one are absent.
    pub planes: BTreeMap<(ObjectId, FrameId), GroundPlane>,
}
