//! Pose of a camera that does not translate, by points of a geographic map.
//!
//! With the camera's centre C, east, north and up of a place, and its rotation R (axes of the map from those of the
//! background), the ray u of a point X of the ground is Rᵀ (X − C) / |X − C|. A homography gives the initial pose;
//! Gauss–Newton over R and C refines it. The unit of such a background is the camera's height, so C also gives the
//! metres per unit. Residuals above the stated standard deviations widen the covariance. A loosely known focal length
//! is estimated by the least sum of squares, with the curvature there as its information.
//!
//! Positions are intersections of rays with the ground, which is the plane of the map: errors of height, tilt and focal
//! length cancel there, as those of a homography do. So the scale, north and position of the alignment are those of the
//! similarity of the plane that is nearest to the displacements of the points by θ = (rotation, C, ln f):
//!
//! ```text
//! φ = (Dᵀ D)⁻¹ Dᵀ G θ,   G = ∂(points on the ground) / ∂θ,   D = ∂(points on the ground) / ∂(ln s, north, east, north)
//! ```
//!
//! The residual of that similarity is added to the variance of the position.

use nalgebra::{Matrix3, Matrix3x2, Point3, Rotation3, SMatrix, SVector, UnitQuaternion, Vector2, Vector3};

use super::Alignment;
use super::align::Covariance;
use crate::math::{Sim3, homography_from_points, svd3};

/// A point of the map and the ray to it from a camera at the origin of the background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapPoint {
    /// Unit vector.
    pub ray_in_world: Vector3<f64>,
    /// Standard deviation of the ray's direction, radians.
    pub ray_std: f64,
    /// Metres east, north and above the middle of all points.
    pub position_m: Point3<f64>,
    /// Standard deviation along each axis.
    pub std_m: f64,
}

/// Reason why points of a map do not determine a camera's pose.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MapPointsError {
    /// Points on one line, or fewer than four.
    #[error("at least four points, no three of them on a line, must be given; found {0}")]
    TooFew(usize),
    /// Image and map are mirrored, or points are above the horizon.
    #[error("no camera above the ground sees the points so; check that longitude is first and which pixel is which")]
    NoCamera,
    /// A point is an outlier with respect to the pose of the others.
    #[error(
        "point {index} is {off_m:.1} m from where the camera sees it; check its pixel, its position and the intrinsics"
    )]
    Contradiction {
        /// Number of the point, from 1.
        index: usize,
        /// Distance on the ground, metres.
        off_m: f64,
    },
}

/// Minimum number of points to detect an outlier: the others must have more measurements than pose and focal length
/// have parameters.
const FEWEST_FOR_DOUBT: usize = 6;
/// Number of points tested by leaving one out, those with the largest residuals: an outlier can bias pose and focal
/// length so that its own residual is small, but not among so many.
const MAX_SUSPECTS: usize = 30;
/// Standard deviations beyond which a point contradicts the others; of twenty right ones the worst is at about three.
const ODD_DEVIATIONS: f64 = 5.0;
/// Root-mean-square residual beyond which points contradict each other, in stated standard deviations.
const MAX_DEVIATIONS: f64 = 4.0;

/// Pose with the least sum of squares.
struct Fit {
    pose: Pose,
    information: SMatrix<f64, 6, 6>,
    /// Sum of squares, standard deviations.
    squares: f64,
    /// Residuals beyond the parameters.
    freedom: usize,
}

impl Fit {
    fn of(points: &[MapPoint]) -> Result<Self, MapPointsError> {
        let mut pose = start(points)?;
        let mut information = SMatrix::<f64, 6, 6>::zeros();
        // Starting from the homography, which is exact up to noise and heights: quadratic convergence.
        for _ in 0..12 {
            let mut gradient = SVector::<f64, 6>::zeros();
            information.fill(0.0);
            for point in points {
                let weight = pose.variance(point).recip();
                let here = pose.residual(point);
                let column = |k: usize| (pose.moved(&(SVector::ith(k, STEP))).residual(point) - here) / STEP;
                let jacobian = SMatrix::<f64, 2, 6>::from_columns(&[0, 1, 2, 3, 4, 5].map(column));
                gradient += jacobian.transpose() * here * weight;
                information += jacobian.transpose() * jacobian * weight;
            }
            let step = information.try_inverse().ok_or(MapPointsError::TooFew(points.len()))? * gradient;
            pose = pose.moved(&-step);
        }
        let squares = points.iter().map(|point| pose.residual(point).norm_squared() / pose.variance(point)).sum();
        Ok(Self { pose, information, squares, freedom: 2 * points.len() - 6 })
    }

