//! Rotations of a camera that does not translate: a drone that hovers, a camera on a pole.
//!
//! Without translation a point has a direction and no depth. With b_ij the ray of point j in camera i, its direction
//! d_j in the world and the rotations R_i (cam_i from world), b_ij = R_i d_j. Views are processed in order: rotations
//! from the directions known so far (Wahba's problem by SVD, reweighted), then the directions of new points; then both
//! alternately. A camera that sways by a share of its height displaces near points relative to far ones; over one
//! ground plane most of that is a rotation, too. Views that are filled with vehicles determine no rotation; theirs is
//! interpolated between their neighbors.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::camera::Camera;
use crate::features::tracks::{TrackTable, View};
use crate::math::{Rigid3, STD_PER_MAD, median};
use crate::scene::{CameraId, Image, Reconstruction};

/// Minimum number of points of a rotation: three determine it, and the others verify it.
const MIN_POINTS: usize = 12;
/// Maximum residual of an inlier, pixels: covers the sway of a hovering drone at some heights of distance, and errors
/// of a guessed focal length towards the corners.
const MAX_ERROR_PX: f64 = 6.0;
/// Minimum inlier ratio of a view: most of its points may be on traffic.
const MIN_INLIER_RATIO: f64 = 0.35;
/// Minimum share of views with a rotation: a video with fewer is of another kind. Two drones and two dashcams that move
/// have 0.05 to 0.41, with residuals of 2 to 5 pixels; twelve cameras on poles and bridges have 0.9 to 1.
const MIN_VIEW_SHARE: f64 = 0.8;
/// Residual up to which the sway is too small for a map, pixels: cameras on poles have 0.04 to 0.7, two rendered drones
/// in the wind 0.3.
const MAX_STATIONARY_PX: f64 = 1.0;
/// Number of sweeps over all views after the first.
const SWEEPS: usize = 3;

/// Views of a camera that only rotates.
#[derive(Clone, Debug)]
pub struct RotatingCamera {
    /// Camera from world by view, with the camera at the origin; the first registered view is the world.
    pub poses: Vec<Option<Rigid3>>,
    /// Robust standard deviation of a coordinate, pixels.
    pub error_px: f64,
}

impl RotatingCamera {
    /// Returns true if the camera sways too little for a map.
    pub fn is_still(&self) -> bool {
        self.error_px <= MAX_STATIONARY_PX
    }

    /// The views as a model without points.
    pub fn model(&self, table: &TrackTable, camera: &Camera) -> Reconstruction {
        let image = |(view, pose): (&View, &Option<Rigid3>)| {
            let (name, observations) = (view.name.clone(), Vec::new());
            Some((view.image, Image { name, camera: CameraId(1), cam_from_world: (*pose)?, observations }))
        };
        let images = table.views.iter().zip(&self.poses).filter_map(image).collect();
        Reconstruction { cameras: [(CameraId(1), *camera)].into(), images, ..Reconstruction::default() }
    }
}

/// Estimates the rotations of the views of one camera; `None` where rotations do not explain them.
///
/// * `table` – ordered views.
pub fn rotating_camera(table: &TrackTable, camera: &Camera) -> Option<RotatingCamera> {
    let mut seen: Vec<Vec<(usize, Vector3<f64>)>> = vec![Vec::new(); table.views.len()];
    for (track, features) in table.tracks.iter().enumerate() {
        for &feature in features {
            seen[feature.view as usize].push((track, camera.ray_from_pixel(table.pixel(feature))));
        }
    }
    let mut world = Directions { of_track: vec![None; table.tracks.len()], focal_px: camera.mean_focal() };
    let mut rotations: Vec<Option<UnitQuaternion<f64>>> = vec![None; seen.len()];
    let mut last = UnitQuaternion::identity();
    for (view, rays) in seen.iter().enumerate() {
        let is_first = rotations.iter().all(Option::is_none);
        rotations[view] = if is_first && rays.len() >= MIN_POINTS { Some(last) } else { world.rotation(rays, last) };
        // Too few known points are no evidence against a rotation, but later views need the new ones.
        if rotations[view].is_some() || world.known(rays).count() < MIN_POINTS {
            last = rotations[view].unwrap_or(last);
            world.extend(rays, &last);
        }
    }
    for _ in 0..SWEEPS {
        world.update(&seen, &rotations);
        for (rotation, rays) in rotations.iter_mut().zip(&seen) {
            *rotation = world.rotation(rays, rotation.unwrap_or(last));
            last = rotation.unwrap_or(last);
        }
    }
    let num_seen = seen.iter().filter(|rays| !rays.is_empty()).count();
    let num_found = rotations.iter().flatten().count();
    if num_found < 2 || (num_found as f64) < MIN_VIEW_SHARE * num_seen as f64 {
        return None;
    }
    let errors = rotations.iter().zip(&seen).filter_map(|(rotation, rays)| Some((rotation.as_ref()?, rays)));
    let errors = errors.flat_map(|(rotation, rays)| world.errors_px(rays, rotation)).collect();
    let first = rotations.iter().flatten().next().copied()?;
    let pose = |rotation: UnitQuaternion<f64>| Rigid3::new(rotation * first.inverse(), Vector3::zeros());
    let poses = interpolated(&rotations).into_iter().map(|rotation| rotation.map(pose)).collect();
    // Two coordinates, of which the median distance is 1.18 σ.
    Some(RotatingCamera { poses, error_px: median(errors)? / crate::math::RAYLEIGH_MEDIAN })
}

