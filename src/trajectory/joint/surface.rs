//! Correction of uncertain points towards the surface through their neighbors.
//!
//! A point that is observed in a few frames, by rays a few degrees apart, is known well across the line of sight and
//! poorly along it. But a vehicle consists of smooth sheets: along its most uncertain direction u_j a point is near the
//! plane
//!
//! ```text
//! z = a + b · q,      q, z: coordinates of a neighbor relative to the point, across u_j and along it
//! ```
//!
//! through its neighbors, each weighted by its own variance along u_j and by its distance. With v_j the point's
//! variance along u_j, s_j² that of a, and σ the standard deviation of a surface from a plane, the point moves by
//!
//! ```text
//! a v_j / (v_j + s_j² + σ²)
//! ```
//!
//! along u_j. Derivation and figures: docs/maths/scale.md.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, SymmetricEigen, Vector3};

use crate::scene::{Point3dId, Reconstruction};

/// Search radius for neighbors across the direction, as a share of the object's radius.
const REACH: f64 = 0.3;
/// Standard deviation of a surface from a plane over that radius, as a share of the object's radius.
const ROUGHNESS: f64 = 0.02;
/// Standard deviation of the slope of a surface, as the rise over the reach in shares of the object's radius.
const RISE_STD: f64 = 0.7;
/// Factor by which standard deviations from image positions are too small: errors of a track are common to its
/// observations.
const INFLATION: f64 = 2.0;
/// Minimum number of neighbors of a surface.
const MIN_NEIGHBORS: usize = 6;
/// Number of rounds of reweighting.
const ROUNDS: usize = 4;
/// Scale of the robust loss of a neighbor's residual (Cauchy), standard deviations.
const CAUCHY_SCALE: f64 = 2.0;

/// Point with its covariance.
struct UncertainPoint {
    id: Point3dId,
    position: Point3<f64>,
    covariance: Matrix3<f64>,
    /// Principal axes of the covariance, by ascending variance.
    axes: Matrix3<f64>,
    /// Standard deviation along the last axis.
    worst: f64,
    /// Standard deviation along the second axis.
    next: f64,
}

impl UncertainPoint {
    fn new(id: Point3dId, position: Point3<f64>, covariance: Matrix3<f64>) -> Self {
        let covariance = covariance * (INFLATION * INFLATION);
        let eigen = SymmetricEigen::new(covariance);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let axes = Matrix3::from_columns(&order.map(|k| eigen.eigenvectors.column(k).into_owned()));
        let std = |k: usize| eigen.eigenvalues[order[k]].max(0.0).sqrt();
        Self { id, position, covariance, axes, worst: std(2), next: std(1) }
    }

    fn direction(&self) -> Vector3<f64> {
        self.axes.column(2).into_owned()
    }
}

/// Neighbor of a point, relative to it and to its most uncertain direction.
struct Neighbor {
    /// Position across the direction, in units of the reach.
    across: [f64; 2],
    /// Position along the direction.
    along: f64,
    /// Weight by distance.
    nearness: f64,
    /// Variance along the direction.
    variance: f64,
}

/// Moves points along their most uncertain direction towards the surface through their neighbors.
///
/// * `covariances` – of the points' positions, from [`point_covariances`](super::precision::point_covariances).
/// * `radius` – the object's.
/// * `is_smooth` – false to keep the positions of the points.
///
/// Returns the resulting standard deviations of the points, in the model's unit; infinite for undetermined ones.
pub(super) fn move_onto_surface(
    model: &mut Reconstruction,
    covariances: &BTreeMap<Point3dId, Option<Matrix3<f64>>>,
    radius: f64,
    is_smooth: bool,
) -> BTreeMap<Point3dId, f64> {
    let known = covariances.iter().filter_map(|(id, covariance)| {
        let position = model.points.get(id)?.position;
        Some(UncertainPoint::new(*id, position, (*covariance)?))
    });
    let points: Vec<UncertainPoint> =
        known.filter(|p| p.worst.is_finite() && p.position.coords.sum().is_finite()).collect();
    let mut stds: BTreeMap<Point3dId, f64> = model.points.keys().map(|id| (*id, f64::INFINITY)).collect();
    for point in &points {
        let moved = is_smooth.then(|| surface_shift(point, &points, radius)).flatten();
        let (shift, worst) = moved.unwrap_or((0.0, point.worst));
        if let Some(moved) = model.points.get_mut(&point.id) {
            moved.position += point.direction() * shift;
        }
        stds.insert(point.id, worst.max(point.next));
    }
    stds
}

/// Displacement of a point along its most uncertain direction, and its standard deviation along it afterwards.
fn surface_shift(point: &UncertainPoint, points: &[UncertainPoint], radius: f64) -> Option<(f64, f64)> {
    let neighbors = neighbors(point, points, radius);
    if neighbors.len() < MIN_NEIGHBORS {
        return None;
    }
    let (height, variance) = surface_height(&neighbors, radius)?;
    let (own, other) = (point.worst.powi(2), variance + (ROUGHNESS * radius).powi(2));
    let share = own / (own + other);
    Some((height * share, (other * share).sqrt())).filter(|(shift, std)| shift.is_finite() && std.is_finite())
}