    /// Ratio of actual to stated residuals.
    ///
    /// * `more` – number of parameters in addition to the pose.
    fn factor(&self, more: usize) -> f64 {
        (self.squares / (self.freedom - more) as f64).sqrt()
    }
}

/// Sum of squares at a focal length, including its prior.
fn squares_at(points_at: &impl Fn(f64) -> Vec<MapPoint>, log_focal: f64, prior_std: f64) -> f64 {
    let fit = Fit::of(&points_at(log_focal)).ok().filter(|fit| fit.pose.center.z > 0.0);
    fit.map_or(f64::INFINITY, |fit| fit.squares + (log_focal / prior_std).powi(2))
}

/// Logarithm of the factor to the focal length with the least sum of squares.
fn best_focal(points_at: &impl Fn(f64) -> Vec<MapPoint>, prior_std: f64) -> f64 {
    // Within 2.5 standard deviations: of a guessed focal length (±40 %) steps of 2.5 %, less than points of a map tell.
    let mut step = 2.5 * prior_std / 40.0;
    let least = |values: &mut dyn Iterator<Item = f64>| {
        let squares = values.map(|at| (squares_at(points_at, at, prior_std), at));
        squares.min_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, at)| at)
    };
    let mut best = least(&mut (-40..=40).map(|k| f64::from(k) * step));
    for _ in 0..4 {
        let (middle, finer) = (best, step / 5.0);
        best = least(&mut (-5..=5).map(|k| middle + f64::from(k) * finer));
        step = finer;
    }
    best
}

/// Single outlier, and its distance from the position predicted by the others, metres: without it they fit far better.
/// A focal length that is not held would be biased by it, so it is estimated again without the point.
fn odd_one_out(points_at: &impl Fn(f64) -> Vec<MapPoint>, fit: &Fit, prior_std: f64) -> Option<(usize, f64)> {
    let points = points_at(0.0);
    // Without a point no more squares can go than there are.
    if points.len() < FEWEST_FOR_DOUBT || fit.squares <= 2.0 * ODD_DEVIATIONS.powi(2) {
        return None;
    }
    let share = |k: &usize| fit.pose.residual(&points[*k]).norm_squared() / fit.pose.variance(&points[*k]);
    let mut suspects: Vec<usize> = (0..points.len()).collect();
    suspects.sort_by(|a, b| share(b).total_cmp(&share(a)));
    let without = |&k: &usize| {
        let others_at = |log_focal: f64| {
            let mut others = points_at(log_focal);
            others.remove(k);
            others
        };
        let log_focal = if prior_std > 0.0 { best_focal(&others_at, prior_std) } else { 0.0 };
        let others = Fit::of(&others_at(log_focal)).ok()?;
        let variance = (others.squares / others.freedom as f64).max(1.0);
        let deviations = ((fit.squares - others.squares) / (2.0 * variance)).sqrt();
        let MapPoint { ray_in_world, position_m, .. } = points_at(log_focal)[k];
        let seen_m = others.pose.at_height(&ray_in_world, position_m.z)?;
        Some((deviations, (k + 1, (seen_m - position_m.coords.xy()).norm())))
    };
    let found = suspects.iter().take(MAX_SUSPECTS).filter_map(without);
    let worst = found.filter(|(deviations, _)| *deviations > ODD_DEVIATIONS).max_by(|a, b| a.0.total_cmp(&b.0));
    worst.map(|(_, point)| point)
}

