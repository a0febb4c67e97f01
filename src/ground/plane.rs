//! Robust fit of a plane to points with outliers.
//!
//! RANSAC (Fischler and Bolles, 1981) over samples of three points, scored as in MSAC (Torr and Zisserman, 2000): the
//! score of a point is 1 − (d / ε)² within its tolerance ε, and 0 beyond. Then least squares on the inliers: the plane
//! through their centroid whose normal is the direction of least variance, repeated until the number of inliers is
//! stable. Equations 4 to 8 of `docs/maths/ground.md`.

use nalgebra::{Matrix3, Point3, Vector3};
use rand::Rng as _;
use thiserror::Error;

use crate::math::{Rng, symmetric_eigen};

/// Distance of the ground below an object from the plane of the points around it, as a share of the RMS distance of
/// these points: curbs and cambers do not average out.
pub(super) const UNEVENNESS: f64 = 0.5;

/// Point with its tolerance, the maximum distance of an inlier from the plane (eq. 1).
#[derive(Clone, Copy, Debug)]
pub(super) struct Candidate {
    pub position: Point3<f64>,
    pub tolerance: f64,
}

/// Reason why there is no plane.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlaneFailure {
    /// Too few points are on any plane.
    #[error("only {found} of {num_points} ground points are on one plane; at least {needed} needed")]
    TooFewInliers {
        /// Number of inliers of the best plane.
        found: usize,
        /// Number of points.
        num_points: usize,
        /// Minimum number of inliers of a plane.
        needed: usize,
    },
    /// The points are nearly collinear, so the plane could rotate about their line.
    #[error("the {num_points} ground points form a strip too narrow to determine the tilt of the plane")]
    Narrow {
        /// Number of inliers.
        num_points: usize,
    },
}

/// Fitted plane; the sign of the normal is arbitrary.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub normal: Vector3<f64>,
    pub point: Point3<f64>,
    pub num_inliers: usize,
    pub rms: f64,
    /// Variance of the height at `point` (eq. 13).
    height_var: f64,
    /// Two orthogonal directions in the plane, and the variance of the slope along each.
    slopes: [(Vector3<f64>, f64); 2],
}

/// Factor on the standard deviation of a slope for errors that do not average out, as in the height.
///
/// * `height_std` – standard deviation of the height by the scatter of the points alone.
/// * `rms` – RMS distance of the points from the plane.
pub(super) fn common_factor(height_std: f64, rms: f64) -> f64 {
    (UNEVENNESS * rms / height_std.max(f64::MIN_POSITIVE)).hypot(1.0)
}

impl Plane {
    pub(super) fn distance(&self, point: &Point3<f64>) -> f64 {
        self.normal.dot(&(point - self.point))
    }

    /// Larger standard deviation of the two slopes, radians, including errors that do not average out.
    pub(super) fn tilt_std(&self) -> f64 {
        let slope_std = self.slopes[0].1.max(self.slopes[1].1).sqrt();
        slope_std * common_factor(self.height_var.sqrt(), self.rms)
    }

    /// Standard deviation of the height at a position on the plane.
    pub(super) fn height_std_at(&self, position: &Point3<f64>) -> f64 {
        let offset = position - self.point;
        let tilted = self.slopes.iter().map(|(direction, var)| direction.dot(&offset).powi(2) * var);
        (self.height_var + tilted.sum::<f64>()).sqrt()
    }

    fn is_inlier(&self, candidate: &Candidate) -> bool {
        self.distance(&candidate.position).abs() <= candidate.tolerance
    }
}

