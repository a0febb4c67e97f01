//! The ground that a vehicle itself drives over.
//!
//! The points round a vehicle lie on kerbs, pavements and gutters as well, and a plane through them may be a decimetre
//! off and turned by a degree. But what a vehicle stands on now it has left free before, or leaves free later, so that
//! other frames show it. With planes that are nearly right its path over the background is known, and the points on
//! that path give better ones. Equations 13a to 13c of `docs/maths/ground.md`.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Vector2, Vector3};

use super::Options;
use super::plane::{UNEVENNESS, common_factor};
use super::vehicle_trajectory::{BodyShape, VehiclePosition, VehicleTrajectory};
use crate::math::{Neighbors, STD_PER_MAD, any_across, is_finite, median};
use crate::scene::{FrameId, GroundPlane, PlaneBasis, Point3dId, Reconstruction};

/// In heights of the vehicle: within that all points on the path count, ...
const NEAR: f64 = 2.0;
/// ... and beyond that none.
const FAR: f64 = 6.0;
/// Most points of a plane.
const MAX_POINTS: usize = 500;
/// Standard deviation of the slopes of a plane of the points round a vehicle.
const TILT: f64 = 0.026;
/// Maximum grade of the ground between a position and a point on the path.
const MAX_GRADE: f64 = 0.05;

/// The same planes, where the vehicle's path has points through these, elsewhere lowered or raised as there.
///
/// Without a path, or with too few points on it, they come back as they are. `ground_points` must be ascending.
pub(super) fn on_driven_ground(
    background: &Reconstruction,
    ground_points: &[Point3dId],
    model: &Reconstruction,
    planes: BTreeMap<FrameId, GroundPlane>,
    options: &Options,
    shape: &BodyShape,
) -> BTreeMap<FrameId, GroundPlane> {
    let mut better = planes.clone();
    // Nearly right planes put the path some decimeters aside.
    for _ in 0..2 {
        let Some(path) = VehicleTrajectory::of(background, model, &better, options.min_observations, shape) else {
            break;
        };
        let driven = Driven::new(background, ground_points, &path);
        let fits: BTreeMap<FrameId, Fit> = path
            .places
            .iter()
            .filter_map(|at| Some((at.frame, driven.fit(at, planes.get(&at.frame)?, options)?)))
            .collect();
        match merged(&planes, &fits, &path) {
            Some(merged) => better = merged,
            None => break,
        }
    }
    better
}

/// The points on a path.
struct Driven<'a> {
    path: &'a VehicleTrajectory,
    points: Vec<Point3<f64>>,
    tree: Option<Neighbors<3>>,
}

/// A plane through points on the path, below the vehicle.
struct Fit {
    plane: GroundPlane,
    /// Height over the other plane there.
    above: f64,
    /// Root mean square residual, pixels.
    roughness: f64,
}

impl<'a> Driven<'a> {
    fn new(background: &Reconstruction, ground_points: &[Point3dId], path: &'a VehicleTrajectory) -> Self {
        let feet: Vec<[f64; 3]> = path.places.iter().map(|place| place.foot.into()).collect();
        let places = Neighbors::new(&feet);
        let nearest = |point: &Point3<f64>| Some(&path.places[*places.as_ref()?.nearest(&(*point).into(), 1).first()?]);
        let stable = ground_points.iter().filter_map(|id| background.points.get(id)).map(|point| point.position);
        let points: Vec<Point3<f64>> = stable
            .filter(is_finite)
            .filter(|point| nearest(point).is_some_and(|place| path.covers(place, point, FAR * path.height)))
            .collect();
        let positions: Vec<[f64; 3]> = points.iter().map(|point| (*point).into()).collect();
        let tree = (!points.is_empty()).then(|| Neighbors::new(&positions)).flatten();
        Self { path, points, tree }
    }

    /// Points on the path round a place, nearest first.
    fn round(&self, place: &VehiclePosition, num_neighbors: usize) -> Vec<Point3<f64>> {
        let Some(tree) = &self.tree else { return Vec::new() };
        let nearest = tree.nearest(&place.foot.into(), MAX_POINTS).into_iter().map(|k| self.points[k]);
        let counts = |(k, point): &(usize, Point3<f64>)| {
            let heights = (point - place.foot).norm() / self.path.height;
            heights <= NEAR || (*k < num_neighbors && heights <= FAR)
        };
        nearest.enumerate().filter(counts).map(|(_, point)| point).collect()
    }

    /// The plane below the vehicle: as level as the one that is known, where the points say nothing else.
    fn fit(&self, place: &VehiclePosition, known: &GroundPlane, options: &Options) -> Option<Fit> {
        let origin = place.foot - known.normal * known.signed_distance(place.foot);
        let along = place.along.unwrap_or_else(|| any_across(&known.normal));
        let (left, up) = (known.normal.cross(&along).normalize(), known.normal);
        let coordinates = |point: &Point3<f64>| {
            let away = point - origin;
            Vector3::new(along.dot(&away), left.dot(&away), up.dot(&away))
        };
        let round: Vec<Vector3<f64>> = self.round(place, options.num_neighbors).iter().map(coordinates).collect();
        let middle = median(round.iter().map(|x| x.z).collect())?;
        let tolerance = 2.0 * options.max_error_px * place.pixel;
        let near: Vec<Vector3<f64>> =
            round.iter().filter(|x| (x.z - middle).abs() <= tolerance + MAX_GRADE * x.xy().norm()).copied().collect();
        if near.len() < options.min_points {
            return None;
        }
        let slope = Slope::through(&near, NEAR * self.path.height, 0.3 * place.pixel)?;
        let normal = (up - along * slope.rise.x - left * slope.rise.y).normalize();
        let common = UNEVENNESS * slope.rms;
        let plane = GroundPlane {
            normal,
            point: origin + up * slope.above,
            num_points: round.len(),
            num_inliers: slope.num_inliers,
            rms: slope.rms,
            basis: PlaneBasis::Path,
            height_std: slope.above_std.hypot(common),
            common_height_std: common,
            tilt_std: (slope.tilt_std * common_factor(slope.above_std, slope.rms)).min(TILT),
        };
        Some(Fit { plane, above: slope.above, roughness: slope.rms / place.pixel })
    }
}

