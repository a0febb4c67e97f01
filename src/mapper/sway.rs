//! The ground and the focal length from the sway of a camera that hovers.
//!
//! A drone in wind moves by a few thousandths of its height. That gives single points no depth, but all points of the
//! ground together show one plane: with the directions d_j, the plane's normal n and the distance 1,
//!
//! ```text
//! X_j = d_j / (−nᵀ d_j),    m_ij = f π(R_i (X_j − c_i)) + error                                                  (1)
//! ```
//!
//! for the rotations R_i, the centres c_i and the focal length f. All of them are adjusted (Levenberg–Marquardt, points
//! eliminated), robustly: houses and trees are no ground. The covariance is the sandwich over parts of the image, whose
//! points err together.

use nalgebra::{DMatrix, DVector, Matrix2, Matrix2x3, Matrix3, Matrix3x2, SMatrix, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::rotating_camera::{RotatingCamera, rotating_camera};
use crate::camera::{Camera, LEAST_DIP, MAX_INCLINATION};
use crate::features::tracks::TrackTable;
use crate::math::{STD_PER_MAD, median};

/// The ground, as the sway shows it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SwayGround {
    /// Unit normal in the world of the rotations, towards the camera.
    pub normal: Vector3<f64>,
    /// Its covariance.
    pub covariance: Matrix3<f64>,
    /// Logarithm of the focal length over the initial one, with standard deviation.
    pub log_focal: [f64; 2],
    /// Root-mean-square distance of the camera from its first position, camera heights.
    pub sway: f64,
}

impl SwayGround {
    /// Standard deviation of the normal's direction, radians.
    pub fn tilt_std(&self) -> f64 {
        self.covariance.trace().sqrt()
    }
}

/// A camera that does not translate, but for its sway.
pub struct HoveringCamera {
    /// Its rotations.
    pub rotations: RotatingCamera,
    /// The camera, with the focal length by the sway.
    pub camera: Camera,
    /// Standard deviation of the focal length's logarithm.
    pub focal_std: f64,
    /// The plane below it; `None` where the sway shows none.
    pub sway: Option<SwayGround>,
}

/// Standard deviation of a normal beyond which the adjustment is not linear, and the sway shows none, radians. Of six
/// rendered flights (seeds 31 to 42) four had a smaller one, or none, and were within 0.6 σ; the others, of 0.17 and
/// 0.25, were 1.6 to 2.9 σ off, and one focal length 21 % at ±4 %.
const MAX_TILT_STD: f64 = 0.15;

/// The camera of views that rotations explain; `None` for others.
///
/// * `focal_std` – prior standard deviation of the focal length's logarithm; 0 holds it.
pub fn hovering_camera(table: &TrackTable, camera: &Camera, focal_std: f64) -> Option<HoveringCamera> {
    let rotations = rotating_camera(table, camera)?;
    let by_view: Vec<_> = rotations.poses.iter().map(|pose| pose.map(|pose| pose.rotation)).collect();
    let sway = sway_ground(table, camera, &by_view, focal_std).filter(|sway| sway.tilt_std() <= MAX_TILT_STD);
    let Some(SwayGround { log_focal: [log_focal, focal_std], .. }) = sway else {
        return Some(HoveringCamera { rotations, camera: *camera, focal_std, sway });
    };
    let camera = camera.zoomed(log_focal.exp());
    Some(HoveringCamera { rotations: rotating_camera(table, &camera)?, camera, focal_std, sway })
}