fn neighbors(point: &UncertainPoint, points: &[UncertainPoint], radius: f64) -> Vec<Neighbor> {
    let reach = REACH * radius;
    let direction = point.direction();
    let neighbor = |other: &UncertainPoint| {
        let offset = point.axes.transpose() * (other.position - point.position);
        let distance = offset.x.hypot(offset.y);
        let is_near = distance < reach && offset.z.abs() < 3.0 * point.worst.hypot(other.worst) + reach;
        (is_near && other.id != point.id).then(|| Neighbor {
            across: [offset.x / reach, offset.y / reach],
            along: offset.z,
            nearness: (-2.0 * (distance / reach).powi(2)).exp(),
            variance: direction.dot(&(other.covariance * direction)) + (ROUGHNESS * radius).powi(2),
        })
    };
    points.iter().filter_map(neighbor).collect()
}

/// Height over the point of the plane through the neighbors, and its variance: robust least squares.
fn surface_height(neighbors: &[Neighbor], radius: f64) -> Option<(f64, f64)> {
    let mut plane = Vector3::zeros();
    let mut variance = f64::INFINITY;
    let prior = (RISE_STD * radius).powi(-2);
    for round in 0..ROUNDS {
        let mut information = Matrix3::from_diagonal(&Vector3::new(0.0, prior, prior));
        let mut sum = Vector3::zeros();
        for neighbor in neighbors {
            let row = Vector3::new(1.0, neighbor.across[0], neighbor.across[1]);
            let off = neighbor.along - row.dot(&plane);
            let excess = if round == 0 { 0.0 } else { off * off / (CAUCHY_SCALE.powi(2) * neighbor.variance) };
            let weight = neighbor.nearness / (neighbor.variance * (1.0 + excess));
            information += row * row.transpose() * weight;
            sum += row * (weight * neighbor.along);
        }
        let inverse = information.try_inverse()?;
        plane = inverse * sum;
        variance = inverse.m11;
    }
    Some((plane.x, variance))
}

#[cfg(test)]
mod tests {
    use rand::Rng as _;

    use super::*;
    use crate::math::seeded_rng;
    use crate::scene::Point3d;

    /// Points of the plane z = 0.2 x with noise along z according to their covariance, and one far from all others.
    fn sheet() -> (Reconstruction, BTreeMap<Point3dId, Option<Matrix3<f64>>>) {
        let mut rng = seeded_rng(4, 0);
        let (mut model, mut covariances) = (Reconstruction::default(), BTreeMap::new());
        let point = |position| Point3d { position, rgb: [0; 3], error_px: 0.0, track: Vec::new() };
        for k in 0..200 {
            let [x, y] = [0, 1].map(|_| rng.random_range(-1.0..1.0));
            let std = if k % 4 == 0 { 0.1 } else { 0.01 };
            let off = std * rng.sample::<f64, _>(rand_distr::StandardNormal);
            model.points.insert(Point3dId(k), point(Point3::new(x, y, 0.2 * x + off)));
            let variances = Vector3::new(1e-6, 1e-6, std * std / INFLATION.powi(2));
            covariances.insert(Point3dId(k), Some(Matrix3::from_diagonal(&variances)));
        }
        model.points.insert(Point3dId(500), point(Point3::new(5.0, 5.0, 5.0)));
        covariances.insert(Point3dId(500), Some(Matrix3::identity() * 0.01));
        model.points.insert(Point3dId(501), point(Point3::origin()));
        covariances.insert(Point3dId(501), None);
        (model, covariances)
    }

    #[test]
    fn uncertain_points_are_moved_onto_the_surface_and_certain_ones_stay() {
        let (mut model, covariances) = sheet();
        let before = model.clone();
        let off = |model: &Reconstruction, id: u64| {
            let p = model.points[&Point3dId(id)].position;
            (p.z - 0.2 * p.x).abs()
        };
        let mean = |model: &Reconstruction, step: usize, first: u64| {
            let ids: Vec<u64> = (first..200).step_by(step).collect();
            ids.iter().map(|id| off(model, *id)).sum::<f64>() / ids.len() as f64
        };
        let stds = move_onto_surface(&mut model, &covariances, 1.0, true);
        assert!(mean(&model, 4, 0) < 0.25 * mean(&before, 4, 0), "{}", mean(&model, 4, 0));
        assert!(mean(&model, 4, 1) < 1.2 * mean(&before, 4, 1));
        assert!(stds[&Point3dId(0)] < 0.05 && stds[&Point3dId(1)] <= 0.011);
        for (id, std) in [(500, 0.2), (501, f64::INFINITY)] {
            let id = Point3dId(id);
            assert_eq!(model.points[&id], before.points[&id]);
            assert!((stds[&id] - std).abs() < 1e-9 || stds[&id] == std);
        }
    }
}
