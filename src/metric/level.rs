//! Metric frame, from the fused scale and the fixes, or from the ground where there are none.

use nalgebra::{Matrix3, Point3, Rotation3, SVector, UnitQuaternion, Vector3};

use super::align::Covariance;
use super::{Alignment, Fused};
use crate::math::{Rigid3, Sim3};
use crate::scene::{MapOrigin, MetricAxes, MetricFrame, MetricStd, Reconstruction};

/// Substitute for a map: the vertical and a position on the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Unit vector, in the frame of the background.
    pub up_in_world: Vector3<f64>,
    /// Standard deviation of its tilt, radians.
    pub tilt_std: f64,
    /// Direction that the second axis follows, projected to the horizontal: the first viewing direction.
    pub ahead_in_world: Vector3<f64>,
    /// The origin of the metric frame, in units of the background.
    pub origin_in_world: Point3<f64>,
}

impl Level {
    /// The vertical and the origin of a background.
    ///
    /// * `up` – the vertical in its frame, and the standard deviation of its tilt, radians; by default, where no ground
    ///   is visible, the mean of the cameras' own.
    /// * `foot_in_world` – the origin; by default the first camera.
    pub fn of_background(
        background: &Reconstruction,
        up: Option<(Vector3<f64>, f64)>,
        foot_in_world: Option<Point3<f64>>,
    ) -> Self {
        let upper = |pose: Rigid3| pose.rotation.inverse() * -Vector3::y();
        let poses = || background.images.values().map(|image| image.cam_from_world);
        // Standard deviation of a camera's tilt where no ground is visible, radians.
        let (up, tilt_std) = up.unwrap_or_else(|| (poses().map(upper).sum(), 0.5));
        let up_in_world = up.try_normalize(f64::EPSILON).unwrap_or_else(|| -Vector3::y());
        let first = poses().next().unwrap_or_else(Rigid3::identity);
        let forward = first.rotation.inverse() * Vector3::z();
        // For a camera facing nearly straight down, the upper edge of the image points ahead.
        let is_steep = forward.angle(&-up_in_world) < 0.3;
        Self {
            up_in_world,
            tilt_std,
            ahead_in_world: if is_steep { upper(first) } else { forward },
            origin_in_world: foot_in_world.unwrap_or_else(|| first.center()),
        }
    }
}

/// Metric frame without georeference: z up, y ahead, the origin of the [`Level`].
///
/// Only scale and tilt have a standard deviation; positions relative to the origin have no other error.
pub fn frame_on_ground(fused: &Fused, level: &Level) -> MetricFrame {
    let rotation = upright(level);
    let metric_from_world = about(level.origin_in_world, Point3::origin(), fused.scale, rotation);
    let mut covariance = Covariance::zeros();
    covariance[(0, 0)] = log_variance(fused);
    (1..3).for_each(|k| covariance[(k, k)] = level.tilt_std * level.tilt_std);
    frame(metric_from_world, level.origin_in_world, &covariance, fused, None)
}

/// Frame of a path aligned to its fixes, at the fused scale: the other sources of scale also correct rotation and
/// position, by their correlation with it (docs/maths/metric.md, eq. 9).
pub fn frame_on_map(fused: &Fused, alignment: &Alignment, origin: MapOrigin) -> MetricFrame {
    let Alignment { metric_from_world, anchor_in_world, covariance, .. } = alignment;
    let variance = covariance[(0, 0)];
    let gain: SVector<f64, 7> = covariance.column(0) / variance;
    let shift = fused.scale.ln() - metric_from_world.scale.ln();
    let turn: Vector3<f64> = gain.fixed_rows::<3>(1) * shift;
    let way: Vector3<f64> = gain.fixed_rows::<3>(4) * shift;
    let rotation = UnitQuaternion::from_scaled_axis(turn) * metric_from_world.rotation;
    let place = *metric_from_world * *anchor_in_world + way;
    let updated = covariance + gain * gain.transpose() * (log_variance(fused) - variance);
    let metric_from_world = about(*anchor_in_world, place, fused.scale, rotation);
    frame(metric_from_world, *anchor_in_world, &updated, fused, Some(origin))
}

fn log_variance(fused: &Fused) -> f64 {
    (fused.std / fused.scale).powi(2)
}

/// Similarity that maps a point to a given position.
fn about(point: Point3<f64>, place: Point3<f64>, scale: f64, rotation: UnitQuaternion<f64>) -> Sim3 {
    Sim3::new(scale, rotation, place - scale * (rotation * point))
}

/// Rotation with ahead and up as the second and the third axis; an arbitrary heading without a direction ahead.
fn upright(level: &Level) -> UnitQuaternion<f64> {
    let up = level.up_in_world.try_normalize(f64::EPSILON).unwrap_or(Vector3::z());
    let flat = |v: Vector3<f64>| (v - up * up.dot(&v)).try_normalize(1e-6);
    let ahead = flat(level.ahead_in_world).or_else(|| flat(Vector3::x())).or_else(|| flat(Vector3::y()));
    let ahead = ahead.unwrap_or(Vector3::y());
    let rows = Matrix3::from_columns(&[ahead.cross(&up), ahead, up]).transpose();
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows))
}