/// Views that take part, evenly spread: neighbours show nothing new, and time grows with their square.
const MOST_VIEWS: usize = 25;
/// Points that take part, and fewest.
const MOST_POINTS: usize = 240;
const MIN_POINTS: usize = 40;
/// Fewest views of a point.
const MIN_VIEWS: usize = 6;
/// Parts of the image over which points are spread and errors are common: across and down.
const PARTS: [usize; 2] = [4, 3];
/// Standard deviation of the camera's position, heights: a meter of wind at 30 m.
const CENTER_STD: f64 = 0.03;
/// Inclinations from which the adjustment starts, radians, of cameras that are upright: one plane has two normals that
/// explain a pair of views.
const STARTS: [f64; 5] = [0.25, 0.6, 0.95, 1.25, 1.55];
/// Scale of the robust loss, pixels: tracking noise. Points off the plane deviate by their height's share of the sway.
const LOSS_PX: f64 = 0.5;
const ROUNDS: usize = 25;
/// Factor of the standard deviations: houses and trees are off the plane, and common to neighboring parts. Pitch and
/// tilt of two rendered flights (46 and 50 m above a street) were off by 1.7 sandwiches, root mean square.
const OFF_PLANE: f64 = 1.7;
/// Standard deviation of a plane's normal that is common to all points, radians: a street's camber and its sidewalks.
const LEAST_TILT_STD: f64 = 0.005;
/// Standard deviation of the focal length at least, as a share: distortion is not adjusted.
const LEAST_FOCAL_STD: f64 = 0.01;
/// χ² by which another normal must be worse: three standard deviations.
const WORSE: f64 = 9.0;
/// Angle between normals that are another one, radians.
const ANOTHER: f64 = 0.1;

/// The plane below a camera that sways; `None` where its motion shows none, or one above which the image is upside
/// down: then it is noise.
///
/// * `rotations` – by view, camera from world; `None` if not registered.
/// * `focal_std` – prior standard deviation of the focal length's logarithm; 0 holds it.
pub fn sway_ground(
    table: &TrackTable,
    camera: &Camera,
    rotations: &[Option<UnitQuaternion<f64>>],
    focal_std: f64,
) -> Option<SwayGround> {
    let problem = Problem::new(table, camera, rotations, focal_std)?;
    let starts = STARTS.iter().map(|pitch| problem.start(Vector3::new(0.0, -pitch.cos(), -pitch.sin())));
    let mut found: Vec<(f64, State)> = starts.map(|start| problem.adjusted(start)).collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (best, state) = found.first()?;
    if (state.rotations[0] * state.normal).y > -MAX_INCLINATION.cos() {
        return None;
    }
    let noise = problem.noise_px(state);
    let rival = found.iter().find(|(_, other)| other.normal.angle(&state.normal) > ANOTHER);
    if rival.is_some_and(|(cost, _)| (cost - best) * 2.0 / noise.powi(2) < WORSE) {
        return None;
    }
    problem.result(state, noise)
}

/// An observation: point, view, and measured pixel from the principal point, undistorted.
struct Seen {
    view: usize,
    pixel: Vector2<f64>,
}

struct Problem {
    /// By point.
    points: Vec<Vec<Seen>>,
    /// Part of the image of each point.
    parts: Vec<usize>,
    directions: Vec<Vector3<f64>>,
    rotations: Vec<UnitQuaternion<f64>>,
    focal_px: f64,
    focal_std: f64,
}

#[derive(Clone)]
struct State {
    normal: Vector3<f64>,
    log_focal: f64,
    rotations: Vec<UnitQuaternion<f64>>,
    centers: Vec<Vector3<f64>>,
    directions: Vec<Vector3<f64>>,
}

/// Parameters that all views share: two of the normal, one of the focal length.
const COMMON: usize = 3;

/// Derivatives of an observation.
struct Linear {
    residual: Vector2<f64>,
    weight: f64,
    common: SMatrix<f64, 2, 3>,
    view: SMatrix<f64, 2, 6>,
    point: Matrix2<f64>,
}

/// Normal equations with the points eliminated.
struct Normal {
    matrix: DMatrix<f64>,
    gradient: DVector<f64>,
    /// By point: inverse of its block, and its gradient.
    points: Vec<(Matrix2<f64>, Vector2<f64>)>,
    /// Coupling of the others with the points, two columns each.
    coupling: DMatrix<f64>,
}

fn tangent(unit: &Vector3<f64>) -> Matrix3x2<f64> {
    let side = unit.cross(&Vector3::ith(unit.iamin(), 1.0)).normalize();
    Matrix3x2::from_columns(&[side, unit.cross(&side)])
}