/// Fits a plane by RANSAC, then by least squares on the inliers.
///
/// `score` is the score of a plane given the sum of its MSAC scores: it can weight orientations, or exclude them (≤ 0).
pub(super) fn fit_plane(
    points: &[Candidate],
    min_inliers: usize,
    max_samples: usize,
    score: impl Fn(&Plane, f64) -> f64,
    rng: &mut Rng,
) -> Result<Plane, PlaneFailure> {
    let too_few = |found| PlaneFailure::TooFewInliers { found, num_points: points.len(), needed: min_inliers };
    if points.len() < min_inliers.max(3) {
        return Err(too_few(points.len()));
    }
    let mut best: Option<(f64, Plane)> = None;
    let mut needed = max_samples;
    let mut drawn = 0;
    while drawn < needed.min(max_samples) {
        drawn += 1;
        let Some(mut plane) = through_sample(points, rng) else { continue };
        let (support, num_inliers) = support(points, &plane);
        plane.num_inliers = num_inliers;
        let value = score(&plane, support);
        if value > best.as_ref().map_or(0.0, |(value, _)| *value) {
            best = Some((value, plane));
            needed = samples_needed(num_inliers as f64 / points.len() as f64);
        }
    }
    let plane = best.map(|(_, plane)| plane).ok_or_else(|| too_few(0))?;
    if plane.num_inliers < min_inliers {
        return Err(too_few(plane.num_inliers));
    }
    refine(points, plane)
        .filter(|plane| plane.num_inliers >= min_inliers)
        .ok_or(PlaneFailure::Narrow { num_points: plane.num_inliers })
}

/// Number of samples after which a better plane is missed with a probability below 1 in 10,000 (eq. 6).
fn samples_needed(inlier_share: f64) -> usize {
    let all_inliers = inlier_share.powi(3).clamp(1e-9, 1.0 - 1e-9);
    (1e-4_f64.ln() / (-all_inliers).ln_1p()).ceil() as usize
}

/// Plane through three random points; `None` if they are nearly collinear (eq. 4).
fn through_sample(points: &[Candidate], rng: &mut Rng) -> Option<Plane> {
    let mut draw = || points[rng.random_range(0..points.len())].position;
    let (a, b, c) = (draw(), draw(), draw());
    let (ab, ac) = (b - a, c - a);
    let normal = ab.cross(&ac);
    // A triangle thinner than 1 in 100 hardly determines its plane; equal draws have no area.
    let is_wide = normal.norm() > 0.01 * ab.norm_squared().max(ac.norm_squared());
    is_wide.then(|| Plane {
        normal: normal.normalize(),
        point: a,
        num_inliers: 0,
        rms: 0.0,
        height_var: 0.0,
        slopes: Default::default(),
    })
}

/// Sum of MSAC scores (eq. 5), and the number of inliers.
fn support(points: &[Candidate], plane: &Plane) -> (f64, usize) {
    points.iter().fold((0.0, 0), |(sum, count), candidate| {
        let relative = plane.distance(&candidate.position) / candidate.tolerance;
        if relative.abs() <= 1.0 { (sum + 1.0 - relative * relative, count + 1) } else { (sum, count) }
    })
}

/// Repeats least squares on the inliers until their number is stable; `None` if they are nearly collinear.
fn refine(points: &[Candidate], start: Plane) -> Option<Plane> {
    let mut plane = start;
    for _ in 0..10 {
        let inliers: Vec<Candidate> = points.iter().copied().filter(|c| plane.is_inlier(c)).collect();
        let next = least_squares_plane(&inliers)?;
        let num_inliers = points.iter().filter(|c| next.is_inlier(c)).count();
        let is_stable = num_inliers == inliers.len();
        plane = Plane { num_inliers, ..next };
        if is_stable {
            break;
        }
    }
    Some(plane)
}

