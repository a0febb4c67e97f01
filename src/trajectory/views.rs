//! Views: cameras with their local ground planes, reduced to the quantities of the scale equations.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::{Options, ScaleError};
use crate::math::{centroid, median};
use crate::scene::{FrameId, GroundPlane, Image, PlaneBasis, Reconstruction};

/// [`View::lever`] from camera height and distance.
///
/// An angular error displaces the object vertically in proportion to its distance: a vehicle far ahead of a low camera
/// has a much larger error than one below a drone.
pub(super) fn lever(camera_height: f64, distance: f64) -> f64 {
    camera_height.abs().max(0.5 * distance)
}

/// Standard deviation of the planes' height that all frames share: the median.
pub(super) fn common_height_std<'a>(planes: impl Iterator<Item = &'a GroundPlane>) -> f64 {
    median(planes.map(|plane| plane.common_height_std).filter(|std| std.is_finite()).collect()).unwrap_or(0.0)
}

/// Mean direction of the plane normals in the object's frame, and the median angle to it, radians.
pub(super) fn mean_normal(views: &Views) -> Option<(Vector3<f64>, f64)> {
    let normals = || views.views.iter().map(|view| view.normal_in_object);
    let mean = normals().sum::<Vector3<f64>>().try_normalize(f64::EPSILON)?;
    let angle = median(normals().map(|normal| normal.angle(&mean)).collect())?;
    Some((mean, angle))
}

/// Camera with its local ground plane.
///
/// The distance of object point j to the plane is h + r a_j (eq. ground_plane_distance with
/// eq. object_to_background_coordinates substituted).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The frame.
    pub frame: FrameId,
    /// h = n · (c − p): the camera's height over the plane, in units of the background.
    pub camera_height: f64,
    /// R(o)ᵀ R(b) n: the plane's normal in the object's frame.
    pub normal_in_object: Vector3<f64>,
    /// The camera's center in the object's frame, c(o).
    pub center_in_object: Point3<f64>,
    /// The camera's center in the background's frame, c.
    pub center_in_background: Point3<f64>,
    /// R(b)ᵀ R(o): rotation from the object's frame to the background's.
    pub background_from_object: UnitQuaternion<f64>,
    /// Standard deviation of the plane's height below the object, units of the background.
    pub height_std: f64,
}

impl View {
    /// View from the two cameras of a frame and its plane.
    pub fn new(frame: FrameId, in_background: &Image, in_object: &Image, plane: &GroundPlane) -> Self {
        let normal_in_cam = in_background.cam_from_world.rotation * plane.normal;
        Self {
            frame,
            camera_height: plane.signed_distance(in_background.cam_from_world.center()),
            normal_in_object: in_object.cam_from_world.rotation.inverse() * normal_in_cam,
            center_in_object: in_object.cam_from_world.center(),
            center_in_background: in_background.cam_from_world.center(),
            background_from_object: in_background.cam_from_world.rotation.inverse() * in_object.cam_from_world.rotation,
            height_std: plane.height_std,
        }
    }

    /// Length to which errors of the height of one of the object's points over its plane are proportional: the camera's
    /// height over the plane, or half of the distance where that is larger (docs/maths/scale.md, eq. 6a).
    pub fn lever(&self, point_in_object: &Point3<f64>, ratio: f64) -> f64 {
        lever(self.camera_height, ratio.abs() * (point_in_object - self.center_in_object).norm())
    }

    /// a_j = n · v_j = (R(o)ᵀ R(b) n) · (o_j − c(o)): height of point j above the camera along the plane's normal
    /// (negative: below), in units of the object.
    pub fn offset(&self, point_in_object: &Point3<f64>) -> f64 {
        self.normal_in_object.dot(&(point_in_object - self.center_in_object))
    }
}

/// Input of the estimators: the views of one object, and the object's points.
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
    /// Standard deviation of the offset between planes of different bases, units of the background; 0 where all have
    /// the same basis.
    pub plane_std: f64,
    /// Largest assumed drift of the object's height over its planes, as a share of [`View::lever`]
    /// (`scale.joint.sigma_distance`).
    pub max_drift: f64,
    /// True if the camera does not translate: then its height over the ground does not determine a ratio.
    pub camera_hovers: bool,
}

impl Views {
    /// Pairs the images of both models by name and keeps those whose frame has a plane. Views and points that are not
    /// finite are skipped.
    pub fn new(
        background: &Reconstruction,
        object: &Reconstruction,
        planes: &BTreeMap<FrameId, GroundPlane>,
        options: &Options,
    ) -> Self {
        let paired = background.paired_images(object);
        let views = paired
            .iter()
            .filter_map(|(frame, in_background, in_object)| {
                let view = View::new(*frame, in_background, in_object, planes.get(frame)?);
                let numbers = view.normal_in_object.sum() + view.center_in_object.coords.sum() + view.camera_height;
                numbers.is_finite().then_some(view)
            })
            .collect();
        Self {
            views,
            points: object.finite_positions(),
            num_paired: paired.len(),
            num_planes: planes.len(),
            plane_std: basis_change_std(planes),
            max_drift: options.joint.max_drift(),
            camera_hovers: planes.values().any(|plane| plane.basis == PlaneBasis::Vehicles),
        }
    }

    /// Standard deviation of the drift of the object's height over its planes that grows with the distance, units of
    /// the background.
    ///
    /// It persists over many frames. Of the drift proportional to [`View::lever`] it is the part beyond that in a view
    /// from above: the median over the views.
    pub(super) fn grazing_std(&self, ratio: f64) -> f64 {
        let middle = centroid(&self.points);
        let beyond = |view: &View| {
            let lever = view.lever(&middle, ratio);
            (lever * lever - view.camera_height * view.camera_height).max(0.0).sqrt()
        };
        self.max_drift * median(self.views.iter().map(beyond).collect()).filter(|std| std.is_finite()).unwrap_or(0.0)
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

/// Median standard deviation of the heights of planes with different bases; 0 if all have the same basis.
fn basis_change_std(planes: &BTreeMap<FrameId, GroundPlane>) -> f64 {
    let bases: BTreeSet<PlaneBasis> = planes.values().map(|plane| plane.basis).collect();
    let stds = planes.values().map(|plane| plane.height_std).filter(|std| std.is_finite() && bases.len() > 1);
    median(stds.collect()).unwrap_or(0.0)
}