impl Problem {
    fn new(
        table: &TrackTable,
        camera: &Camera,
        rotations: &[Option<UnitQuaternion<f64>>],
        focal_std: f64,
    ) -> Option<Self> {
        let registered: Vec<usize> = (0..rotations.len()).filter(|&view| rotations[view].is_some()).collect();
        let step = registered.len().div_ceil(MOST_VIEWS).max(1);
        let mut place = vec![None; rotations.len()];
        let mut chosen = Vec::new();
        for &view in registered.iter().step_by(step) {
            place[view] = Some(chosen.len());
            chosen.extend(rotations[view]);
        }
        let focal_px = camera.mean_focal();
        let mut in_parts: Vec<Vec<(Vec<Seen>, Vector3<f64>)>> = (0..PARTS[0] * PARTS[1]).map(|_| Vec::new()).collect();
        for features in &table.tracks {
            let mut seen = Vec::new();
            let (mut direction, mut middle) = (Vector3::zeros(), Vector2::zeros());
            for &feature in features {
                let Some(view) = place[feature.view as usize] else { continue };
                let pixel = table.pixel(feature);
                let ray = camera.ray_from_pixel(pixel);
                if ray.z > 0.0 {
                    seen.push(Seen { view, pixel: ray.xy() / ray.z * focal_px });
                    direction += chosen[view].inverse() * ray;
                    middle += pixel.coords;
                }
            }
            let Some(direction) = direction.try_normalize(f64::EPSILON).filter(|_| seen.len() >= MIN_VIEWS) else {
                continue;
            };
            let share = middle / seen.len() as f64;
            let share = [share.x / f64::from(camera.width), share.y / f64::from(camera.height)];
            let [column, row] = [0, 1].map(|k| ((share[k] * PARTS[k] as f64) as usize).min(PARTS[k] - 1));
            in_parts[row * PARTS[0] + column].push((seen, direction));
        }
        let (mut points, mut parts, mut directions) = (Vec::new(), Vec::new(), Vec::new());
        for (part, mut tracks) in in_parts.into_iter().enumerate() {
            tracks.sort_by_key(|(seen, _)| std::cmp::Reverse(seen.len()));
            for (seen, direction) in tracks.into_iter().take(MOST_POINTS / (PARTS[0] * PARTS[1])) {
                points.push(seen);
                parts.push(part);
                directions.push(direction);
            }
        }
        let is_enough = points.len() >= MIN_POINTS && chosen.len() >= MIN_VIEWS;
        is_enough.then_some(Self { points, parts, directions, rotations: chosen, focal_px, focal_std })
    }

    fn start(&self, normal: Vector3<f64>) -> State {
        State {
            normal: self.rotations[0].inverse() * normal,
            log_focal: 0.0,
            rotations: self.rotations.clone(),
            centers: vec![Vector3::zeros(); self.rotations.len()],
            directions: self.directions.clone(),
        }
    }

    /// Residual of an observation, pixels, with position of the point on the plane and in the camera; `None` where the
    /// plane is above the horizon.
    fn residual(&self, state: &State, point: usize, seen: &Seen) -> Option<(Vector2<f64>, Vector3<f64>, Vector3<f64>)> {
        let direction = state.directions[point];
        let dip = -state.normal.dot(&direction);
        let in_world = direction / dip;
        let in_cam = state.rotations[seen.view] * (in_world - state.centers[seen.view]);
        let is_ahead = dip > LEAST_DIP && in_cam.z > 0.0;
        let focal = self.focal_px * state.log_focal.exp();
        is_ahead.then(|| (in_cam.xy() / in_cam.z * focal - seen.pixel, in_world, in_cam))
    }

    /// Half of χ² in pixels, robust, with the priors.
    fn cost(&self, state: &State, noise: f64) -> f64 {
        // A point that leaves the plane costs as much as a far outlier.
        let lost = (1.0 + (20.0 / LOSS_PX).powi(2)).ln();
        let of = |point: usize, seen: &Seen| {
            let residual = self.residual(state, point, seen).map(|(residual, ..)| residual.norm_squared());
            0.5 * LOSS_PX.powi(2) * residual.map_or(lost, |square| (square / LOSS_PX.powi(2)).ln_1p())
        };
        let data: f64 = (0..self.points.len()).flat_map(|p| self.points[p].iter().map(move |seen| of(p, seen))).sum();
        let centers: f64 = state.centers.iter().map(|center| center.norm_squared()).sum::<f64>() / CENTER_STD.powi(2);
        let focal = if self.focal_std > 0.0 { (state.log_focal / self.focal_std).powi(2) } else { 0.0 };
        data + 0.5 * noise.powi(2) * (centers + focal)
    }