/// Focal length by points of a map: logarithm of a factor and its standard deviation; `None` where they do not
/// determine a pose.
///
/// * `points_at` – the points with rays of a camera whose focal length is larger by the exponential of the argument.
/// * `prior_std` – standard deviation of the logarithm beforehand.
pub fn focal_over_map(points_at: impl Fn(f64) -> Vec<MapPoint>, prior_std: f64) -> Option<(f64, f64)> {
    let squares = |log_focal: f64| squares_at(&points_at, log_focal, prior_std);
    let best = best_focal(&points_at, prior_std);
    let fit = Fit::of(&points_at(best)).ok()?;
    // Wide enough for the differences to be above roundings.
    let reach = (0.01 * prior_std).max(1e-4);
    let curvature = (squares(best + reach) + squares(best - reach) - 2.0 * squares(best)) / (2.0 * reach.powi(2));
    let factor = fit.factor(1);
    let std = curvature.recip().sqrt() * factor.max(1.0);
    (curvature.is_finite() && std.is_finite() && factor <= MAX_DEVIATIONS).then(|| (best, std.min(prior_std)))
}

/// Estimates the camera's pose; the middle of the points is the anchor. The covariance is that of ground positions.
///
/// * `points_at` – the points with rays of a camera whose focal length is larger by the exponential of the argument.
/// * `focal_std` – standard deviation of that logarithm, these points included.
/// * `prior_std` – the same without them; 0 where it is held.
///
/// # Errors
/// [`MapPointsError`].
pub fn camera_over_map(
    points_at: impl Fn(f64) -> Vec<MapPoint>,
    focal_std: f64,
    prior_std: f64,
) -> Result<Alignment, MapPointsError> {
    let points = points_at(0.0);
    let fit = Fit::of(&points)?;
    let factor = fit.factor(0);
    let Fit { pose, information, .. } = &fit;
    let height = pose.center.z;
    if !(height > 0.0 && factor.is_finite()) {
        return Err(MapPointsError::NoCamera);
    }
    if let Some((index, off_m)) = odd_one_out(&points_at, &fit, prior_std) {
        return Err(MapPointsError::Contradiction { index, off_m });
    }
    if factor > MAX_DEVIATIONS {
        let off_m = |point: &MapPoint| {
            let at = pose.at_height(&point.ray_in_world, point.position_m.z);
            at.map_or(f64::INFINITY, |at| (at - point.position_m.coords.xy()).norm())
        };
        let worst = (1..).zip(points.iter().map(off_m)).max_by(|a, b| a.1.total_cmp(&b.1));
        let worst = worst.filter(|(_, off_m)| off_m.is_finite());
        return Err(
            worst.map_or(MapPointsError::NoCamera, |(index, off_m)| MapPointsError::Contradiction { index, off_m })
        );
    }
    let of_pose = information.try_inverse().ok_or(MapPointsError::TooFew(points.len()))? * factor.max(1.0).powi(2);
    let middle = points.iter().map(|point| point.position_m.coords.xy()).sum::<Vector2<f64>>() / points.len() as f64;
    let refocused = points_at(FOCAL_STEP);
    let by_focal = Fit::of(&refocused).ok().map(|fit| (fit.pose, &refocused[..]));
    let covariance = covariance_on_ground(pose, &points, &of_pose, by_focal, focal_std, middle)
        .ok_or(MapPointsError::TooFew(points.len()))?;
    let metric_from_world = Sim3::new(height, pose.metric_from_world, pose.center.coords);
    Ok(Alignment {
        metric_from_world,
        anchor_in_world: metric_from_world.inverse() * Point3::from(middle.push(0.0)),
        covariance,
        offset_s: 0.0,
        offset_std_s: 0.0,
        num_fixes: points.len(),
        rejected_share: 0.0,
        noise_factor: factor,
    })
}

