//! The ground below a camera that does not translate, from the vehicles on it and other sources of its tilt.
//!
//! Without translation no point of the background has a depth. But a vehicle keeps its size and points where it goes:
//! on a plane with the unit normal n towards the camera, at the height 1 below it, the ray u meets the ground at the
//! distance 1 / s with s = −nᵀu. A box there of a car's proportions and unit length, along the path, has the extent
//! b_ki in the image, so that the vehicle's extent is
//!
//! ```text
//! ln e_ki = a_k + ln b_ki(n) + error                                                                               (1)
//! ```
//!
//! for frame i of vehicle k: along its own path each vehicle shows how the ground recedes. a_k, its length over the
//! height of the camera, is also about the same for all vehicles. How far both are from that shows how far they may be.
//! With a horizon that is level to some degrees and a
//! pitch that may be given, the normal with the least sum of squares is taken; residuals count robustly. The unit of
//! such a background is the camera's height.

use std::collections::BTreeMap;
use std::f64::consts::FRAC_1_SQRT_2;

use nalgebra::{DMatrix, DVector, Matrix2, Matrix3, Matrix3x2, Point2, Point3, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::height::CameraHeight;
use super::local::{LocalPlanes, SkipReason, lowest_foot, object_pixels};
use super::relief::Relief;
use crate::camera::{Camera, LEAST_DIP, MAX_INCLINATION, MAX_TILT_STD, ROLL_STD, up_in_cam};
use crate::math::{RobustLoss, median};
use crate::scene::{FrameId, GroundPlane, Image, PlaneBasis, Reconstruction, Rect};

/// The ground below a camera that does not translate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HoveringGround {
    /// Unit normal in the background's frame, towards the camera.
    pub normal_in_world: Vector3<f64>,
    /// A point of it: one unit below the camera that is at the origin.
    pub point_in_world: Point3<f64>,
    /// Standard deviation of its tilt about any horizontal axis, radians, without that of the focal length.
    pub tilt_std: f64,
    /// Vehicles that show it.
    pub num_vehicles: usize,
    /// Inclination of the camera's axis below the ground's horizon in the first frame, radians.
    pub pitch: f64,
    /// Other sources of the normal.
    pub sources: Vec<StatedTilt>,
    /// The tilt by the sizes of vehicles alone, where these determine it.
    pub by_vehicles: Option<StatedTilt>,
    /// Sources that contradict all others.
    pub contradictions: Vec<TiltContradiction>,
    /// Covariance of the normal, without that of the focal length.
    pub normal_covariance: Matrix3<f64>,
    /// Change of the normal by one standard deviation of the focal length.
    pub normal_by_focal: Vector3<f64>,
}

/// The ground's tilt against the camera of the first frame by another source than vehicles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StatedTilt {
    /// Its name, for people.
    pub source: String,
    /// Inclination of the camera's axis below the horizon, and of the horizon to the right, radians.
    pub angles: [f64; 2],
    /// Their standard deviations; `None` where nothing is stated.
    pub std: [Option<f64>; 2],
    /// Of what it is the tilt.
    pub kind: TiltKind,
}

/// Of what a source states the tilt.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum TiltKind {
    /// The ground.
    Ground,
    /// The vertical, by a sensor or by buildings: then a level horizon is no further evidence.
    Vertical,
    /// The plane of a map in whose frame positions are. It is the ground as it is: rays meet it where a homography to
    /// the map would put them, whatever its error, and would not meet a better plane there.
    Map {
        /// Points of the ground with heights, in the background's frame, which it follows; none for a plane.
        relief_in_world: Vec<Point3<f64>>,
    },
}

/// A source of the normal against all others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TiltContradiction {
    /// Name of the source.
    pub source: String,
    /// Angle between the normals, radians.
    pub angle: f64,
    /// The same in standard deviations of both.
    pub deviations: f64,
}

impl StatedTilt {
    /// Tilt of a vertical or normal in the camera's frame, with its covariance.
    pub fn of_up(source: &str, up_in_cam: &Vector3<f64>, covariance: &Matrix3<f64>) -> Self {
        let [x, y, z] = [up_in_cam.x.clamp(-1.0, 1.0), up_in_cam.y, up_in_cam.z];
        let across = (y * y + z * z).max(f64::MIN_POSITIVE);
        let by_up = [Vector3::new(0.0, z, -y) / across, Vector3::x() / across.sqrt()];
        let std = by_up.map(|by| Some(by.dot(&(covariance * by)).max(0.0).sqrt()));
        Self { source: source.to_owned(), angles: [(-z).atan2(-y), x.asin()], std, kind: TiltKind::Ground }
    }

    /// The angles and their covariance, if both are stated.
    fn known_angles(&self) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let variances = Vector2::new(self.std[0]?.powi(2), self.std[1]?.powi(2));
        Some((Vector2::from(self.angles), Matrix2::from_diagonal(&variances)))
    }

    /// Differences of angles from the stated ones with their standard deviations.
    fn differences(&self, angles: Vector2<f64>) -> impl Iterator<Item = (usize, f64, f64)> {
        (0..2).filter_map(move |k| Some((k, angles[k] - self.angles[k], self.std[k]?)))
    }
}

