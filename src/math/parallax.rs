//! Angles between the rays to a point.

use nalgebra::Point3;

/// The largest angle at a point between the directions to the first or the last center and any other.
///
/// For a camera trajectory this is the widest angle, at linear cost.
pub fn widest_angle(point: Point3<f64>, centers: impl Iterator<Item = Point3<f64>>) -> f64 {
    let directions: Vec<_> = centers.map(|c| (c - point).normalize()).collect();
    let ends = [directions.first(), directions.last()];
    let cosine =
        ends.into_iter().flatten().flat_map(|end| directions.iter().map(move |d| end.dot(d))).fold(1.0f64, f64::min);
    cosine.clamp(-1.0, 1.0).acos()
}