/// Covariance of the similarity of the ground about the middle of the points (see above), by the points and what lies
/// between two of them.
///
/// * `of_pose` – covariance of the pose at the focal length as it is.
/// * `by_focal` – pose and points with a focal length that is longer by [`FOCAL_STEP`].
fn covariance_on_ground(
    pose: &Pose,
    points: &[MapPoint],
    of_pose: &SMatrix<f64, 6, 6>,
    by_focal: Option<(Pose, &[MapPoint])>,
    focal_std: f64,
    middle: Vector2<f64>,
) -> Option<Covariance> {
    let mut of_parameters = SMatrix::<f64, 7, 7>::zeros();
    of_parameters.fixed_view_mut::<6, 6>(0, 0).copy_from(of_pose);
    of_parameters[(6, 6)] = focal_std.powi(2);
    // Rotation of the map's axes by the parameters.
    let mut turns = SMatrix::<f64, 3, 7>::zeros();
    turns.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    if let Some((moved, _)) = &by_focal {
        let turn = (moved.metric_from_world * pose.metric_from_world.inverse()).scaled_axis() / FOCAL_STEP;
        turns.set_column(6, &turn);
    }
    let moved: [Pose; 6] = std::array::from_fn(|j| pose.moved(&SVector::ith(j, STEP)));
    let between = |points: &[MapPoint], (j, k): (usize, usize)| points[j].ray_in_world + points[k].ray_in_world;
    let displacement = |pair: (usize, usize)| {
        let ray = between(points, pair);
        let height = 0.5 * (points[pair.0].position_m.z + points[pair.1].position_m.z);
        let here = pose.at_height(&ray, height)?;
        let mut by = SMatrix::<f64, 2, 7>::zeros();
        for (j, pose) in moved.iter().enumerate() {
            by.set_column(j, &((pose.at_height(&ray, height)? - here) / STEP));
        }
        if let Some((pose, points)) = &by_focal {
            by.set_column(6, &((pose.at_height(&between(points, pair), height)? - here) / FOCAL_STEP));
        }
        let [x, y] = (here - middle).into();
        Some((by, SMatrix::<f64, 2, 4>::new(x, -y, 1.0, 0.0, y, x, 0.0, 1.0)))
    };
    // Evenly chosen: the time grows with the square of their number.
    let step = points.len().div_ceil(40);
    let sampled = || (0..points.len()).step_by(step);
    let pairs = sampled().flat_map(|j| sampled().skip_while(move |k| *k < j).map(move |k| (j, k)));
    let rows: Vec<_> = pairs.map(displacement).collect::<Option<_>>()?;
    let normal_equations: SMatrix<f64, 4, 4> = rows.iter().map(|(_, similarity)| similarity.tr_mul(similarity)).sum();
    let right_side: SMatrix<f64, 4, 7> = rows.iter().map(|(by, similarity)| similarity.tr_mul(by)).sum();
    let by_similarity = normal_equations.try_inverse()? * right_side;
    let unexplained = |(by, similarity): &(SMatrix<f64, 2, 7>, SMatrix<f64, 2, 4>)| {
        let rest = by - similarity * by_similarity;
        (rest * of_parameters * rest.transpose()).trace()
    };
    let variance = rows.iter().map(unexplained).sum::<f64>() / (2 * rows.len()) as f64;
    let mut by_parameters = SMatrix::<f64, 7, 7>::zeros();
    by_parameters.set_row(0, &by_similarity.row(0));
    by_parameters.fixed_view_mut::<2, 7>(1, 0).copy_from(&turns.fixed_rows::<2>(0));
    by_parameters.fixed_view_mut::<3, 7>(3, 0).copy_from(&by_similarity.fixed_rows::<3>(1));
    let mut covariance = by_parameters * of_parameters * by_parameters.transpose();
    (4..6).for_each(|k| covariance[(k, k)] += variance);
    Some(covariance)
}

/// Step of the derivatives, radians and metres.
const STEP: f64 = 1e-6;
/// Step of that by the logarithm of the focal length: a fit ends within a hundred millionth.
const FOCAL_STEP: f64 = 1e-3;

/// Camera over the map.
struct Pose {
    metric_from_world: UnitQuaternion<f64>,
    center: Point3<f64>,
}