/// Least-squares plane (eq. 7).
///
/// Points are weighted by the inverse square of their tolerance, which is proportional to their standard deviation.
/// `None` for fewer than three points, or if they are spread by less than their tolerance in all directions but one
/// (eq. 8).
pub(super) fn least_squares_plane(points: &[Candidate]) -> Option<Plane> {
    if points.len() < 3 {
        return None;
    }
    let weight = |c: &Candidate| 1.0 / (c.tolerance * c.tolerance);
    let total: f64 = points.iter().map(weight).sum();
    let center = points.iter().map(|c| c.position.coords * weight(c)).sum::<Vector3<f64>>() / total;
    let offset = |c: &Candidate| c.position.coords - center;
    let covariance = points.iter().map(|c| offset(c) * offset(c).transpose() * weight(c)).sum::<Matrix3<f64>>() / total;
    let eigen = symmetric_eigen(covariance)?;
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    let normal: Vector3<f64> = eigen.eigenvectors.column(order[0]).into_owned();
    let mean_tolerance_sq = points.len() as f64 / total;
    let is_wide = eigen.eigenvalues[order[1]] > mean_tolerance_sq;
    let rms = (points.iter().map(|c| normal.dot(&offset(c)).powi(2)).sum::<f64>() / points.len() as f64).sqrt();
    // Residuals in tolerances, with three degrees of freedom less.
    let squares = points.iter().map(|c| normal.dot(&offset(c)).powi(2) * weight(c)).sum::<f64>();
    let height_var = squares / (points.len() as f64 - 3.0).max(1.0) / total;
    let slope = |k: usize| (eigen.eigenvectors.column(order[k]).into_owned(), height_var / eigen.eigenvalues[order[k]]);
    let slopes = [slope(1), slope(2)];
    let plane = Plane { normal, point: center.into(), num_inliers: points.len(), rms, height_var, slopes };
    (is_wide && normal.iter().all(|x| x.is_finite())).then_some(plane)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::seeded_rng;

    fn scattered(num: usize, num_outliers: usize, seed: u64, width: f64) -> Vec<Candidate> {
        let mut rng = seeded_rng(seed, 0);
        let mut uniform = |limit: f64| (rng.random::<f64>() * 2.0 - 1.0) * limit;
        let inlier = |x: f64, y: f64, noise: f64| Point3::new(x, y, 0.2 * x - 0.1 * y + 3.0 + noise);
        let mut points: Vec<_> = (0..num).map(|_| inlier(uniform(5.0), uniform(width), uniform(0.02))).collect();
        points.extend((0..num_outliers).map(|_| Point3::new(uniform(5.0), uniform(5.0), uniform(10.0))));
        points.into_iter().map(|position| Candidate { position, tolerance: 0.05 }).collect()
    }

    fn fit(points: &[Candidate]) -> Result<Plane, PlaneFailure> {
        fit_plane(points, 10, 1000, |_, support| support, &mut seeded_rng(9, 9))
    }

    #[test]
    fn outliers_do_not_tilt_the_plane() {
        let truth = Vector3::new(-0.2, 0.1, 1.0).normalize();
        for seed in 0..10 {
            let plane = fit(&scattered(40, 40, seed, 5.0)).unwrap();
            // Noise of ± 2 cm on 40 points over ± 5 m: about 1 mrad.
            assert!(plane.normal.cross(&truth).norm() < 0.005, "seed {seed}");
            assert!(plane.num_inliers >= 40 && plane.rms < 0.025);
        }
    }

    #[test]
    fn curbs_do_not_average_out() {
        // A road 4 m wide and a sidewalk of 2 m that is 12 cm higher.
        let mut rng = seeded_rng(5, 0);
        let mut position = || (rng.random_range(-4.0..4.0), rng.random_range(-2.0..4.0), rng.random_range(-0.02..0.02));
        let height = |y: f64| if y > 2.0 { 0.12 } else { 0.0 };
        let points = (0..50).map(|_| position()).map(|(x, y, noise)| Point3::new(x, y, height(y) + noise));
        let points: Vec<_> = points.map(|position| Candidate { position, tolerance: 0.2 }).collect();
        let plane = fit(&points).unwrap();
        let tilt = plane.normal.cross(&Vector3::z()).norm();
        assert!(tilt > 0.02 && tilt < 2.5 * plane.tilt_std() && plane.tilt_std() < 0.05, "{tilt} {plane:?}");
    }

    #[test]
    fn lines_and_clouds_have_no_plane() {
        assert!(matches!(fit(&scattered(40, 0, 1, 0.01)), Err(PlaneFailure::Narrow { .. })));
        assert!(matches!(fit(&scattered(0, 30, 1, 5.0)), Err(PlaneFailure::TooFewInliers { needed: 10, .. })));
        assert!(matches!(fit(&scattered(4, 0, 1, 5.0)), Err(PlaneFailure::TooFewInliers { found: 4, .. })));
        let same = vec![Candidate { position: Point3::origin(), tolerance: 0.1 }; 20];
        assert!(fit(&same).is_err());
    }
}
