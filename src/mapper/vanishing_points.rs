//! The ground's normal and the focal length from straight lines in some images.
//!
//! Streets, kerbs, markings, walls and vehicles have edges that are vertical, or horizontal along few directions. With
//! the vertical n, azimuths a_k and the focal length f, the vanishing directions are
//!
//! ```text
//! v_0 = n,    v_k = cos a_k e_1 + sin a_k e_2,    e_1, e_2 ⊥ n                                                     (1)
//! ```
//!
//! and a segment whose plane with the camera center has the normal m, and whose midpoint has the direction c, deviates
//! from the line towards v by the angle
//!
//! ```text
//! sin ε = mᵀ v / ‖c × v‖                                                                                           (2)
//! ```
//!
//! Each segment is assigned to the direction with the smallest residual. The robust cost is searched on a grid, then
//! minimized (Levenberg–Marquardt). The verticals of walls are those of gravity, against which the ground is inclined
//! by the slope of roads. The slope enters the covariance as a parameter with a prior that is considered but not
//! adjusted (S. Schmidt, *Application of State-Space Methods to Navigation Problems*, 1966). Literature: J. Coughlan,
//! A. Yuille, *Manhattan World*, 1999; G. Schindler, F. Dellaert, *Atlanta World*, 2004.

use nalgebra::{DMatrix, DVector, Matrix3, Matrix3x2, Point2, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::camera::{Camera, MAX_TILT_STD, ROLL_STD, SLOPE_STD, up_in_cam};
use crate::math::RobustLoss;

/// Standard deviation of a segment's ends across it, pixels.
const END_STD_PX: f64 = 0.35;
/// Standard deviation of the direction of parallel edges, radians.
const PARALLEL_STD: f64 = 0.005;
/// Number of horizontal directions: two of each of two crossing streets.
const NUM_LEVEL: usize = 4;
/// Minimum angle between horizontal directions, radians.
const MIN_AZIMUTH_DIFFERENCE: f64 = 0.17;
/// Loss of a residual in standard deviations: many edges belong to none of the directions.
const LOSS: RobustLoss = RobustLoss::Cauchy { scale: std::f64::consts::SQRT_2 };
/// Range of accepted inclinations, radians. Closer to the horizon, and to straight down, the road ahead and the
/// vertical are ambiguous: a vanishing point in the image may be either. A drone's view straight down was estimated as
/// 73.5° ± 1.4° with three times its focal length, so the upper limit must be two standard deviations away.
const INCLINATIONS: [f64; 2] = [0.09, 1.31];
/// Minimum number of segments: fewer random ones are explained, too.
const MIN_SEGMENTS: usize = 50;
/// Maximum residual of an inlier, standard deviations.
const MAX_RESIDUAL: f64 = 3.0;
/// Minimum inlier ratio: 60 random segments have 0.62, 150 have 0.45, those in streets 0.86 to 0.97, and those on three
/// real roads that bend, where the directions are meaningless, 0.82 to 0.85.
const MIN_INLIER_RATIO: f64 = 0.86;
/// Number of grid points from which the first view is adjusted.
const NUM_STARTS: usize = 12;
/// Number of the first view's minima from which all views are adjusted.
const NUM_MINIMA: usize = 4;
/// Number of segments in the grid search, the longest of the first view: more only cost time.
const NUM_SEARCHED: usize = 150;

/// The ground's normal by straight lines.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LineNormal {
    /// Unit normal in the world of the rotations, towards the camera.
    pub normal_in_world: Vector3<f64>,
    /// Its covariance.
    pub covariance: Matrix3<f64>,
}

/// Segments of a view: its rotation, camera from world, and both ends of each, pixels.
pub type ViewSegments<'a> = (UnitQuaternion<f64>, &'a [[Point2<f64>; 2]]);

