//! Points and directions.

use nalgebra::{Point3, Vector3};

/// Mean of points; the origin for none.
pub fn centroid(points: &[Point3<f64>]) -> Point3<f64> {
    Point3::from(points.iter().map(|point| point.coords).sum::<Vector3<f64>>() / points.len().max(1) as f64)
}

/// Returns true if all coordinates of a point are finite.
pub fn is_finite(point: &Point3<f64>) -> bool {
    point.coords.iter().all(|x| x.is_finite())
}

/// Any unit vector orthogonal to a unit vector.
pub fn any_across(direction: &Vector3<f64>) -> Vector3<f64> {
    let axis = if direction.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    direction.cross(&axis).normalize()
}

/// Two unit vectors orthogonal to a unit vector and to each other.
pub fn across(direction: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = any_across(direction);
    [first, direction.cross(&first)]
}