    fn linear(&self, state: &State, point: usize, seen: &Seen) -> Option<Linear> {
        let (residual, in_world, in_cam) = self.residual(state, point, seen)?;
        let focal = self.focal_px * state.log_focal.exp();
        let (x, y) = (in_cam.x / in_cam.z, in_cam.y / in_cam.z);
        let by_cam = Matrix2x3::new(1.0, 0.0, -x, 0.0, 1.0, -y) * (focal / in_cam.z);
        let by_world = by_cam * state.rotations[seen.view].to_rotation_matrix().matrix();
        let direction = state.directions[point];
        let dip = -state.normal.dot(&direction);
        let of_normal = by_world * in_world * (in_world.transpose() * tangent(&state.normal));
        let along = tangent(&direction);
        let of_point = by_world * (along + in_world * (state.normal.transpose() * along)) / dip;
        let mut common = SMatrix::<f64, 2, 3>::zeros();
        common.fixed_view_mut::<2, 2>(0, 0).copy_from(&of_normal);
        if self.focal_std > 0.0 {
            common.set_column(2, &(residual + seen.pixel));
        }
        let mut view = SMatrix::<f64, 2, 6>::zeros();
        view.fixed_view_mut::<2, 3>(0, 0).copy_from(&(-by_cam * in_cam.cross_matrix()));
        view.fixed_view_mut::<2, 3>(0, 3).copy_from(&-by_world);
        let weight = 1.0 / (1.0 + residual.norm_squared() / LOSS_PX.powi(2));
        Some(Linear { residual, weight, common, view, point: of_point })
    }

    /// Number of parameters without points; the first view is the frame.
    fn size(&self) -> usize {
        COMMON + 6 * (self.rotations.len() - 1)
    }

    /// Derivatives by each common or view parameter.
    fn rows(linear: &Linear, view: usize) -> impl Iterator<Item = (usize, Vector2<f64>)> + Clone {
        let Linear { common, view: of_view, .. } = *linear;
        let common = (0..COMMON).map(move |k| (k, common.column(k).into_owned()));
        let of_view = (0..6).map(move |k| (COMMON + 6 * view + k - 6, of_view.column(k).into_owned()));
        common.chain(of_view.take(if view == 0 { 0 } else { 6 }))
    }

    fn normal(&self, state: &State, noise: f64, damping: f64) -> Normal {
        let size = self.size();
        let (mut matrix, mut gradient) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let mut coupling = DMatrix::zeros(size, 2 * self.points.len());
        let mut weighted = coupling.clone();
        let mut points = Vec::new();
        for (point, observations) in self.points.iter().enumerate() {
            let (mut block, mut of_point) = (Matrix2::zeros(), Vector2::zeros());
            let mut with_others = coupling.columns_mut(2 * point, 2);
            for seen in observations {
                let Some(linear) = self.linear(state, point, seen) else { continue };
                block += linear.point.transpose() * linear.point * linear.weight;
                of_point += linear.point.transpose() * linear.residual * linear.weight;
                let rows = Self::rows(&linear, seen.view);
                for (row, by) in rows.clone() {
                    gradient[row] += linear.weight * by.dot(&linear.residual);
                    let with_point = by.transpose() * linear.point * linear.weight;
                    with_others[(row, 0)] += with_point[0];
                    with_others[(row, 1)] += with_point[1];
                    for (column, with) in rows.clone() {
                        matrix[(row, column)] += linear.weight * by.dot(&with);
                    }
                }
            }
            block += Matrix2::identity() * (damping * block.trace() + f64::MIN_POSITIVE);
            let inverse = block.try_inverse().unwrap_or_else(Matrix2::zeros);
            let of_weighted = &with_others * inverse;
            gradient -= &of_weighted * of_point;
            weighted.columns_mut(2 * point, 2).copy_from(&of_weighted);
            points.push((inverse, of_point));
        }
        matrix.gemm(-1.0, &weighted, &coupling.transpose(), 1.0);
        for (k, information) in self.priors(noise).into_iter().enumerate() {
            matrix[(k, k)] += information + damping * matrix[(k, k)];
            gradient[k] += information * self.off_prior(state, k);
        }
        Normal { matrix, gradient, points, coupling }
    }

