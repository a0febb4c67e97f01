//! Absolute pose of a camera from 2D–3D correspondences.

use nalgebra::{Matrix6, Point2, Point3, UnitQuaternion, Vector3, Vector6};

use super::solvers::p3p;
use crate::camera::Camera;
use crate::math::{Rigid3, Rng, RobustLoss};
use crate::robust::{self, Estimator};

/// 2D–3D correspondences of a camera; both lists have the same length.
pub struct PixelsAndPoints<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// Observed pixel positions.
    pub pixels: &'a [Point2<f64>],
    /// Positions in the world.
    pub points: &'a [Point3<f64>],
}

/// Absolute pose with its inliers.
#[derive(Clone, Debug)]
pub struct Resection {
    /// World to camera.
    pub cam_from_world: Rigid3,
    /// Indices of the data within the threshold.
    pub inliers: Vec<usize>,
}

/// P3P LO-RANSAC on the reprojection error; `None` when no pose is supported by more than its own sample.
pub fn estimate(data: &PixelsAndPoints<'_>, max_error_px: f64, rng: &mut Rng) -> Option<Resection> {
    let rays: Vec<_> = data.pixels.iter().map(|&p| data.camera.ray_from_pixel(p)).collect();
    let estimator = PoseEstimator { data, rays };
    let options = robust::Options { max_iterations: 2000, ..robust::Options::with_max_error(max_error_px) };
    let consensus = robust::ransac(&estimator, &options, rng)?;
    Some(Resection { cam_from_world: consensus.model, inliers: consensus.inliers })
}

/// Refines a nearby initial pose (of a neighbor, or interpolated) robustly on all data.
pub fn refine_from(data: &PixelsAndPoints<'_>, start: &Rigid3, max_error_px: f64) -> Option<Resection> {
    let all: Vec<usize> = (0..data.pixels.len()).collect();
    let mut pose = *start;
    // A wide loss first, to converge from an initial pose some pixels off; then the threshold itself.
    for scale in [8.0 * max_error_px, 2.0 * max_error_px, 0.5 * max_error_px] {
        pose = gauss_newton(data, &pose, &all, RobustLoss::Cauchy { scale }, 8)?;
    }
    let max_sq = max_error_px * max_error_px;
    let inliers: Vec<usize> = all.into_iter().filter(|&i| reprojection_error_sq(data, &pose, i) <= max_sq).collect();
    (inliers.len() >= 4).then_some(Resection { cam_from_world: pose, inliers })
}

struct PoseEstimator<'a> {
    data: &'a PixelsAndPoints<'a>,
    rays: Vec<Vector3<f64>>,
}

impl Estimator for PoseEstimator<'_> {
    type Model = Rigid3;
    // P3P needs three points.
    const SAMPLE_SIZE: usize = 3;

    fn num_data(&self) -> usize {
        self.rays.len()
    }

    fn fit(&self, sample: &[usize], models: &mut Vec<Rigid3>) {
        let rays = std::array::from_fn(|k| self.rays[sample[k]]);
        let points = std::array::from_fn(|k| self.data.points[sample[k]]);
        models.extend(p3p(&rays, &points));
    }

    fn error_sq(&self, pose: &Rigid3, datum: usize) -> f64 {
        reprojection_error_sq(self.data, pose, datum)
    }

    fn refine(&self, pose: &Rigid3, inliers: &[usize]) -> Option<Rigid3> {
        gauss_newton(self.data, pose, inliers, RobustLoss::Squared, 4)
    }
}

fn reprojection_error_sq(data: &PixelsAndPoints<'_>, pose: &Rigid3, i: usize) -> f64 {
    match data.camera.pixel_from_cam(*pose * data.points[i]) {
        Some(pixel) => (pixel - data.pixels[i]).norm_squared(),
        None => f64::INFINITY,
    }
}

