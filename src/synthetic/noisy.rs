//! Effect of pixel noise on a reconstruction: points triangulated and cameras resected from noisy observations.
//!
//! Each point is moved to where its noisy observations put it, given the true cameras, and each camera to where its
//! noisy observations put it, given the true points. That is one half-step each of an alternation, not a bundle
//! adjustment, but errors have the size and the direction (depth against rotation) that real ones have.

use nalgebra::{Matrix3, Matrix6, Point3, SMatrix, UnitQuaternion, Vector3, Vector6};
use rand::Rng as _;
use rand_distr::StandardNormal;

use crate::camera::Camera;
use crate::math::{Rigid3, Rng};
use crate::scene::Reconstruction;

/// Gauss-Newton starts at the truth and the noise is a pixel or so: a few steps suffice.
const NUM_STEPS: usize = 4;

/// Adds Gaussian noise to every observation, then moves points and cameras to fit.
pub(super) fn disturb(reconstruction: &mut Reconstruction, pixel_px: f64, rng: &mut Rng) {
    for image in reconstruction.images.values_mut() {
        for observation in &mut image.observations {
            observation.pixel.x += pixel_px * rng.sample::<f64, _>(StandardNormal);
            observation.pixel.y += pixel_px * rng.sample::<f64, _>(StandardNormal);
        }
    }
    let exact = reconstruction.clone();
    for point in reconstruction.points.values_mut() {
        for _ in 0..NUM_STEPS {
            point.position += point_step(&exact, point).unwrap_or_default();
        }
    }
    for image in reconstruction.images.values_mut() {
        for _ in 0..NUM_STEPS {
            let step = pose_step(&exact, image).unwrap_or_default();
            let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
            image.cam_from_world = Rigid3::new(turn, step.fixed_rows::<3>(3).into_owned()) * image.cam_from_world;
        }
    }
}

fn point_step(exact: &Reconstruction, point: &crate::scene::Point3d) -> Option<Vector3<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for element in &point.track {
        let image = &exact.images[&element.image];
        let camera = exact.camera_of(image);
        let projection = camera.project(image.cam_from_world * point.position);
        let d_world = projection.d_point * image.cam_from_world.rotation.to_rotation_matrix().matrix();
        let residual = image.observations[element.observation_idx as usize].pixel - projection.pixel;
        normal += d_world.transpose() * d_world;
        right += d_world.transpose() * residual;
    }
    Some(normal.cholesky()?.solve(&right))
}

/// Rotation (scaled axis), then translation, applied on the camera's side.
fn pose_step(exact: &Reconstruction, image: &crate::scene::Image) -> Option<Vector6<f64>> {
    let camera: &Camera = exact.camera_of(image);
    let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
    for observation in &image.observations {
        let Some(id) = observation.point else { continue };
        let in_cam: Point3<f64> = image.cam_from_world * exact.points[&id].position;
        let projection = camera.project(in_cam);
        let mut d_pose = SMatrix::<f64, 2, 6>::zeros();
        // d(exp(ω) x)/dω = −[x]×.
        d_pose.fixed_columns_mut::<3>(0).copy_from(&(-projection.d_point * in_cam.coords.cross_matrix()));
        d_pose.fixed_columns_mut::<3>(3).copy_from(&projection.d_point);
        normal += d_pose.transpose() * d_pose;
        right += d_pose.transpose() * (observation.pixel - projection.pixel);
    }
    Some(normal.cholesky()?.solve(&right))
}
