//! Two-view geometry: verification of matches, relative pose, and suitability as an initial pair.

use nalgebra::{Matrix3, Point2, Point3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};

use super::solvers::{essential_five_point, homography_from_points};
use crate::camera::Camera;
use crate::math::{Rigid3, Rng, across, seeded_rng, svd3, upper_median};
use crate::robust::{self, Consensus, Estimator};

/// Relative pose of two calibrated views that observe the same points.
#[derive(Clone, Debug)]
pub struct TwoViewGeometry {
    /// Second camera from first; the translation has unit length.
    pub cam2_from_cam1: Rigid3,
    /// Indices of the inliers in front of both cameras.
    pub inliers: Vec<usize>,
    /// Median angle at the inlier points between the rays to both cameras, radians.
    pub median_angle: f64,
    /// Inliers of the best homography over inliers of the epipolar geometry: near one for a planar scene or a purely
    /// rotating camera.
    pub homography_ratio: f64,
    /// That homography, second view from first.
    pub homography: Option<Matrix3<f64>>,
    /// Its inliers as a share of all correspondences.
    pub homography_share: f64,
}

/// Undistorted positions on the plane z = 1 of the same points in two views; both lists have the same length.
pub struct Correspondences {
    /// First view.
    pub first: Vec<Vector2<f64>>,
    /// Second view.
    pub second: Vec<Vector2<f64>>,
}

impl Correspondences {
    /// Correspondences from the pixels of each point in both views, and the cameras.
    pub fn new([a, b]: [&Camera; 2], pixels: impl IntoIterator<Item = [Point2<f64>; 2]>) -> Self {
        let normalized = |[p, q]: [Point2<f64>; 2]| (a.normalized_from_pixel(p), b.normalized_from_pixel(q));
        let (first, second) = pixels.into_iter().map(normalized).unzip();
        Self { first, second }
    }
}

/// Geometric mean of the focal lengths of two cameras: pixels per normalized unit of their [`Correspondences`].
pub fn mean_focal([first, second]: [&Camera; 2]) -> f64 {
    (first.mean_focal() * second.mean_focal()).sqrt()
}

/// Random number generator for a pair of views.
pub fn pair_rng(seed: u64, [first, second]: [usize; 2]) -> Rng {
    seeded_rng(seed, (first as u64) << 32 | second as u64)
}

/// Estimates the relative pose by five-point LO-RANSAC on the Sampson distance.
///
/// * `max_error` – threshold in normalized units: pixels over the focal length.
///
/// `None` when no essential matrix is supported by more than its own sample.
pub fn estimate(pairs: &Correspondences, max_error: f64, rng: &mut Rng) -> Option<TwoViewGeometry> {
    estimate_with(pairs, max_error, 0, rng)
}

/// As [`estimate`], but a pose with fewer than `least_inliers` inliers may be suboptimal or missing.
pub fn estimate_with(
    pairs: &Correspondences,
    max_error: f64,
    least_inliers: usize,
    rng: &mut Rng,
) -> Option<TwoViewGeometry> {
    let options = robust::Options { least_inliers, ..robust::Options::with_max_error(max_error) };
    let essential = robust::ransac(&EssentialEstimator(pairs), &options, rng)?;
    let (cam2_from_cam1, inliers) = pose_in_front(pairs, &essential)?;
    let angles = inliers.iter().filter_map(|&i| ray_angle(pairs, &cam2_from_cam1, i)).collect();
    // Only the inlier ratio is needed: without a dominant plane, more samples cost time and do not change the result.
    let few = robust::Options { max_iterations: 200, least_inliers: 0, ..options };
    let homography = robust::ransac(&HomographyEstimator(pairs), &few, rng);
    let homography_inliers = homography.as_ref().map_or(0, |h| h.inliers.len());
    Some(TwoViewGeometry {
        median_angle: upper_median(angles)?,
        homography_ratio: homography_inliers as f64 / essential.inliers.len() as f64,
        homography: homography.map(|h| h.model),
        homography_share: homography_inliers as f64 / pairs.first.len() as f64,
        cam2_from_cam1,
        inliers,
    })
}

/// Geometric verification: indices of the matches consistent with one epipolar geometry. Empty if there is none.
pub fn verify(pairs: &Correspondences, max_error: f64, rng: &mut Rng) -> Vec<usize> {
    let options = robust::Options { max_iterations: 1000, ..robust::Options::with_max_error(max_error) };
    robust::ransac(&EssentialEstimator(pairs), &options, rng).map(|c| c.inliers).unwrap_or_default()
}