/// Rotations, interpolated where they are missing between two known ones.
fn interpolated(rotations: &[Option<UnitQuaternion<f64>>]) -> Vec<Option<UnitQuaternion<f64>>> {
    let known: Vec<(usize, UnitQuaternion<f64>)> =
        rotations.iter().enumerate().filter_map(|(view, rotation)| Some((view, (*rotation)?))).collect();
    let mut filled = rotations.to_vec();
    for pair in known.windows(2) {
        let [(from, before), (to, after)] = [pair[0], pair[1]];
        for view in from + 1..to {
            filled[view] = before.try_slerp(&after, (view - from) as f64 / (to - from) as f64, f64::EPSILON);
        }
    }
    filled
}

/// Directions of points in the world.
struct Directions {
    of_track: Vec<Option<Vector3<f64>>>,
    focal_px: f64,
}

impl Directions {
    /// Known directions of the points of a view, and their rays.
    fn known<'a>(
        &'a self,
        rays: &'a [(usize, Vector3<f64>)],
    ) -> impl Iterator<Item = (Vector3<f64>, Vector3<f64>)> + 'a {
        rays.iter().filter_map(move |(track, ray)| Some((self.of_track[*track]?, *ray)))
    }

    /// Distances of rays from the directions of their points, pixels.
    fn errors_px<'a>(
        &'a self,
        rays: &'a [(usize, Vector3<f64>)],
        rotation: &'a UnitQuaternion<f64>,
    ) -> impl Iterator<Item = f64> + 'a {
        self.known(rays).map(move |(direction, ray)| self.focal_px * (rotation * direction - ray).norm())
    }

    /// Estimates the rotation of a view; `None` if it has too few inliers.
    fn rotation(&self, rays: &[(usize, Vector3<f64>)], start: UnitQuaternion<f64>) -> Option<UnitQuaternion<f64>> {
        let known: Vec<(Vector3<f64>, Vector3<f64>)> = self.known(rays).collect();
        if known.len() < MIN_POINTS {
            return None;
        }
        let mut rotation = start;
        for _ in 0..8 {
            let errors: Vec<f64> = known.iter().map(|(d, ray)| (rotation * d - ray).norm()).collect();
            // The scale decreases from a wide start to the noise of the points.
            let scale = STD_PER_MAD * median(errors.clone())? + 0.2 / self.focal_px;
            let mut sum = Matrix3::zeros();
            for ((direction, ray), error) in known.iter().zip(&errors) {
                sum += ray * direction.transpose() / (1.0 + (error / scale).powi(2));
            }
            rotation = nearest_rotation(&sum)?;
        }
        let most = MAX_ERROR_PX / self.focal_px;
        let num_inliers = known.iter().filter(|(direction, ray)| (rotation * direction - ray).norm() <= most).count();
        (num_inliers >= MIN_POINTS && num_inliers as f64 >= MIN_INLIER_RATIO * known.len() as f64).then_some(rotation)
    }

    /// Adds the directions of new points of a view.
    fn extend(&mut self, rays: &[(usize, Vector3<f64>)], rotation: &UnitQuaternion<f64>) {
        for (track, ray) in rays {
            self.of_track[*track].get_or_insert_with(|| rotation.inverse() * ray);
        }
    }

    /// Recomputes the directions as means over all views.
    fn update(&mut self, seen: &[Vec<(usize, Vector3<f64>)>], rotations: &[Option<UnitQuaternion<f64>>]) {
        let mut sums = vec![Vector3::zeros(); self.of_track.len()];
        for (rays, rotation) in seen.iter().zip(rotations) {
            let Some(rotation) = rotation else { continue };
            rays.iter().for_each(|(track, ray)| sums[*track] += rotation.inverse() * ray);
        }
        self.of_track = sums.iter().map(|sum| sum.try_normalize(f64::EPSILON)).collect();
    }
}

/// The rotation R that maximizes tr(Rᵀ M).
fn nearest_rotation(m: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let svd = m.try_svd(true, true, f64::EPSILON, 100)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let flip = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant().signum()));
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * flip * v_t));
    rotation.coords.iter().all(|x| x.is_finite()).then_some(rotation)
}

#[cfg(test)]
pub(crate) mod tests;