    /// Information of the priors by parameter, in pixels.
    fn priors(&self, noise: f64) -> Vec<f64> {
        let of = |k: usize| match k {
            // One radian: before the centres move, nothing shows the normal.
            0 | 1 => noise.powi(2),
            // Held.
            2 if self.focal_std <= 0.0 => 1.0,
            2 => (noise / self.focal_std).powi(2),
            _ if (k - COMMON) % 6 < 3 => 0.0,
            _ => (noise / CENTER_STD).powi(2),
        };
        (0..self.size()).map(of).collect()
    }

    fn off_prior(&self, state: &State, k: usize) -> f64 {
        match k {
            0 | 1 => 0.0,
            2 => state.log_focal,
            _ if (k - COMMON) % 6 < 3 => 0.0,
            _ => state.centers[1 + (k - COMMON) / 6][(k - COMMON) % 6 - 3],
        }
    }

    fn moved(&self, state: &State, normal: &Normal, step: &DVector<f64>) -> State {
        let turned = |unit: &Vector3<f64>, by: Vector2<f64>| (unit + tangent(unit) * by).normalize();
        let mut moved = state.clone();
        moved.normal = turned(&state.normal, Vector2::new(step[0], step[1]));
        moved.log_focal += step[2];
        for view in 1..state.rotations.len() {
            let at = COMMON + 6 * (view - 1);
            let [turn, way] = [at, at + 3].map(|at| Vector3::new(step[at], step[at + 1], step[at + 2]));
            moved.rotations[view] = UnitQuaternion::from_scaled_axis(turn) * state.rotations[view];
            moved.centers[view] += way;
        }
        let of_others = normal.coupling.tr_mul(step);
        for (point, (direction, (inverse, gradient))) in moved.directions.iter_mut().zip(&normal.points).enumerate() {
            let by = -(inverse * (gradient + Vector2::new(of_others[2 * point], of_others[2 * point + 1])));
            *direction = turned(direction, by);
        }
        moved
    }

    /// The state of least cost near a start, and its cost.
    fn adjusted(&self, mut state: State) -> (f64, State) {
        /// Tracking noise before it is known, pixels.
        const NOISE_PX: f64 = 0.3;
        let mut cost = self.cost(&state, NOISE_PX);
        let mut damping = 1e-4;
        for _ in 0..ROUNDS {
            let normal = self.normal(&state, NOISE_PX, damping);
            let Some(solved) = normal.matrix.clone().cholesky().map(|factor| -factor.solve(&normal.gradient)) else {
                damping *= 10.0;
                continue;
            };
            let trial = self.moved(&state, &normal, &solved);
            let of_trial = self.cost(&trial, NOISE_PX);
            let gain = cost - of_trial;
            if gain >= 0.0 {
                (state, cost, damping) = (trial, of_trial, damping * 0.2);
                if gain < 1e-5 * cost {
                    break;
                }
            } else {
                damping *= 10.0;
            }
        }
        (cost, state)
    }

    fn noise_px(&self, state: &State) -> f64 {
        let all = self.points.iter().enumerate().flat_map(|(point, seen)| seen.iter().map(move |seen| (point, seen)));
        let residuals = all.filter_map(|(point, seen)| Some(self.residual(state, point, seen)?.0));
        median(residuals.flat_map(|r| [r.x.abs(), r.y.abs()]).collect()).map_or(LOSS_PX, |mad| STD_PER_MAD * mad)
    }

