//! A vehicle that drives over a piece of ground, past a moving camera, with everything known.
//!
//! The world is metric, z up. What a reconstruction would give lives in other frames and units, as it does in reality:
//! the background in a turned frame of unit [`Options::background_unit_m`], the object in its own of unit
//! [`Options::object_unit_m`]. The true scale ratio is the quotient of the two, and never one by chance.
//!
//! Without noise everything is exact: object points keep their distance to the local plane of every frame, whatever the
//! terrain, since the vehicle stands on its tangent plane.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point2, Point3, Rotation3, Unit, UnitQuaternion, Vector3};
use rand::Rng as _;
use rand_distr::StandardNormal;

use super::noisy;
use super::vehicle::{SurfacePoint, surface_points};
use crate::camera::Camera;
use crate::math::{Rigid3, Rng, Sim3, seeded_rng};
use crate::scene::{
    CameraId, Frame, FrameId, GroundPlane, Image, ImageId, Observation, PlaneBasis, Point3d, Point3dId, Reconstruction,
    TrackElement,
};

/// The shape of the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Terrain {
    /// z = 0.
    Flat,
    /// z = gradient · (x, y).
    Slope {
        /// Rise per metre along x and y.
        gradient: [f64; 2],
    },
    /// z = amplitude · sin(2πx / wavelength) · cos(2πy / wavelength).
    Hills {
        /// Half the height between valley and top, metres.
        amplitude_m: f64,
        /// Distance between tops, metres.
        wavelength_m: f64,
    },
}

/// The vehicle's way over the ground, seen from above.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Route {
    /// Along x.
    Straight,
    /// A circle to the left.
    Curve {
        /// Radius of the circle, metres.
        radius_m: f64,
    },
}

/// Disturbances of the exact world.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Noise {
    /// Standard deviation of observations, pixels; points and cameras of both reconstructions move accordingly.
    pub pixel_px: f64,
    /// Standard deviation of a plane's height below the vehicle, metres.
    pub plane_height_m: f64,
    /// Standard deviation of a plane's tilt, about a random horizontal axis, degrees.
    pub plane_tilt_deg: f64,
    /// Fraction of frames whose plane is wrong: tilted by 5 to 20 degrees and off by half a metre or so.
    pub bad_planes: f64,
}

/// Which world to make.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Frames of the video.
    pub num_frames: u32,
    /// The ground.
    pub terrain: Terrain,
    /// The vehicle's way.
    pub route: Route,
    /// The vehicle's speed, metres per second.
    pub speed_m_s: f64,
    /// Height of the camera over the ground at the start, metres.
    pub camera_height_m: f64,
    /// Climb until the end (ΔH), meters. Over [`Terrain::Flat`] and [`Terrain::Slope`] no climb means that the camera
    /// moves exactly parallel to the ground: the degenerate case.
    pub camera_climb_m: f64,
    /// Distance from camera to vehicle, first and last, metres.
    pub distance_m: [f64; 2],
    /// True if the points of the wheels are reconstructed; without them the lowest point is 0.37 m over the ground.
    pub has_wheels: bool,
    /// Points on the vehicle's body.
    pub num_object_points: usize,
    /// Points on the ground.
    pub num_ground_points: usize,
    /// Points on façades and poles.
    pub num_other_points: usize,
    /// One unit of the object's reconstruction, metres.
    pub object_unit_m: f64,
    /// One unit of the background's reconstruction, metres.
    pub background_unit_m: f64,
    /// Disturbances.
    pub noise: Noise,
}

impl Default for Options {
    /// An easy case: 60 frames, camera 12 m up and climbing 8 m, vehicle 22 to 30 m off, no noise.
    fn default() -> Self {
        Self {
            num_frames: 60,
            terrain: Terrain::Flat,
            route: Route::Straight,
            speed_m_s: 8.0,
            camera_height_m: 12.0,
            camera_climb_m: 8.0,
            distance_m: [22.0, 30.0],
            has_wheels: true,
            num_object_points: 200,
            num_ground_points: 3000,
            num_other_points: 300,
            object_unit_m: 1.7,
            background_unit_m: 4.1,
            noise: Noise::default(),
        }
    }
}

