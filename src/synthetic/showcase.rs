//! A finished result to look at: a street corner, a climbing camera, a car that turns left, a van whose scale is
//! undetermined, and a bicycle that was seen but not reconstructed. Exact but for a little pixel noise.
//!
//! It is made for the report and for exporters, which need something of every kind: gaps, reasons, far outliers,
//! several objects. The estimators have worlds of their own.

use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, PI};

use ::image::{Rgb, RgbImage};
use nalgebra::{Point2, Point3, UnitQuaternion, Vector3};
use rand::Rng as _;

use super::drive::look_at;
use crate::camera::Camera;
use crate::math::{Rigid3, Rng, Sim3, centroid, seeded_rng};
use crate::scene::{
    CameraId, Dimensions, Estimate, Frame, FrameId, Ground, GroundPlane, GroundSource, Image, ImageId, Mask, Metric,
    MetricAxes, MetricFrame, MetricPose, MetricShare, MetricStd, MetricVerdict, Motion, ObjectId, ObjectPose,
    ObjectTrajectory, Observation, PlaneBasis, Point3d, Point3dId, Reason, ReasonKind, Reconstruction, ScaleEstimate,
    ScaleMethod, TrackElement, Travel, Trust, Verdict,
};

/// Upward direction of the street corner in the background's frame.
pub const UP: Vector3<f64> = Vector3::new(0.0, -0.8, -0.6);
/// Ids of the three vehicles.
pub const CAR: ObjectId = ObjectId(1);
/// The van drives straight on, seen by a camera at constant height: degenerate.
pub const VAN: ObjectId = ObjectId(2);
/// The bicycle is never reconstructed.
pub const BICYCLE: ObjectId = ObjectId(3);

/// Frames in which the car cannot be registered.
const CAR_LOST: std::ops::Range<u32> = 31..36;
/// Frames in which the camera cannot be registered.
const CAMERA_LOST: std::ops::Range<u32> = 48..50;

/// A run's result.
#[derive(Clone, Debug)]
pub struct Showcase {
    /// 60 frames at 15 per second, unless asked otherwise.
    pub frames: Vec<Frame>,
    /// Street, façades, trees and a few points at the horizon.
    pub background: Reconstruction,
    /// Labels and planes.
    pub ground: Ground,
    /// Car and van.
    pub vehicles: Vec<Vehicle>,
    /// Takes metres, z up, into the background's frame.
    pub background_from_metric: Sim3,
    /// The inverse of it, as telemetry would give it: z up, y north.
    pub metric: Metric,
    camera: Camera,
}

/// A reconstructed vehicle.
#[derive(Clone, Debug)]
pub struct Vehicle {
    /// In its own frame.
    pub model: Reconstruction,
    /// In the background's frame.
    pub trajectory: ObjectTrajectory,
    /// Frames in which it is in the picture.
    pub visible: Vec<FrameId>,
    /// Length, width, height, metres.
    pub size_m: [f64; 3],
}

/// The result of `num_frames` frames; one seed, one result.
pub fn showcase(num_frames: u32, seed: u64) -> Showcase {
    let rng = &mut seeded_rng(seed, 0x7368_6f77);
    let camera = Camera::with_focal(960, 540, 820.0);
    let background_from_metric = Sim3::new(0.31, rotation_to_up(), Vector3::new(0.4, 1.1, 3.0));
    let frames: Vec<Frame> = (0..num_frames).map(frame).collect();
    let world = street(rng);
    let mut background = Reconstruction::default();
    background.cameras.insert(CameraId(1), camera);
    for f in frames.iter().filter(|f| !CAMERA_LOST.contains(&f.id.0)) {
        add_image(&mut background, f, cam_from_metric(progress(f.id, num_frames)));
    }
    add_points(&mut background, &camera, &world, rng);
    background.transform(&background_from_metric);
    let ground_ids = background.points.keys().zip(&world).filter(|(_, p)| p.is_ground).map(|(id, _)| *id).collect();
    let mut result = Showcase {
        ground: Ground { source: GroundSource::Masks, point_ids: ground_ids, planes: BTreeMap::new() },
        vehicles: Vec::new(),
        frames,
        background,
        metric: metric(&background_from_metric),
        background_from_metric,
        camera,
    };
    for (id, size_m) in [(CAR, [4.3, 1.8, 1.5]), (VAN, [5.6, 2.0, 2.5])] {
        let vehicle = vehicle(&mut result, id, size_m, rng);
        result.vehicles.push(vehicle);
    }
    result
}