/// Standard deviation of an extent's logarithm along one path, which masks and changes of the view leave: 0.03 to 0.1
/// on two rendered flights looking straight down.
const EXTENT_STD: f64 = 0.07;
/// Standard deviation of the logarithm of lengths among vehicles: cars, vans, and now and then a lorry.
const SIZE_STD: f64 = 0.4;
/// Length of the box that is projected, as a share of the camera's height: small, so that it is where its middle is.
const BOX_LENGTH: f64 = 0.01;
/// Sights to both sides between which a vehicle's direction is taken.
const REACH: usize = 3;
/// Way between them at least, as a share of the vehicle's extent: the middles of masks err by a tenth of it. It must
/// not depend on the normal: the sum of squares would be least where fewest sights have a direction.
const MIN_WAY: f64 = 0.5;
/// Smallest inclination that is tried, radians: a horizon just outside the image.
const MIN_INCLINATION: f64 = 0.03;
const NUM_PITCHES: usize = 120;
const PITCH_STEP: f64 = (MAX_INCLINATION - MIN_INCLINATION) / NUM_PITCHES as f64;
/// Standard deviation of the ground's height below a vehicle as a share of the camera's: slopes and kerbs.
pub(super) const UNEVENNESS: f64 = 0.01;

/// The ground that explains the sizes of vehicles and other sources; `None` where they do not determine it.
///
/// * `vehicles` – images of each vehicle, in images of `background`, all of whose cameras are at the origin.
/// * `focal_std` – standard deviation of the focal length as a share of it.
pub fn hovering_ground(
    background: &Reconstruction,
    vehicles: &[BTreeMap<FrameId, Rect>],
    stated: Vec<StatedTilt>,
    focal_std: f64,
) -> Option<HoveringGround> {
    let solver = TiltSolver::new(background, vehicles, focal_std)?;
    let all: Vec<&StatedTilt> = stated.iter().collect();
    let differences = solver.differences(&all);
    let of_map = all.iter().find(|tilt| matches!(tilt.kind, TiltKind::Map { .. })).and_then(|map| map.known_angles());
    // A map is the ground as it is, whatever other sources say.
    let (disagreement, tilt) = match of_map {
        Some((angles, covariance)) => (1.0, Tilt { angles, covariance, by_focal: Vector2::zeros() }),
        None => (disagreement(&differences), solver.tilt(&all)?),
    };
    let tilt_std = tilt.covariance.trace().sqrt();
    let normal = |angles: Vector2<f64>| solver.problem.normal(angles);
    let normal_in_world = normal(tilt.angles);
    let by_angle = [Vector2::x(), Vector2::y()].map(|axis| {
        const STEP: f64 = 1e-4;
        (normal(tilt.angles + axis * STEP) - normal(tilt.angles - axis * STEP)) / (2.0 * STEP)
    });
    let by_angles = Matrix3x2::from_columns(&by_angle);
    let by_vehicles = solver.by_vehicles();
    (tilt_std <= MAX_TILT_STD).then(|| HoveringGround {
        normal_in_world,
        point_in_world: Point3::from(-normal_in_world),
        tilt_std: disagreement * tilt_std,
        num_vehicles: solver.problem.vehicles.len(),
        pitch: tilt.angles.x,
        by_vehicles,
        contradictions: differences.iter().filter_map(Difference::contradiction).collect(),
        normal_covariance: by_angles * tilt.covariance * by_angles.transpose() * disagreement.powi(2),
        normal_by_focal: 0.5 * (normal(tilt.angles + tilt.by_focal) - normal(tilt.angles - tilt.by_focal)),
        sources: stated,
    })
}

/// Inclination and tilt that explain vehicles and sources.
struct Tilt {
    angles: Vector2<f64>,
    covariance: Matrix2<f64>,
    /// Change by one standard deviation of the focal length.
    by_focal: Vector2<f64>,
}

impl Tilt {
    /// Standard deviations, with that of the focal length.
    fn std(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.covariance[(axis, axis)].sqrt().hypot(self.by_focal[axis]))
    }
}

/// A source against all others.
struct Difference {
    source: String,
    /// Of each stated angle: from the one by the others, and in standard deviations of both.
    angles: Vec<(f64, f64)>,
}

impl Difference {
    fn contradiction(&self) -> Option<TiltContradiction> {
        let deviations = self.angles.iter().map(|(_, deviations)| deviations.abs()).fold(0.0, f64::max);
        let angle = self.angles.iter().map(|(off, _)| *off).fold(0.0, f64::hypot);
        let source = self.source.clone();
        // As for sources of scale.
        (deviations > 3.0).then_some(TiltContradiction { source, angle, deviations })
    }
}

