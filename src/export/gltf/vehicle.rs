//! Bounding box of a vehicle's points.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::math::Sim3;

/// The twelve edges of a box around most of the points, two ends each, in the object's frame: upright in the scene, and
/// along the direction of motion. `None` without points.
///
/// * `scene_from_object` – its poses, y up.
pub(super) fn box_edges(points: &[Point3<f64>], scene_from_object: &[Sim3]) -> Option<Vec<Point3<f64>>> {
    let axes = axes(scene_from_object)?;
    let mut low = [0.0; 3];
    let mut high = [0.0; 3];
    for (k, axis) in axes.column_iter().enumerate() {
        let mut along: Vec<f64> = points.iter().map(|point| axis.dot(&point.coords)).collect();
        along.sort_by(f64::total_cmp);
        // Trims outliers: a few points are always wrong.
        let outside = (0.02 * along.len() as f64) as usize;
        (low[k], high[k]) = (*along.get(outside)?, *along.get(along.len() - 1 - outside)?);
    }
    let corner = |bits: usize| {
        let local = Vector3::from_fn(|k, _| if bits >> k & 1 == 1 { high[k] } else { low[k] });
        Point3::from(axes * local)
    };
    let edges = (0..8).flat_map(|bits| (0..3).filter(move |k| bits >> k & 1 == 0).map(move |k| (bits, bits | 1 << k)));
    Some(edges.flat_map(|(a, b)| [corner(a), corner(b)]).collect())
}

/// Right-handed axes of the object as columns: along its path, up, across. `None` without poses.
fn axes(scene_from_object: &[Sim3]) -> Option<Matrix3<f64>> {
    let to_object = |pose: &Sim3, direction: Vector3<f64>| pose.rotation.inverse() * direction;
    let up: Vector3<f64> = scene_from_object.iter().map(|pose| to_object(pose, Vector3::y())).sum();
    let up = up.try_normalize(1e-9)?;
    let steps = scene_from_object.windows(2);
    let ahead: Vector3<f64> = steps.map(|pair| to_object(&pair[0], pair[1].translation - pair[0].translation)).sum();
    let level = |direction: Vector3<f64>| (direction - up * up.dot(&direction)).try_normalize(1e-9);
    // The heading of a stationary vehicle is arbitrary.
    let ahead = level(ahead).or_else(|| level(Vector3::x())).or_else(|| level(Vector3::z()))?;
    Some(Matrix3::from_columns(&[ahead, up, ahead.cross(&up)]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn box_is_upright_and_along_the_path() {
        let turn = UnitQuaternion::from_euler_angles(0.4, -0.3, 0.9);
        let pose = |k: f64| Sim3::new(2.0, turn, Vector3::new(k, 0.0, k));
        let points: Vec<_> = (0..8)
            .map(|bits| {
                let side = |k: usize| if bits >> k & 1 == 1 { 1.0 } else { -1.0 };
                let along = Vector3::new(1.0, 0.0, 1.0).normalize();
                let across = along.cross(&Vector3::y());
                let in_scene = along * 2.0 * side(0) + Vector3::y() * 0.7 * side(1) + across * 0.9 * side(2);
                Point3::from(turn.inverse() * in_scene)
            })
            .collect();
        let edges = box_edges(&points, &[pose(0.0), pose(1.0)]).unwrap();
        assert_eq!(edges.len(), 24);
        for point in &points {
            assert!(edges.iter().any(|corner| (corner - point).norm() < 1e-9), "{point}");
        }
        assert!(box_edges(&[], &[pose(0.0)]).is_none() && box_edges(&points, &[]).is_none());
        assert!(box_edges(&points, &[pose(0.0)]).is_some());
    }
}