/// z = above + rise · (x, y).
struct Slope {
    above: f64,
    above_std: f64,
    rise: Vector2<f64>,
    tilt_std: f64,
    num_inliers: usize,
    rms: f64,
}

impl Slope {
    /// Eq. 13a: near points count more, stray ones do not, and slopes are small. `None` where nothing is left.
    fn through(points: &[Vector3<f64>], reach: f64, least_std: f64) -> Option<Self> {
        let nearness = |x: &Vector3<f64>| (-0.5 * x.xy().norm_squared() / (reach * reach)).exp();
        let prior = Matrix3::from_diagonal(&Vector3::new(0.0, TILT.powi(-2), TILT.powi(-2)));
        let mut solution = Vector3::new(median(points.iter().map(|x| x.z).collect())?, 0.0, 0.0);
        let mut covariance = Matrix3::zeros();
        let mut kept = Vec::new();
        // Rounds of reweighting.
        for _ in 0..20 {
            let residual = |x: &Vector3<f64>| x.z - solution.dot(&Vector3::new(1.0, x.x, x.y));
            let std = (STD_PER_MAD * median(points.iter().map(|x| residual(x).abs()).collect())?).max(least_std);
            let tukey = |x: &Vector3<f64>| (1.0 - (residual(x) / (4.685 * std)).powi(2)).max(0.0).powi(2);
            let (mut normal_matrix, mut right) = (prior, Vector3::zeros());
            kept.clear();
            for x in points {
                let weight = nearness(x) * tukey(x) / (std * std);
                let row = Vector3::new(1.0, x.x, x.y);
                normal_matrix += row * row.transpose() * weight;
                right += row * (weight * x.z);
                if weight > 0.0 {
                    kept.push(residual(x));
                }
            }
            covariance = normal_matrix.try_inverse()?;
            solution = covariance * right;
        }
        let rms = (kept.iter().map(|r| r * r).sum::<f64>() / kept.len().max(1) as f64).sqrt();
        let is_known = solution.iter().chain(covariance.iter()).all(|x| x.is_finite()) && covariance[(0, 0)] > 0.0;
        is_known.then(|| Self {
            above: solution.x,
            above_std: covariance[(0, 0)].sqrt(),
            rise: Vector2::new(solution.y, solution.z),
            tilt_std: covariance[(1, 1)].max(covariance[(2, 2)]).sqrt(),
            num_inliers: kept.len(),
            rms,
        })
    }
}

/// Planes from the path where they are surer than what the two kinds differ by from frame to frame; elsewhere the
/// others, moved by what they differ by next to there (eq. 13c). `None` where that is too few, or the two contradict
/// one another.
fn merged(
    planes: &BTreeMap<FrameId, GroundPlane>,
    fits: &BTreeMap<FrameId, Fit>,
    path: &VehicleTrajectory,
) -> Option<BTreeMap<FrameId, GroundPlane>> {
    let middle = median(fits.values().map(|fit| fit.above).collect())?;
    let spread = STD_PER_MAD * median(fits.values().map(|fit| (fit.above - middle).abs()).collect())?;
    let common = median(fits.values().map(|fit| fit.plane.common_height_std).collect())?;
    let roughness = median(fits.values().map(|fit| fit.roughness).collect())?;
    let rms = median(fits.values().map(|fit| fit.plane.rms).collect())?;
    let is_sure = |fit: &&Fit| {
        let is_steady = fit.plane.own_height_std() <= spread.max(rms);
        // A rougher plane lies across a kerb; below a pixel every one is smooth.
        is_steady && fit.roughness <= (3.0 * roughness).max(1.0)
    };
    let sure: BTreeMap<FrameId, &Fit> =
        fits.iter().map(|(frame, fit)| (*frame, fit)).filter(|(_, fit)| is_sure(fit)).collect();
    let camera_height = median(path.places.iter().map(|place| place.camera_height).collect())?;
    // Planes that differ by more are no ground, the ones or the others.
    if sure.len() < 5 || middle.abs() > 0.25 * camera_height {
        return None;
    }
    let moved = |frame: FrameId, plane: &GroundPlane| {
        let mut next: Vec<(&FrameId, &&Fit)> = sure.iter().collect();
        next.sort_by_key(|(other, _)| other.0.abs_diff(frame.0));
        // Frames next to one without points of its own, that determine the difference of the two kinds of planes.
        let gap = median(next.iter().take(9).map(|(_, fit)| fit.above).collect()).unwrap_or(middle);
        let own = plane.own_height_std().hypot(spread);
        GroundPlane {
            point: plane.point + plane.normal * gap,
            height_std: own.hypot(common),
            common_height_std: common,
            ..*plane
        }
    };
    let surely = |frame: &FrameId| sure.get(frame).map(|fit| fit.plane);
    Some(planes.iter().map(|(frame, plane)| (*frame, surely(frame).unwrap_or_else(|| moved(*frame, plane)))).collect())
}