/// A world as two reconstructions would see it, and the truth about it.
#[derive(Clone, Debug)]
pub struct Drive {
    /// Frames, ascending.
    pub frames: Vec<Frame>,
    /// The background: ground and other points, cameras.
    pub background: Reconstruction,
    /// The object in its own frame and unit.
    pub object: Reconstruction,
    /// Background points that lie on the ground, ascending.
    pub ground_points: Vec<Point3dId>,
    /// The local plane of each frame (with the noise that was asked for), in the background's frame.
    pub planes: BTreeMap<FrameId, GroundPlane>,
    /// True scale ratio: background units per object unit.
    pub ratio: f64,
    /// True pose of the object in each frame; its scale is `ratio`.
    pub world_from_object: BTreeMap<FrameId, Sim3>,
    /// Takes metres, z up, into the background's frame.
    pub background_from_metric: Sim3,
}

/// Makes the world of `options`; the same seed gives the same world, and noise does not change what is disturbed.
pub fn drive(options: &Options, seed: u64) -> Drive {
    let rng = &mut seeded_rng(seed, 0x6472_6976);
    let background_from_metric = random_similarity(1.0 / options.background_unit_m, rng);
    let vehicle_from_object = random_similarity(options.object_unit_m, rng);
    let surface = surface_points(options.num_object_points, options.has_wheels, rng);
    let (ground, other) = background_points(options, rng);
    let ids: Vec<FrameId> = (0..options.num_frames).map(FrameId).collect();
    let stage = Stage { options, look: rng.random_range(-1.0..1.0) };
    let poses: Vec<_> = ids.iter().map(|id| (stage.metric_from_vehicle(*id), stage.cam_from_metric(*id))).collect();
    let mut background = reconstruct_background(&poses, ground.iter().chain(&other));
    let mut object = reconstruct_object(&poses, &surface);
    // The object's cameras are known relative to the vehicle; the rest is a change of frame and unit.
    object.transform(&vehicle_from_object.inverse());
    background.transform(&background_from_metric);
    let noise_rng = &mut seeded_rng(seed, 0x6e6f_6973);
    if options.noise.pixel_px > 0.0 {
        noisy::disturb(&mut background, options.noise.pixel_px, noise_rng);
        noisy::disturb(&mut object, options.noise.pixel_px, noise_rng);
    }
    let mut planes = BTreeMap::new();
    let mut world_from_object = BTreeMap::new();
    for (id, (metric_from_vehicle, _)) in ids.iter().zip(&poses) {
        planes.insert(*id, plane(metric_from_vehicle, &background_from_metric, &options.noise, noise_rng));
        world_from_object.insert(*id, background_from_metric * Sim3::from(*metric_from_vehicle) * vehicle_from_object);
    }
    Drive {
        frames: ids.iter().copied().map(frame).collect(),
        ground_points: background.points.keys().copied().filter(|id| id.0 <= ground.len() as u64).collect(),
        background,
        object,
        planes,
        ratio: options.object_unit_m / options.background_unit_m,
        world_from_object,
        background_from_metric,
    }
}

impl Terrain {
    /// Height at a place, metres.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        match *self {
            Self::Flat => 0.0,
            Self::Slope { gradient: [gx, gy] } => gx * x + gy * y,
            Self::Hills { amplitude_m, wavelength_m } => {
                let k = std::f64::consts::TAU / wavelength_m;
                amplitude_m * (k * x).sin() * (k * y).cos()
            }
        }
    }

    /// Upward unit normal at a place.
    pub fn normal(&self, x: f64, y: f64) -> Vector3<f64> {
        let [gx, gy] = match *self {
            Self::Flat => [0.0, 0.0],
            Self::Slope { gradient } => gradient,
            Self::Hills { amplitude_m, wavelength_m } => {
                let k = std::f64::consts::TAU / wavelength_m;
                let a = amplitude_m * k;
                [a * (k * x).cos() * (k * y).cos(), -a * (k * x).sin() * (k * y).sin()]
            }
        };
        Vector3::new(-gx, -gy, 1.0).normalize()
    }

    /// Height of the plane that cameras keep their height over: the terrain itself where it is a plane.
    fn datum(&self, x: f64, y: f64) -> f64 {
        if matches!(self, Self::Hills { .. }) { 0.0 } else { self.height(x, y) }
    }
}

/// Where vehicle and camera are at each moment, metric, z up.
struct Stage<'a> {
    options: &'a Options,
    /// Turns the camera's path a little from seed to seed, −1 to 1.
    look: f64,
}

