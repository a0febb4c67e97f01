//! Tilt of the ground by the sizes of vehicles along their paths (eq. 1).

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Matrix2, Point2, Point3, UnitQuaternion, Vector2, Vector3};

use super::tilt::{TiltEstimate, TiltKind};
use crate::camera::{Camera, MAX_INCLINATION, ROLL_STD, up_in_cam};
use crate::math::{RobustLoss, median};
use crate::scene::{FrameId, Image, Reconstruction, Rect};

/// Standard deviation of the logarithm of an extent along one path, by errors of masks and changes of the view: 0.03 to
/// 0.1 on two rendered flights with nadir views.
const EXTENT_STD: f64 = 0.07;
/// Standard deviation of the logarithm of lengths among vehicles: cars, vans and a few trucks.
const SIZE_STD: f64 = 0.4;
/// Length of the projected box, as a share of the camera's height: small, so the whole box is at its center's distance.
const BOX_LENGTH: f64 = 0.01;
/// Number of images before and after one between which a vehicle's direction of motion is measured.
const REACH: usize = 3;
/// Minimum displacement between them, as a share of the vehicle's extent: the centers of masks are off by a tenth of
/// it. It must not depend on the normal: the sum of squares would be minimal where the fewest images have a direction.
const MIN_DISPLACEMENT: f64 = 0.5;
/// Minimum inclination of the search, radians: a horizon just outside the image.
const MIN_INCLINATION: f64 = 0.03;
/// Number of steps of the search over inclinations.
const NUM_PITCHES: usize = 120;
/// Step of the search over inclinations, radians.
const PITCH_STEP: f64 = (MAX_INCLINATION - MIN_INCLINATION) / NUM_PITCHES as f64;

/// Moving vehicles with their observations, in cameras with `zoom` times the focal length of the background.
pub(super) fn observed_vehicles(
    background: &Reconstruction,
    vehicles: &[BTreeMap<FrameId, Rect>],
    zoom: f64,
) -> Vec<Vehicle> {
    let by_frame: BTreeMap<FrameId, &Image> = background.images.iter().map(|(id, image)| (id.frame(), image)).collect();
    let images_of = |vehicle: &BTreeMap<FrameId, Rect>| {
        // More frames increase the run time only.
        let step = vehicle.len().div_ceil(20).max(1);
        let observed = |(frame, bounds): (&FrameId, &Rect)| {
            let image = by_frame.get(frame)?;
            let (camera, cam_from_world) = (background.camera_of(image).zoomed(zoom), image.cam_from_world.rotation);
            let ray = cam_from_world.inverse() * camera.ray_from_pixel(bounds.center().into());
            let extent_px = bounds.extent_px();
            (extent_px > 0.0).then_some((camera, cam_from_world, ray, extent_px))
        };
        let observed: Vec<_> = vehicle.iter().step_by(step).filter_map(observed).collect();
        let last = observed.len().saturating_sub(1);
        let image = |(k, &(camera, cam_from_world, ray, extent_px)): (usize, &(Camera, _, _, f64))| {
            let neighbors = [k.saturating_sub(REACH), (k + REACH).min(last)].map(|k| observed[k].2);
            let displacement_px = neighbors[0].angle(&neighbors[1]) * camera.mean_focal();
            let log_extent = extent_px.ln();
            (displacement_px >= MIN_DISPLACEMENT * extent_px).then_some(VehicleImage {
                camera,
                cam_from_world,
                ray,
                neighbors,
                log_extent,
            })
        };
        let images: Vec<VehicleImage> = observed.iter().enumerate().filter_map(image).collect();
        // Effective number of extents: mask errors persist, and masks grow along the whole path as they include
        // shadows.
        let extents = (vehicle.len() as f64 / 10.0).min(3.0);
        Vehicle { weight: extents / images.len().max(1) as f64, images }
    };
    // Fewer frames hardly show how the ground recedes.
    let long = vehicles.iter().filter(|images| images.len() >= 6);
    long.map(images_of).filter(|vehicle| !vehicle.images.is_empty()).collect()
}

/// Observation of a vehicle in one frame.
pub(super) struct VehicleImage {
    pub(super) camera: Camera,
    pub(super) cam_from_world: UnitQuaternion<f64>,
    /// Viewing ray through its center, a unit vector in the world.
    pub(super) ray: Vector3<f64>,
    /// Rays some images before and after.
    pub(super) neighbors: [Vector3<f64>; 2],
    pub(super) log_extent: f64,
}

/// Observations of one vehicle.
pub(super) struct Vehicle {
    images: Vec<VehicleImage>,
    /// Weight of an image: effective number of extents per image.
    weight: f64,
}

impl Vehicle {
    /// Logarithm of its length by each image, for a normal of the ground.
    fn log_lengths(&self, normal: &Vector3<f64>) -> Vec<Option<f64>> {
        self.images.iter().map(|image| image.log_length(normal)).collect()
    }
}

