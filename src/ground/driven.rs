//! Ground planes from the points on a vehicle's own path.
//!
//! Points around a vehicle are on curbs, sidewalks and gutters as well, and a plane through them may be off by a
//! decimeter and a degree. But the surface below a vehicle is visible in other frames, before or after the vehicle
//! covers it. Approximate planes give the path of the vehicle over the background, and the points on that path give
//! better planes. Equations 13a to 13c of `docs/maths/ground.md`.

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Vector2, Vector3};

use super::Options;
use super::plane::{UNEVENNESS, common_factor};
use super::vehicle_trajectory::{BodyShape, VehiclePosition, VehicleTrajectory};
use crate::math::{Neighbors, STD_PER_MAD, any_across, is_finite, median};
use crate::scene::{FrameId, GroundPlane, PlaneBasis, Point3dId, Reconstruction};

/// Radius within which all points on the path are used, in heights of the vehicle.
const FULL_RADIUS: f64 = 2.0;
/// Maximum distance of a point that is used, in heights of the vehicle.
const MAX_RADIUS: f64 = 6.0;
/// Maximum number of points of a plane.
const MAX_POINTS: usize = 500;
/// Standard deviation of the slopes of a plane of all points around a vehicle, radians.
const TILT: f64 = 0.026;
/// Maximum grade of the ground between a position and a point on the path.
const MAX_GRADE: f64 = 0.05;

/// Corrects the planes below a vehicle by the points on its path.
///
/// Frames with enough points on the path get a plane through them. The planes of other frames are shifted along their
/// normals by the offset in the nearest of these frames. Without a path, or with too few points on it, the planes are
/// returned unchanged. `ground_points` must be ascending.
pub(super) fn corrected_by_path(
    background: &Reconstruction,
    ground_points: &[Point3dId],
    model: &Reconstruction,
    planes: BTreeMap<FrameId, GroundPlane>,
    options: &Options,
    shape: &BodyShape,
) -> BTreeMap<FrameId, GroundPlane> {
    let mut corrected = planes.clone();
    // With approximate planes the path is off by some decimeters.
    for _ in 0..2 {
        let Some(path) = VehicleTrajectory::of(background, model, &corrected, options.min_observations, shape) else {
            break;
        };
        let path_points = PathPoints::new(background, ground_points, &path);
        let fits: BTreeMap<FrameId, Fit> = path
            .positions
            .iter()
            .filter_map(|at| Some((at.frame, path_points.fit(at, planes.get(&at.frame)?, options)?)))
            .collect();
        match merged(&planes, &fits, &path) {
            Some(merged) => corrected = merged,
            None => break,
        }
    }
    corrected
}

/// Ground points on a path.
struct PathPoints<'a> {
    path: &'a VehicleTrajectory,
    points: Vec<Point3<f64>>,
    tree: Option<Neighbors<3>>,
}

/// Plane through points on the path, below the vehicle.
struct Fit {
    plane: GroundPlane,
    /// Height over the input plane below the vehicle.
    height_offset: f64,
    /// Root mean square residual, pixels.
    roughness: f64,
}

impl<'a> PathPoints<'a> {
    fn new(background: &Reconstruction, ground_points: &[Point3dId], path: &'a VehicleTrajectory) -> Self {
        let path_points: Vec<[f64; 3]> = path.positions.iter().map(|position| position.ground_point.into()).collect();
        let path_tree = Neighbors::new(&path_points);
        let nearest = |point: &Point3<f64>| {
            let idx = *path_tree.as_ref()?.nearest(&(*point).into(), 1).first()?;
            Some(&path.positions[idx])
        };
        let stable = ground_points.iter().filter_map(|id| background.points.get(id)).map(|point| point.position);
        let points: Vec<Point3<f64>> = stable
            .filter(is_finite)
            .filter(|point| {
                nearest(point).is_some_and(|position| path.covers(position, point, MAX_RADIUS * path.height))
            })
            .collect();
        let positions: Vec<[f64; 3]> = points.iter().map(|point| (*point).into()).collect();
        let tree = (!points.is_empty()).then(|| Neighbors::new(&positions)).flatten();
        Self { path, points, tree }
    }

    /// Points on the path around a position, nearest first.
    fn around(&self, position: &VehiclePosition, num_neighbors: usize) -> Vec<Point3<f64>> {
        let Some(tree) = &self.tree else { return Vec::new() };
        let nearest = tree.nearest(&position.ground_point.into(), MAX_POINTS).into_iter().map(|k| self.points[k]);
        let counts = |(k, point): &(usize, Point3<f64>)| {
            let heights = (point - position.ground_point).norm() / self.path.height;
            heights <= FULL_RADIUS || (*k < num_neighbors && heights <= MAX_RADIUS)
        };
        nearest.enumerate().filter(counts).map(|(_, point)| point).collect()
    }