fn frame(index: u32) -> Frame {
    Frame { id: FrameId(index), name: format!("{index:06}.jpg"), time_s: f64::from(index) / 15.0 }
}

fn progress(frame: FrameId, num_frames: u32) -> f64 {
    f64::from(frame.0) / f64::from(num_frames.max(2) - 1)
}

/// A rotation that takes z to [`UP`].
fn rotation_to_up() -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(&Vector3::z(), &UP).expect("z and UP are not opposite")
}

/// The camera flies along the street behind the car, climbs, and keeps looking at it.
fn cam_from_metric(s: f64) -> Rigid3 {
    let center = Point3::new(-26.0 + 18.0 * s, -17.0 - 2.0 * (PI * s).sin(), 8.0 + 7.0 * s);
    look_at(center, Point3::new(2.0 + 10.0 * s, 3.0 + 6.0 * s, 0.5))
}

/// Where a vehicle stands on the street: x forward, z up, origin on the ground under its middle.
fn metric_from_vehicle(id: ObjectId, s: f64) -> Rigid3 {
    let (x, y, heading) = if id == CAR {
        // Straight on for 14 m, then a left turn with a radius of 9 m, then straight on.
        let way = 36.0 * s;
        let turn = ((way - 14.0) / 9.0).clamp(0.0, FRAC_PI_2);
        let (before, after) = (way.min(14.0), (way - 14.0 - 9.0 * FRAC_PI_2).max(0.0));
        (-12.0 + before + 9.0 * turn.sin(), -1.8 + 9.0 * (1.0 - turn.cos()) + after, turn)
    } else {
        (24.0 - 30.0 * s, 1.9, PI)
    };
    Rigid3::new(UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading), Vector3::new(x, y, 0.0))
}

/// A point of the street corner.
struct StreetPoint {
    metric: Point3<f64>,
    rgb: [u8; 3],
    is_ground: bool,
}

fn street(rng: &mut Rng) -> Vec<StreetPoint> {
    let mut points = Vec::new();
    let shade = |base: [u8; 3], by: i16| base.map(|c| (i16::from(c) + by).clamp(0, 255) as u8);
    let mut add = |x: f64, y: f64, z: f64, rgb: [u8; 3], by: i16, is_ground: bool| {
        points.push(StreetPoint { metric: Point3::new(x, y, z), rgb: shade(rgb, by), is_ground });
    };
    for _ in 0..9000 {
        let (x, y) = (rng.random_range(-28.0..42.0), rng.random_range(-16.0..34.0));
        let (on_x, on_y) = (f64::abs(y) < 4.0, f64::abs(x - 11.0) < 4.0);
        let line = (on_x && f64::abs(y) < 0.1 && !on_y) || (on_y && f64::abs(x - 11.0) < 0.1 && !on_x);
        let rgb = match (line, on_x || on_y) {
            (true, _) => [225, 225, 220],
            (false, true) => [98, 98, 104],
            (false, false) => [118, 138, 84],
        };
        add(x, y, rng.random_range(-0.02..0.02), rgb, rng.random_range(-22..22), true);
    }
    for (x0, y0, dx, dy, height, rgb) in [
        (-24.0, 7.0, 26.0, 9.0, 9.0, [186, 142, 108]),
        (18.0, 8.0, 18.0, 12.0, 13.0, [168, 172, 178]),
        (18.0, -15.0, 20.0, 8.0, 7.0, [196, 178, 132]),
    ] {
        for _ in 0..2200 {
            let (u, z) = (rng.random_range(0.0..2.0 * (dx + dy)), rng.random_range(0.0..height));
            let (x, y): (f64, f64) = match u {
                u if u < dx => (u, 0.0),
                u if u < dx + dy => (dx, u - dx),
                u if u < 2.0 * dx + dy => (u - dx - dy, dy),
                _ => (0.0, u - 2.0 * dx - dy),
            };
            let window = (z % 3.0 > 1.1 && z % 3.0 < 2.4) && ((u % 2.6) > 1.2);
            let rgb = if window { [62, 78, 96] } else { rgb };
            add(x0 + x, y0 + y, z, rgb, rng.random_range(-16..16), false);
        }
    }
    for k in 0..9 {
        let (x, y) = ([-20.0, -12.0, -4.0, 22.0, 30.0, 38.0][k % 6], if k < 6 { -6.5 } else { 6.0 });
        for _ in 0..260 {
            let d = Vector3::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
            let p = d.normalize() * 1.9;
            add(x + p.x, y + p.y, 4.6 + p.z * 1.2, [70, 112, 52], rng.random_range(-26..26), false);
        }
    }
    for _ in 0..30 {
        let angle = rng.random_range(0.0..2.0 * PI);
        let far = rng.random_range(900.0..9000.0);
        add(far * angle.cos(), far * angle.sin(), rng.random_range(0.0..900.0), [150, 170, 200], 0, false);
    }
    points
}

