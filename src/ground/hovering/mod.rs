//! Ground plane below a camera that does not translate, from the vehicles on it and other sources of its tilt.
//!
//! Without translation, points of the background have no depth. But the size of a vehicle is constant, and its heading
//! is the direction of its path. On a plane with the unit normal n towards the camera, at the distance 1 below it, the
//! ray u intersects the ground at the distance 1 / s with s = −nᵀu. A box of a car's proportions and unit length there,
//! along the path, has the extent b_ki in the image, so the vehicle's extent is
//!
//! ```text
//! ln e_ki = a_k + ln b_ki(n) + error                                                                               (1)
//! ```
//!
//! for frame i of vehicle k: along its own path each vehicle shows how the ground recedes. a_k, the logarithm of its
//! length over the height of the camera, is similar for all vehicles. The normal minimizes a robust sum of squares of
//! both residuals, plus those of a prior of a level horizon and of other sources ([`TiltEstimate`]). The unit of such a
//! background is the camera's height.

#[cfg(test)]
mod tests;
mod tilt;
mod vehicle_sizes;

use std::collections::BTreeMap;
use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::{Matrix3, Matrix3x2, Point2, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::height::CameraHeight;
use super::local::{LocalPlanes, SkipReason, contact_point, object_pixels};
use super::relief::Relief;
use crate::camera::{LEAST_DIP, MAX_TILT_STD};
use crate::scene::{FrameId, GroundPlane, Image, PlaneBasis, Reconstruction, Rect};
use tilt::{Difference, Tilt, TiltSolver, birge_ratio};
pub use tilt::{TiltContradiction, TiltEstimate, TiltKind};

/// Ground plane below a camera that does not translate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HoveringGround {
    /// Unit normal in the background's frame, towards the camera.
    pub normal_in_world: Vector3<f64>,
    /// Point on the plane, one unit below the camera at the origin.
    pub point_in_world: Point3<f64>,
    /// Standard deviation of the tilt over both axes, radians, without the share of the focal length.
    pub tilt_std: f64,
    /// Number of vehicles whose sizes are used.
    pub num_vehicles: usize,
    /// Inclination of the camera's axis below the ground's horizon in the first frame, radians.
    pub pitch: f64,
    /// Estimates of the tilt by other sources.
    pub sources: Vec<TiltEstimate>,
    /// Tilt by the sizes of vehicles alone, where these determine it.
    pub by_vehicles: Option<TiltEstimate>,
    /// Sources that contradict all others.
    pub contradictions: Vec<TiltContradiction>,
    /// Covariance of the normal, without the share of the focal length.
    pub normal_covariance: Matrix3<f64>,
    /// Change of the normal by one standard deviation of the focal length.
    pub normal_by_focal: Vector3<f64>,
}

/// Standard deviation of the ground's height below a vehicle, as a share of the camera's height: slopes and curbs.
pub(super) const UNEVENNESS: f64 = 0.01;

/// Estimates the ground plane from the sizes of vehicles and other sources; `None` where they do not determine it.
///
/// * `vehicles` – bounding boxes of each vehicle by frame, in images of `background`; all cameras are at the origin.
/// * `focal_std` – relative standard deviation of the focal length.
pub fn hovering_ground(
    background: &Reconstruction,
    vehicles: &[BTreeMap<FrameId, Rect>],
    sources: Vec<TiltEstimate>,
    focal_std: f64,
) -> Option<HoveringGround> {
    let solver = TiltSolver::new(background, vehicles, focal_std)?;
    let all: Vec<&TiltEstimate> = sources.iter().collect();
    let differences = solver.differences(&all);
    let map_tilt = all.iter().find(|tilt| matches!(tilt.kind, TiltKind::Map { .. })).and_then(|map| map.known_angles());
    // The plane of a map is used without fusion, whatever other sources give.
    let (birge_ratio, tilt) = match map_tilt {
        Some((angles, covariance)) => (1.0, Tilt { angles, covariance, by_focal: Vector2::zeros() }),
        None => (birge_ratio(&differences), solver.tilt(&all)?),
    };
    let tilt_std = tilt.covariance.trace().sqrt();
    let normal = |angles: Vector2<f64>| solver.problem.normal(angles);
    let normal_in_world = normal(tilt.angles);
    let by_angle = [Vector2::x(), Vector2::y()].map(|axis| {
        // Step of the numerical derivatives, radians.
        const STEP: f64 = 1e-4;
        (normal(tilt.angles + axis * STEP) - normal(tilt.angles - axis * STEP)) / (2.0 * STEP)
    });
    let by_angles = Matrix3x2::from_columns(&by_angle);
    let by_vehicles = solver.by_vehicles();
    (tilt_std <= MAX_TILT_STD).then(|| HoveringGround {
        normal_in_world,
        point_in_world: Point3::from(-normal_in_world),
        tilt_std: birge_ratio * tilt_std,
        num_vehicles: solver.problem.vehicles.len(),
        pitch: tilt.angles.x,
        by_vehicles,
        contradictions: differences.iter().filter_map(Difference::contradiction).collect(),
        normal_covariance: by_angles * tilt.covariance * by_angles.transpose() * birge_ratio.powi(2),
        normal_by_focal: 0.5 * (normal(tilt.angles + tilt.by_focal) - normal(tilt.angles - tilt.by_focal)),
        sources,
    })
}

