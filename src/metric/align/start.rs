//! Initial alignment in closed form, robust against jumps, for one time offset.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use super::Support;
use crate::math::{Sim3, svd3};

/// Centres of the camera and positions of the receiver at the same times.
pub(super) struct Pairs {
    pub(super) centers: Vec<Point3<f64>>,
    pub(super) positions: Vec<Point3<f64>>,
    /// Standard deviations below which a residual counts as zero, metres.
    pub(super) std_m: f64,
}

/// Iterations of reweighting; a few suffice for convergence.
pub(super) const NUM_ROUNDS: usize = 8;

/// The similarity with the least sum of distances, and the mean of these (metres), by reweighted least squares.
pub(super) fn align(pairs: &Pairs, up_in_world: Option<Vector3<f64>>, rounds: usize) -> Option<(Sim3, f64)> {
    let mut weights = vec![1.0; pairs.centers.len()];
    let mut found = None;
    for _ in 0..rounds {
        let similarity = match up_in_world {
            Some(up) => upright(pairs, &weights, up)?,
            None => free(pairs, &weights)?,
        };
        let distances: Vec<f64> =
            pairs.centers.iter().zip(&pairs.positions).map(|(c, p)| (similarity * *c - p).norm()).collect();
        weights = distances.iter().map(|distance| 1.0 / distance.max(0.5 * pairs.std_m)).collect();
        let mean = distances.iter().sum::<f64>() / distances.len() as f64;
        found = Some((similarity, mean));
    }
    found.filter(|(similarity, mean)| mean.is_finite() && similarity.scale.is_finite() && similarity.scale > 0.0)
}

/// Up in the frame of the background, where it is known.
pub(super) fn up(support: &Support) -> Option<Vector3<f64>> {
    let from_attitude = support.orientation.map(|known| known.metric_from_world.inverse() * Vector3::z());
    support.gravity.map(|gravity| gravity.up_in_world).or(from_attitude)
}

fn mean(points: &[Point3<f64>], weights: &[f64]) -> Vector3<f64> {
    let sum: Vector3<f64> = points.iter().zip(weights).map(|(point, weight)| point.coords * *weight).sum();
    sum / weights.iter().sum::<f64>()
}

/// Umeyama's weighted similarity; for collinear points the rotation about their line is arbitrary.
fn free(pairs: &Pairs, weights: &[f64]) -> Option<Sim3> {
    let (from, to) = (mean(&pairs.centers, weights), mean(&pairs.positions, weights));
    let mut covariance = Matrix3::zeros();
    let mut variance = 0.0;
    for ((center, position), weight) in pairs.centers.iter().zip(&pairs.positions).zip(weights) {
        let (c, p) = (center.coords - from, position.coords - to);
        covariance += p * c.transpose() * *weight;
        variance += c.norm_squared() * weight;
    }
    let svd = svd3(covariance)?;
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut sign = Vector3::repeat(1.0);
    sign.z = (u.determinant() * v_t.determinant()).signum();
    let rotation = Rotation3::from_matrix_unchecked(u * Matrix3::from_diagonal(&sign) * v_t);
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation);
    let scale = svd.singular_values.dot(&sign) / variance;
    Some(Sim3::new(scale, rotation, to - rotation * from * scale))
}

/// Similarity that preserves the vertical: heading, scale and translation, linear in a = s cos ψ, b = s sin ψ.
fn upright(pairs: &Pairs, weights: &[f64], up_in_world: Vector3<f64>) -> Option<Sim3> {
    let level = UnitQuaternion::rotation_between(&up_in_world, &Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let (from, to) = (mean(&pairs.centers, weights), mean(&pairs.positions, weights));
    let (mut a, mut b, mut variance) = (0.0, 0.0, 0.0);
    for ((center, position), weight) in pairs.centers.iter().zip(&pairs.positions).zip(weights) {
        let (c, p) = (level * (center.coords - from), position.coords - to);
        a += weight * (c.x * p.x + c.y * p.y);
        b += weight * (c.x * p.y - c.y * p.x);
        variance += weight * (c.x * c.x + c.y * c.y);
    }
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), b.atan2(a)) * level;
    let scale = a.hypot(b) / variance;
    Some(Sim3::new(scale, rotation, to - rotation * from * scale))
}