impl Pose {
    fn moved(&self, step: &SVector<f64, 6>) -> Self {
        let turn = UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(0).into_owned());
        Self {
            metric_from_world: turn * self.metric_from_world,
            center: self.center + step.fixed_rows::<3>(3).into_owned(),
        }
    }

    fn center_to_point(&self, point: &MapPoint) -> Vector3<f64> {
        point.position_m - self.center
    }

    /// Predicted direction across the ray.
    fn residual(&self, point: &MapPoint) -> Vector2<f64> {
        let direction = self.metric_from_world.inverse() * self.center_to_point(point).normalize();
        let u = point.ray_in_world;
        let side = u.cross(&Vector3::ith(u.iamin(), 1.0)).normalize();
        Matrix3x2::from_columns(&[side, u.cross(&side)]).transpose() * direction
    }

    fn variance(&self, point: &MapPoint) -> f64 {
        point.ray_std.powi(2) + (point.std_m / self.center_to_point(point).norm()).powi(2)
    }

    /// Intersection of a ray with the plane of a height.
    fn at_height(&self, ray_in_world: &Vector3<f64>, height: f64) -> Option<Vector2<f64>> {
        let ray = self.metric_from_world * ray_in_world;
        (ray.z < 0.0).then(|| (self.center.coords - ray * ((self.center.z - height) / ray.z)).xy())
    }
}

fn start(points: &[MapPoint]) -> Result<Pose, MapPointsError> {
    let too_few = MapPointsError::TooFew(points.len());
    let ahead = points.iter().map(|point| point.ray_in_world).sum::<Vector3<f64>>();
    let level = UnitQuaternion::rotation_between(&ahead, &Vector3::z()).ok_or(MapPointsError::NoCamera)?;
    let seen: Option<Vec<Vector2<f64>>> = points
        .iter()
        .map(|point| {
            let ray = level * point.ray_in_world;
            (ray.z > 0.0).then(|| ray.xy() / ray.z)
        })
        .collect();
    let ground: Vec<Vector2<f64>> = points.iter().map(|point| point.position_m.coords.xy()).collect();
    let h = homography_from_points(&ground, &seen.ok_or(MapPointsError::NoCamera)?).ok_or(too_few)?;
    let length = 0.5 * (h.column(0).norm() + h.column(1).norm());
    // In front of the camera.
    let h = h / length * (h * ground[0].push(1.0)).z.signum();
    let [a, b, t] = [0, 1, 2].map(|k| h.column(k).into_owned());
    let svd = svd3(Matrix3::from_columns(&[a, b, a.cross(&b)])).ok_or(MapPointsError::NoCamera)?;
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Err(MapPointsError::NoCamera) };
    let cam_from_metric = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * v_t));
    let pose = Pose {
        metric_from_world: cam_from_metric.inverse() * level,
        center: Point3::from(-(cam_from_metric.inverse() * t)),
    };
    (pose.center.z > 0.0).then_some(pose).ok_or(MapPointsError::NoCamera)
}

#[cfg(test)]
mod tests {
    use super::super::metric_from_cam;
    use super::super::placing::covariance_at;
    use super::*;
    use crate::math::seeded_rng;
    use rand::Rng as _;
    use rand_distr::StandardNormal;

    const GROUND: [[f64; 2]; 5] = [[-25.0, 30.0], [20.0, 35.0], [30.0, 80.0], [-30.0, 85.0], [2.0, 55.0]];

    /// A camera at 50 m facing north, 40° down, and points with errors of `std_m`.
    fn points(num: usize, std_m: f64, seed: u64) -> (Vec<MapPoint>, UnitQuaternion<f64>, Point3<f64>) {
        let (rotation, center) = (metric_from_cam(0.1, -0.7, 0.02), Point3::new(3.0, -2.0, 50.0));
        let mut rng = seeded_rng(seed, 0);
        let mut noise = move || std_m * rng.sample::<f64, _>(StandardNormal);
        let point = |&[east, north]: &[f64; 2]| MapPoint {
            ray_in_world: (rotation.inverse() * (Vector3::new(east, north, 0.0) - center.coords)).normalize(),
            ray_std: 1e-3,
            position_m: Point3::new(east + noise(), north + noise(), 0.0),
            std_m: 0.3,
        };
        (GROUND[..num].iter().map(point).collect(), rotation, center)
    }