/// Number of inliers of the epipolar geometry of a given motion; `None` for zero translation, which has none.
pub fn num_explained(pairs: &Correspondences, cam2_from_cam1: &Rigid3, max_error: f64) -> Option<usize> {
    let direction = cam2_from_cam1.translation.try_normalize(f64::EPSILON)?;
    let essential = essential_from_pose(&Rigid3::new(cam2_from_cam1.rotation, direction));
    let estimator = EssentialEstimator(pairs);
    let fits = |&i: &usize| estimator.error_sq(&essential, i) <= max_error * max_error;
    Some((0..pairs.first.len()).filter(fits).count())
}

/// As [`verify`], for two cameras whose focal lengths may have independent errors of up to a third.
///
/// A common factor changes an epipolar geometry little, a ratio much. Therefore several ratios are tried, and the one
/// with most inliers is chosen.
pub fn verify_of_two_cameras(pairs: &Correspondences, max_error: f64, rng: &mut Rng) -> Vec<usize> {
    let mut best = verify(pairs, max_error, rng);
    for ratio in [0.75_f64, 4.0 / 3.0, 0.5625, 16.0 / 9.0] {
        // With fewer inliers the ratio may be wrong, and the others are tried.
        if best.len() as f64 >= 0.7 * pairs.first.len() as f64 {
            break;
        }
        // Half of the factor on either side, so that the errors of both are weighted as before.
        let scaled = |side: &[Vector2<f64>], factor: f64| side.iter().map(|p| p * factor).collect::<Vec<_>>();
        let (first, second) = (scaled(&pairs.first, ratio.sqrt()), scaled(&pairs.second, ratio.sqrt().recip()));
        let found = verify(&Correspondences { first, second }, max_error, rng);
        if found.len() > best.len() {
            best = found;
        }
    }
    best
}

/// Midpoint of the shortest segment between two rays, in the first camera; `None` for parallel rays.
fn midpoint(pairs: &Correspondences, cam2_from_cam1: &Rigid3, i: usize) -> Option<Point3<f64>> {
    let ray1 = pairs.first[i].push(1.0);
    let ray2 = cam2_from_cam1.rotation.inverse() * pairs.second[i].push(1.0);
    let center2 = cam2_from_cam1.center().coords;
    let (a, b, c) = (ray1.norm_squared(), ray1.dot(&ray2), ray2.norm_squared());
    let determinant = a * c - b * b;
    if determinant <= 1e-12 * a * c {
        return None;
    }
    let (d, e) = (ray1.dot(&center2), ray2.dot(&center2));
    let (s, t) = ((c * d - b * e) / determinant, (b * d - a * e) / determinant);
    (s > 0.0 && t > 0.0).then(|| Point3::from((ray1 * s + center2 + ray2 * t) / 2.0))
}

fn ray_angle(pairs: &Correspondences, cam2_from_cam1: &Rigid3, i: usize) -> Option<f64> {
    let point = midpoint(pairs, cam2_from_cam1, i)?;
    Some(point.coords.angle(&(point - cam2_from_cam1.center())))
}

/// Of the four poses of an essential matrix, the one that puts most inliers in front of both cameras.
fn pose_in_front(pairs: &Correspondences, essential: &Consensus<Matrix3<f64>>) -> Option<(Rigid3, Vec<usize>)> {
    poses_from_essential(&essential.model)?
        .into_iter()
        .map(|pose| {
            let in_front = |&i: &usize| midpoint(pairs, &pose, i).is_some();
            let inliers: Vec<usize> = essential.inliers.iter().copied().filter(in_front).collect();
            (pose, inliers)
        })
        .max_by_key(|(_, inliers)| inliers.len())
        .filter(|(_, inliers)| !inliers.is_empty())
}

/// Maximum iterations from a matrix to its nearest rotation: a few dozen suffice. nalgebra's default has no limit, and
/// near a zero essential matrix the singular vectors may not be orthonormal, so that it does not terminate.
const MAX_ITERATIONS: usize = 200;