/// Iteratively reweighted Gauss-Newton on the six degrees of freedom of the pose (rotation and translation in camera
/// coordinates); `None` if fewer than three points are in front of the camera or the normal equations are singular.
fn gauss_newton(
    data: &PixelsAndPoints<'_>,
    start: &Rigid3,
    used: &[usize],
    loss: RobustLoss,
    rounds: usize,
) -> Option<Rigid3> {
    let mut pose = *start;
    for _ in 0..rounds {
        let mut hessian = Matrix6::zeros();
        let mut gradient = Vector6::zeros();
        let mut count = 0;
        for &i in used {
            let in_cam = pose * data.points[i];
            if in_cam.z <= f64::EPSILON {
                continue;
            }
            let projection = data.camera.project(in_cam);
            let residual = projection.pixel - data.pixels[i];
            let weight = loss.evaluate(residual.norm_squared())[1];
            let turn = projection.d_point * -in_cam.coords.cross_matrix();
            let mut jacobian = nalgebra::Matrix2x6::zeros();
            jacobian.fixed_view_mut::<2, 3>(0, 0).copy_from(&turn);
            jacobian.fixed_view_mut::<2, 3>(0, 3).copy_from(&projection.d_point);
            hessian += jacobian.transpose() * jacobian * weight;
            gradient += jacobian.transpose() * residual * weight;
            count += 1;
        }
        if count < 3 {
            return None;
        }
        let delta = -hessian.cholesky()?.solve(&gradient);
        let turn = UnitQuaternion::from_scaled_axis(delta.fixed_rows::<3>(0).into_owned());
        pose = Rigid3::new(turn, delta.fixed_rows::<3>(3).into_owned()) * pose;
        if delta.norm() < 1e-10 {
            break;
        }
    }
    pose.translation.iter().all(|t| t.is_finite()).then_some(pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::seeded_rng;
    use rand::Rng as _;

    fn world(outliers: usize) -> (Camera, Rigid3, Vec<Point2<f64>>, Vec<Point3<f64>>) {
        let camera = Camera { radial: [-0.1, 0.02], ..Camera::with_focal(960, 540, 800.0) };
        let truth = Rigid3::new(UnitQuaternion::from_euler_angles(0.2, 0.4, -0.1), Vector3::new(0.3, -0.2, 9.0));
        let mut rng = seeded_rng(9, 0);
        let points: Vec<_> =
            (0..80).map(|_| Point3::from(Vector3::from_fn(|_, _| rng.random_range(-2.0..2.0)))).collect();
        let mut pixels: Vec<_> = points.iter().map(|p| camera.pixel_from_cam(truth * *p).unwrap()).collect();
        for pixel in pixels.iter_mut().take(outliers) {
            *pixel = Point2::new(rng.random_range(0.0..960.0), rng.random_range(0.0..540.0));
        }
        (camera, truth, pixels, points)
    }

    #[test]
    fn pose_comes_back_through_outliers() {
        let (camera, truth, pixels, points) = world(40);
        let data = PixelsAndPoints { camera: &camera, pixels: &pixels, points: &points };
        let found = estimate(&data, 2.0, &mut seeded_rng(2, 0)).unwrap();
        assert!(found.cam_from_world.angle_to(&truth) < 1e-8);
        assert!((found.cam_from_world.center() - truth.center()).norm() < 1e-7);
        assert!(found.inliers.len() >= 40);
    }

    #[test]
    fn a_near_start_is_pulled_in() {
        let (camera, truth, pixels, points) = world(15);
        let data = PixelsAndPoints { camera: &camera, pixels: &pixels, points: &points };
        let nudge = Rigid3::new(UnitQuaternion::from_euler_angles(0.01, -0.01, 0.0), Vector3::new(0.05, 0.0, 0.1));
        let found = refine_from(&data, &(nudge * truth), 2.0).unwrap();
        assert!(found.cam_from_world.angle_to(&truth) < 1e-3);
        assert!(found.inliers.len() >= 64);
    }
}