fn add_image(model: &mut Reconstruction, frame: &Frame, cam_from_world: Rigid3) {
    let image = Image { name: frame.name.clone(), camera: CameraId(1), cam_from_world, observations: Vec::new() };
    model.images.insert(ImageId::from(frame.id), image);
}

/// Adds points, seen by every seventh image or so, with pixel noise.
fn add_points(model: &mut Reconstruction, camera: &Camera, points: &[StreetPoint], rng: &mut Rng) {
    for (k, point) in points.iter().enumerate() {
        let id = Point3dId(k as u64 + 1);
        let mut track = Vec::new();
        let mut error_px = 0.0;
        for (image_id, image) in model.images.iter_mut().filter(|(i, _)| (i.0 as usize + k) % 7 < 2) {
            let Some(pixel) = camera.pixel_from_cam(image.cam_from_world * point.metric) else { continue };
            let noise = Point2::new(rng.random_range(-0.7..0.7), rng.random_range(-0.7..0.7));
            if camera.contains(pixel) {
                track.push(TrackElement { image: *image_id, observation_idx: image.observations.len() as u32 });
                image.observations.push(Observation { pixel: pixel + noise.coords, point: Some(id) });
                error_px += noise.coords.norm();
            }
        }
        error_px /= track.len().max(1) as f64;
        model.points.insert(id, Point3d { position: point.metric, rgb: point.rgb, error_px, track });
    }
}

/// Reconstructs one vehicle and adds its local planes to the ground.
fn vehicle(result: &mut Showcase, id: ObjectId, size_m: [f64; 3], rng: &mut Rng) -> Vehicle {
    let degenerate = id == VAN;
    let num_frames = result.frames.len() as u32;
    let vehicle_from_object =
        Sim3::new(1.6, UnitQuaternion::from_euler_angles(0.3, 1.0, -0.4), Vector3::new(0.2, 0.1, 0.5));
    let ratio = vehicle_from_object.scale * result.background_from_metric.scale;
    // The van's scale is wrong on purpose: what is undetermined looks like something.
    let wrong = if degenerate { 0.82 } else { 1.0 };
    let visible: Vec<_> = result.frames.iter().map(|f| f.id).filter(|f| id == CAR || f.0 % num_frames > 5).collect();
    let mut model = Reconstruction::default();
    model.cameras.insert(CameraId(1), result.camera);
    let registered = |f: &FrameId| !(CAMERA_LOST.contains(&f.0) || id == CAR && CAR_LOST.contains(&f.0));
    for f in visible.iter().filter(|f| registered(f)) {
        let s = progress(*f, num_frames);
        add_image(&mut model, &frame(f.0), cam_from_metric(s) * metric_from_vehicle(id, s));
    }
    add_points(&mut model, &result.camera, &body(size_m, id, rng), rng);
    let middle = centroid(&model.finite_positions());
    model.transform(&vehicle_from_object.inverse());
    let mut poses = Vec::new();
    for f in visible.iter().filter(|f| registered(f)) {
        let s = progress(*f, num_frames);
        let true_pose = result.background_from_metric * Sim3::from(metric_from_vehicle(id, s)) * vehicle_from_object;
        let camera = (result.background_from_metric * Point3::from(cam_from_metric(s).center().coords)).coords;
        let shrink = Sim3::new(wrong, UnitQuaternion::identity(), camera * (1.0 - wrong));
        let world_from_object = shrink * true_pose;
        let position = world_from_object * (vehicle_from_object.inverse() * middle);
        poses.push(ObjectPose {
            frame: *f,
            name: frame(f.0).name,
            time_s: frame(f.0).time_s,
            position: position.coords.into(),
            world_from_object,
            metric: Some(metric_pose(id, *f, num_frames, wrong)),
        });
        result.ground.planes.insert((id, *f), local_plane(&result.background_from_metric, id, s, rng));
    }
    let alternatives = [(ScaleMethod::ConstantDistance, ratio * wrong), (ScaleMethod::Intersection, ratio * 1.013)];
    let scale = ScaleEstimate {
        std: (!degenerate).then_some(0.011 * ratio),
        degenerate,
        reason: degenerate.then(|| "the camera keeps its height over the ground, seen from the van".to_owned()),
        alternatives: alternatives.into(),
        ..ScaleEstimate::new(ratio * wrong, ScaleMethod::ConstantDistance)
    };
    let (class, confidence) = if id == CAR { ("car", 0.93) } else { ("van", 0.78) };
    let trajectory = ObjectTrajectory {
        verdict: Some(if degenerate { undetermined() } else { sound() }),
        dimensions: Some(dimensions(size_m)),
        travel: Some(travel(&poses, result.background_from_metric.scale)),
        poses,
        ..ObjectTrajectory::new(id, class, confidence, scale)
    };
    Vehicle { model, trajectory, visible, size_m }
}