/// The four poses with unit translation of an essential matrix (Hartley, Zisserman, section 9.6.2).
fn poses_from_essential(essential: &Matrix3<f64>) -> Option<[Rigid3; 4]> {
    let svd = svd3(*essential)?;
    let (mut u, mut v_t) = (svd.u?, svd.v_t?);
    if u.determinant() < 0.0 {
        u = -u;
    }
    if v_t.determinant() < 0.0 {
        v_t = -v_t;
    }
    // nalgebra sorts singular values descending, so the last column of U spans the left null space.
    let w = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
    let translation: Vector3<f64> = u.column(2).into_owned();
    let rotation =
        |m: Matrix3<f64>| Rotation3::from_matrix_eps(&m, f64::EPSILON, MAX_ITERATIONS, Rotation3::identity());
    let rotation = |m: Matrix3<f64>| UnitQuaternion::from_rotation_matrix(&rotation(m));
    let (r1, r2) = (rotation(u * w * v_t), rotation(u * w.transpose() * v_t));
    Some([
        Rigid3::new(r1, translation),
        Rigid3::new(r1, -translation),
        Rigid3::new(r2, translation),
        Rigid3::new(r2, -translation),
    ])
}

/// Sampson's first-order distance of two positions to the epipolar constraint, signed.
#[inline]
pub fn sampson_distance(essential: &Matrix3<f64>, first: &Vector2<f64>, second: &Vector2<f64>) -> f64 {
    let (p, q) = (first.push(1.0), second.push(1.0));
    let (line2, line1) = (essential * p, essential.tr_mul(&q));
    let gradient_sq = line2.xy().norm_squared() + line1.xy().norm_squared();
    if gradient_sq > 0.0 { q.dot(&line2) / gradient_sq.sqrt() } else { f64::INFINITY }
}

struct EssentialEstimator<'a>(&'a Correspondences);

impl EssentialEstimator<'_> {
    #[inline]
    fn sampson(&self, essential: &Matrix3<f64>, i: usize) -> f64 {
        sampson_distance(essential, &self.0.first[i], &self.0.second[i])
    }
}

impl Estimator for EssentialEstimator<'_> {
    type Model = Matrix3<f64>;
    // Five points determine an essential matrix.
    const SAMPLE_SIZE: usize = 5;

    fn num_data(&self) -> usize {
        self.0.first.len()
    }

    fn fit(&self, sample: &[usize], models: &mut Vec<Matrix3<f64>>) {
        let rays = |points: &[Vector2<f64>]| std::array::from_fn(|k| points[sample[k]].push(1.0));
        models.extend(essential_five_point(&rays(&self.0.first), &rays(&self.0.second)));
    }

    fn error_sq(&self, essential: &Matrix3<f64>, datum: usize) -> f64 {
        self.sampson(essential, datum).powi(2)
    }

    /// Gauss-Newton on the five degrees of freedom of (R, t / ‖t‖), derivatives by differences: linear eight-point
    /// refinement would fail on planar scenes.
    fn refine(&self, essential: &Matrix3<f64>, inliers: &[usize]) -> Option<Matrix3<f64>> {
        // Step of the numerical derivatives, radians: of the rotation, and of the direction of the translation.
        const STEP: f64 = 1e-7;
        let mut pose = poses_from_essential(essential)?[0];
        // Gauss–Newton converges quadratically from a RANSAC result.
        for _ in 0..3 {
            let current = essential_from_pose(&pose);
            let moved: [Matrix3<f64>; 5] = std::array::from_fn(|k| {
                let mut delta = SVector::<f64, 5>::zeros();
                delta[k] = STEP;
                essential_from_pose(&perturbed(&pose, &delta))
            });
            let mut hessian = SMatrix::<f64, 5, 5>::zeros();
            let mut gradient = SVector::<f64, 5>::zeros();
            for &i in inliers {
                let residual = self.sampson(&current, i);
                let slope = SVector::<f64, 5>::from_fn(|k, _| (self.sampson(&moved[k], i) - residual) / STEP);
                hessian += slope * slope.transpose();
                gradient += slope * residual;
            }
            let delta = hessian.cholesky()?.solve(&gradient);
            pose = perturbed(&pose, &-delta);
        }
        let refined = essential_from_pose(&pose);
        refined.iter().all(|v| v.is_finite()).then_some(refined)
    }
}

fn essential_from_pose(pose: &Rigid3) -> Matrix3<f64> {
    pose.translation.cross_matrix() * pose.rotation.to_rotation_matrix().matrix() / std::f64::consts::SQRT_2
}

/// Rotates by the first three components and moves the translation on its unit sphere by the last two.
fn perturbed(pose: &Rigid3, delta: &SVector<f64, 5>) -> Rigid3 {
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(delta[0], delta[1], delta[2]));
    let t = pose.translation;
    let [a, b] = across(&t);
    Rigid3::new(turn * pose.rotation, (t + a * delta[3] + b * delta[4]).normalize())
}

