//! Points drawn onto the surface that their neighbours lie on.
//!
//! What is seen in a few frames, by rays a few degrees apart, is known well across the line of sight and badly along
//! it. But a vehicle is made of smooth sheets: along its worst direction u_j a point lies near the plane
//!
//! ```text
//! z = a + b · q,      q, z: coordinates of a neighbour relative to the point, across u_j and along it
//! ```
//!
//! through its neighbours, each weighted by its own variance along u_j and by its distance. With v_j the point's
//! variance along u_j, s_j² that of a, and σ what a surface deviates from a plane, the point moves by
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
/// Largest slope that counts as likely (standard deviation), as rise over the reach in shares of the object's radius.
const LIKELY_RISE: f64 = 0.7;
/// Factor by which standard deviations from image positions are too small: errors of a track are common to its
/// observations.
const INFLATION: f64 = 2.0;
/// Minimum number of neighbors of a surface.
const MIN_NEIGHBOURS: usize = 6;
/// Number of rounds of reweighting.
const ROUNDS: usize = 4;
/// Scale of the robust loss of a neighbor's residual (Cauchy), standard deviations.
const CAUCHY_SCALE: f64 = 2.0;

/// One point and how it may be off.
struct Blurred {
    id: Point3dId,
    position: Point3<f64>,
    covariance: Matrix3<f64>,
    /// The directions of the covariance, the worst one last.
    axes: Matrix3<f64>,
    /// Standard deviation along the worst one, and along the next.
    worst: f64,
    next: f64,
}

impl Blurred {
    fn new(id: Point3dId, position: Point3<f64>, covariance: Matrix3<f64>) -> Self {
        let covariance = covariance * (INFLATION * INFLATION);
        let eigen = SymmetricEigen::new(covariance);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let axes = Matrix3::from_columns(&order.map(|k| eigen.eigenvectors.column(k).into_owned()));
        let deviation = |k: usize| eigen.eigenvalues[order[k]].max(0.0).sqrt();
        Self { id, position, covariance, axes, worst: deviation(2), next: deviation(1) }
    }

    fn direction(&self) -> Vector3<f64> {
        self.axes.column(2).into_owned()
    }
}

/// A neighbour as a point sees it: place across the direction in units of the reach, place along it, weight by
/// distance, and variance along the direction.
struct Neighbour {
    across: [f64; 2],
    along: f64,
    nearness: f64,
    variance: f64,
}

/// Moves points along the direction in which they are least sure, towards the surface that their neighbours lie on.
///
/// * `covariances` – of the points' places, as [`point_covariances`](super::precision::point_covariances) gives them.
/// * `radius` – the object's.
/// * `is_smooth` – false to leave the points where they are.
///
/// Returns the points' standard deviations afterwards, in the model's unit; infinite for those that nothing determines.
pub(super) fn draw_onto_surface(
    model: &mut Reconstruction,
    covariances: &BTreeMap<Point3dId, Option<Matrix3<f64>>>,
    radius: f64,
    is_smooth: bool,
) -> BTreeMap<Point3dId, f64> {
    let known = covariances.iter().filter_map(|(id, covariance)| {
        let position = model.points.get(id)?.position;
        Some(Blurred::new(*id, position, (*covariance)?))
    });
    let points: Vec<Blurred> = known.filter(|p| p.worst.is_finite() && p.position.coords.sum().is_finite()).collect();
    let mut deviations: BTreeMap<Point3dId, f64> = model.points.keys().map(|id| (*id, f64::INFINITY)).collect();
    for point in &points {
        let moved = is_smooth.then(|| drawn(point, &points, radius)).flatten();
        let (shift, worst) = moved.unwrap_or((0.0, point.worst));
        if let Some(moved) = model.points.get_mut(&point.id) {
            moved.position += point.direction() * shift;
        }
        deviations.insert(point.id, worst.max(point.next));
    }
    deviations
}

/// Displacement of a point along its worst direction, and its standard deviation there afterwards.
fn drawn(point: &Blurred, points: &[Blurred], radius: f64) -> Option<(f64, f64)> {
    let neighbours = neighbours(point, points, radius);
    if neighbours.len() < MIN_NEIGHBOURS {
        return None;
    }
    let (height, variance) = surface_height(&neighbours, radius)?;
    let (own, other) = (point.worst.powi(2), variance + (ROUGHNESS * radius).powi(2));
    let share = own / (own + other);
    Some((height * share, (other * share).sqrt())).filter(|(shift, std)| shift.is_finite() && std.is_finite())
}

fn neighbours(point: &Blurred, points: &[Blurred], radius: f64) -> Vec<Neighbour> {
    let reach = REACH * radius;
    let direction = point.direction();
    let neighbour = |other: &Blurred| {
        let offset = point.axes.transpose() * (other.position - point.position);
        let distance = offset.x.hypot(offset.y);
        let is_near = distance < reach && offset.z.abs() < 3.0 * point.worst.hypot(other.worst) + reach;
        (is_near && other.id != point.id).then(|| Neighbour {
            across: [offset.x / reach, offset.y / reach],
            along: offset.z,
            nearness: (-2.0 * (distance / reach).powi(2)).exp(),
            variance: direction.dot(&(other.covariance * direction)) + (ROUGHNESS * radius).powi(2),
        })
    };
    points.iter().filter_map(neighbour).collect()
}

/// The height of the plane through the neighbours over the point, and its variance: robust least squares.
fn surface_height(neighbours: &[Neighbour], radius: f64) -> Option<(f64, f64)> {
    let mut plane = Vector3::zeros();
    let mut variance = f64::INFINITY;
    let prior = (LIKELY_RISE * radius).powi(-2);
    for round in 0..ROUNDS {
        let mut information = Matrix3::from_diagonal(&Vector3::new(0.0, prior, prior));
        let mut sum = Vector3::zeros();
        for neighbour in neighbours {
            let row = Vector3::new(1.0, neighbour.across[0], neighbour.across[1]);
            let off = neighbour.along - row.dot(&plane);
            let doubt = if round == 0 { 0.0 } else { off * off / (CAUCHY_SCALE.powi(2) * neighbour.variance) };
            let weight = neighbour.nearness / (neighbour.variance * (1.0 + doubt));
            information += row * row.transpose() * weight;
            sum += row * (weight * neighbour.along);
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

    /// Points of the plane z = 0.2 x, off along z by as much as their covariance says, and one far from all others.
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
    fn unsure_points_are_drawn_onto_the_surface_and_sure_ones_stay() {
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
        let deviations = draw_onto_surface(&mut model, &covariances, 1.0, true);
        assert!(mean(&model, 4, 0) < 0.25 * mean(&before, 4, 0), "{}", mean(&model, 4, 0));
        assert!(mean(&model, 4, 1) < 1.2 * mean(&before, 4, 1));
        assert!(deviations[&Point3dId(0)] < 0.05 && deviations[&Point3dId(1)] <= 0.011);
        for (id, deviation) in [(500, 0.2), (501, f64::INFINITY)] {
            let id = Point3dId(id);
            assert_eq!(model.points[&id], before.points[&id]);
            assert!((deviations[&id] - deviation).abs() < 1e-9 || deviations[&id] == deviation);
        }
    }
}