    /// The points with rays of a camera whose focal length is assumed to be a share of the true one.
    fn zoomed(points: &[MapPoint], log_focal: f64) -> Vec<MapPoint> {
        let axis = metric_from_cam(0.1, -0.7, 0.02).inverse() * Vector3::new(0.1, 1.0, -0.84);
        let axis = axis.normalize();
        let ray = |u: Vector3<f64>| {
            let along = axis * axis.dot(&u);
            (along + (u - along) / log_focal.exp()).normalize()
        };
        points.iter().map(|point| MapPoint { ray_in_world: ray(point.ray_in_world), ..*point }).collect()
    }

    #[test]
    fn positions_on_the_ground_are_within_their_deviations() {
        const SEEN: [[f64; 2]; 4] = [[-10.0, 40.0], [15.0, 70.0], [0.0, 30.0], [-20.0, 75.0]];
        // The same camera with a known focal length, and with one estimated from the points and a prior of ±15 %.
        for prior_std in [0.0, 0.15] {
            let (mut inside, mut all, mut largest_std) = ([0, 0], 0, 0.0f64);
            for seed in 0..60 {
                let (points, _, center) = points(5, 0.3, seed);
                let error = prior_std * (f64::from(seed as u32 % 7) - 3.0) / 2.0;
                let at = |log: f64| zoomed(&points, log + error);
                let (log_focal, std) = match prior_std > 0.0 {
                    true => focal_over_map(at, prior_std).unwrap(),
                    false => (0.0, 0.0),
                };
                let found = camera_over_map(|log| at(log_focal + log), std, prior_std).unwrap();
                for [east, north] in SEEN {
                    let truth = Vector3::new(east, north, 0.0);
                    let ray = metric_from_cam(0.1, -0.7, 0.02).inverse() * (truth - center.coords);
                    let point = MapPoint { ray_in_world: ray.normalize(), ..points[0] };
                    let [seen] = zoomed(&[point], log_focal + error)[..] else { unreachable!() };
                    let Sim3 { rotation, translation, .. } = found.metric_from_world;
                    let pose = Pose { metric_from_world: rotation, center: Point3::from(translation) };
                    let place = pose.at_height(&seen.ray_in_world, 0.0).unwrap().push(0.0);
                    let anchor = found.metric_from_world * found.anchor_in_world;
                    let covariance = covariance_at(&(place - anchor.coords), &found.covariance);
                    for k in 0..2 {
                        let off = (place - truth)[k].abs() / covariance[(k, k)].sqrt();
                        inside[0] += i32::from(off <= 1.0);
                        inside[1] += i32::from(off <= 2.0);
                        all += 1;
                        largest_std = largest_std.max(covariance[(k, k)].sqrt());
                    }
                }
            }
            let [one, two] = inside.map(|inside| f64::from(inside) / f64::from(all));
            // Residuals below the stated standard deviations do not reduce the covariance.
            assert!((0.6..0.9).contains(&one) && two > 0.93, "{prior_std}: {one} {two}");
            // Alone, the error of the camera's height or of its inclination would move them by a metre.
            assert!(largest_std < 0.8, "{largest_std}");
        }
    }

    #[test]
    fn four_points_determine_the_pose() {
        let (points, rotation, center) = points(4, 0.0, 0);
        let found = camera_over_map(|_| points.clone(), 0.0, 0.0).unwrap();
        assert!((Point3::from(found.metric_from_world.translation) - center).norm() < 1e-6);
        assert!(found.metric_from_world.rotation.angle_to(&rotation) < 1e-7);
    }