    /// Fits the plane below the vehicle, with the slope of the input plane as a prior.
    fn fit(&self, position: &VehiclePosition, input: &GroundPlane, options: &Options) -> Option<Fit> {
        let origin = position.ground_point - input.normal * input.signed_distance(position.ground_point);
        let along = position.along.unwrap_or_else(|| any_across(&input.normal));
        let (left, up) = (input.normal.cross(&along).normalize(), input.normal);
        let coordinates = |point: &Point3<f64>| {
            let offset = point - origin;
            Vector3::new(along.dot(&offset), left.dot(&offset), up.dot(&offset))
        };
        let around: Vec<Vector3<f64>> = self.around(position, options.num_neighbors).iter().map(coordinates).collect();
        let median_height = median(around.iter().map(|x| x.z).collect())?;
        let tolerance = 2.0 * options.max_error_px * position.pixel;
        let near: Vec<Vector3<f64>> = around
            .iter()
            .filter(|x| (x.z - median_height).abs() <= tolerance + MAX_GRADE * x.xy().norm())
            .copied()
            .collect();
        if near.len() < options.min_points {
            return None;
        }
        let slope = Slope::through(&near, FULL_RADIUS * self.path.height, 0.3 * position.pixel)?;
        let normal = (up - along * slope.gradient.x - left * slope.gradient.y).normalize();
        let common = UNEVENNESS * slope.rms;
        let plane = GroundPlane {
            normal,
            point: origin + up * slope.height_offset,
            num_points: around.len(),
            num_inliers: slope.num_inliers,
            rms: slope.rms,
            basis: PlaneBasis::Path,
            height_std: slope.height_offset_std.hypot(common),
            common_height_std: common,
            tilt_std: (slope.tilt_std * common_factor(slope.height_offset_std, slope.rms)).min(TILT),
        };
        Some(Fit { plane, height_offset: slope.height_offset, roughness: slope.rms / position.pixel })
    }
}

/// Plane z = `height_offset` + `gradient` · (x, y).
struct Slope {
    height_offset: f64,
    height_offset_std: f64,
    gradient: Vector2<f64>,
    tilt_std: f64,
    num_inliers: usize,
    rms: f64,
}

impl Slope {
    /// Minimizes eq. 13a: distance weights, Tukey's loss, and a prior of small slopes. `None` if it is singular.
    fn through(points: &[Vector3<f64>], reach: f64, least_std: f64) -> Option<Self> {
        let nearness = |x: &Vector3<f64>| (-0.5 * x.xy().norm_squared() / (reach * reach)).exp();
        let prior = Matrix3::from_diagonal(&Vector3::new(0.0, TILT.powi(-2), TILT.powi(-2)));
        let mut solution = Vector3::new(median(points.iter().map(|x| x.z).collect())?, 0.0, 0.0);
        let mut covariance = Matrix3::zeros();
        let mut kept = Vec::new();
        // Number of reweighting iterations.
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
            height_offset: solution.x,
            height_offset_std: covariance[(0, 0)].sqrt(),
            gradient: Vector2::new(solution.y, solution.z),
            tilt_std: covariance[(1, 1)].max(covariance[(2, 2)]).sqrt(),
            num_inliers: kept.len(),
            rms,
        })
    }
}

/// Merges the planes from the path with the input planes.
///
/// A plane from the path is used where its own standard deviation is at most the scatter of the differences between the
/// two kinds, or the median residual. Elsewhere the input plane is shifted by the median difference in the nearest
/// frames (eq. 13c). `None` with too few planes from the path, or if the two kinds contradict each other.
fn merged(
    planes: &BTreeMap<FrameId, GroundPlane>,
    fits: &BTreeMap<FrameId, Fit>,
    path: &VehicleTrajectory,
) -> Option<BTreeMap<FrameId, GroundPlane>> {
    let median_offset = median(fits.values().map(|fit| fit.height_offset).collect())?;
    let spread = STD_PER_MAD * median(fits.values().map(|fit| (fit.height_offset - median_offset).abs()).collect())?;
    let common = median(fits.values().map(|fit| fit.plane.common_height_std).collect())?;
    let roughness = median(fits.values().map(|fit| fit.roughness).collect())?;
    let rms = median(fits.values().map(|fit| fit.plane.rms).collect())?;
    let is_reliable = |fit: &&Fit| {
        let is_steady = fit.plane.own_height_std() <= spread.max(rms);
        // A plane with larger residuals crosses a curb; below a pixel every plane is smooth.
        is_steady && fit.roughness <= (3.0 * roughness).max(1.0)
    };
    let reliable: BTreeMap<FrameId, &Fit> =
        fits.iter().map(|(frame, fit)| (*frame, fit)).filter(|(_, fit)| is_reliable(fit)).collect();
    let camera_height = median(path.positions.iter().map(|position| position.camera_height).collect())?;
    // If the planes differ by more, one of the two kinds is not the ground.
    if reliable.len() < 5 || median_offset.abs() > 0.25 * camera_height {
        return None;
    }
    let shifted = |frame: FrameId, plane: &GroundPlane| {
        let mut next: Vec<(&FrameId, &&Fit)> = reliable.iter().collect();
        next.sort_by_key(|(other, _)| other.0.abs_diff(frame.0));
        // Number of nearest frames that determine the difference of the two kinds of planes.
        let shift = median(next.iter().take(9).map(|(_, fit)| fit.height_offset).collect()).unwrap_or(median_offset);
        let own = plane.own_height_std().hypot(spread);
        GroundPlane {
            point: plane.point + plane.normal * shift,
            height_std: own.hypot(common),
            common_height_std: common,
            ..*plane
        }
    };
    let from_path = |frame: &FrameId| reliable.get(frame).map(|fit| fit.plane);
    Some(
        planes
            .iter()
            .map(|(frame, plane)| (*frame, from_path(frame).unwrap_or_else(|| shifted(*frame, plane))))
            .collect(),
    )
}
