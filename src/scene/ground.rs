//! The ground as the scale estimators see it.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{FrameId, ObjectId, Point3dId};

/// Where the ground labels came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GroundSource {
    /// Masks given by the user.
    Masks,
    /// A semantic segmentation model.
    Model,
    /// The dominant plane below the camera: no labels were there, and the result is marked.
    Geometric,
}

/// Basis of a local plane: the links of the chain of fallbacks, the most reliable first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PlaneBasis {
    /// Points that the object itself drives over, in other frames than this.
    Path,
    /// Points round the object that labels call ground.
    LabelledPoints,
    /// Points round the object that were found to be ground without labels.
    Points,
    /// The one plane that stands still in the frame of a camera fixed to a vehicle.
    Mount,
    /// The dominant plane of the whole place, far from the object or not.
    Dominant,
    /// The plane below a camera that does not translate, by straight lines, the sizes of vehicles and what is given.
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
    /// In words, for people.
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
/// Its deviations speak of the ground below the object, which may lie far from the points of the plane.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroundPlane {
    /// Unit normal towards the camera's side.
    #[schemars(with = "[f64; 3]")]
    pub normal: Vector3<f64>,
    /// A point of the plane.
    #[schemars(with = "[f64; 3]")]
    pub point: Point3<f64>,
    /// Ground points that took part.
    pub num_points: usize,
    /// Those within the RANSAC threshold.
    pub num_inliers: usize,
    /// Root mean square distance of the inliers, in units of the background.
    pub rms: f64,
    /// Basis of the plane.
    pub basis: PlaneBasis,
    /// Standard deviation of its height below the object, along the normal, in units of the background.
    pub height_std: f64,
    /// The part of `height_std` that all frames of the object share, so that more frames do not make it smaller; at
    /// most `height_std`.
    pub common_height_std: f64,
    /// Standard deviation of its tilt about any axis in the plane, radians.
    pub tilt_std: f64,
}

impl GroundPlane {
    /// The part of `height_std` that is new in every frame.
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
    /// Where the labels came from.
    pub source: GroundSource,
    /// Background points labelled as ground, ascending.
    pub point_ids: Vec<Point3dId>,
    /// The local plane of each object in each frame; what has none is absent.
    pub planes: BTreeMap<(ObjectId, FrameId), GroundPlane>,
}
