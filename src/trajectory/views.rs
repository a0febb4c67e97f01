//! Views: cameras with their local ground planes, reduced to the numbers that the scale equations need.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};

use super::ScaleError;
use crate::scene::{FrameId, GroundPlane, Image, Reconstruction};

/// One camera with its local ground plane. With it the distance of object point j to the plane is h + r a_j
/// (eq. ground_plane_distance with eq. object_to_background_coordinates put in).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The frame.
    pub frame: FrameId,
    /// h = n · (c − p): the camera's height over the plane, in units of the background.
    pub camera_height: f64,
    /// R(o)ᵀ R(b) n: the plane's normal in the object's frame.
    pub normal_in_object: Vector3<f64>,
    /// The camera's centre in the object's frame, c(o).
    pub center_in_object: Point3<f64>,
}

impl View {
    /// From the two cameras of a frame and its plane.
    pub fn new(frame: FrameId, in_background: &Image, in_object: &Image, plane: &GroundPlane) -> Self {
        let normal_in_cam = in_background.cam_from_world.rotation * plane.normal;
        Self {
            frame,
            camera_height: plane.signed_distance(in_background.cam_from_world.center()),
            normal_in_object: in_object.cam_from_world.rotation.inverse() * normal_in_cam,
            center_in_object: in_object.cam_from_world.center(),
        }
    }

    /// a_j = n · v_j = (R(o)ᵀ R(b) n) · (o_j − c(o)): how far point j lies above (below: negative) the camera along the
    /// plane's normal, in units of the object.
    pub fn offset(&self, point_in_object: &Point3<f64>) -> f64 {
        self.normal_in_object.dot(&(point_in_object - self.center_in_object))
    }
}

/// Everything that the estimators look at: the views of one object, and the object's points.
#[derive(Clone, Debug, PartialEq)]
pub struct Views {
    /// Frames with both cameras and a plane, ascending.
    pub views: Vec<View>,
    /// o_j, in the object's frame.
    pub points: Vec<Point3<f64>>,
    /// Frames with both cameras.
    pub num_paired: usize,
    /// Frames with a plane.
    pub num_planes: usize,
}

impl Views {
    /// Pairs the images of both models by name and keeps those whose frame has a plane. Views and points with numbers
    /// that are not finite are left out.
    pub fn new(background: &Reconstruction, object: &Reconstruction, planes: &BTreeMap<FrameId, GroundPlane>) -> Self {
        let paired = background.paired_images(object);
        let views = paired
            .iter()
            .filter_map(|(frame, in_background, in_object)| {
                let view = View::new(*frame, in_background, in_object, planes.get(frame)?);
                let numbers = view.normal_in_object.sum() + view.center_in_object.coords.sum() + view.camera_height;
                numbers.is_finite().then_some(view)
            })
            .collect();
        let is_finite = |p: &Point3<f64>| p.coords.iter().all(|x| x.is_finite());
        let points = object.points.values().map(|point| point.position).filter(is_finite).collect();
        Self { views, points, num_paired: paired.len(), num_planes: planes.len() }
    }

    /// Fails unless there are `needed` views and a point.
    pub(super) fn require(&self, needed: usize) -> Result<(), ScaleError> {
        if self.points.is_empty() {
            return Err(ScaleError::NoPoints);
        }
        if self.views.len() < needed {
            let usable = self.views.len();
            return Err(ScaleError::TooFewViews { usable, paired: self.num_paired, planes: self.num_planes, needed });
        }
        Ok(())
    }
}
