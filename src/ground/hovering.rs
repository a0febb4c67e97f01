//! The ground below a camera that does not translate, from the vehicles on it.
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
//! height of the camera, is also about the same for all vehicles. With a horizon that is level to some degrees and a
//! pitch that may be given, the normal with the least sum of squares is taken; residuals count robustly. The unit of
//! such a background is the camera's height.

use std::collections::BTreeMap;

use nalgebra::{Matrix2, Point2, Point3, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::height::CameraHeight;
use super::local::{LocalPlanes, SkipReason, SkippedFrame, lowest_foot, object_pixels};
use crate::camera::Camera;
use crate::math::{RobustLoss, median};
use crate::scene::{FrameId, GroundPlane, Image, ObjectImage, PlaneBasis, Reconstruction};

/// The ground below a camera that does not translate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HoveringGround {
    /// Unit normal in the background's frame, towards the camera.
    pub normal_in_world: Vector3<f64>,
    /// Standard deviation of its tilt about any horizontal axis, radians.
    pub tilt_std: f64,
    /// Vehicles that show it.
    pub num_vehicles: usize,
}

/// A stated inclination of the camera's axis below the horizon in the first frame, with standard deviation, radians.
pub type StatedPitch = Option<[f64; 2]>;

/// Standard deviation of an extent's logarithm along one path, which masks and changes of the view leave.
const EXTENT_STD: f64 = 0.05;
/// Frames of a vehicle that count as one independent extent: masks err for a while.
const FRAMES_TOGETHER: f64 = 10.0;
/// Standard deviation of the logarithm of lengths among vehicles: cars, vans, and now and then a lorry.
const SIZE_STD: f64 = 0.4;
/// Width and height of a vehicle over its length: a car's.
const PROPORTIONS: [f64; 2] = [0.4, 0.33];
/// Length of the box that is projected, as a share of the camera's height: small, so that it is where its middle is.
const BOX_LENGTH: f64 = 0.01;
/// Frames of a vehicle that are looked at, evenly spread; more cost time only.
const MOST_SIGHTS: usize = 20;
/// Sights to both sides between which a vehicle's direction is taken.
const REACH: usize = 3;
/// Standard deviation of the horizon's roll, radians: gimbals keep it within one degree, poles within some.
const ROLL_STD: f64 = 0.035;
/// Inclinations that are tried, radians: from a horizon just outside the image to straight down.
const PITCHES: [f64; 2] = [0.03, 1.57];
const NUM_PITCHES: usize = 120;
/// Standard deviation of the tilt beyond which the ground is unknown, radians.
const MAX_TILT_STD: f64 = 0.15;
/// Fewest frames of a vehicle that counts.
const MIN_FRAMES: usize = 6;
/// Standard deviation of the ground's height below a vehicle as a share of the camera's: slopes and kerbs.
const UNEVENNESS: f64 = 0.01;

/// The ground that explains the sizes of vehicles; `None` where neither they nor a stated pitch determine it.
///
/// * `vehicles` – images of each vehicle, in images of `background`, all of whose cameras are at the origin.
pub fn hovering_ground(
    background: &Reconstruction,
    vehicles: &[BTreeMap<FrameId, ObjectImage>],
    pitch: StatedPitch,
) -> Option<HoveringGround> {
    let first = background.images.values().next()?;
    let by_frame: BTreeMap<FrameId, &Image> = background.images.iter().map(|(id, image)| (id.frame(), image)).collect();
    let sights_of = |vehicle: &BTreeMap<FrameId, ObjectImage>| {
        let step = vehicle.len().div_ceil(MOST_SIGHTS).max(1);
        let sight = |(frame, seen): (&FrameId, &ObjectImage)| {
            let image = by_frame.get(frame)?;
            let (camera, cam_from_world) = (background.camera_of(image), image.cam_from_world.rotation);
            let ray = cam_from_world.inverse() * camera.ray_from_pixel(seen.middle);
            let log_extent = seen.extent_px.ln();
            log_extent.is_finite().then_some(Sight { camera, cam_from_world, ray, log_extent })
        };
        let sights: Vec<Sight> = vehicle.iter().step_by(step).filter_map(sight).collect();
        Vehicle { weight: vehicle.len() as f64 / FRAMES_TOGETHER / sights.len().max(1) as f64, sights }
    };
    let vehicles: Vec<Vehicle> = vehicles.iter().filter(|images| images.len() >= MIN_FRAMES).map(sights_of).collect();
    let problem = Problem { vehicles: &vehicles, pitch };
    let world_from_cam = first.cam_from_world.rotation.inverse();
    let cost = |angles: Vector2<f64>| problem.cost(&(world_from_cam * up_in_cam(angles)), angles);
    let candidates = (0..=NUM_PITCHES).map(|k| {
        let pitch = PITCHES[0] + (PITCHES[1] - PITCHES[0]) * k as f64 / NUM_PITCHES as f64;
        Vector2::new(pitch, 0.0)
    });
    let start = candidates.min_by(|a, b| cost(*a).total_cmp(&cost(*b)))?;
    let (angles, covariance) = minimum(&cost, start)?;
    let tilt_std = covariance.trace().sqrt();
    (tilt_std <= MAX_TILT_STD).then(|| HoveringGround {
        normal_in_world: world_from_cam * up_in_cam(angles),
        tilt_std,
        num_vehicles: vehicles.len(),
    })
}