/// Metric frame by telemetry, within 2 %.
fn metric(background_from_metric: &Sim3) -> Metric {
    let metric_from_background = background_from_metric.inverse();
    let Sim3 { scale, rotation, translation } = metric_from_background;
    let frame = MetricFrame {
        scale,
        rotation_wxyz: [rotation.w, rotation.i, rotation.j, rotation.k],
        translation: translation.into(),
        axes: MetricAxes::EastNorthUp,
        origin: None,
        std: MetricStd { scale: 0.02 * scale, tilt_deg: 0.4, heading_deg: Some(1.2), place_m: None },
        anchor: [0.0; 3],
        covariance: [[0.0; 7]; 7],
    };
    let share = |source: &str, off: f64, std: f64, share: f64| MetricShare {
        source: source.into(),
        scale: scale * off,
        std: std * scale,
        share,
    };
    Metric {
        verdict: MetricVerdict::Telemetry,
        reason: None,
        frame: Some(frame),
        shares: vec![
            share("fixes of the receiver", 1.004, 0.021, 0.92),
            share("sizes of 2 vehicles", 0.95, 0.07, 0.08),
        ],
        contradictions: Vec::new(),
        time_offset_s: Some(0.2),
        time_offset_std_s: Some(0.1),
        dates: None,
    }
}

/// Metric values of one pose, from the vehicle's true position; the van's have the error of its scale.
fn metric_pose(id: ObjectId, frame: FrameId, num_frames: u32, wrong: f64) -> MetricPose {
    let seconds = f64::from(num_frames.max(2) - 1) / 15.0;
    let at = |s: f64| metric_from_vehicle(id, s);
    let s = progress(frame, num_frames);
    let step = 1e-3;
    let velocity = (at(s + step).translation - at(s - step).translation) * (wrong / (2.0 * step * seconds));
    let turn = at(s - step).rotation.rotation_to(&at(s + step).rotation).scaled_axis().z / (2.0 * step * seconds);
    let heading = 90.0 - at(s).rotation.euler_angles().2.to_degrees();
    let position: [f64; 3] = (at(s).translation * wrong).into();
    let distance = (at(s).translation - cam_from_metric(s).center().coords).norm() * wrong;
    let wobble = 0.6 * (f64::from(frame.0 * 7 % 11) - 5.0);
    let motion = Motion {
        smoothed_position_m: position,
        smoothed_position_std_m: [0.3; 3],
        speed_m_s: velocity.norm(),
        speed_std_m_s: (0.02 * velocity.norm()).hypot(0.15),
        raw_speed_m_s: (velocity.norm() + wobble).max(0.0),
        acceleration_m_s2: 0.1 * wobble,
        acceleration_std_m_s2: 0.4,
        heading_deg: Some(heading.rem_euclid(360.0)),
        heading_std_deg: Some(0.8),
        yaw_rate_deg_s: Some(-turn.to_degrees()),
        yaw_rate_std_deg_s: Some(1.5),
    };
    MetricPose {
        position_m: position,
        position_std_m: [0.3; 3],
        distance_to_camera_m: distance,
        distance_to_camera_std_m: 0.02 * distance,
        motion: Some(motion),
        place: None,
    }
}