/// Estimates the ground's normal and the focal length from segments in the views of a camera that only rotates.
///
/// Returns the normal, and the logarithm of the focal length over the initial one with its standard deviation. `None`
/// if too few segments are straight lines of built structures, or if these leave the result undetermined. Views show
/// the same lines: together they count as one.
///
/// * `focal_std` – prior standard deviation of the focal length's logarithm; 0 holds it.
pub fn horizon(views: &[ViewSegments], camera: &Camera, focal_std: f64) -> Option<(LineNormal, [f64; 2])> {
    let (first_from_world, _) = views.first()?;
    let lines_of = |(view_from_world, segments): &ViewSegments| {
        let first_from_view = first_from_world * view_from_world.inverse();
        let line = |ends| Line::new(ends, camera, first_from_view);
        segments.iter().filter_map(line).collect::<Vec<Line>>()
    };
    let lines: Vec<Vec<Line>> = views.iter().map(lines_of).collect();
    let first = Problem { lines: lines.first()?, weight: 1.0, focal_std };
    if first.lines.len() < MIN_SEGMENTS {
        return None;
    }
    // The first view alone locates the minima, in a fifth of the time.
    let mut found: Vec<Minimum> = first.starts().into_iter().filter_map(|start| first.minimum(start)).collect();
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let starts = distinct(&found).into_iter().take(NUM_MINIMA).map(|found| found.at.clone());
    let problem = Problem { lines: &lines.concat(), weight: 1.0 / views.len() as f64, focal_std };
    let mut minima: Vec<Minimum> = starts.filter_map(|start| problem.minimum(start)).collect();
    minima.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let best = minima.first()?;
    let share = problem.inlier_ratio(&best.at);
    if share < MIN_INLIER_RATIO {
        return None;
    }
    let (mean, covariance) = mean_of_minima(&minima);
    let [least, most] = INCLINATIONS;
    let is_possible = mean.x >= least && mean.x + 2.0 * covariance[(0, 0)].sqrt() <= most;
    let tilt_std = (covariance[(0, 0)] + covariance[(1, 1)]).sqrt();
    tracing::debug!(
        "straight lines: {} segments, {share:.2} explained, pitch {:.1}°, tilt ± {:.1}°, focal length × {:.3}",
        problem.lines.len(),
        mean.x.to_degrees(),
        tilt_std.to_degrees(),
        mean.z.exp()
    );
    (is_possible && tilt_std <= MAX_TILT_STD).then(|| {
        let angles = mean.xy();
        let normal = up_in_cam(angles);
        let by = [Vector2::x(), Vector2::y()].map(|axis| (up_in_cam(angles + axis * STEP) - normal) / STEP);
        let by = Matrix3x2::from_columns(&by);
        let in_cam = by * covariance.fixed_view::<2, 2>(0, 0) * by.transpose();
        let world_from_cam = first_from_world.inverse().to_rotation_matrix();
        let in_world = LineNormal {
            normal_in_world: world_from_cam * normal,
            covariance: world_from_cam * in_cam * world_from_cam.transpose(),
        };
        (in_world, [mean.z, covariance[(2, 2)].sqrt().min(focal_std)])
    })
}

/// Step of numerical derivatives.
const STEP: f64 = 1e-5;
/// Difference of inclination, roll and focal length below which minima are the same.
const SAME_MINIMUM: f64 = 0.02;

/// Segment in normalized image coordinates.
#[derive(Clone)]
struct Line {
    ends: [Vector2<f64>; 2],
    first_from_view: UnitQuaternion<f64>,
    /// Standard deviation of its direction, radians.
    std: f64,
}

impl Line {
    fn new(ends: &[Point2<f64>; 2], camera: &Camera, first_from_view: UnitQuaternion<f64>) -> Option<Self> {
        let length_px = (ends[1] - ends[0]).norm();
        let rays = ends.map(|end| camera.ray_from_pixel(end));
        let std = (END_STD_PX * 12.0_f64.sqrt() / length_px).hypot(PARALLEL_STD);
        rays.iter().all(|ray| ray.z > 0.0).then(|| Self {
            ends: rays.map(|ray| ray.xy() / ray.z),
            first_from_view,
            std,
        })
    }
}

/// Plane of a segment and the camera center, for some focal length.
struct SegmentPlane {
    /// Unit vector to the midpoint of the segment.
    middle: Vector3<f64>,
    /// Unit normal of the plane.
    normal: Vector3<f64>,
    std: f64,
}

