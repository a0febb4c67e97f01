//! Intersection of viewing rays with the ground.

use nalgebra::{Point3, Vector3};

use super::View;
use crate::math::{Neighbors, Rigid3, across, upper_median};

/// Ground of a background: a plane, and ground points whose heights over it correct it locally.
pub struct GroundModel {
    normal: Vector3<f64>,
    point: Point3<f64>,
    /// Two unit directions along the plane.
    axes: [Vector3<f64>; 2],
    heights: Vec<f64>,
    positions: Vec<[f64; 2]>,
    tree: Option<Neighbors<2>>,
}

/// Number of nearest ground points whose median height corrects the plane.
const NUM_NEAR: usize = 8;

impl GroundModel {
    /// Model of a plane in the background's frame and ground points; `None` if the normal has no length.
    ///
    /// * `normal` – towards the cameras.
    /// * `ground_points` – from `ground::dominant_plane_points` or labels; without any, the plane is not corrected.
    pub fn new(normal: Vector3<f64>, point: Point3<f64>, ground_points: &[Point3<f64>]) -> Option<Self> {
        let normal = normal.try_normalize(1e-12).filter(|n| n.iter().all(|x| x.is_finite()))?;
        let axes = across(&normal);
        let finite = ground_points.iter().filter(|p| p.coords.iter().all(|x| x.is_finite()));
        let offsets: Vec<Vector3<f64>> = finite.map(|p| p - point).collect();
        let positions: Vec<[f64; 2]> = offsets.iter().map(|o| axes.map(|axis| axis.dot(o))).collect();
        let tree = if positions.is_empty() { None } else { Neighbors::new(&positions) };
        Some(Self { normal, point, axes, heights: offsets.iter().map(|o| normal.dot(o)).collect(), positions, tree })
    }

    /// Height of a camera over the plane, in units of the background; `None` below it.
    pub(super) fn camera_height(&self, cam_from_world: &Rigid3) -> Option<f64> {
        let height = self.normal.dot(&(cam_from_world.center() - self.point));
        (height > 0.0).then_some(height)
    }

    /// Intersects the ray through a pixel with the ground, in the background's frame.
    ///
    /// `None` for rays to the sky or near the horizon, beyond a depth of a hundred camera heights.
    pub fn intersect(&self, view: &View, pixel: [f64; 2]) -> Option<Point3<f64>> {
        let ray = view.camera.normalized_from_pixel(pixel.into()).push(1.0);
        let inverse_depth = self.inverse_depth(&view.cam_from_world, ray)?;
        let height = self.camera_height(&view.cam_from_world)?;
        // Beyond, the depth range of a pixel is half its distance: the position is undetermined.
        let is_near = inverse_depth * 100.0 * height > 1.0;
        is_near.then(|| view.cam_from_world.inverse() * Point3::from(ray / inverse_depth))
    }

    /// Inverse depth at which the ray (x, y, 1), in camera coordinates, intersects the ground.
    ///
    /// Zero or negative for a ray to the sky; `None` if the camera is below the plane.
    pub(super) fn inverse_depth(&self, cam_from_world: &Rigid3, ray: Vector3<f64>) -> Option<f64> {
        let center = cam_from_world.center();
        let height = self.camera_height(cam_from_world)?;
        let direction = cam_from_world.rotation.inverse() * ray;
        let descent = -self.normal.dot(&direction);
        let mut inverse_depth = descent / height;
        // Two iterations: intersect the plane, correct its height there, and repeat.
        for _ in 0..2 {
            if inverse_depth <= 0.0 {
                break;
            }
            let position = center + direction / inverse_depth;
            let local = height - self.height_near(&position, height).unwrap_or(0.0);
            if local <= 0.1 * height {
                break;
            }
            inverse_depth = descent / local;
        }
        Some(inverse_depth)
    }

    /// Median height over the plane of the nearest ground points; `None` if all are farther away than `reach`.
    fn height_near(&self, position: &Point3<f64>, reach: f64) -> Option<f64> {
        let at = self.axes.map(|axis| axis.dot(&(position - self.point)));
        let near = self.tree.as_ref()?.nearest(&at, NUM_NEAR);
        let distance = |k: usize| (self.positions[k][0] - at[0]).hypot(self.positions[k][1] - at[1]);
        upper_median(near.into_iter().filter(|&k| distance(k) <= reach).map(|k| self.heights[k]).collect())
    }
}
