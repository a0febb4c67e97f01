//! Rotation of the background's frame by a camera's attitude in a log.

use nalgebra::{UnitQuaternion, Vector3};

use super::Orientation;

/// Standard deviation of a gimbal's pitch and roll, radians (a degree).
const TILT_STD: f64 = 0.017;

/// Standard deviation of its yaw, which a compass gives, radians (five degrees).
const HEADING_STD: f64 = 0.087;

/// Axes east, north, up from those of a camera (x right, y down, z forward) whose optical axis has the direction `yaw`,
/// clockwise from north, and `pitch`, upwards from the horizon, with a rotation `roll` to the right about it; radians.
pub fn metric_from_cam(yaw: f64, pitch: f64, roll: f64) -> UnitQuaternion<f64> {
    let forward = Vector3::new(yaw.sin() * pitch.cos(), yaw.cos() * pitch.cos(), pitch.sin());
    let right = Vector3::new(yaw.cos(), -yaw.sin(), 0.0);
    UnitQuaternion::from_basis_unchecked(&[right, forward.cross(&right), forward])
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll)
}

/// Mean rotation of pairs of attitudes: `metric_from_cam` by the log and `cam_from_world` by the reconstruction, at the
/// same times. The rotations of the pairs relative to it are zero on average.
///
/// `None` without pairs, and where they disagree with each other: the log's angles are then not those of this camera.
pub fn orientation(pairs: &[(UnitQuaternion<f64>, UnitQuaternion<f64>)]) -> Option<Orientation> {
    let rotations: Vec<UnitQuaternion<f64>> =
        pairs.iter().map(|(metric_from_cam, cam_from_world)| metric_from_cam * cam_from_world).collect();
    let mean = mean(&rotations)?;
    let squares: f64 = rotations.iter().map(|rotation| rotation.angle_to(&mean).powi(2)).sum();
    let spread = (squares / rotations.len() as f64).sqrt();
    // Attitudes that disagree by more than this with the camera's motion are not those of the camera, radians.
    let agrees = spread <= 0.35 && mean.coords.iter().all(|value| value.is_finite());
    // Errors of a gimbal last as long as a flight: they do not average out.
    agrees.then(|| Orientation {
        metric_from_world: mean,
        tilt_std: TILT_STD.max(spread),
        heading_std: HEADING_STD.max(spread),
    })
}

/// Iterations of the mean: each rotates by the mean residual, and five converge from rotations of a radian.
fn mean(rotations: &[UnitQuaternion<f64>]) -> Option<UnitQuaternion<f64>> {
    let mut mean = *rotations.first()?;
    for _ in 0..5 {
        let sum: Vector3<f64> = rotations.iter().map(|rotation| (rotation * mean.inverse()).scaled_axis()).sum();
        mean = UnitQuaternion::from_scaled_axis(sum / rotations.len() as f64) * mean;
    }
    Some(mean)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    #[test]
    fn the_optical_axis_follows_the_angles() {
        let north = metric_from_cam(0.0, 0.0, 0.0);
        assert!((north * Vector3::z() - Vector3::y()).norm() < 1e-12);
        assert!((north * Vector3::x() - Vector3::x()).norm() < 1e-12);
        assert!((north * Vector3::y() + Vector3::z()).norm() < 1e-12);
        let east = metric_from_cam(FRAC_PI_2, 0.0, 0.0);
        assert!((east * Vector3::z() - Vector3::x()).norm() < 1e-12);
        // Straight down, the upper edge of the picture towards the east.
        let down = metric_from_cam(FRAC_PI_2, -FRAC_PI_2, 0.0);
        assert!((down * Vector3::z() + Vector3::z()).norm() < 1e-12);
        assert!((down * -Vector3::y() - Vector3::x()).norm() < 1e-12);
        // A roll to the right lowers the right edge.
        assert!((metric_from_cam(0.0, 0.0, 0.1) * Vector3::x()).z < -0.09);
    }

    #[test]
    fn attitudes_that_follow_the_camera_turn_the_background() {
        let metric_from_world = UnitQuaternion::from_euler_angles(0.3, -0.8, 2.0);
        let pair = |i: u32, error: f64| {
            let metric_from_cam = metric_from_cam(0.1 * f64::from(i), -0.5, 0.02);
            let noisy = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), error) * metric_from_cam;
            (noisy, metric_from_cam.inverse() * metric_from_world)
        };
        let pairs: Vec<_> = (0..20).map(|i| pair(i, if i % 2 == 0 { 0.01 } else { -0.01 })).collect();
        let found = orientation(&pairs).unwrap();
        assert!(found.metric_from_world.angle_to(&metric_from_world) < 1e-3);
        assert_eq!((found.tilt_std, found.heading_std), (TILT_STD, HEADING_STD));
        let others: Vec<_> = (0..20).map(|i| pair(i, 0.15 * f64::from(i))).collect();
        assert_eq!((orientation(&others), orientation(&[])), (None, None));
    }
}
