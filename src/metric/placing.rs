//! Motion of objects in the background's frame, in meters.
//!
//! An object's point is at x = c + r v (`docs/maths/scale.md`): its ratio r moves it along the ray from the camera's
//! centre c, the metres per unit move it in proportion to the same ray, and the error of the image position moves it
//! across the ray (`docs/maths/metric.md`, eq. 10).

use nalgebra::{Matrix3, Point3, SMatrix, Vector3};

use super::align::Covariance;
use crate::scene::{MetricFrame, MetricPose};

/// A point observed by a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObservedPoint {
    /// The point, in the frame of the background.
    pub point: Point3<f64>,
    /// The camera's centre, in the frame of the background.
    pub center: Point3<f64>,
    /// Standard deviation of the scale ratio, as a share of it.
    pub log_ratio_std: f64,
    /// Standard deviation of the direction, radians.
    pub direction_std: f64,
    /// Further covariance of the position in this frame, in the frame and unit of the background.
    pub pose_covariance: Matrix3<f64>,
}

impl ObservedPoint {
    fn ray_m(&self, frame: &MetricFrame) -> Vector3<f64> {
        let metric_from_world = frame.metric_from_world();
        metric_from_world.rotation * (self.point - self.center) * metric_from_world.scale
    }

    /// Covariance of the point relative to the camera along the metric axes.
    pub fn covariance_m(&self, frame: &MetricFrame) -> Matrix3<f64> {
        let log_std = frame.log_scale_std().hypot(self.log_ratio_std);
        ray_covariance(&self.ray_m(frame), log_std, self.direction_std) + in_metres(frame, &self.pose_covariance)
    }
}

/// Transforms a covariance of the background's frame to the metric axes.
pub fn in_metres(frame: &MetricFrame, covariance: &Matrix3<f64>) -> Matrix3<f64> {
    let metric_from_world = frame.metric_from_world();
    let rotation = metric_from_world.rotation.to_rotation_matrix();
    rotation * covariance * rotation.transpose() * metric_from_world.scale.powi(2)
}

/// Position and distance in metres, relative to the camera; without motion and georeferenced position.
pub fn metric_pose(frame: &MetricFrame, observed: &ObservedPoint) -> MetricPose {
    let ray_m = observed.ray_m(frame);
    let covariance = observed.covariance_m(frame);
    let along = ray_m.try_normalize(0.0).unwrap_or_default();
    MetricPose {
        position_m: (frame.metric_from_world() * observed.point).coords.into(),
        position_std_m: axes_std(&covariance),
        distance_to_camera_m: ray_m.norm(),
        distance_to_camera_std_m: along.dot(&(covariance * along)).max(0.0).sqrt(),
        motion: None,
        place: None,
    }
}

/// Standard deviations of the point's georeferenced position along the axes of the metric frame: those of the
/// alignment, which include the scale, and those of the ratio and the direction.
pub fn place_std_m(frame: &MetricFrame, observed: &ObservedPoint) -> [f64; 3] {
    let of_ray = ray_covariance(&observed.ray_m(frame), observed.log_ratio_std, observed.direction_std);
    axes_std(&(alignment_covariance(frame, observed.point) + of_ray + in_metres(frame, &observed.pose_covariance)))
}

/// Covariance along the ray in proportion to its length, and across it by the direction.
fn ray_covariance(ray_m: &Vector3<f64>, log_std: f64, direction_std: f64) -> Matrix3<f64> {
    let along = ray_m * ray_m.transpose();
    let across = Matrix3::identity() * ray_m.norm_squared() - along;
    along * (log_std * log_std) + across * (direction_std * direction_std)
}

/// Covariance of a point's position due to the alignment of the frame.
fn alignment_covariance(frame: &MetricFrame, point: Point3<f64>) -> Matrix3<f64> {
    let metric_from_world = frame.metric_from_world();
    let arm = metric_from_world.rotation * (point - Point3::from(frame.anchor)) * metric_from_world.scale;
    covariance_at(&arm, &Covariance::from_fn(|j, k| frame.covariance[j][k]))
}

/// Covariance of a point's position, metres², at a displacement from the anchor of an alignment.
pub(super) fn covariance_at(arm: &Vector3<f64>, covariance: &Covariance) -> Matrix3<f64> {
    let mut jacobian = SMatrix::<f64, 3, 7>::zeros();
    jacobian.set_column(0, arm);
    jacobian.fixed_view_mut::<3, 3>(0, 1).copy_from(&-arm.cross_matrix());
    jacobian.fixed_view_mut::<3, 3>(0, 4).copy_from(&Matrix3::identity());
    jacobian * covariance * jacobian.transpose()
}

fn axes_std(covariance: &Matrix3<f64>) -> [f64; 3] {
    [0, 1, 2].map(|k| covariance[(k, k)].max(0.0).sqrt())
}

#[cfg(test)]
mod tests {
    use nalgebra::{point, vector};

    use super::*;
    use crate::metric::{Kind, Level, Source, frame_on_ground, fuse};

    fn frame() -> MetricFrame {
        let source = Source { name: "a".to_owned(), kind: Kind::Surveyed, log_scale: 2f64.ln(), std: 0.03 };
        let level = Level {
            up_in_world: vector![0.0, 0.0, 1.0],
            tilt_std: 0.0,
            ahead_in_world: vector![0.0, 1.0, 0.0],
            origin_in_world: point![0.0, 0.0, 0.0],
        };
        frame_on_ground(&fuse(&[source]).unwrap(), &level)
    }

    #[test]
    fn the_ratio_moves_a_point_along_its_ray() {
        let observed = ObservedPoint {
            point: point![0.0, 10.0, 0.0],
            center: point![0.0, 0.0, 0.0],
            log_ratio_std: 0.04,
            direction_std: 1e-3,
            pose_covariance: Matrix3::zeros(),
        };
        let found = metric_pose(&frame(), &observed);
        assert!((Point3::from(found.position_m) - point![0.0, 20.0, 0.0]).norm() < 1e-9, "{found:?}");
        // Twenty metres along the ray at 3 % of the scale and 4 % of the ratio; a thousandth across it.
        let expected = [0.02, 1.0, 0.02];
        assert!(found.position_std_m.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        assert!((found.distance_to_camera_m - 20.0).abs() < 1e-9);
        assert!((found.distance_to_camera_std_m - 1.0).abs() < 1e-9);
    }

    #[test]
    fn the_position_has_the_errors_of_the_frame_and_the_ray() {
        let mut frame = frame();
        frame.covariance[4][4] = 9.0;
        frame.covariance[3][3] = 1e-4;
        let observed = ObservedPoint {
            point: point![0.0, 10.0, 0.0],
            center: point![0.0, 8.0, 0.0],
            log_ratio_std: 0.1,
            direction_std: 0.0,
            pose_covariance: Matrix3::zeros(),
        };
        let [east, north, up] = place_std_m(&frame, &observed);
        assert!((east - 9.04f64.sqrt()).abs() < 1e-9, "three metres, and a hundredth of a turn at twenty: {east}");
        assert!((north - 0.6f64.hypot(0.4)).abs() < 1e-9, "{north}");
        assert!(up.abs() < 1e-9, "{up}");
    }
}