/// Factor by which sources that disagree know less than they state (Birge's ratio), at least 1.
fn disagreement(differences: &[Difference]) -> f64 {
    let squares: Vec<f64> = differences.iter().flat_map(|one| &one.angles).map(|(_, off)| off * off).collect();
    (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt().max(1.0)
}

/// Finds the tilt by any of the sources. The focal length is not adjusted: its share is what the angles would be with
/// another one.
struct TiltSolver {
    problem: Problem,
    /// With a focal length one standard deviation shorter and longer; `None` where it is known.
    zoomed: Option<[Problem; 2]>,
}

impl TiltSolver {
    fn new(background: &Reconstruction, vehicles: &[BTreeMap<FrameId, Rect>], focal_std: f64) -> Option<Self> {
        let world_from_cam = background.images.values().next()?.cam_from_world.rotation.inverse();
        let problem = |log_focal: f64, noise: f64| {
            let vehicles = sights(background, vehicles, log_focal.exp());
            Problem { vehicles, world_from_cam, noise }
        };
        let noise = problem(0.0, 1.0).actual_noise();
        let zoomed = (focal_std > 0.0).then(|| [-focal_std, focal_std].map(|by| problem(by, noise)));
        Some(Self { problem: problem(0.0, noise), zoomed })
    }

    /// `None` where vehicles and sources do not determine it.
    fn tilt(&self, stated: &[&StatedTilt]) -> Option<Tilt> {
        let (angles, covariance) = self.problem.minimum(stated, None)?;
        let angles_of = |problem: &Problem| Some(problem.minimum(stated, Some(angles))?.0);
        let by_focal = match &self.zoomed {
            Some([shorter, longer]) => 0.5 * (angles_of(longer)? - angles_of(shorter)?),
            None => Vector2::zeros(),
        };
        Some(Tilt { angles, covariance, by_focal })
    }

    /// The tilt by the sizes of vehicles alone.
    fn by_vehicles(&self) -> Option<StatedTilt> {
        let tilt = self.tilt(&[]).filter(|_| !self.problem.vehicles.is_empty())?;
        let ([inclination, to_side], source) = (tilt.std(), "sizes of vehicles".to_owned());
        let std = [Some(inclination), Some(to_side)];
        let stated = StatedTilt { source, angles: tilt.angles.into(), std, kind: TiltKind::Ground };
        (inclination.hypot(to_side) <= MAX_TILT_STD).then_some(stated)
    }

    /// Each source against all others, as far as these determine the tilt.
    fn differences(&self, all: &[&StatedTilt]) -> Vec<Difference> {
        let against_others = |k: usize| {
            let others: Vec<&StatedTilt> = all[..k].iter().chain(&all[k + 1..]).copied().collect();
            let tilt = self.tilt(&others)?;
            let others_std = tilt.std();
            let off = |(axis, off, std): (usize, f64, f64)| (off, off / std.hypot(others_std[axis]));
            let angles = all[k].differences(tilt.angles).map(off).collect();
            Some(Difference { source: all[k].source.clone(), angles })
        };
        (0..all.len()).filter_map(against_others).collect()
    }
}

/// Sights of the vehicles in the frames, by cameras whose focal length is `zoom` times the one of the background.
fn sights(background: &Reconstruction, vehicles: &[BTreeMap<FrameId, Rect>], zoom: f64) -> Vec<Vehicle> {
    let by_frame: BTreeMap<FrameId, &Image> = background.images.iter().map(|(id, image)| (id.frame(), image)).collect();
    let sights_of = |vehicle: &BTreeMap<FrameId, Rect>| {
        // More frames cost time only.
        let step = vehicle.len().div_ceil(20).max(1);
        let seen = |(frame, seen): (&FrameId, &Rect)| {
            let image = by_frame.get(frame)?;
            let (camera, cam_from_world) = (background.camera_of(image).zoomed(zoom), image.cam_from_world.rotation);
            let ray = cam_from_world.inverse() * camera.ray_from_pixel(seen.center().into());
            let extent_px = seen.extent_px();
            (extent_px > 0.0).then_some((camera, cam_from_world, ray, extent_px))
        };
        let seen: Vec<_> = vehicle.iter().step_by(step).filter_map(seen).collect();
        let last = seen.len().saturating_sub(1);
        let sight = |(k, &(camera, cam_from_world, ray, extent_px)): (usize, &(Camera, _, _, f64))| {
            let way = [k.saturating_sub(REACH), (k + REACH).min(last)].map(|k| seen[k].2);
            let way_px = way[0].angle(&way[1]) * camera.mean_focal();
            let log_extent = extent_px.ln();
            (way_px >= MIN_WAY * extent_px).then_some(Sight { camera, cam_from_world, ray, way, log_extent })
        };
        let sights: Vec<Sight> = seen.iter().enumerate().filter_map(sight).collect();
        // Independent ones: masks err for a while, and grow along the whole path, as shadows become part of them.
        let extents = (vehicle.len() as f64 / 10.0).min(3.0);
        Vehicle { weight: extents / sights.len().max(1) as f64, sights }
    };
    // In fewer frames a path hardly shows how the ground recedes.
    let long = vehicles.iter().filter(|images| images.len() >= 6);
    long.map(sights_of).filter(|vehicle| !vehicle.sights.is_empty()).collect()
}

/// A vehicle in one frame.
struct Sight {
    camera: Camera,
    cam_from_world: UnitQuaternion<f64>,
    /// Unit vector in the world, through its middle.
    ray: Vector3<f64>,
    /// The same some sights before and after.
    way: [Vector3<f64>; 2],
    log_extent: f64,
}

struct Vehicle {
    sights: Vec<Sight>,
    /// Independent extents for which each of them counts.
    weight: f64,
}

impl Vehicle {
    /// Logarithms of its length by its sights, if the ground has this normal; it must move.
    fn log_lengths(&self, normal: &Vector3<f64>) -> Vec<Option<f64>> {
        self.sights.iter().map(|sight| sight.log_length(normal)).collect()
    }
}

impl Sight {
    /// Logarithm of the vehicle's length, if the ground has this normal.
    fn log_length(&self, normal: &Vector3<f64>) -> Option<f64> {
        // Above the horizon there is no ground: as far away as can be.
        let position = |ray: Vector3<f64>| ray / (-normal.dot(&ray)).max(1e-3);
        let way = position(self.way[1]) - position(self.way[0]);
        let forward = (way - normal * normal.dot(&way)).try_normalize(0.0)?;
        let log_length = self.log_extent - self.box_extent_px(&position(self.ray), &forward, normal)?.ln();
        log_length.is_finite().then_some(log_length)
    }

    /// Extent of a box of unit length on the ground, pixels; `None` where it is behind the camera.
    fn box_extent_px(&self, middle: &Vector3<f64>, forward: &Vector3<f64>, up: &Vector3<f64>) -> Option<f64> {
        let left = up.cross(forward);
        // Of a car, over its length.
        let [width, height] = [0.4, 0.33];
        let corner = |corner: u8| {
            let side = |bit: u8| if corner & bit == 0 { -0.5 } else { 0.5 };
            let offset = forward * side(1) + left * (side(2) * width) + up * ((side(4) + 0.5) * height);
            self.camera.pixel_from_cam(Point3::from(self.cam_from_world * (middle + offset * BOX_LENGTH)))
        };
        let corners: Vec<Point2<f64>> = (0..8).map(corner).collect::<Option<_>>()?;
        Some(Rect::around(&corners)?.extent_px() / BOX_LENGTH)
    }
}

struct Problem {
    vehicles: Vec<Vehicle>,
    /// Of the first frame.
    world_from_cam: UnitQuaternion<f64>,
    /// Standard deviations of extents and sizes over [`EXTENT_STD`] and [`SIZE_STD`].
    noise: f64,
}

/// Inclination and tilt, the common logarithm of lengths, and that of each vehicle.
type Parameters = DVector<f64>;

/// Sum of squares near some parameters.
struct Local {
    cost: f64,
    gradient: DVector<f64>,
    information: DMatrix<f64>,
}

impl Local {
    fn zero(size: usize) -> Self {
        Self { cost: 0.0, gradient: DVector::zeros(size), information: DMatrix::zeros(size, size) }
    }

    /// Adds a residual in standard deviations that counts `weight` times.
    fn add(&mut self, residual: f64, by: &[(usize, f64)], weight: f64, loss: RobustLoss) {
        let [rho, slope, _] = loss.evaluate(residual * residual);
        self.cost += 0.5 * weight * rho;
        for &(j, of_j) in by {
            self.gradient[j] += weight * slope * residual * of_j;
            by.iter().for_each(|&(k, of_k)| self.information[(j, k)] += weight * slope * of_j * of_k);
        }
    }
}

/// The best of the inclinations that were searched, with a level horizon.
fn least(searched: &[(f64, f64)]) -> Option<Vector2<f64>> {
    let best = searched.iter().min_by(|a, b| a.1.total_cmp(&b.1));
    best.map(|(pitch, _)| Vector2::new(*pitch, 0.0))
}

/// Mean square of the distance of inclinations from one, by their likelihoods: near straight down, and where there are
/// several minima, much more than the curvature of one tells. Zero where the search is too coarse to show it.
fn mean_square_off(searched: &[(f64, f64)], pitch: f64) -> f64 {
    let lowest = searched.iter().map(|(_, cost)| *cost).fold(f64::INFINITY, f64::min);
    let likelihood = |(_, cost): &(f64, f64)| (lowest - cost).exp();
    let sum: f64 = searched.iter().map(likelihood).sum();
    let square = searched.iter().map(|at| likelihood(at) * (at.0 - pitch).powi(2)).sum::<f64>() / sum;
    if square > PITCH_STEP * PITCH_STEP { square } else { 0.0 }
}

/// Index of the common logarithm of lengths; those of the vehicles follow.
const LENGTH: usize = 2;

impl Problem {
    /// The angles that explain vehicles and sources best, near some angles or anywhere, with their covariance.
    fn minimum(&self, stated: &[&StatedTilt], near: Option<Vector2<f64>>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let searched = if near.is_none() { self.search(stated) } else { Vec::new() };
        let mut at = self.start(near.or_else(|| least(&searched))?);
        let (mut here, mut damping) = (self.local(&at, stated), 1e-6);
        for _ in 0..40 {
            let diagonal = here.information.diagonal() * damping;
            let damped = &here.information + DMatrix::from_diagonal(&diagonal.add_scalar(f64::MIN_POSITIVE));
            let step = damped.cholesky().map(|factor| -factor.solve(&here.gradient));
            let trial = step.as_ref().map(|step| self.local(&(&at + step), stated));
            match step.zip(trial).filter(|(_, trial)| trial.cost <= here.cost) {
                Some((step, trial)) => {
                    at += &step;
                    (here, damping) = (trial, damping * 0.1);
                    if step.rows(0, 2).norm() < 1e-6 {
                        break;
                    }
                }
                None => damping *= 10.0,
            }
        }
        let mut covariance = here.information.try_inverse()?.fixed_view::<2, 2>(0, 0).into_owned();
        covariance[(0, 0)] = covariance[(0, 0)].max(mean_square_off(&searched, at[0]));
        let is_known = covariance.iter().all(|x| x.is_finite()) && covariance[(0, 0)] > 0.0 && covariance[(1, 1)] > 0.0;
        let is_possible = (0.0..=MAX_INCLINATION).contains(&at[0]);
        (is_known && is_possible).then(|| (Vector2::new(at[0], at[1]), covariance))
    }

    /// Half of χ² at inclinations from the horizon to straight down.
    fn search(&self, stated: &[&StatedTilt]) -> Vec<(f64, f64)> {
        let cost = |k: usize| {
            let pitch = MIN_INCLINATION + PITCH_STEP * k as f64;
            (pitch, self.local(&self.start(Vector2::new(pitch, 0.0)), stated).cost)
        };
        (0..=NUM_PITCHES).map(cost).collect()
    }

    /// Actual over stated standard deviation of extents and sizes, at least 1: the factor with which their mean loss is
    /// that of normal errors (P. J. Huber, *Robust Statistics*, 1981, proposal 2). Masks of vehicles of 12 pixels that
    /// catch shadows and neighbors grow by half along a path.
    fn actual_noise(&self) -> f64 {
        /// Mean loss of a normal error.
        const EXPECTED: f64 = 0.776;
        let extents: f64 = self.vehicles.iter().map(|vehicle| vehicle.weight * vehicle.sights.len() as f64).sum();
        // A length of each vehicle is adjusted, and has a residual from the common one; that and the angles are left.
        let expected = EXPECTED * (extents - 3.0).max(1.0);
        let Some(angles) = least(&self.search(&[])) else { return 1.0 };
        let at = self.start(angles);
        (0..20).fold(1.0, |noise, _| {
            let mut local = Local::zero(at.len());
            self.add_vehicles(&mut local, &at, noise);
            (noise * (2.0 * local.cost / expected).sqrt()).max(1.0)
        })
    }

    fn normal(&self, angles: Vector2<f64>) -> Vector3<f64> {
        self.world_from_cam * up_in_cam(angles)
    }

    /// Parameters at some angles: lengths are medians.
    fn start(&self, angles: Vector2<f64>) -> Parameters {
        let normal = self.normal(angles);
        let of =
            |vehicle: &Vehicle| median(vehicle.log_lengths(&normal).into_iter().flatten().collect()).unwrap_or(0.0);
        let lengths: Vec<f64> = self.vehicles.iter().map(of).collect();
        let common = median(lengths.clone()).unwrap_or(0.0);
        DVector::from_iterator(LENGTH + 1 + lengths.len(), [angles.x, angles.y, common].into_iter().chain(lengths))
    }

    /// Half of χ² with its derivatives.
    fn local(&self, at: &Parameters, stated: &[&StatedTilt]) -> Local {
        let mut local = Local::zero(at.len());
        let angles = Vector2::new(at[0], at[1]);
        if !stated.iter().any(|tilt| tilt.kind == TiltKind::Vertical) {
            local.add(angles.y / ROLL_STD, &[(1, ROLL_STD.recip())], 1.0, RobustLoss::Squared);
        }
        for (k, off, std) in stated.iter().flat_map(|tilt| tilt.differences(angles)) {
            local.add(off / std, &[(k, std.recip())], 1.0, RobustLoss::Squared);
        }
        // What no vehicle shows stays where it is.
        local.information[(LENGTH, LENGTH)] += f64::EPSILON;
        self.add_vehicles(&mut local, at, self.noise);
        local
    }

    fn add_vehicles(&self, local: &mut Local, at: &Parameters, noise: f64) {
        const STEP: f64 = 1e-4;
        let loss = RobustLoss::Cauchy { scale: 2.0 };
        let (size_std, extent_std) = (SIZE_STD * noise, EXTENT_STD * noise);
        let angles = Vector2::new(at[0], at[1]);
        let normals = [[0.0, 0.0], [STEP, 0.0], [0.0, STEP]].map(|[a, b]| self.normal(angles + Vector2::new(a, b)));
        for (index, vehicle) in (LENGTH + 1..).zip(&self.vehicles) {
            let of_vehicle = [(index, size_std.recip()), (LENGTH, -size_std.recip())];
            local.add((at[index] - at[LENGTH]) / size_std, &of_vehicle, 1.0, loss);
            let [here, pitched, tilted] = normals.map(|normal| vehicle.log_lengths(&normal));
            for ((here, pitched), tilted) in here.into_iter().zip(pitched).zip(tilted) {
                let (Some(here), Some(pitched), Some(tilted)) = (here, pitched, tilted) else { continue };
                let by = [(0, (pitched - here) / STEP), (1, (tilted - here) / STEP), (index, -1.0)];
                let by = by.map(|(k, by)| (k, by / extent_std));
                local.add((here - at[index]) / extent_std, &by, vehicle.weight, loss);
            }
        }
    }
}

impl HoveringGround {
    /// Points with heights of the map whose plane it is; `None` where it is of no map.
    fn relief(&self) -> Option<&[Point3<f64>]> {
        self.sources.iter().find_map(|source| match &source.kind {
            TiltKind::Map { relief_in_world } => Some(relief_in_world.as_slice()),
            TiltKind::Ground | TiltKind::Vertical => None,
        })
    }

    /// Returns true if it is the plane of a map: then its tilt, the height of the camera and the focal length move
    /// nothing on it, and what they leave of positions is in the alignment with the map.
    pub fn is_mapped(&self) -> bool {
        self.relief().is_some()
    }

    /// Standard deviation of its tilt, radians, with that of the focal length.
    pub fn total_tilt_std(&self) -> f64 {
        self.tilt_std.hypot(self.normal_by_focal.norm())
    }

    fn height_of(&self, point: Point3<f64>) -> f64 {
        self.normal_in_world.dot(&(point - self.point_in_world))
    }

    /// The camera's height over it, which varies with its sway.
    pub fn camera_height(&self, background: &Reconstruction) -> CameraHeight {
        let num_frames = background.images.len();
        let sum: f64 = background.images.values().map(|image| self.height_of(image.cam_from_world.center())).sum();
        let mean = if num_frames > 0 { sum / num_frames as f64 } else { 1.0 };
        CameraHeight {
            mean,
            std: UNEVENNESS * mean,
            spread: 0.0,
            up_in_world: self.normal_in_world,
            // Half of a spread counts as the standard deviation of the vertical.
            tilt_spread: 2.0 * self.total_tilt_std(),
            num_frames,
            foot_in_world: self.point_in_world,
        }
    }

    /// Where a ray meets it; `None` where it passes too close to the horizon.
    pub fn meets(&self, from: Point3<f64>, direction: &Vector3<f64>) -> Option<Point3<f64>> {
        let dip = -self.normal_in_world.dot(direction) / direction.norm();
        (dip >= LEAST_DIP).then(|| from + direction.normalize() * (self.height_of(from) / dip))
    }

    /// The plane below an object in every frame that is registered in both models.
    pub(super) fn planes(&self, background: &Reconstruction, model: &Reconstruction) -> LocalPlanes {
        let relief = self.relief().and_then(|points| Relief::new(points, self.normal_in_world));
        let below = |(frame, image, in_object): (FrameId, &Image, &Image)| {
            let plane = self.plane_below(background, image, &object_pixels(in_object), relief.as_ref());
            (frame, plane.ok_or(SkipReason::NoObjectObservations))
        };
        background.paired_images(model).into_iter().map(below).collect()
    }

    fn plane_below(
        &self,
        background: &Reconstruction,
        image: &Image,
        pixels: &[Point2<f64>],
        relief: Option<&Relief>,
    ) -> Option<GroundPlane> {
        let center = image.cam_from_world.center();
        let foot_on = |normal: &Vector3<f64>, height: f64| lowest_foot(background, image, pixels, (normal, height));
        let mut normal = self.normal_in_world;
        let mut height = self.height_of(center);
        let mut foot = foot_on(&normal, height)?;
        // Each round leaves the ratio of the ground's slope to that of the sight.
        for _ in 0..5 {
            let Some((next, place)) = relief.and_then(|relief| relief.plane_near(foot)) else { break };
            (normal, height) = (next, next.dot(&(center - place)));
            foot = foot_on(&normal, height)?;
        }
        let point = center - normal * height;
        let off = foot - point;
        let of_tilt = if self.is_mapped() { 0.0 } else { off.dot(&(self.normal_covariance * off)).max(0.0).sqrt() };
        let of_relief = relief.map_or(0.0, |relief| relief.height_std);
        let height_std = of_tilt.hypot(UNEVENNESS * height).hypot(of_relief);
        Some(GroundPlane {
            normal,
            point,
            num_points: 0,
            num_inliers: 0,
            rms: UNEVENNESS * height,
            basis: PlaneBasis::Vehicles,
            height_std,
            common_height_std: height_std,
            // About either horizontal axis.
            tilt_std: self.tilt_std * FRAC_1_SQRT_2,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    use crate::math::{Rigid3, seeded_rng};
    use crate::scene::{CameraId, ImageId, Observation, Point3dId};
    use rand::Rng as _;
    use rand_distr::StandardNormal;

    /// A camera at rest that looks down by `pitch`, rolled by `roll`; vehicles of 4.5 m drive on straight lines.
    fn scene(pitch: f64, roll: f64, seed: u64) -> (Reconstruction, Vec<BTreeMap<FrameId, Rect>>, Vector3<f64>) {
        const HEIGHT: f64 = 60.0;
        let camera = Camera::with_focal(1280, 720, 1000.0);
        let mut background = Reconstruction::default();
        background.cameras.insert(CameraId(1), camera);
        for frame in 0..100 {
            let (name, cam_from_world) = (format!("{frame}"), Rigid3::identity());
            let image = Image { name, camera: CameraId(1), cam_from_world, observations: Vec::new() };
            background.images.insert(ImageId::from(FrameId(frame)), image);
        }
        let up = up_in_cam(Vector2::new(pitch, roll));
        let right = Vector3::x() - up * up.x;
        let (right, ahead) = (right.normalize(), up.cross(&right).normalize());
        let mut rng = seeded_rng(seed, 0);
        let mut vehicle = || {
            let middle = HEIGHT / pitch.tan();
            let start = [rng.random_range(-40.0..40.0), middle + rng.random_range(-20.0..30.0)];
            let heading: f64 = rng.random_range(0.0..std::f64::consts::TAU);
            let size = 4.5 * (0.1 * rng.sample::<f64, _>(StandardNormal)).exp();
            let mut images = BTreeMap::new();
            for frame in 0..100u32 {
                let way = 0.5 * f64::from(frame);
                let (x, y) = (start[0] + way * heading.cos(), start[1] + way * heading.sin());
                let point = Point3::from(right * x + ahead * y - up * HEIGHT);
                let Some(pixel) = camera.pixel_from_cam(point).filter(|pixel| camera.contains(*pixel)) else {
                    continue;
                };
                let noise = (0.02 * rng.sample::<f64, _>(StandardNormal)).exp();
                let forward = right * heading.cos() + ahead * heading.sin();
                let sight = Sight {
                    camera,
                    cam_from_world: UnitQuaternion::identity(),
                    ray: up,
                    way: [up; 2],
                    log_extent: 0.0,
                };
                let box_px = sight.box_extent_px(&(point.coords / HEIGHT), &forward, &up).unwrap();
                let extent_px = noise * size / HEIGHT * box_px;
                let half = Vector2::repeat(0.5 * extent_px);
                images.extend(Rect::around(&[pixel - half, pixel + half]).map(|bounds| (FrameId(frame), bounds)));
            }
            images
        };
        (background, (0..6).map(|_| vehicle()).collect(), up)
    }

    #[test]
    fn sizes_of_vehicles_show_the_ground() {
        let mut found = Vec::new();
        let mut all = 0;
        for seed in 0..12 {
            for (pitch, roll) in [(0.4, 0.0), (0.8, 0.02), (1.3, -0.02)] {
                let (background, vehicles, up) = scene(pitch, roll, seed);
                let ground = hovering_ground(&background, &vehicles, Vec::new(), 0.0);
                found.extend(ground.map(|ground| (pitch, ground.normal_in_world.angle(&up), ground.tilt_std)));
                all += 1;
            }
        }
        // Seen from nearly straight above, few paths tell; then there is no answer.
        let within = found.iter().filter(|(_, off, std)| *off <= 2.0 * std).count();
        assert!(found.len() * 3 >= all * 2 && within * 10 >= found.len() * 9, "{} of {all}: {found:?}", found.len());
    }

    #[test]
    fn sizes_that_vary_know_less() {
        // From straight above, extents that grow along each path would show an inclined ground.
        let mut off = Vec::new();
        for seed in 0..12 {
            let (background, mut vehicles, up) = scene(FRAC_PI_2, 0.0, seed);
            for (k, images) in vehicles.iter_mut().enumerate() {
                let growth = [0.9, -0.3, 0.4, 0.1, -0.1, 0.5][(k + seed as usize) % 6] / images.len().max(1) as f64;
                for (frame, bounds) in (0..).zip(images.values_mut()) {
                    let half = Vector2::repeat(0.5 * bounds.extent_px() * (growth * f64::from(frame)).exp());
                    let middle: Point2<f64> = bounds.center().into();
                    *bounds = Rect::around(&[middle - half, middle + half]).unwrap();
                }
            }
            let solver = TiltSolver::new(&background, &vehicles, 0.0).unwrap();
            off.extend(solver.tilt(&[]).map(|tilt| {
                (solver.problem.normal(tilt.angles).angle(&up), tilt.covariance.trace().sqrt(), solver.problem.noise)
            }));
        }
        let within = off.iter().filter(|(off, std, _)| off <= std).count();
        assert!(off.len() > 6 && within * 3 >= off.len() * 2, "{off:?}");
        assert!(off.iter().all(|(off, std, _)| *off < 3.0 * std), "{off:?}");
        assert!(median(off.iter().map(|(.., noise)| *noise).collect()).unwrap() > 1.5, "{off:?}");
    }

    #[test]
    fn a_stated_vertical_holds_straight_down_too() {
        for (pitch, tilt) in [(0.6, 0.02), (FRAC_PI_2, 0.03), (1.6, -0.01)] {
            let (background, ..) = scene(1.0, 0.0, 1);
            let up = up_in_cam(Vector2::new(pitch, tilt));
            let found = hovering_ground(
                &background,
                &[],
                vec![StatedTilt {
                    kind: TiltKind::Vertical,
                    ..StatedTilt::of_up("telemetry", &up, &(Matrix3::identity() * 4e-4))
                }],
                0.0,
            )
            .unwrap();
            assert!(found.normal_in_world.angle(&up) < 1e-4 && (found.tilt_std - 0.0283).abs() < 1e-3, "{found:?}");
        }
    }

    #[test]
    fn the_plane_of_a_map_is_taken_as_it_is() {
        let (background, vehicles, up) = scene(0.6, 0.0, 1);
        let of_map = up_in_cam(Vector2::new(0.63, 0.01));
        let tilt = |kind| StatedTilt { kind, ..StatedTilt::of_up("map", &of_map, &(Matrix3::identity() * 4e-4)) };
        let found = |kind| hovering_ground(&background, &vehicles, vec![tilt(kind)], 0.0).unwrap();
        let plane = TiltKind::Map { relief_in_world: Vec::new() };
        let (map, ground) = (found(plane), found(TiltKind::Ground));
        assert!(map.normal_in_world.angle(&of_map) < 1e-9 && map.normal_in_world.angle(&up) > 0.02);
        assert!(ground.normal_in_world.angle(&of_map) > 1e-3, "fused with vehicles");
        assert!(map.tilt_std > ground.tilt_std && map.num_vehicles == ground.num_vehicles);
    }

    #[test]
    fn planes_follow_points_with_heights() {
        let (mut background, vehicles, up) = scene(0.6, 0.0, 1);
        // The ground rises by a tenth of the camera's height beyond its foot, seen at the middle of the frame.
        let axis = Vector3::z();
        let foot = Point3::from(axis / -up.dot(&axis));
        let relief: Vec<Point3<f64>> = (0..9)
            .map(|k| [f64::from(k % 3) - 1.0, f64::from(k / 3) - 1.0].map(|x| 0.2 * x))
            .map(|[x, y]| foot + Vector3::x() * x + up.cross(&Vector3::x()) * y + up * 0.1)
            .collect();
        let image = background.images.values_mut().next().unwrap();
        image.observations = vec![Observation { pixel: Point2::new(640.0, 360.0), point: Some(Point3dId(0)) }];
        let height = |relief_in_world: Vec<Point3<f64>>| {
            let kind = TiltKind::Map { relief_in_world };
            let tilt = StatedTilt { kind, ..StatedTilt::of_up("map", &up, &(Matrix3::identity() * 4e-4)) };
            let ground = hovering_ground(&background, &vehicles, vec![tilt], 0.0).unwrap();
            let planes = ground.planes(&background, &background).planes;
            let plane = planes.values().next().unwrap();
            (plane.signed_distance(Point3::origin()), plane.normal.angle(&up))
        };
        let (level, lifted) = (height(Vec::new()), height(relief));
        assert!(
            (level.0 - 1.0).abs() < 1e-6 && (lifted.0 - 0.9).abs() < 2e-3 && lifted.1 < 0.01,
            "{level:?} {lifted:?}"
        );
    }

    #[test]
    fn another_focal_length_turns_the_ground_as_stated() {
        let (mut background, vehicles, _) = scene(0.8, 0.0, 3);
        let focal_std = 0.1;
        let found =
            |background: &Reconstruction| hovering_ground(background, &vehicles, Vec::new(), focal_std).unwrap();
        let as_it_is = found(&background);
        let camera = background.cameras[&CameraId(1)];
        background.cameras.insert(CameraId(1), camera.zoomed(focal_std.exp()));
        let turned = found(&background).normal_in_world - as_it_is.normal_in_world;
        assert!(turned.norm() > 0.01, "{turned}");
        assert!((turned - as_it_is.normal_by_focal).norm() < 0.3 * turned.norm(), "{turned} {as_it_is:?}");
        assert!(as_it_is.total_tilt_std() > as_it_is.tilt_std);
    }

    #[test]
    fn sources_that_disagree_know_less() {
        let (background, ..) = scene(0.6, 0.0, 1);
        let tilt = |pitch: f64| StatedTilt {
            source: "pitch".to_owned(),
            angles: [pitch, 0.0],
            std: [Some(0.02), Some(0.02)],
            kind: TiltKind::Vertical,
        };
        let found = |other: f64| hovering_ground(&background, &[], vec![tilt(0.6), tilt(other)], 0.0).unwrap();
        let (agreed, apart) = (found(0.61), found(0.72));
        assert!((agreed.tilt_std - 0.02).abs() < 1e-3, "{agreed:?}");
        assert!((apart.pitch - 0.66).abs() < 1e-3 && apart.tilt_std > 0.05, "{apart:?}");
        assert_eq!(apart.contradictions.len(), 2);
    }

    #[test]
    fn a_stated_pitch_is_enough_and_nothing_is_not() {
        let (background, vehicles, up) = scene(0.6, 0.0, 1);
        let pitch = |pitch: f64| {
            vec![StatedTilt {
                source: "pitch".to_owned(),
                angles: [pitch, 0.0],
                std: [Some(0.01), None],
                kind: TiltKind::Ground,
            }]
        };
        let stated = hovering_ground(&background, &[], pitch(0.6), 0.0).unwrap();
        assert!(stated.normal_in_world.angle(&up) < 1e-3 && stated.tilt_std < 0.04, "{stated:?}");
        assert_eq!(hovering_ground(&background, &[], Vec::new(), 0.0), None);
        assert_eq!(stated.by_vehicles, None);
        let both = hovering_ground(&background, &vehicles, pitch(0.6), 0.0).unwrap();
        let alone = hovering_ground(&background, &vehicles, Vec::new(), 0.0).unwrap();
        assert_eq!(both.by_vehicles.as_ref().map(|tilt| tilt.angles[0]), Some(alone.pitch));
        assert!(both.tilt_std <= stated.tilt_std && both.num_vehicles > 3 && both.contradictions.is_empty());
        let wrong = hovering_ground(&background, &vehicles, pitch(1.2), 0.0).unwrap();
        assert!(wrong.contradictions[0].deviations > 3.0 && wrong.contradictions[0].angle > 0.3, "{wrong:?}");
        let planes = both.planes(&background, &background);
        assert!(planes.planes.is_empty() && planes.skipped.len() == 100);
    }
}