struct HomographyEstimator<'a>(&'a Correspondences);

impl Estimator for HomographyEstimator<'_> {
    type Model = Matrix3<f64>;
    // Four points determine a homography.
    const SAMPLE_SIZE: usize = 4;

    fn num_data(&self) -> usize {
        self.0.first.len()
    }

    fn fit(&self, sample: &[usize], models: &mut Vec<Matrix3<f64>>) {
        models.extend(self.refine(&Matrix3::identity(), sample));
    }

    fn error_sq(&self, homography: &Matrix3<f64>, datum: usize) -> f64 {
        let mapped = homography * self.0.first[datum].push(1.0);
        if mapped.z == 0.0 { f64::INFINITY } else { (mapped.xy() / mapped.z - self.0.second[datum]).norm_squared() }
    }

    fn refine(&self, _: &Matrix3<f64>, inliers: &[usize]) -> Option<Matrix3<f64>> {
        let pick = |points: &[Vector2<f64>]| inliers.iter().map(|&i| points[i]).collect::<Vec<_>>();
        homography_from_points(&pick(&self.0.first), &pick(&self.0.second))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    /// Points in a box in front of two cameras, projected into both, with outliers at the end.
    fn views(truth: &Rigid3, planar: bool, outliers: usize) -> (Vec<Vector2<f64>>, Vec<Vector2<f64>>) {
        let mut rng = seeded_rng(5, 1);
        let mut pairs: Vec<_> = (0..200)
            .map(|_| {
                let mut p =
                    Point3::new(rng.random_range(-2.0..2.0), rng.random_range(-2.0..2.0), rng.random_range(4.0..8.0));
                if planar {
                    p.z = 6.0 + 0.2 * p.x;
                }
                let q = *truth * p;
                (p.xy().coords / p.z, q.xy().coords / q.z)
            })
            .collect();
        let mut wild = || Vector2::new(rng.random_range(-0.5..0.5), rng.random_range(-0.5..0.5));
        pairs.extend((0..outliers).map(|_| (wild(), wild())));
        pairs.into_iter().unzip()
    }

    #[test]
    fn pose_comes_back_through_outliers() {
        let t = Vector3::new(1.0, 0.1, 0.2).normalize();
        let truth = Rigid3::new(UnitQuaternion::from_euler_angles(0.05, -0.1, 0.02), t);
        let (first, second) = views(&truth, false, 100);
        let pairs = Correspondences { first, second };
        let found = estimate(&pairs, 1e-3, &mut seeded_rng(1, 0)).unwrap();
        assert!(found.cam2_from_cam1.angle_to(&truth) < 1e-4);
        assert!((found.cam2_from_cam1.translation - t).norm() < 1e-3);
        assert!(found.inliers.len() >= 200 && found.homography_ratio < 0.5);
        assert!(found.median_angle > 0.1);
    }

    #[test]
    fn another_motion_explains_less() {
        let truth = Rigid3::new(UnitQuaternion::from_euler_angles(0.05, -0.1, 0.02), Vector3::new(1.0, 0.1, 0.2));
        let (first, second) = views(&truth, false, 100);
        let pairs = Correspondences { first, second };
        let count = |motion: &Rigid3| num_explained(&pairs, motion, 1e-3);
        assert!((200..220).contains(&count(&truth).unwrap()));
        let off = Rigid3::new(truth.rotation, truth.translation + Vector3::new(0.0, 0.3, 0.0));
        assert!(count(&off).unwrap() < 40, "{:?}", count(&off));
        assert_eq!(count(&Rigid3::new(truth.rotation, Vector3::zeros())), None);
    }

    #[test]
    fn planes_and_pure_rotations_show_in_the_homography_ratio() {
        let planar = Rigid3::new(UnitQuaternion::identity(), Vector3::x());
        let (first, second) = views(&planar, true, 0);
        let pairs = Correspondences { first, second };
        assert!(estimate(&pairs, 1e-3, &mut seeded_rng(1, 0)).unwrap().homography_ratio > 0.95);
        let turned = Rigid3::new(UnitQuaternion::from_euler_angles(0.0, 0.2, 0.0), Vector3::zeros());
        let (first, second) = views(&turned, false, 0);
        let pairs = Correspondences { first, second };
        if let Some(found) = estimate(&pairs, 1e-3, &mut seeded_rng(1, 0)) {
            assert!(found.homography_ratio > 0.95);
        }
    }
}