impl Stage<'_> {
    /// Passed part of the clip, 0 to 1.
    fn progress(&self, frame: FrameId) -> f64 {
        f64::from(frame.0) / f64::from(self.options.num_frames.saturating_sub(1).max(1))
    }

    /// Place and direction on the map.
    fn route(&self, frame: FrameId) -> ([f64; 2], [f64; 2]) {
        let s = self.options.speed_m_s * f64::from(frame.0) / FPS;
        match self.options.route {
            Route::Straight => ([s, 0.0], [1.0, 0.0]),
            Route::Curve { radius_m } => {
                let (sin, cos) = (s / radius_m).sin_cos();
                ([radius_m * sin, radius_m * (1.0 - cos)], [cos, sin])
            }
        }
    }

    fn metric_from_vehicle(&self, frame: FrameId) -> Rigid3 {
        let ([x, y], [dx, dy]) = self.route(frame);
        let up = self.options.terrain.normal(x, y);
        let left = up.cross(&Vector3::new(dx, dy, 0.0)).normalize();
        let rotation = UnitQuaternion::from_basis_unchecked(&[left.cross(&up), left, up]);
        Rigid3::new(rotation, Vector3::new(x, y, self.options.terrain.height(x, y)))
    }

    fn cam_from_metric(&self, frame: FrameId) -> Rigid3 {
        let o = self.options;
        let (t, ([x, y], _)) = (self.progress(frame), self.route(frame));
        let height = o.camera_height_m + o.camera_climb_m * t;
        let slant = o.distance_m[0] + (o.distance_m[1] - o.distance_m[0]) * t;
        let reach = (slant * slant - height * height).max(1.0).sqrt();
        let (sin, cos) = (3.5 + 0.9 * t + 0.4 * self.look).sin_cos();
        let (cx, cy) = (x + reach * cos, y + reach * sin);
        let center = Point3::new(cx, cy, o.terrain.datum(cx, cy) + height);
        let target = Point3::new(x + 1.5 * (4.0 * t).sin(), y + 1.0, o.terrain.height(x, y) + 1.0);
        look_at(center, target)
    }
}

/// A camera with a level horizon, z up in the world.
pub(super) fn look_at(center: Point3<f64>, target: Point3<f64>) -> Rigid3 {
    let forward = (target - center).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let cam_from_world = Matrix3::from_columns(&[right, forward.cross(&right), forward]).transpose();
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(cam_from_world));
    Rigid3::from_rotation_and_center(rotation, center)
}

fn random_similarity(scale: f64, rng: &mut Rng) -> Sim3 {
    let mut angle = || rng.random_range(-2.0..2.0);
    let rotation = UnitQuaternion::from_euler_angles(angle(), angle(), angle());
    Sim3::new(scale, rotation, Vector3::new(angle(), angle(), angle()) * 5.0)
}

/// Ground points, and points that stand over it, metric.
fn background_points(options: &Options, rng: &mut Rng) -> (Vec<Point3<f64>>, Vec<Point3<f64>>) {
    let length = options.speed_m_s * f64::from(options.num_frames) / FPS;
    let terrain = options.terrain;
    let mut place = |up: f64| {
        let (x, y) = (rng.random_range(-30.0..length + 30.0), rng.random_range(-25.0..45.0));
        Point3::new(x, y, terrain.height(x, y) + rng.random_range(0.0..=1.0) * up)
    };
    let ground = (0..options.num_ground_points).map(|_| place(0.0)).collect();
    let other = (0..options.num_other_points)
        .map(|k| {
            let p = place(8.0);
            // Half of them stand on a façade along the road.
            if k % 2 == 0 { Point3::new(p.x, 18.0, p.z + 0.5) } else { p }
        })
        .collect();
    (ground, other)
}

const CAMERA: CameraId = CameraId(1);
/// Frames per second.
const FPS: f64 = 10.0;

fn camera() -> Camera {
    Camera::with_focal(960, 540, 900.0)
}

fn frame(id: FrameId) -> Frame {
    Frame { id, name: format!("{:06}.jpg", id.0), time_s: f64::from(id.0) / FPS }
}

fn empty_model() -> Reconstruction {
    Reconstruction { cameras: BTreeMap::from([(CAMERA, camera())]), ..Reconstruction::default() }
}

/// Adds an image that sees the given points, and their tracks.
fn add_image(
    model: &mut Reconstruction,
    idx: usize,
    cam_from_world: Rigid3,
    seen: Vec<(Point3dId, Point3<f64>, Point2<f64>)>,
) {
    let id = ImageId::from(FrameId(idx as u32));
    for (observation_idx, (point_id, position, _)) in seen.iter().enumerate() {
        let point = model.points.entry(*point_id).or_insert_with(|| Point3d {
            position: *position,
            rgb: [128; 3],
            error_px: 0.0,
            track: Vec::new(),
        });
        point.track.push(TrackElement { image: id, observation_idx: observation_idx as u32 });
    }
    let observations = seen.iter().map(|(id, _, pixel)| Observation { pixel: *pixel, point: Some(*id) }).collect();
    let name = frame(FrameId(idx as u32)).name;
    model.images.insert(id, Image { name, camera: CAMERA, cam_from_world, observations });
}

