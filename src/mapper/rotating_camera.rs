//! Rotations of a camera that does not translate: a drone that hovers, a camera on a pole.
//!
//! Without translation a point has a direction and no depth. With b_ij the ray of point j in camera i, its direction
//! d_j in the world and the rotations R_i (cam_i from world), b_ij = R_i d_j. Views are taken in order: rotations from
//! the directions known so far (Wahba's problem by SVD, reweighted), then the directions of new points; then both in
//! turns. A camera that sways by a share of its height moves near points against far ones; over one ground plane most
//! of that is a rotation, too. Views that vehicles fill show no rotation; they get one between those of their
//! neighbors.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::camera::Camera;
use crate::features::tracks::{TrackTable, View};
use crate::math::{Rigid3, STD_PER_MAD, median};
use crate::scene::{CameraId, Image, Reconstruction};

/// Fewest points that hold a rotation: three determine it, and as many again show that they are right.
const MIN_POINTS: usize = 12;
/// Residual beyond which a point is no part of the rotation, pixels: the sway of a hovering drone at some heights of
/// distance, and errors of a guessed focal length towards the corners.
const MAX_ERROR_PX: f64 = 6.0;
/// Share of the points of a view that must agree on its rotation: traffic may have most of them.
const MIN_SHARE: f64 = 0.35;
/// Share of the views that must have one: fewer are another kind of video. Of those of two drones and two dashcams that
/// move, 0.05 to 0.41 have one, with residuals of 2 to 5 pixels; of twelve cameras on poles and bridges, 0.9 to 1.
const MIN_VIEWS: f64 = 0.8;
/// Residual up to which no sway is left that a map needs, pixels: cameras on poles have 0.04 to 0.7, two rendered
/// drones in the wind 0.3.
const STILL_PX: f64 = 1.0;
/// Sweeps over all views after the first.
const SWEEPS: usize = 3;

/// Views of a camera that only rotates.
#[derive(Clone, Debug)]
pub struct RotatingCamera {
    /// By view: world to camera, with the camera at the origin; the first registered view is the world.
    pub poses: Vec<Option<Rigid3>>,
    /// Robust standard deviation of a coordinate, pixels.
    pub error_px: f64,
}

impl RotatingCamera {
    /// Returns true if it sways so little that no map can be made of its views.
    pub fn is_still(&self) -> bool {
        self.error_px <= STILL_PX
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

/// Rotations of the views of one camera; `None` where rotations do not explain them.
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
        // Too few known points say nothing against a rotation, but what follows needs the new ones.
        if rotations[view].is_some() || world.known(rays).count() < MIN_POINTS {
            last = rotations[view].unwrap_or(last);
            world.extend(rays, &last);
        }
    }
    for _ in 0..SWEEPS {
        world.renew(&seen, &rotations);
        for (rotation, rays) in rotations.iter_mut().zip(&seen) {
            *rotation = world.rotation(rays, rotation.unwrap_or(last));
            last = rotation.unwrap_or(last);
        }
    }
    let num_seen = seen.iter().filter(|rays| !rays.is_empty()).count();
    let num_found = rotations.iter().flatten().count();
    if num_found < 2 || (num_found as f64) < MIN_VIEWS * num_seen as f64 {
        return None;
    }
    let errors = rotations.iter().zip(&seen).filter_map(|(rotation, rays)| Some((rotation.as_ref()?, rays)));
    let errors = errors.flat_map(|(rotation, rays)| world.errors_px(rays, rotation)).collect();
    let first = rotations.iter().flatten().next().copied()?;
    let pose = |rotation: UnitQuaternion<f64>| Rigid3::new(rotation * first.inverse(), Vector3::zeros());
    let poses = without_gaps(&rotations).into_iter().map(|rotation| rotation.map(pose)).collect();
    // Two coordinates, of which the median distance is 1.18 σ.
    Some(RotatingCamera { poses, error_px: median(errors)? / crate::math::RAYLEIGH_MEDIAN })
}

/// Rotations with those between two known ones interpolated.
fn without_gaps(rotations: &[Option<UnitQuaternion<f64>>]) -> Vec<Option<UnitQuaternion<f64>>> {
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

    /// The rotation of a view; `None` where too few points agree on one.
    fn rotation(&self, rays: &[(usize, Vector3<f64>)], start: UnitQuaternion<f64>) -> Option<UnitQuaternion<f64>> {
        let known: Vec<(Vector3<f64>, Vector3<f64>)> = self.known(rays).collect();
        if known.len() < MIN_POINTS {
            return None;
        }
        let mut rotation = start;
        for _ in 0..8 {
            let errors: Vec<f64> = known.iter().map(|(d, ray)| (rotation * d - ray).norm()).collect();
            // From a wide start to the noise of the points.
            let scale = STD_PER_MAD * median(errors.clone())? + 0.2 / self.focal_px;
            let mut sum = Matrix3::zeros();
            for ((direction, ray), error) in known.iter().zip(&errors) {
                sum += ray * direction.transpose() / (1.0 + (error / scale).powi(2));
            }
            rotation = nearest_rotation(&sum)?;
        }
        let most = MAX_ERROR_PX / self.focal_px;
        let agreeing = known.iter().filter(|(direction, ray)| (rotation * direction - ray).norm() <= most).count();
        (agreeing >= MIN_POINTS && agreeing as f64 >= MIN_SHARE * known.len() as f64).then_some(rotation)
    }

    /// Adds the directions of new points of a view.
    fn extend(&mut self, rays: &[(usize, Vector3<f64>)], rotation: &UnitQuaternion<f64>) {
        for (track, ray) in rays {
            self.of_track[*track].get_or_insert_with(|| rotation.inverse() * ray);
        }
    }

    /// Directions as the means over all views.
    fn renew(&mut self, seen: &[Vec<(usize, Vector3<f64>)>], rotations: &[Option<UnitQuaternion<f64>>]) {
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