impl SegmentPlane {
    /// Residual against the line towards a vanishing direction, standard deviations.
    fn residual(&self, direction: &Vector3<f64>) -> f64 {
        let across = (1.0 - self.middle.dot(direction).powi(2)).max(1e-12).sqrt();
        self.normal.dot(direction) / across / self.std
    }
}

/// Inclination, roll, logarithm of the focal length, and the azimuths of the horizontal directions.
type Parameters = DVector<f64>;
/// Index of the focal length's logarithm.
const FOCAL: usize = 2;
/// Index of the first azimuth, and number of the parameters before it.
const LEVEL: usize = 3;

struct Minimum {
    cost: f64,
    at: Parameters,
    /// Covariance of inclination, roll and focal length, including the slope of roads.
    covariance: Matrix3<f64>,
}

impl Minimum {
    fn common(&self) -> Vector3<f64> {
        Vector3::new(self.at[0], self.at[1], self.at[FOCAL])
    }
}

/// Minima, the lowest first, without those that are the same as a lower one.
fn distinct(minima: &[Minimum]) -> Vec<&Minimum> {
    let mut distinct: Vec<&Minimum> = Vec::new();
    for found in minima {
        if distinct.iter().all(|other| (found.common() - other.common()).amax() > SAME_MINIMUM) {
            distinct.push(found);
        }
    }
    distinct
}

/// Mean and covariance of inclination, roll and focal length over the distinct minima, weighted by likelihood.
///
/// Thus σ covers what the lines leave undetermined.
fn mean_of_minima(minima: &[Minimum]) -> (Vector3<f64>, Matrix3<f64>) {
    let distinct = distinct(minima);
    let least = distinct.iter().map(|found| found.cost).fold(f64::INFINITY, f64::min);
    let likelihoods: Vec<f64> = distinct.iter().map(|found| (least - found.cost).exp()).collect();
    let sum: f64 = likelihoods.iter().sum();
    let weighted = || distinct.iter().zip(likelihoods.iter().map(|likelihood| likelihood / sum));
    let mean: Vector3<f64> = weighted().map(|(found, weight)| found.common() * weight).sum();
    let spread = |found: &Minimum| (found.common() - mean) * (found.common() - mean).transpose();
    (mean, weighted().map(|(found, weight)| (found.covariance + spread(found)) * weight).sum())
}

struct Problem<'a> {
    lines: &'a [Line],
    /// Weight of each segment.
    weight: f64,
    focal_std: f64,
}