fn frame(
    metric_from_world: Sim3,
    anchor: Point3<f64>,
    covariance: &Covariance,
    fused: &Fused,
    origin: Option<MapOrigin>,
) -> MetricFrame {
    let Sim3 { scale, rotation, translation } = metric_from_world;
    let q = rotation.into_inner().normalize();
    let std = |k: usize| covariance[(k, k)].max(0.0).sqrt();
    let on_map = origin.is_some();
    MetricFrame {
        scale,
        rotation_wxyz: [q.w, q.i, q.j, q.k],
        translation: translation.into(),
        axes: if on_map { MetricAxes::EastNorthUp } else { MetricAxes::Up },
        origin,
        std: MetricStd {
            scale: fused.std,
            tilt_deg: std(1).hypot(std(2)).to_degrees() / std::f64::consts::SQRT_2,
            heading_deg: on_map.then(|| std(3).to_degrees()),
            place_m: on_map.then(|| [4, 5, 6].map(std)),
        },
        anchor: anchor.coords.into(),
        covariance: std::array::from_fn(|j| std::array::from_fn(|k| covariance[(j, k)])),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{point, vector};

    use super::*;
    use crate::metric::{Kind, Source, fuse};

    fn source(scale: f64, std: f64) -> Source {
        Source { name: "a".to_owned(), kind: Kind::Surveyed, log_scale: scale.ln(), std }
    }

    fn near(a: Point3<f64>, b: Point3<f64>) -> bool {
        (a - b).norm() < 1e-9
    }

    #[test]
    fn the_ground_is_below_and_the_camera_faces_ahead() {
        let fused = fuse(&[source(12.0, 0.03)]).unwrap();
        // Axes of a camera: down is the second, ahead the third.
        let level = Level {
            up_in_world: vector![0.0, -1.0, 0.0],
            tilt_std: 0.04,
            ahead_in_world: vector![0.0, 0.5, 1.0],
            origin_in_world: point![1.0, 2.0, 3.0],
        };
        let found = frame_on_ground(&fused, &level);
        let metric_from_world = found.metric_from_world();
        assert!(near(metric_from_world * level.origin_in_world, Point3::origin()));
        assert!(near(metric_from_world * point![1.0, 1.0, 3.0], point![0.0, 0.0, 12.0]));
        assert!(near(metric_from_world * point![1.0, 2.0, 4.0], point![0.0, 12.0, 0.0]));
        assert!(near(metric_from_world * point![2.0, 2.0, 3.0], point![12.0, 0.0, 0.0]));
        assert_eq!((found.axes, found.origin, found.std.heading_deg), (MetricAxes::Up, None, None));
        assert!((found.log_scale_std() - 0.03).abs() < 1e-12);
        assert!((found.std.tilt_deg.to_radians() - 0.04).abs() < 1e-12);
        let straight_down = Level { ahead_in_world: -level.up_in_world, ..level };
        assert!((upright(&straight_down) * level.up_in_world - Vector3::z()).norm() < 1e-9);
    }

    #[test]
    fn other_sources_of_scale_correct_the_correlated_parameters() {
        let mut covariance = Covariance::identity() * 0.04;
        covariance[(0, 0)] = 0.01;
        covariance[(0, 4)] = 0.01;
        covariance[(4, 0)] = 0.01;
        let alignment = Alignment {
            metric_from_world: Sim3::new(
                10.0,
                UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3),
                vector![5.0, 6.0, 7.0],
            ),
            anchor_in_world: point![1.0, -1.0, 2.0],
            covariance,
            offset_s: 0.0,
            offset_std_s: 0.1,
            num_fixes: 9,
            rejected_share: 0.0,
            noise_factor: 1.0,
        };
        let origin = MapOrigin { longitude: 8.0, latitude: 47.0, height_m: 400.0, knows_height: true };
        let alone = fuse(&[source(10.0, 0.1)]).unwrap();
        let found = frame_on_map(&alone, &alignment, origin);
        let place = alignment.metric_from_world * alignment.anchor_in_world;
        assert!(near(found.metric_from_world() * alignment.anchor_in_world, place));
        assert!((found.std.place_m.unwrap()[0] - 0.2).abs() < 1e-12 && (found.covariance[0][4] - 0.01).abs() < 1e-12);
        let both = fuse(&[source(10.0, 0.1), source(10.5, 0.01)]).unwrap();
        let found = frame_on_map(&both, &alignment, origin);
        assert!((found.log_scale_std() - both.std / both.scale).abs() < 1e-12);
        let moved = found.metric_from_world() * alignment.anchor_in_world - place;
        assert!((moved - vector![(both.scale / 10.0).ln(), 0.0, 0.0]).norm() < 1e-9, "{moved}");
        // The part of the first axis' variance that is correlated with the scale is gone.
        assert!((found.std.place_m.unwrap()[0].powi(2) - 0.03 - found.covariance[0][0]).abs() < 1e-9);
    }
}