/// Of a path without noise, give or take 2 %.
fn travel(poses: &[ObjectPose], units_per_metre: f64) -> Travel {
    let estimate = |value: f64| Estimate { value, std: 0.02 * value };
    let path_units = poses.windows(2).map(|pair| pair[0].distance_to(&pair[1])).sum::<f64>();
    let away = poses.first().zip(poses.last()).map_or(0.0, |(first, last)| first.distance_to(last));
    let seconds = poses.first().zip(poses.last()).map_or(0.0, |(first, last)| last.time_s - first.time_s).max(1e-3);
    let speeds = poses.iter().filter_map(|pose| Some(pose.metric?.motion?.speed_m_s));
    Travel {
        path_units: estimate(path_units),
        displacement_units: estimate(away),
        path_m: Some(estimate(path_units / units_per_metre)),
        displacement_m: Some(estimate(away / units_per_metre)),
        mean_speed_m_s: Some(estimate(path_units / units_per_metre / seconds)),
        max_speed_m_s: Some(estimate(speeds.fold(0.0, f64::max))),
    }
}

/// All but the height, which nobody saw.
fn dimensions([length, width, _]: [f64; 3]) -> Dimensions {
    let known = |value: f64| Some(Estimate { value, std: 0.03 * value });
    Dimensions { length_m: known(length), width_m: known(width), height_m: None }
}

fn sound() -> Verdict {
    let says = "scale uncertainty ±1.1 % (1σ)";
    let reasons = vec![
        Reason::supports(ReasonKind::Deviation, says),
        Reason::supports(ReasonKind::Ground, "stands on the ground: lowest points at 4.0 % of its height"),
    ];
    Verdict { state: Trust::Good, reasons }
}

fn undetermined() -> Verdict {
    let says = "scale undetermined: the camera keeps its height";
    let reasons = vec![
        Reason::refutes(ReasonKind::Determined, says),
        Reason::doubts(ReasonKind::Pixels, 0.5, "small: its points span 18 px in the image"),
    ];
    Verdict { state: Trust::Rejected, reasons }
}

fn local_plane(background_from_metric: &Sim3, id: ObjectId, s: f64, rng: &mut Rng) -> GroundPlane {
    let on_ground = Point3::from(metric_from_vehicle(id, s).translation);
    let lift = Vector3::new(0.0, 0.0, rng.random_range(-0.02..0.02));
    GroundPlane {
        normal: background_from_metric.rotation * Vector3::z(),
        point: *background_from_metric * (on_ground + lift),
        num_points: 50,
        num_inliers: 46,
        rms: 0.01 * background_from_metric.scale,
        basis: PlaneBasis::LabelledPoints,
        height_std: 0.01 * background_from_metric.scale,
        common_height_std: 0.0,
        tilt_std: 0.005,
    }
}

/// Points on the hull of a vehicle: a body and a narrower cabin.
fn body([length, width, height]: [f64; 3], id: ObjectId, rng: &mut Rng) -> Vec<StreetPoint> {
    let paint = if id == CAR { [176, 30, 36] } else { [228, 228, 224] };
    let point = |k: usize| {
        let cabin = k.is_multiple_of(3);
        let (l, w) = if cabin { (0.55 * length, 0.86 * width) } else { (length, width) };
        let (low, high) = if cabin { (0.55 * height, height) } else { (0.2 * height, 0.58 * height) };
        let mut at = [rng.random_range(-0.5..0.5) * l, rng.random_range(-0.5..0.5) * w, rng.random_range(low..high)];
        match rng.random_range(0..5) {
            0 => at[0] = 0.5 * l,
            1 => at[0] = -0.5 * l,
            2 => at[1] = 0.5 * w,
            3 => at[1] = -0.5 * w,
            _ => at[2] = high,
        }
        let glass = cabin && at[2] < 0.93 * height;
        StreetPoint { metric: Point3::from(at), rgb: if glass { [44, 52, 62] } else { paint }, is_ground: false }
    };
    (0..900).map(point).collect()
}

