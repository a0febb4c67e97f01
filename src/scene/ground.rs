//! The ground as the scale estimators see it.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::{FrameId, ObjectId, Point3dId};

/// Where the ground labels came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum GroundSource {
    /// Masks given by the user.
    Masks,
    /// A semantic segmentation model.
    Model,
    /// The dominant plane below the camera: no labels were there, and the result is marked.
    Geometric,
}

/// A local plane of the ground near one object in one frame, in the background's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GroundPlane {
    /// Unit normal, towards the camera's side (n_i).
    pub normal: Vector3<f64>,
    /// A point of the plane (p_i).
    pub point: Point3<f64>,
    /// Ground points that took part.
    pub num_points: usize,
    /// Those within the RANSAC threshold.
    pub num_inliers: usize,
    /// Root mean square distance of the inliers, in units of the background.
    pub rms: f64,
}

impl GroundPlane {
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
