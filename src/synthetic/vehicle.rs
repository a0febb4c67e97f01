//! A box on wheels, as points with outward normals.

use nalgebra::{Point3, Vector3};
use rand::Rng as _;

use crate::math::Rng;

/// Length, width, height of the body, metres.
const SIZE_M: [f64; 3] = [4.5, 1.8, 1.5];
/// Height of the body's lower edge over the ground, metres: the lowest points of a vehicle whose wheels are missing.
pub(super) const CLEARANCE_M: f64 = 0.37;
/// Radius of the wheels, meters.
const WHEEL_RADIUS_M: f64 = 0.33;

/// A surface point in the vehicle's frame: metres; x forward, y left, z up; the origin lies on the ground, amid the
/// wheels.
#[derive(Clone, Copy, Debug)]
pub(super) struct SurfacePoint {
    pub position: Point3<f64>,
    /// Outward unit normal: the point is seen from the half space that it points to.
    pub normal: Vector3<f64>,
}

/// `num_body` random points on the sides and the roof, and with wheels six on the outer face of each, one of them the
/// contact point at height 0.
pub(super) fn surface_points(num_body: usize, has_wheels: bool, rng: &mut Rng) -> Vec<SurfacePoint> {
    let mut points: Vec<_> = (0..num_body).map(|_| body_point(rng)).collect();
    if has_wheels {
        for (x, side) in [(1.4, 1.0), (1.4, -1.0), (-1.4, 1.0), (-1.4, -1.0)] {
            points.extend((0..6).map(|k| wheel_point(x, side, k)));
        }
    }
    points
}

fn body_point(rng: &mut Rng) -> SurfacePoint {
    let [length, width, height] = SIZE_M;
    let along = (rng.random::<f64>() - 0.5) * length;
    let across = (rng.random::<f64>() - 0.5) * width;
    let up = rng.random_range(CLEARANCE_M..height);
    let sign = if rng.random::<bool>() { 1.0 } else { -1.0 };
    match rng.random_range(0..4) {
        0 => surface([sign * length / 2.0, across, up], [sign, 0.0, 0.0]),
        1 => surface([along, across, height], [0.0, 0.0, 1.0]),
        // Half of all points lie on the long sides, which is where the area is.
        _ => surface([along, sign * width / 2.0, up], [0.0, sign, 0.0]),
    }
}

fn wheel_point(x: f64, side: f64, k: usize) -> SurfacePoint {
    let angle = std::f64::consts::TAU * k as f64 / 6.0;
    let (sin, cos) = angle.sin_cos();
    let up = WHEEL_RADIUS_M * (1.0 - cos);
    surface([x + WHEEL_RADIUS_M * sin, side * SIZE_M[1] / 2.0, up], [0.0, side, 0.0])
}

fn surface([x, y, z]: [f64; 3], normal: [f64; 3]) -> SurfacePoint {
    SurfacePoint { position: Point3::new(x, y, z), normal: normal.into() }
}