impl Showcase {
    /// The vehicles' masks in a frame: the hulls of their projected boxes, and a box for the bicycle.
    pub fn masks(&self, frame: FrameId) -> Vec<(ObjectId, Mask)> {
        let s = progress(frame, self.frames.len() as u32);
        let cam = cam_from_metric(s);
        let mut masks = Vec::new();
        for vehicle in self.vehicles.iter().filter(|v| v.visible.contains(&frame)) {
            let id = vehicle.trajectory.id;
            let [l, w, h] = vehicle.size_m;
            let corner = |k: usize| {
                let sign = |bit: usize| if k >> bit & 1 == 0 { -0.5 } else { 0.5 };
                let at = Point3::new(sign(0) * l, sign(1) * w, (sign(2) + 0.5) * h);
                self.camera.pixel_from_cam(cam * (metric_from_vehicle(id, s) * at))
            };
            let corners: Vec<_> = (0..8).filter_map(corner).collect();
            masks.push((id, hull_mask(&corners, self.camera.width, self.camera.height)));
        }
        if let Some(at) = self.camera.pixel_from_cam(cam * Point3::new(-2.0 + 6.0 * s, -5.0, 0.9)) {
            let inside = |x: u32, y: u32| (f64::from(x) - at.x).abs() < 9.0 && (f64::from(y) - at.y).abs() < 14.0;
            masks.push((BICYCLE, Mask::from_fn(self.camera.width, self.camera.height, inside)));
        }
        masks
    }

    /// A coarse picture of a frame: every point a square, far ones first.
    pub fn picture(&self, frame: FrameId) -> RgbImage {
        let (width, height) = (self.camera.width, self.camera.height);
        let s = progress(frame, self.frames.len() as u32);
        let cam = cam_from_metric(s);
        let sky = |y: u32| [150 + (y / 8).min(80) as u8, 184 + (y / 12).min(50) as u8, 224];
        let mut picture = RgbImage::from_fn(width, height, |_, y| Rgb(sky(y)));
        let metric_from_background = self.background_from_metric.inverse();
        let mut dots: Vec<(Point3<f64>, [u8; 3], f64)> = Vec::new();
        for p in self.background.points.values() {
            dots.push((cam * (metric_from_background * p.position), p.rgb, 0.55));
        }
        for v in &self.vehicles {
            let id = v.trajectory.id;
            for p in body(v.size_m, id, &mut seeded_rng(7, 7)) {
                dots.push((cam * (metric_from_vehicle(id, s) * p.metric), p.rgb, 0.16));
            }
        }
        dots.sort_by(|a, b| b.0.z.total_cmp(&a.0.z));
        for (at, rgb, size) in dots {
            if let Some(pixel) = self.camera.pixel_from_cam(at) {
                square(&mut picture, pixel, size * self.camera.focal[0] / at.z.max(0.5), rgb);
            }
        }
        picture
    }
}

fn square(picture: &mut RgbImage, at: Point2<f64>, side: f64, rgb: [u8; 3]) {
    let half = (side / 2.0).clamp(0.5, 30.0);
    let range = |c: f64, len: u32| (c - half).max(0.0) as u32..((c + half).max(0.0) as u32).min(len);
    for y in range(at.y, picture.height()) {
        for x in range(at.x, picture.width()) {
            picture.put_pixel(x, y, Rgb(rgb));
        }
    }
}

/// The pixels inside the convex hull of a few points.
fn hull_mask(points: &[Point2<f64>], width: u32, height: u32) -> Mask {
    let cross = |a: Point2<f64>, b: Point2<f64>, c: Point2<f64>| (b - a).perp(&(c - a));
    // An edge of the hull has every point on one side of it.
    let edges: Vec<_> = points
        .iter()
        .flat_map(|a| points.iter().map(move |b| (*a, *b)))
        .filter(|(a, b)| a != b && points.iter().all(|c| cross(*a, *b, *c) >= -1e-9))
        .collect();
    let inside = |x: u32, y: u32| {
        let p = Point2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
        !edges.is_empty() && edges.iter().all(|(a, b)| cross(*a, *b, p) >= 0.0)
    };
    Mask::from_fn(width, height, inside)
}