fn see(cam_from_world: &Rigid3, point: Point3<f64>) -> Option<Point2<f64>> {
    camera().pixel_from_cam(*cam_from_world * point).filter(|pixel| camera().contains(*pixel))
}

/// Drops points that fewer than two images see: nothing can be reported of them.
fn drop_unseen(mut model: Reconstruction) -> Reconstruction {
    let unseen = model.points.iter().filter(|(_, point)| point.track.len() < 2).map(|(id, _)| *id);
    model.remove_points(&unseen.collect::<Vec<_>>());
    model
}

fn reconstruct_background<'a>(
    poses: &[(Rigid3, Rigid3)],
    points: impl Iterator<Item = &'a Point3<f64>> + Clone,
) -> Reconstruction {
    let mut model = empty_model();
    for (idx, (metric_from_vehicle, cam_from_metric)) in poses.iter().enumerate() {
        // The vehicle hides what is behind it.
        let hidden = |pixel: Point2<f64>| {
            let middle = see(cam_from_metric, *metric_from_vehicle * Point3::new(0.0, 0.0, 0.7));
            middle.is_some_and(|middle| (pixel - middle).norm() < 60.0)
        };
        let seen = points.clone().zip(1..).filter_map(|(point, id)| {
            let pixel = see(cam_from_metric, *point).filter(|pixel| !hidden(*pixel))?;
            Some((Point3dId(id), *point, pixel))
        });
        add_image(&mut model, idx, *cam_from_metric, seen.collect());
    }
    drop_unseen(model)
}

fn reconstruct_object(poses: &[(Rigid3, Rigid3)], surface: &[SurfacePoint]) -> Reconstruction {
    let mut model = empty_model();
    for (idx, (metric_from_vehicle, cam_from_metric)) in poses.iter().enumerate() {
        let cam_from_vehicle = *cam_from_metric * *metric_from_vehicle;
        let eye = cam_from_vehicle.center();
        let seen = surface.iter().zip(1..).filter_map(|(point, id)| {
            let faces_camera = point.normal.dot(&(eye - point.position)) > 0.0;
            let pixel = see(&cam_from_vehicle, point.position).filter(|_| faces_camera)?;
            Some((Point3dId(id), point.position, pixel))
        });
        add_image(&mut model, idx, cam_from_vehicle, seen.collect());
    }
    drop_unseen(model)
}

/// The tangent plane under the vehicle, disturbed, in the background's frame.
fn plane(metric_from_vehicle: &Rigid3, background_from_metric: &Sim3, noise: &Noise, rng: &mut Rng) -> GroundPlane {
    let mut normal_sample = || rng.sample::<f64, _>(StandardNormal);
    let place = [normal_sample() * 2.0, normal_sample() * 2.0];
    let (mut height, mut tilt) = (noise.plane_height_m * normal_sample(), noise.plane_tilt_deg * normal_sample());
    let bad_height = 0.5 * normal_sample();
    let bad_tilt = rng.random_range(5.0..20.0);
    let (is_bad, direction) = (rng.random::<f64>() < noise.bad_planes, rng.random_range(0.0..std::f64::consts::TAU));
    if is_bad {
        (height, tilt) = (height + bad_height, tilt + bad_tilt);
    }
    let axis = Unit::new_unchecked(Vector3::new(direction.cos(), direction.sin(), 0.0));
    let normal =
        metric_from_vehicle.rotation * (UnitQuaternion::from_axis_angle(&axis, tilt.to_radians()) * Vector3::z());
    // The anchor of a fitted plane is the middle of its points, a few metres from the vehicle; its height error counts
    // there.
    let anchor = *metric_from_vehicle * Point3::new(place[0], place[1], height);
    GroundPlane {
        normal: background_from_metric.rotation * normal,
        point: *background_from_metric * anchor,
        num_points: 50,
        num_inliers: 50,
        rms: noise.plane_height_m * background_from_metric.scale,
        basis: PlaneBasis::LabelledPoints,
        height_std: noise.plane_height_m * background_from_metric.scale,
        common_height_std: 0.0,
        tilt_std: noise.plane_tilt_deg.to_radians(),
    }
}