impl HoveringGround {
    /// Points with heights of the map that defines the plane; `None` if no map does.
    fn relief(&self) -> Option<&[Point3<f64>]> {
        self.sources.iter().find_map(|source| match &source.kind {
            TiltKind::Map { relief_in_world } => Some(relief_in_world.as_slice()),
            TiltKind::Ground | TiltKind::Vertical => None,
        })
    }

    /// Returns true if the plane is that of a map.
    ///
    /// Errors of its tilt, of the camera height and of the focal length then do not affect positions on it; the
    /// remaining position error is that of the alignment with the map.
    pub fn is_mapped(&self) -> bool {
        self.relief().is_some()
    }

    /// Standard deviation of the tilt over both axes, radians, with the share of the focal length.
    pub fn total_tilt_std(&self) -> f64 {
        self.tilt_std.hypot(self.normal_by_focal.norm())
    }

    fn height_of(&self, point: Point3<f64>) -> f64 {
        self.normal_in_world.dot(&(point - self.point_in_world))
    }

    /// Mean height of the camera over the plane; it varies with the sway of the camera.
    pub fn camera_height(&self, background: &Reconstruction) -> CameraHeight {
        let num_frames = background.images.len();
        let sum: f64 = background.images.values().map(|image| self.height_of(image.cam_from_world.center())).sum();
        let mean = if num_frames > 0 { sum / num_frames as f64 } else { 1.0 };
        CameraHeight {
            mean,
            std: UNEVENNESS * mean,
            spread: 0.0,
            up_in_world: self.normal_in_world,
            // [`CameraHeight::tilt_std`] uses half of the spread.
            tilt_spread: 2.0 * self.total_tilt_std(),
            num_frames,
            foot_in_world: self.point_in_world,
        }
    }

    /// Intersection of a ray with the plane; `None` too close to the horizon.
    pub fn intersect(&self, from: Point3<f64>, direction: &Vector3<f64>) -> Option<Point3<f64>> {
        let dip = -self.normal_in_world.dot(direction) / direction.norm();
        (dip >= LEAST_DIP).then(|| from + direction.normalize() * (self.height_of(from) / dip))
    }

    /// Planes below an object in every frame that is registered in both models.
    pub(super) fn planes(&self, background: &Reconstruction, model: &Reconstruction) -> LocalPlanes {
        let relief = self.relief().and_then(|points| Relief::new(points, self.normal_in_world));
        let below = |(frame, image, in_object): (FrameId, &Image, &Image)| {
            let plane = self.plane_below(background, image, &object_pixels(in_object), relief.as_ref());
            (frame, plane.ok_or(SkipReason::NoObjectObservations))
        };
        background.paired_images(model).into_iter().map(below).collect()
    }

    fn plane_below(
        &self,
        background: &Reconstruction,
        image: &Image,
        pixels: &[Point2<f64>],
        relief: Option<&Relief>,
    ) -> Option<GroundPlane> {
        let center = image.cam_from_world.center();
        let contact_on =
            |normal: &Vector3<f64>, height: f64| contact_point(background, image, pixels, (normal, height));
        let mut normal = self.normal_in_world;
        let mut height = self.height_of(center);
        let mut contact = contact_on(&normal, height)?;
        // Each iteration reduces the error by the ratio of the ground's slope to that of the viewing ray.
        for _ in 0..5 {
            let Some((next, position)) = relief.and_then(|relief| relief.plane_near(contact)) else { break };
            (normal, height) = (next, next.dot(&(center - position)));
            contact = contact_on(&normal, height)?;
        }
        let point = center - normal * height;
        let offset = contact - point;
        let of_tilt =
            if self.is_mapped() { 0.0 } else { offset.dot(&(self.normal_covariance * offset)).max(0.0).sqrt() };
        let of_relief = relief.map_or(0.0, |relief| relief.height_std);
        let height_std = of_tilt.hypot(UNEVENNESS * height).hypot(of_relief);
        Some(GroundPlane {
            normal,
            point,
            num_points: 0,
            num_inliers: 0,
            rms: UNEVENNESS * height,
            basis: PlaneBasis::Vehicles,
            height_std,
            common_height_std: height_std,
            // About either horizontal axis.
            tilt_std: self.tilt_std * FRAC_1_SQRT_2,
        })
    }
}
