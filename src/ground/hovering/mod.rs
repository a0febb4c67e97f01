//! The ground below a camera that does not translate, from the vehicles on it and other sources of its tilt.
//!
//! Without translation no point of the background has a depth. But a vehicle keeps its size and points where it goes:
//! on a plane with the unit normal n towards the camera, at the height 1 below it, the ray u meets the ground at the
//! distance 1 / s with s = −nᵀu. A box there of a car's proportions and unit length, along the path, has the extent
//! b_ki in the image, so that the vehicle's extent is
//!
//! ```text
//! ln e_ki = a_k + ln b_ki(n) + error                                                                               (1)
//! ```
//!
//! for frame i of vehicle k: along its own path each vehicle shows how the ground recedes. a_k, its length over the
//! height of the camera, is about the same for all vehicles. The normal minimizes the sum of squares of both residuals,
//! robustly, with a horizon that is level to some degrees, and of those of other sources ([`StatedTilt`]). The unit of
//! such a background is the camera's height.

#[cfg(test)]
mod tests;
mod tilt;
mod vehicle_sizes;

use std::collections::BTreeMap;
use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::{Matrix3, Matrix3x2, Point2, Point3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::height::CameraHeight;
use super::local::{LocalPlanes, SkipReason, lowest_foot, object_pixels};
use super::relief::Relief;
use crate::camera::{LEAST_DIP, MAX_TILT_STD};
use crate::scene::{FrameId, GroundPlane, Image, PlaneBasis, Reconstruction, Rect};
use tilt::{Difference, Tilt, TiltSolver, disagreement};
pub use tilt::{StatedTilt, TiltContradiction, TiltKind};

/// The ground below a camera that does not translate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HoveringGround {
    /// Unit normal in the background's frame, towards the camera.
    pub normal_in_world: Vector3<f64>,
    /// A point of it: one unit below the camera that is at the origin.
    pub point_in_world: Point3<f64>,
    /// Standard deviation of its tilt about any horizontal axis, radians, without that of the focal length.
    pub tilt_std: f64,
    /// Vehicles that show it.
    pub num_vehicles: usize,
    /// Inclination of the camera's axis below the ground's horizon in the first frame, radians.
    pub pitch: f64,
    /// Other sources of the normal.
    pub sources: Vec<StatedTilt>,
    /// The tilt by the sizes of vehicles alone, where these determine it.
    pub by_vehicles: Option<StatedTilt>,
    /// Sources that contradict all others.
    pub contradictions: Vec<TiltContradiction>,
    /// Covariance of the normal, without that of the focal length.
    pub normal_covariance: Matrix3<f64>,
    /// Change of the normal by one standard deviation of the focal length.
    pub normal_by_focal: Vector3<f64>,
}

/// Standard deviation of the ground's height below a vehicle as a share of the camera's: slopes and kerbs.
pub(super) const UNEVENNESS: f64 = 0.01;

/// The ground that explains the sizes of vehicles and other sources; `None` where they do not determine it.
///
/// * `vehicles` – images of each vehicle, in images of `background`, all of whose cameras are at the origin.
/// * `focal_std` – standard deviation of the focal length as a share of it.
pub fn hovering_ground(
    background: &Reconstruction,
    vehicles: &[BTreeMap<FrameId, Rect>],
    stated: Vec<StatedTilt>,
    focal_std: f64,
) -> Option<HoveringGround> {
    let solver = TiltSolver::new(background, vehicles, focal_std)?;
    let all: Vec<&StatedTilt> = stated.iter().collect();
    let differences = solver.differences(&all);
    let of_map = all.iter().find(|tilt| matches!(tilt.kind, TiltKind::Map { .. })).and_then(|map| map.known_angles());
    // A map is the ground as it is, whatever other sources say.
    let (disagreement, tilt) = match of_map {
        Some((angles, covariance)) => (1.0, Tilt { angles, covariance, by_focal: Vector2::zeros() }),
        None => (disagreement(&differences), solver.tilt(&all)?),
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
        tilt_std: disagreement * tilt_std,
        num_vehicles: solver.problem.vehicles.len(),
        pitch: tilt.angles.x,
        by_vehicles,
        contradictions: differences.iter().filter_map(Difference::contradiction).collect(),
        normal_covariance: by_angles * tilt.covariance * by_angles.transpose() * disagreement.powi(2),
        normal_by_focal: 0.5 * (normal(tilt.angles + tilt.by_focal) - normal(tilt.angles - tilt.by_focal)),
        sources: stated,
    })
}

impl HoveringGround {
    /// Points with heights of the map whose plane it is; `None` where it is of no map.
    fn relief(&self) -> Option<&[Point3<f64>]> {
        self.sources.iter().find_map(|source| match &source.kind {
            TiltKind::Map { relief_in_world } => Some(relief_in_world.as_slice()),
            TiltKind::Ground | TiltKind::Vertical => None,
        })
    }

    /// Returns true if it is the plane of a map: then its tilt, the height of the camera and the focal length move
    /// nothing on it, and what they leave of positions is in the alignment with the map.
    pub fn is_mapped(&self) -> bool {
        self.relief().is_some()
    }

    /// Standard deviation of its tilt, radians, with that of the focal length.
    pub fn total_tilt_std(&self) -> f64 {
        self.tilt_std.hypot(self.normal_by_focal.norm())
    }

    fn height_of(&self, point: Point3<f64>) -> f64 {
        self.normal_in_world.dot(&(point - self.point_in_world))
    }

    /// The camera's height over it, which varies with its sway.
    pub fn camera_height(&self, background: &Reconstruction) -> CameraHeight {
        let num_frames = background.images.len();
        let sum: f64 = background.images.values().map(|image| self.height_of(image.cam_from_world.center())).sum();
        let mean = if num_frames > 0 { sum / num_frames as f64 } else { 1.0 };
        CameraHeight {
            mean,
            std: UNEVENNESS * mean,
            spread: 0.0,
            up_in_world: self.normal_in_world,
            // Half of a spread counts as the standard deviation of the vertical.
            tilt_spread: 2.0 * self.total_tilt_std(),
            num_frames,
            foot_in_world: self.point_in_world,
        }
    }

    /// Where a ray meets it; `None` where it passes too close to the horizon.
    pub fn meets(&self, from: Point3<f64>, direction: &Vector3<f64>) -> Option<Point3<f64>> {
        let dip = -self.normal_in_world.dot(direction) / direction.norm();
        (dip >= LEAST_DIP).then(|| from + direction.normalize() * (self.height_of(from) / dip))
    }

    /// The plane below an object in every frame that is registered in both models.
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
        let foot_on = |normal: &Vector3<f64>, height: f64| lowest_foot(background, image, pixels, (normal, height));
        let mut normal = self.normal_in_world;
        let mut height = self.height_of(center);
        let mut foot = foot_on(&normal, height)?;
        // Each round leaves the ratio of the ground's slope to that of the sight.
        for _ in 0..5 {
            let Some((next, place)) = relief.and_then(|relief| relief.plane_near(foot)) else { break };
            (normal, height) = (next, next.dot(&(center - place)));
            foot = foot_on(&normal, height)?;
        }
        let point = center - normal * height;
        let off = foot - point;
        let of_tilt = if self.is_mapped() { 0.0 } else { off.dot(&(self.normal_covariance * off)).max(0.0).sqrt() };
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