/// The vertical in the frame of a camera that looks down by a pitch, and is rolled about its axis.
fn up_in_cam(angles: Vector2<f64>) -> Vector3<f64> {
    let [pitch, roll] = [angles.x, angles.y];
    Vector3::new(roll.sin() * pitch.cos(), -roll.cos() * pitch.cos(), -pitch.sin())
}

/// Least cost near a start, by Newton's method on finite differences, and the covariance there.
fn minimum(cost: &dyn Fn(Vector2<f64>) -> f64, start: Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    const STEP: f64 = 2e-3;
    const ROUNDS: usize = 30;
    let axis = [Vector2::new(STEP, 0.0), Vector2::new(0.0, STEP)];
    let derivatives = |at: Vector2<f64>| {
        let here = cost(at);
        let gradient = Vector2::from_fn(|k, _| (cost(at + axis[k]) - cost(at - axis[k])) / (2.0 * STEP));
        let second = |k: usize| (cost(at + axis[k]) - 2.0 * here + cost(at - axis[k])) / (STEP * STEP);
        let [a, b] = axis;
        let mixed = (cost(at + a + b) - cost(at + a - b) - cost(at - a + b) + cost(at - a - b)) / (4.0 * STEP * STEP);
        (here, gradient, Matrix2::new(second(0), mixed, mixed, second(1)))
    };
    let mut at = start;
    let mut damping = 0.0;
    for _ in 0..ROUNDS {
        let (here, gradient, hessian) = derivatives(at);
        let damped = hessian + Matrix2::identity() * damping;
        let is_convex = damped.determinant() > 0.0 && damped.trace() > 0.0;
        let step = if is_convex { damped.try_inverse().map(|inverse| -(inverse * gradient)) } else { None };
        match step.filter(|step| cost(at + step) <= here) {
            Some(step) => {
                at += step;
                damping *= 0.1;
                if step.norm() < 1e-6 {
                    break;
                }
            }
            None => damping = (10.0 * damping).max(hessian.norm().max(1.0)),
        }
    }
    let (_, _, hessian) = derivatives(at);
    // The cost is half of χ².
    let covariance = hessian.try_inverse().filter(|_| hessian.determinant() > 0.0 && hessian.trace() > 0.0)?;
    Some((at, covariance))
}

/// A vehicle in one frame.
struct Sight<'a> {
    camera: &'a Camera,
    cam_from_world: UnitQuaternion<f64>,
    /// Unit vector in the world, through its middle.
    ray: Vector3<f64>,
    log_extent: f64,
}

struct Vehicle<'a> {
    sights: Vec<Sight<'a>>,
    /// Independent extents for which each of them counts.
    weight: f64,
}

impl Vehicle<'_> {
    /// Logarithms of its length by its sights, if the ground has this normal; it must move.
    fn log_lengths(&self, normal: &Vector3<f64>) -> Vec<f64> {
        // Above the horizon there is no ground: as far away as can be.
        let position = |sight: &Sight| sight.ray / (-normal.dot(&sight.ray)).max(1e-3);
        let path: Vec<Vector3<f64>> = self.sights.iter().map(position).collect();
        let last = path.len().saturating_sub(1);
        let length = |k: usize| {
            let way = path[(k + REACH).min(last)] - path[k.saturating_sub(REACH)];
            let forward = (way - normal * normal.dot(&way)).try_normalize(BOX_LENGTH)?;
            let log_length = self.sights[k].log_extent - self.sights[k].box_extent_px(&path[k], &forward, normal)?.ln();
            log_length.is_finite().then_some(log_length)
        };
        (0..path.len()).filter_map(length).collect()
    }
}

impl Sight<'_> {
    /// Extent of a box of unit length on the ground, pixels; `None` where it is behind the camera.
    fn box_extent_px(&self, middle: &Vector3<f64>, forward: &Vector3<f64>, up: &Vector3<f64>) -> Option<f64> {
        let left = up.cross(forward);
        let [width, height] = PROPORTIONS;
        let mut ends = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for corner in 0..8u8 {
            let side = |bit: u8| if corner & bit == 0 { -0.5 } else { 0.5 };
            let offset = forward * side(1) + left * (side(2) * width) + up * ((side(4) + 0.5) * height);
            let pixel =
                self.camera.pixel_from_cam(Point3::from(self.cam_from_world * (middle + offset * BOX_LENGTH)))?;
            for (end, at) in ends.iter_mut().zip([pixel.x, pixel.y]) {
                *end = [end[0].min(at), end[1].max(at)];
            }
        }
        Some(ends.iter().map(|[least, most]| most - least).fold(0.0, f64::max) / BOX_LENGTH)
    }
}