    #[test]
    fn heights_of_points_count() {
        let (level, rotation, center) = points(5, 0.0, 0);
        let lifted = |(k, point): (usize, &MapPoint)| {
            let position_m = Point3::new(point.position_m.x, point.position_m.y, [-3.0, 2.0, 4.0, -1.0, -2.0][k]);
            MapPoint { position_m, ray_in_world: (rotation.inverse() * (position_m - center)).normalize(), ..*point }
        };
        let on_hill: Vec<MapPoint> = level.iter().enumerate().map(lifted).collect();
        let found = camera_over_map(|_| on_hill.clone(), 0.0, 0.0).unwrap();
        assert!((Point3::from(found.metric_from_world.translation) - center).norm() < 1e-6);
        assert!(found.metric_from_world.rotation.angle_to(&rotation) < 1e-7);
        // Without the heights, the same points give another camera position, if any.
        let flat = |point: &MapPoint| MapPoint {
            position_m: Point3::new(point.position_m.x, point.position_m.y, 0.0),
            ..*point
        };
        let flat: Vec<MapPoint> = on_hill.iter().map(flat).collect();
        let off = camera_over_map(|_| flat.clone(), 0.0, 0.0)
            .map(|found| Point3::from(found.metric_from_world.translation) - center);
        assert!(off.is_err() || off.is_ok_and(|off| off.norm() > 1.0));
    }

    #[test]
    fn an_outlier_is_named_and_does_not_bias_the_focal_length() {
        let (rotation, center) = (metric_from_cam(0.1, -0.7, 0.02), Point3::new(3.0, -2.0, 50.0));
        let (mut named, mut refused) = (0, 0);
        for seed in 0..10 {
            let mut rng = seeded_rng(seed, 1);
            let mut noise = || 0.2 * rng.sample::<f64, _>(StandardNormal);
            let right: Vec<MapPoint> = (0..9)
                .map(|k| [f64::from(k % 3) * 25.0 - 25.0, f64::from(k / 3) * 25.0 + 30.0])
                .map(|[east, north]| MapPoint {
                    ray_in_world: (rotation.inverse() * (Point3::new(east, north, 0.0) - center)).normalize(),
                    ray_std: 1e-3,
                    position_m: Point3::new(east + noise(), north + noise(), noise()),
                    std_m: 0.3,
                })
                .collect();
            let mut wrong = right.clone();
            let index = 1 + seed as usize % 9;
            wrong[index - 1].position_m.z += 12.0;
            let placed = |points: &[MapPoint]| {
                let (log_focal, std) = focal_over_map(|log| zoomed(points, log), 0.75).unwrap_or((0.0, 0.75));
                camera_over_map(|log| zoomed(points, log_focal + log), std, 0.75)
            };
            refused += i32::from(placed(&right).is_err());
            let found = placed(&wrong).err();
            named += i32::from(matches!(found, Some(MapPointsError::Contradiction { index: k, .. }) if k == index));
        }
        assert!(named >= 9 && refused == 0, "{named} {refused}");
    }

    #[test]
    fn points_show_the_focal_length() {
        let mut inside = 0;
        for seed in 0..40 {
            let (points, ..) = points(5, 0.3, seed);
            let (found, std) = focal_over_map(|log| zoomed(&points, log - 0.3), 0.4).unwrap();
            assert!(std < 0.1 && (found - 0.3).abs() < 4.0 * std, "{found} {std}");
            inside += i32::from((found - 0.3).abs() <= std);
        }
        assert!((24..=36).contains(&inside), "{inside}");
    }

    #[test]
    fn points_that_determine_no_pose_are_rejected() {
        let (all, ..) = points(5, 0.0, 0);
        let camera = |points: &[MapPoint]| camera_over_map(|_| points.to_vec(), 0.0, 0.0);
        assert!(matches!(camera(&all[..3]), Err(MapPointsError::TooFew(3))));
        assert!(camera(&[]).is_err());
        let swapped = |point: &MapPoint| MapPoint { position_m: point.position_m.yxz(), ..*point };
        let mirrored: Vec<MapPoint> = all.iter().map(swapped).collect();
        assert_eq!(camera(&mirrored), Err(MapPointsError::NoCamera));
        let mut one_off = all.clone();
        one_off[4].position_m.x += 8.0;
        assert!(matches!(camera(&one_off), Err(MapPointsError::Contradiction { index: 5, .. })));
        let line: Vec<MapPoint> =
            (0..4).map(|k| MapPoint { position_m: Point3::new(0.0, 9.0 * f64::from(k), 0.0), ..all[0] }).collect();
        assert!(camera(&line).is_err());
    }
}