    fn result(&self, state: &State, noise: f64) -> Option<SwayGround> {
        let normal = self.normal(state, noise, 0.0);
        let inverse = normal.matrix.clone().try_inverse()?;
        let size = self.size();
        let num_parts = PARTS[0] * PARTS[1];
        let mut pulls = vec![DVector::<f64>::zeros(size); num_parts];
        for (point, observations) in self.points.iter().enumerate() {
            let pull = &mut pulls[self.parts[point]];
            for seen in observations {
                let Some(linear) = self.linear(state, point, seen) else { continue };
                for (row, by) in Self::rows(&linear, seen.view) {
                    pull[row] += linear.weight * by.dot(&linear.residual);
                }
            }
            let (inverse, gradient) = &normal.points[point];
            *pull -= normal.coupling.columns(2 * point, 2) * (inverse * gradient);
        }
        let mut meat = DMatrix::from_diagonal(&DVector::from_vec(self.priors(noise))) * noise.powi(2);
        // As many degrees of freedom of the parts are the common parameters'.
        let factor = OFF_PLANE.powi(2) * num_parts as f64 / (num_parts - COMMON) as f64;
        pulls.iter().for_each(|pull| meat += pull * pull.transpose() * factor);
        let sandwich = &inverse * meat * &inverse;
        let of_noise = &inverse * noise.powi(2);
        let wider = |j: usize, k: usize| {
            if of_noise[(0, 0)] + of_noise[(1, 1)] > sandwich[(0, 0)] + sandwich[(1, 1)] {
                of_noise[(j, k)]
            } else {
                sandwich[(j, k)]
            }
        };
        let axes = tangent(&state.normal);
        let covariance = axes * Matrix2::from_fn(wider) * axes.transpose();
        let focal_std = if self.focal_std > 0.0 { sandwich[(2, 2)].max(of_noise[(2, 2)]).sqrt() } else { 0.0 };
        let sway = state.centers.iter().map(Vector3::norm_squared).sum::<f64>() / state.centers.len() as f64;
        let covariance = covariance + Matrix3::from_diagonal_element(LEAST_TILT_STD.powi(2))
            - LEAST_TILT_STD.powi(2) * state.normal * state.normal.transpose();
        let focal_std = focal_std.max(LEAST_FOCAL_STD).min(self.focal_std);
        let is_finite = covariance.iter().all(|x| x.is_finite()) && focal_std.is_finite();
        is_finite.then(|| SwayGround {
            normal: state.normal,
            covariance,
            log_focal: [state.log_focal, focal_std],
            sway: sway.sqrt(),
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;

    use super::super::rotating_camera::{rotating_camera, tests::views};
    use super::*;

    #[test]
    fn sway_shows_the_ground_and_the_focal_length() {
        for (sway_m, focal) in [(0.4, 1.0), (0.4, 1.15), (0.2, 1.0)] {
            let (table, camera, truth) = views(sway_m);
            let guess = Camera::with_focal(camera.width, camera.height, camera.mean_focal() * focal);
            let rotations: Vec<_> = rotating_camera(&table, &guess)
                .unwrap()
                .poses
                .iter()
                .map(|pose| Some(pose.as_ref()?.rotation))
                .collect();
            let found = sway_ground(&table, &guess, &rotations, 0.2).unwrap();
            let normal = truth[0] * -Vector3::z();
            let (off, std) = (found.normal.angle(&normal), found.tilt_std());
            let [log_focal, focal_std] = found.log_focal;
            assert!(off < 3.0 * std && std < 0.05, "{off} {std}");
            assert!((log_focal + focal.ln()).abs() < 3.0 * focal_std && focal_std <= 0.011, "{found:?}");
        }
    }

    #[test]
    fn a_plane_above_an_upright_image_is_noise() {
        let (table, camera, _) = views(0.4);
        let rotations = |turn: UnitQuaternion<f64>| -> Vec<_> {
            let poses = rotating_camera(&table, &camera).unwrap().poses;
            poses.iter().map(|pose| Some(turn * pose.as_ref()?.rotation)).collect()
        };
        assert!(sway_ground(&table, &camera, &rotations(UnitQuaternion::identity()), 0.0).is_some());
        // The same tracks in an image that is turned by half a turn.
        let (mut turned, [width, height]) = (table.clone(), [camera.width, camera.height].map(f64::from));
        for pixel in turned.views.iter_mut().flat_map(|view| &mut view.pixels) {
            *pixel = Point2::new(width - pixel.x, height - pixel.y);
        }
        let half_a_turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
        assert!(sway_ground(&turned, &camera, &rotations(half_a_turn), 0.0).is_none());
    }

    #[test]
    fn a_camera_at_rest_shows_no_ground() {
        let (table, camera, _) = views(0.0);
        let rotations: Vec<_> =
            rotating_camera(&table, &camera).unwrap().poses.iter().map(|pose| Some(pose.as_ref()?.rotation)).collect();
        let found = sway_ground(&table, &camera, &rotations, 0.0);
        assert!(found.is_none_or(|found| found.tilt_std() > 0.1), "{found:?}");
    }
}