impl Problem<'_> {
    fn planes(&self, log_focal: f64) -> Vec<SegmentPlane> {
        let depth = log_focal.exp();
        let plane = |line: &Line| {
            let [from, to] = line.ends.map(|end| line.first_from_view * Vector3::new(end.x, end.y, depth).normalize());
            SegmentPlane { middle: (from + to).normalize(), normal: from.cross(&to).normalize(), std: line.std }
        };
        self.lines.iter().map(plane).collect()
    }

    /// Cost of the priors.
    fn prior(&self, roll: f64, log_focal: f64) -> f64 {
        let of_focal = if self.focal_std > 0.0 { (log_focal / self.focal_std).powi(2) } else { 0.0 };
        0.5 * ((roll / ROLL_STD).powi(2) + of_focal)
    }

    /// Best points of a grid that are not close to one another.
    fn starts(&self) -> Vec<Parameters> {
        // Usual distances of minima: inclination, and logarithm of the focal length.
        const OTHER: [f64; 2] = [0.05, 0.08];
        let in_stds: &[f64] =
            if self.focal_std > 0.0 { &[-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0] } else { &[0.0] };
        let mut found: Vec<(f64, Parameters)> = Vec::new();
        for log_focal in in_stds.iter().map(|by| by * self.focal_std) {
            let mut planes = self.planes(log_focal);
            planes.sort_by(|a, b| a.std.total_cmp(&b.std));
            planes.truncate(NUM_SEARCHED);
            let angles = (1..31).flat_map(|pitch| [-3.0, 0.0, 3.0].map(|roll| [3.0 * f64::from(pitch), roll]));
            for [pitch, roll] in angles.map(|degrees| degrees.map(f64::to_radians)) {
                let (cost, azimuths) = greedy_directions(&planes, Vector2::new(pitch, roll));
                let at = [pitch, roll, log_focal].into_iter().chain(azimuths);
                found.push((cost + self.prior(roll, log_focal), DVector::from_iterator(LEVEL + NUM_LEVEL, at)));
            }
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut starts: Vec<Parameters> = Vec::new();
        for (_, at) in found {
            let off = |other: &Parameters, k: usize| (at[k] - other[k]).abs();
            let is_other = |other: &Parameters| off(other, 0) > OTHER[0] || off(other, FOCAL) > OTHER[1];
            if starts.len() < NUM_STARTS && starts.iter().all(is_other) {
                starts.push(at);
            }
        }
        starts
    }

    /// Residual of each segment against its best direction, and the index of that direction.
    fn residuals(&self, at: &Parameters) -> Vec<(f64, usize)> {
        let directions = directions(at);
        let least = |plane: &SegmentPlane| {
            let all = directions.iter().map(|direction| plane.residual(direction)).zip(0..);
            all.min_by(|a, b| a.0.abs().total_cmp(&b.0.abs())).unwrap_or((f64::INFINITY, 0))
        };
        self.planes(at[FOCAL]).iter().map(least).collect()
    }

    fn cost(&self, at: &Parameters) -> f64 {
        let of_lines = self.residuals(at).iter().map(|(off, _)| 0.5 * LOSS.evaluate(off * off)[0]).sum::<f64>();
        of_lines * self.weight + self.prior(at[1], at[FOCAL])
    }

    /// Inlier ratio of the segments.
    fn inlier_ratio(&self, at: &Parameters) -> f64 {
        let num_inliers = self.residuals(at).iter().filter(|(off, _)| off.abs() < MAX_RESIDUAL).count();
        num_inliers as f64 / self.lines.len() as f64
    }

    /// Derivatives of the residuals against the assigned directions, by every parameter and by the slope of the ground.
    fn derivatives(&self, at: &Parameters, assigned: &[(f64, usize)]) -> (DMatrix<f64>, DMatrix<f64>) {
        let of = |log_focal: f64, directions: [Vector3<f64>; NUM_LEVEL + 1]| {
            let off = |(plane, (_, k)): (&SegmentPlane, &(f64, usize))| plane.residual(&directions[*k]);
            DVector::from_iterator(assigned.len(), self.planes(log_focal).iter().zip(assigned).map(off))
        };
        let here = of(at[FOCAL], directions(at));
        let moved = |k: usize| {
            let mut moved = at.clone();
            moved[k] += STEP;
            moved
        };
        let by = |k: usize| (of(moved(k)[FOCAL], directions(&moved(k))) - &here) / STEP;
        let by_slope = |k: usize| {
            let mut inclined = directions(at);
            inclined[0] = directions(&moved(k))[0];
            (of(at[FOCAL], inclined) - &here) / STEP
        };
        let all: Vec<DVector<f64>> = (0..at.len()).map(by).collect();
        (DMatrix::from_columns(&all), DMatrix::from_columns(&[by_slope(0), by_slope(1)]))
    }

    /// Finds the minimum near a start, with its covariance.
    fn minimum(&self, mut at: Parameters) -> Option<Minimum> {
        let (mut cost, mut damping) = (self.cost(&at), 1e-6);
        for _ in 0..25 {
            let (information, gradient, _) = self.normal_equations(&at);
            let diagonal = information.diagonal() * damping;
            let damped = information + DMatrix::from_diagonal(&diagonal.add_scalar(1e-9));
            let step = damped.cholesky().map(|factor| -factor.solve(&gradient));
            let trial = step.map(|step| (self.cost(&(&at + &step)), step));
            match trial.filter(|(of_trial, _)| *of_trial <= cost) {
                Some((of_trial, step)) => {
                    at += &step;
                    (cost, damping) = (of_trial, damping * 0.1);
                    if step.amax() < 1e-5 {
                        break;
                    }
                }
                None => damping *= 10.0,
            }
        }
        let (information, _, by_slope) = self.normal_equations(&at);
        let inverse = information.try_inverse()?;
        let of_slope = &inverse * by_slope * SLOPE_STD;
        let covariance = &inverse + &of_slope * of_slope.transpose();
        Some(Minimum { cost, at, covariance: covariance.fixed_view::<LEVEL, LEVEL>(0, 0).into_owned() })
    }

    /// Information, gradient, and derivative of the gradient by the slope of the ground.
    fn normal_equations(&self, at: &Parameters) -> (DMatrix<f64>, DVector<f64>, DMatrix<f64>) {
        let assigned = self.residuals(at);
        let (by, by_slope) = self.derivatives(at, &assigned);
        let weights = DVector::from_iterator(
            assigned.len(),
            assigned.iter().map(|(off, _)| self.weight * LOSS.evaluate(off * off)[1]),
        );
        let off = DVector::from_iterator(assigned.len(), assigned.iter().map(|(off, _)| *off));
        let mut weighted = by.clone();
        weighted.column_iter_mut().for_each(|mut column| column.component_mul_assign(&weights));
        let (mut information, mut gradient) = (weighted.tr_mul(&by), weighted.tr_mul(&off));
        let held = if self.focal_std > 0.0 { self.focal_std } else { 1e-6 };
        for (k, std) in [(1, ROLL_STD), (FOCAL, held)] {
            information[(k, k)] += std.powi(-2);
            gradient[k] += at[k] / std.powi(2);
        }
        let of_slope = weighted.tr_mul(&by_slope);
        (information, gradient, of_slope)
    }
}