impl VehicleImage {
    /// Logarithm of the vehicle's length, for a normal of the ground.
    fn log_length(&self, normal: &Vector3<f64>) -> Option<f64> {
        // Rays above the horizon are assigned a large distance.
        let position = |ray: Vector3<f64>| ray / (-normal.dot(&ray)).max(1e-3);
        let displacement = position(self.neighbors[1]) - position(self.neighbors[0]);
        let forward = (displacement - normal * normal.dot(&displacement)).try_normalize(0.0)?;
        let log_length = self.log_extent - self.box_extent_px(&position(self.ray), &forward, normal)?.ln();
        log_length.is_finite().then_some(log_length)
    }

    /// Extent of a box of unit length on the ground, pixels; `None` behind the camera.
    pub(super) fn box_extent_px(
        &self,
        middle: &Vector3<f64>,
        forward: &Vector3<f64>,
        up: &Vector3<f64>,
    ) -> Option<f64> {
        let left = up.cross(forward);
        // Width and height of a car over its length.
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

/// Least-squares problem of the tilt and the lengths of vehicles.
pub(super) struct Problem {
    pub(super) vehicles: Vec<Vehicle>,
    /// Rotation of the first frame.
    pub(super) world_from_cam: UnitQuaternion<f64>,
    /// Factor on [`EXTENT_STD`] and [`SIZE_STD`].
    pub(super) noise: f64,
}

/// Inclination, tilt, common logarithm of lengths, and logarithm of the length of each vehicle.
type Parameters = DVector<f64>;

/// Cost and its normal equations at some parameters.
struct NormalEquations {
    cost: f64,
    gradient: DVector<f64>,
    information: DMatrix<f64>,
}

impl NormalEquations {
    fn zero(size: usize) -> Self {
        Self { cost: 0.0, gradient: DVector::zeros(size), information: DMatrix::zeros(size, size) }
    }

    /// Adds a residual in standard deviations, with its derivatives by parameters.
    fn add(&mut self, residual: f64, by: &[(usize, f64)], weight: f64, loss: RobustLoss) {
        let [rho, slope, _] = loss.evaluate(residual * residual);
        self.cost += 0.5 * weight * rho;
        for &(j, of_j) in by {
            self.gradient[j] += weight * slope * residual * of_j;
            by.iter().for_each(|&(k, of_k)| self.information[(j, k)] += weight * slope * of_j * of_k);
        }
    }
}

/// Searched inclination with the minimum cost, and a level horizon.
fn best_level_pitch(searched: &[(f64, f64)]) -> Option<Vector2<f64>> {
    let best = searched.iter().min_by(|a, b| a.1.total_cmp(&b.1));
    best.map(|(pitch, _)| Vector2::new(*pitch, 0.0))
}

/// Variance of the inclination by the likelihoods of the search.
///
/// Near nadir views, and with several minima, it is much larger than by the curvature of one minimum. Zero where it is
/// below the resolution of the search.
fn likelihood_variance(searched: &[(f64, f64)], pitch: f64) -> f64 {
    let min_cost = searched.iter().map(|(_, cost)| *cost).fold(f64::INFINITY, f64::min);
    let likelihood = |(_, cost): &(f64, f64)| (min_cost - cost).exp();
    let sum: f64 = searched.iter().map(likelihood).sum();
    let square = searched.iter().map(|at| likelihood(at) * (at.0 - pitch).powi(2)).sum::<f64>() / sum;
    if square > PITCH_STEP * PITCH_STEP { square } else { 0.0 }
}

/// Index of the common logarithm of lengths; those of the vehicles follow.
const LENGTH: usize = 2;

impl Problem {
    /// Angles of minimum cost, near given ones or by search, with their covariance.
    pub(super) fn minimum(
        &self,
        estimates: &[&TiltEstimate],
        near: Option<Vector2<f64>>,
    ) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let searched = if near.is_none() { self.search(estimates) } else { Vec::new() };
        let mut at = self.start(near.or_else(|| best_level_pitch(&searched))?);
        let (mut here, mut damping) = (self.normal_equations(&at, estimates), 1e-6);
        for _ in 0..40 {
            let diagonal = here.information.diagonal() * damping;
            let damped = &here.information + DMatrix::from_diagonal(&diagonal.add_scalar(f64::MIN_POSITIVE));
            let step = damped.cholesky().map(|factor| -factor.solve(&here.gradient));
            let trial = step.as_ref().map(|step| self.normal_equations(&(&at + step), estimates));
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
        covariance[(0, 0)] = covariance[(0, 0)].max(likelihood_variance(&searched, at[0]));
        let is_known = covariance.iter().all(|x| x.is_finite()) && covariance[(0, 0)] > 0.0 && covariance[(1, 1)] > 0.0;
        let is_possible = (0.0..=MAX_INCLINATION).contains(&at[0]);
        (is_known && is_possible).then(|| (Vector2::new(at[0], at[1]), covariance))
    }

    /// Half of χ² at inclinations from the horizon to the nadir.
    fn search(&self, estimates: &[&TiltEstimate]) -> Vec<(f64, f64)> {
        let cost = |k: usize| {
            let pitch = MIN_INCLINATION + PITCH_STEP * k as f64;
            (pitch, self.normal_equations(&self.start(Vector2::new(pitch, 0.0)), estimates).cost)
        };
        (0..=NUM_PITCHES).map(cost).collect()
    }

    /// Factor on the standard deviations of extents and sizes, at least 1.
    ///
    /// With this factor the mean loss is that of normal errors (P. J. Huber, *Robust Statistics*, 1981, proposal 2).
    /// Masks of vehicles of 12 pixels that include shadows and neighbors grow by half along a path.
    pub(super) fn noise_factor(&self) -> f64 {
        /// Mean loss of a normal error.
        const EXPECTED: f64 = 0.776;
        let extents: f64 = self.vehicles.iter().map(|vehicle| vehicle.weight * vehicle.images.len() as f64).sum();
        // Each length is a parameter with a residual from the common length; that and two angles remain.
        let expected = EXPECTED * (extents - 3.0).max(1.0);
        let Some(angles) = best_level_pitch(&self.search(&[])) else { return 1.0 };
        let at = self.start(angles);
        (0..20).fold(1.0, |noise, _| {
            let mut equations = NormalEquations::zero(at.len());
            self.add_vehicles(&mut equations, &at, noise);
            (noise * (2.0 * equations.cost / expected).sqrt()).max(1.0)
        })
    }

    pub(super) fn normal(&self, angles: Vector2<f64>) -> Vector3<f64> {
        self.world_from_cam * up_in_cam(angles)
    }

    /// Initial parameters at some angles; lengths are medians.
    fn start(&self, angles: Vector2<f64>) -> Parameters {
        let normal = self.normal(angles);
        let of =
            |vehicle: &Vehicle| median(vehicle.log_lengths(&normal).into_iter().flatten().collect()).unwrap_or(0.0);
        let lengths: Vec<f64> = self.vehicles.iter().map(of).collect();
        let common = median(lengths.clone()).unwrap_or(0.0);
        DVector::from_iterator(LENGTH + 1 + lengths.len(), [angles.x, angles.y, common].into_iter().chain(lengths))
    }

    /// Half of χ², with its derivatives.
    fn normal_equations(&self, at: &Parameters, estimates: &[&TiltEstimate]) -> NormalEquations {
        let mut equations = NormalEquations::zero(at.len());
        let angles = Vector2::new(at[0], at[1]);
        if !estimates.iter().any(|tilt| tilt.kind == TiltKind::Vertical) {
            equations.add(angles.y / ROLL_STD, &[(1, ROLL_STD.recip())], 1.0, RobustLoss::Squared);
        }
        for (k, difference, std) in estimates.iter().flat_map(|tilt| tilt.differences(angles)) {
            equations.add(difference / std, &[(k, std.recip())], 1.0, RobustLoss::Squared);
        }
        // Keeps the normal matrix regular without vehicles.
        equations.information[(LENGTH, LENGTH)] += f64::EPSILON;
        self.add_vehicles(&mut equations, at, self.noise);
        equations
    }

    fn add_vehicles(&self, equations: &mut NormalEquations, at: &Parameters, noise: f64) {
        // Step of the numerical derivatives, radians.
        const STEP: f64 = 1e-4;
        let loss = RobustLoss::Cauchy { scale: 2.0 };
        let (size_std, extent_std) = (SIZE_STD * noise, EXTENT_STD * noise);
        let angles = Vector2::new(at[0], at[1]);
        let normals = [[0.0, 0.0], [STEP, 0.0], [0.0, STEP]].map(|[a, b]| self.normal(angles + Vector2::new(a, b)));
        for (index, vehicle) in (LENGTH + 1..).zip(&self.vehicles) {
            let of_vehicle = [(index, size_std.recip()), (LENGTH, -size_std.recip())];
            equations.add((at[index] - at[LENGTH]) / size_std, &of_vehicle, 1.0, loss);
            let [here, pitched, tilted] = normals.map(|normal| vehicle.log_lengths(&normal));
            for ((here, pitched), tilted) in here.into_iter().zip(pitched).zip(tilted) {
                let (Some(here), Some(pitched), Some(tilted)) = (here, pitched, tilted) else { continue };
                let by = [(0, (pitched - here) / STEP), (1, (tilted - here) / STEP), (index, -1.0)];
                let by = by.map(|(k, by)| (k, by / extent_std));
                equations.add((here - at[index]) / extent_std, &by, vehicle.weight, loss);
            }
        }
    }
}