struct Problem<'a> {
    vehicles: &'a [Vehicle<'a>],
    pitch: StatedPitch,
}

impl Problem<'_> {
    /// Half of χ² of a normal.
    fn cost(&self, normal: &Vector3<f64>, angles: Vector2<f64>) -> f64 {
        let loss = RobustLoss::Cauchy { scale: 2.0 };
        let mut lengths = Vec::new();
        let mut cost = 0.5 * (angles.y / ROLL_STD).powi(2);
        if let Some([pitch, std]) = self.pitch {
            cost += 0.5 * ((angles.x - pitch) / std).powi(2);
        }
        for vehicle in self.vehicles {
            let all = vehicle.log_lengths(normal);
            let Some(middle) = median(all.clone()) else { continue };
            let rho: f64 = all.iter().map(|length| loss.evaluate(((length - middle) / EXTENT_STD).powi(2))[0]).sum();
            cost += 0.5 * vehicle.weight * rho;
            lengths.push(middle);
        }
        let middle = median(lengths.clone()).unwrap_or(0.0);
        cost + 0.5 * lengths.iter().map(|length| loss.evaluate(((length - middle) / SIZE_STD).powi(2))[0]).sum::<f64>()
    }
}

impl HoveringGround {
    /// The camera's height over it, which is the unit.
    pub fn camera_height(&self, background: &Reconstruction) -> CameraHeight {
        CameraHeight {
            mean: 1.0,
            std: UNEVENNESS,
            spread: 0.0,
            up_in_world: self.normal_in_world,
            tilt_spread: self.tilt_std,
            num_frames: background.images.len(),
            foot_in_world: Point3::from(-self.normal_in_world),
        }
    }

    /// The plane below an object in every frame that is registered in both models.
    pub(super) fn planes(&self, background: &Reconstruction, model: &Reconstruction) -> LocalPlanes {
        let mut found = LocalPlanes::default();
        for (frame, image, in_object) in background.paired_images(model) {
            match self.plane_below(background, image, &object_pixels(in_object)) {
                Some(plane) => drop(found.planes.insert(frame, plane)),
                None => found.skipped.push(SkippedFrame { frame, reason: SkipReason::NoObjectObservations }),
            }
        }
        found
    }

    fn plane_below(&self, background: &Reconstruction, image: &Image, pixels: &[Point2<f64>]) -> Option<GroundPlane> {
        let normal = self.normal_in_world;
        let center = image.cam_from_world.center();
        let foot = lowest_foot(background, image, pixels, (&normal, 1.0))?;
        let point = center - normal;
        let height_std = (self.tilt_std * (foot - point).norm()).hypot(UNEVENNESS);
        Some(GroundPlane {
            normal,
            point,
            num_points: 0,
            num_inliers: 0,
            rms: UNEVENNESS,
            basis: PlaneBasis::Vehicles,
            height_std,
            common_height_std: height_std,
            tilt_std: self.tilt_std,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Rigid3, seeded_rng};
    use crate::scene::{CameraId, ImageId};
    use rand::Rng as _;
    use rand_distr::StandardNormal;

    /// A camera at rest that looks down by `pitch`, rolled by `roll`; vehicles of 4.5 m drive on straight lines.
    fn scene(pitch: f64, roll: f64, seed: u64) -> (Reconstruction, Vec<BTreeMap<FrameId, ObjectImage>>, Vector3<f64>) {
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
                let sight =
                    Sight { camera: &camera, cam_from_world: UnitQuaternion::identity(), ray: up, log_extent: 0.0 };
                let box_px = sight.box_extent_px(&(point.coords / HEIGHT), &forward, &up).unwrap();
                let extent_px = noise * size / HEIGHT * box_px;
                images.insert(FrameId(frame), ObjectImage { middle: pixel, extent_px });
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
                let ground = hovering_ground(&background, &vehicles, None);
                found.extend(ground.map(|ground| (pitch, ground.normal_in_world.angle(&up), ground.tilt_std)));
                all += 1;
            }
        }
        // Seen from nearly straight above, few paths tell; then there is no answer.
        let within = found.iter().filter(|(_, off, std)| *off <= 2.0 * std).count();
        assert!(found.len() * 3 >= all * 2 && within * 10 >= found.len() * 9, "{} of {all}: {found:?}", found.len());
    }

    #[test]
    fn a_stated_pitch_is_enough_and_nothing_is_not() {
        let (background, vehicles, up) = scene(0.6, 0.0, 1);
        let stated = hovering_ground(&background, &[], Some([0.6, 0.01])).unwrap();
        assert!(stated.normal_in_world.angle(&up) < 1e-3 && stated.tilt_std < 0.04, "{stated:?}");
        assert_eq!(hovering_ground(&background, &[], None), None);
        let both = hovering_ground(&background, &vehicles, Some([0.6, 0.01])).unwrap();
        assert!(both.tilt_std <= stated.tilt_std && both.num_vehicles > 3);
        let planes = both.planes(&background, &background);
        assert!(planes.planes.is_empty() && planes.skipped.len() == 100);
    }
}