/// Selects horizontal directions greedily, by what each explains beyond the vertical and those before.
///
/// Returns the remaining cost and the azimuths.
fn greedy_directions(planes: &[SegmentPlane], angles: Vector2<f64>) -> (f64, [f64; NUM_LEVEL]) {
    // Number of azimuths of the search over half a turn, in steps of 2°.
    const NUM_AZIMUTHS: usize = 90;
    let azimuth = |k: usize| std::f64::consts::PI * k as f64 / NUM_AZIMUTHS as f64;
    let costs = |direction: Vector3<f64>| -> Vec<f64> {
        // Halved: steps of the grid are wider than the standard deviations of long segments.
        planes.iter().map(|plane| (plane.residual(&direction) / 2.0).powi(2).ln_1p()).collect()
    };
    let mut least = costs(up_in_cam(angles));
    let of_azimuths: Vec<Vec<f64>> = (0..NUM_AZIMUTHS).map(|k| costs(level(angles, azimuth(k)))).collect();
    let mut chosen: Vec<f64> = Vec::new();
    let azimuths = std::array::from_fn(|_| {
        let is_free =
            |k: &usize| chosen.iter().all(|other| azimuth_difference(azimuth(*k), *other) > MIN_AZIMUTH_DIFFERENCE);
        let gain = |k: usize| least.iter().zip(&of_azimuths[k]).map(|(a, b)| (a - b).max(0.0)).sum::<f64>();
        let gains = (0..NUM_AZIMUTHS).filter(is_free).map(|k| (gain(k), k));
        let best = gains.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(0, |(_, k)| k);
        least.iter_mut().zip(&of_azimuths[best]).for_each(|(least, cost)| *least = least.min(*cost));
        chosen.push(azimuth(best));
        azimuth(best)
    });
    (least.iter().sum(), azimuths)
}

/// Vertical direction and horizontal directions.
fn directions(at: &Parameters) -> [Vector3<f64>; NUM_LEVEL + 1] {
    let angles = Vector2::new(at[0], at[1]);
    std::array::from_fn(|k| if k == 0 { up_in_cam(angles) } else { level(angles, at[LEVEL + k - 1]) })
}

/// Horizontal direction; the azimuth is from the right of the image.
fn level(angles: Vector2<f64>, azimuth: f64) -> Vector3<f64> {
    let up = up_in_cam(angles);
    let right = (Vector3::x() - up * up.x).normalize();
    right * azimuth.cos() + up.cross(&right) * azimuth.sin()
}

/// Angle between two undirected azimuths.
fn azimuth_difference(a: f64, b: f64) -> f64 {
    let off = (a - b).rem_euclid(std::f64::consts::PI);
    off.min(std::f64::consts::PI - off)
}

#[cfg(test)]
pub(crate) mod tests;
