use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Rotation3, Vector3};

use super::template::of_body;
use super::*;
use crate::camera::Camera;
use crate::math::Sim3;
use crate::scene::{CameraId, Frame, ImageId, ObjectId, PlaneBasis, Point3d, Point3dId, ScaleEstimate, ScaleMethod};
use crate::trajectory::{ObjectDescription, assemble};

/// Length, width and height of the car in the tests, meters; the unit of its model is the meter.
const CAR: [f64; 3] = [4.4, 1.8, 1.5];
/// Units of the background in a meter.
const RATIO: f64 = 2.0;

/// A car at the origin, with cameras around it.
struct World {
    object: Reconstruction,
    background: Reconstruction,
    planes: BTreeMap<FrameId, GroundPlane>,
    silhouettes: BTreeMap<FrameId, Silhouette>,
    trajectory: ObjectTrajectory,
    options: Options,
}

fn looking_at(eye: Point3<f64>, target: Point3<f64>) -> Rigid3 {
    let forward = (target - eye).normalize();
    let right = forward.cross(&Vector3::z()).normalize();
    let rows = Matrix3::from_rows(&[right.transpose(), forward.cross(&right).transpose(), forward.transpose()]);
    Rigid3::from_rotation_and_center(Rotation3::from_matrix_unchecked(rows).into(), eye)
}

/// Cameras at these azimuths (degrees from straight ahead of the car), 15 m away and 5 m above the ground.
fn world(azimuths: &[f64]) -> World {
    let corners: Vec<Point3<f64>> =
        of_body(Body::Car)[1].corners().iter().map(|c| Point3::from(c.component_mul(&Vector3::from(CAR)))).collect();
    let camera = Camera::with_focal(960, 540, 880.0);
    let (mut object, mut background) = (Reconstruction::default(), Reconstruction::default());
    object.cameras.insert(CameraId(1), camera);
    background.cameras.insert(CameraId(1), camera);
    for (k, corner) in corners.iter().enumerate() {
        for (j, within) in [0.94, 0.96, 0.98].into_iter().enumerate() {
            let position = Point3::new(within * corner.x, within * corner.y, corner.z);
            let point = Point3d { position, rgb: [0; 3], error_px: 0.5, track: Vec::new() };
            object.points.insert(Point3dId((3 * k + j) as u64 + 1), point);
        }
    }
    let (mut planes, mut silhouettes, mut frames) = (BTreeMap::new(), BTreeMap::new(), Vec::new());
    for (k, azimuth) in azimuths.iter().enumerate() {
        let (sin, cos) = azimuth.to_radians().sin_cos();
        let (id, name) = (FrameId(k as u32), format!("{k:06}.jpg"));
        let pose = looking_at(Point3::new(15.0 * cos, 15.0 * sin, 5.0), Point3::new(0.0, 0.0, 0.7));
        let image = |cam_from_world| Image {
            name: name.clone(),
            camera: CameraId(1),
            cam_from_world,
            observations: Vec::new(),
        };
        object.images.insert(ImageId::from(id), image(pose));
        let wider = Rigid3::from_rotation_and_center(pose.rotation, Point3::from(pose.center().coords * RATIO));
        background.images.insert(ImageId::from(id), image(wider));
        let seen = corners.iter().filter_map(|corner| camera.pixel_from_cam(pose * *corner)).collect();
        silhouettes.insert(id, Silhouette { hull: seen });
        planes.insert(id, level());
        frames.push(Frame { id, name, time_s: 0.1 * k as f64 });
    }
    let description = ObjectDescription { id: ObjectId(1), class: "car".into(), confidence: 1.0 };
    let scale = ScaleEstimate { std: Some(0.01 * RATIO), ..ScaleEstimate::new(RATIO, ScaleMethod::Joint) };
    let trajectory = assemble(description, &background, &object, scale, &frames);
    World { object, background, planes, silhouettes, trajectory, options: Options::default() }
}

fn level() -> GroundPlane {
    GroundPlane {
        normal: Vector3::z(),
        point: Point3::origin(),
        num_points: 50,
        num_inliers: 50,
        rms: 0.0,
        basis: PlaneBasis::Points,
        height_std: 0.0,
        common_height_std: 0.0,
        tilt_std: 0.0,
    }
}

impl World {
    /// Moves the car forward.
    fn drive(mut self) -> Self {
        for (k, pose) in self.trajectory.poses.iter_mut().enumerate() {
            pose.position = [k as f64, 0.0, 0.0];
        }
        self
    }

    /// Expresses the car in another frame.
    fn in_frame(mut self, new_from_old: &Rigid3) -> Self {
        let new_from_old = Sim3::new(1.0, new_from_old.rotation, new_from_old.translation);
        self.object.transform(&new_from_old);
        let old_from_new = new_from_old.inverse();
        for pose in &mut self.trajectory.poses {
            pose.world_from_object = pose.world_from_object * old_from_new;
        }
        self
    }

    fn subject(&self) -> Subject<'_> {
        let Self { object, background, planes, silhouettes, trajectory, options } = self;
        Subject { trajectory, object, background, planes, silhouettes, options }
    }

    fn extents(&self) -> Extents {
        extents(&self.subject())
    }
}

#[test]
fn bodies_of_two_sub_maps_align_their_frames() {
    let side = world(&[50.0, 60.0, 70.0, 80.0, 90.0, 100.0, 110.0, 120.0, 130.0]).drive();
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.1);
    let rear_from_side = Rigid3::new(turn, Vector3::new(0.7, -0.3, 0.0));
    let rear = world(&[165.0, 170.0, 175.0, 180.0, 185.0, 190.0, 195.0]).drive().in_frame(&rear_from_side);
    let known = PlacedFit::of(&side.subject(), Body::Car, None).unwrap();
    let body = PlacedFit::of(&rear.subject(), Body::Car, Some(&known)).unwrap();
    let found = body.object_from_body() * known.object_from_body().inverse();
    assert!((found.translation - rear_from_side.translation).xy().norm() < 0.1, "{found:?}");
    assert!(found.angle_to(&rear_from_side) < 0.02, "{found:?}");
    assert!(PlacedFit::of(&world(&[50.0, 60.0, 70.0]).subject(), Body::Car, None).is_none());
}

/// Returns true if the error of an extent is below two standard deviations, and one standard deviation below a tenth.
fn is_near(found: Option<Estimate>, meters: f64) -> bool {
    found.is_some_and(|e| (e.value - RATIO * meters).abs() < 2.0 * e.std && e.std < 0.1 * e.value)
}

#[test]
fn a_car_visible_from_all_sides_is_measured() {
    let azimuths: Vec<f64> = (0..12).map(|k| 30.0 * f64::from(k)).collect();
    let found = world(&azimuths).drive().extents();
    assert!(
        is_near(found.length, CAR[0]) && is_near(found.width, CAR[1]) && is_near(found.height, CAR[2]),
        "{found:?}"
    );
    // The standard deviation of every extent includes that of the scale ratio.
    assert!(found.height.is_some_and(|height| height.std > 0.01 * height.value));
}

#[test]
fn the_length_of_a_stationary_car_is_its_longer_side() {
    let azimuths: Vec<f64> = (0..12).map(|k| 30.0 * f64::from(k)).collect();
    let found = world(&azimuths).extents();
    assert!(is_near(found.length, CAR[0]) && is_near(found.width, CAR[1]), "{found:?}");
}

#[test]
fn the_center_of_a_body_is_estimated_from_one_side() {
    let turn = UnitQuaternion::from_euler_angles(0.4, -0.2, 1.1);
    let other_frame = Rigid3::new(turn, Vector3::new(0.7, -0.3, 5.0));
    let mut world = world(&[35.0, 50.0, 65.0, 80.0, 100.0, 115.0, 130.0, 145.0]).drive().in_frame(&other_frame);
    // Only the points of that side.
    let old_from_new = other_frame.inverse();
    world.object.points.retain(|_, point| (old_from_new * point.position).y > 0.2);
    let points = crate::trajectory::object_center(&world.object);
    let truth = Point3::new(0.0, 0.0, 0.5 * CAR[2]);
    let off = |found: Point3<f64>| old_from_new * found - truth;
    assert!(off(points).xy().norm() > 0.5, "{points}");
    let center = world.extents().center.unwrap();
    let error = off(center.in_object.into());
    assert!(error.norm() < 0.15, "{error}");
    // Its covariance is that of the same axes, in the unit of the background.
    let pose = world.trajectory.poses[0].world_from_object;
    let covariance = center.covariance_in_world(&pose);
    let in_world = pose.rotation * other_frame.rotation * error * RATIO;
    let deviations = in_world.dot(&(covariance.try_inverse().unwrap() * in_world)).sqrt();
    assert!(deviations < 3.0, "{deviations}: {covariance}");
    assert!(covariance.trace().sqrt() < 0.3 * RATIO, "{covariance}");
    world.trajectory.refer_to(center);
    let position = Point3::from(world.trajectory.poses[0].position);
    assert!((position - pose * Point3::from(center.in_object)).norm() < 1e-12);
}

#[test]
fn from_behind_a_car_has_no_length() {
    let found = world(&[178.0, 179.0, 180.0, 181.0, 182.0]).drive().extents();
    assert_eq!(found.length, None);
    // Its center is known well in width and height, and roughly along its length.
    let center = found.center.unwrap();
    let stds = [0, 1, 2].map(|axis| center.covariance[axis][axis].sqrt());
    let [ahead, left, up] = center.in_object;
    assert!(ahead.abs() < 2.0 * stds[0] && left.abs() < 0.1 && (up - 0.5 * CAR[2]).abs() < 0.1, "{center:?}");
    assert!(stds[0] > 3.0 * stds[1].max(stds[2]) && stds[1] < 0.1 && stds[2] < 0.1, "{stds:?}");
    assert!(is_near(found.width, CAR[1]) && is_near(found.height, CAR[2]), "{found:?}");
}

#[test]
fn a_car_occluded_in_half_of_the_frames_keeps_its_size() {
    let azimuths: Vec<f64> = (0..24).map(|k| 15.0 * f64::from(k)).collect();
    let mut world = world(&azimuths).drive();
    for silhouette in world.silhouettes.values_mut().step_by(2) {
        let middle = silhouette.hull.iter().map(|p| p.x).sum::<f64>() / silhouette.hull.len() as f64;
        silhouette.hull.retain(|p| p.x < middle);
    }
    let found = world.extents();
    assert!(
        is_near(found.length, CAR[0]) && is_near(found.width, CAR[1]) && is_near(found.height, CAR[2]),
        "{found:?}"
    );
}

#[test]
fn missing_data_give_no_extents() {
    let mut world = world(&[0.0, 90.0, 180.0]).drive();
    world.silhouettes.pop_first();
    assert_eq!(world.extents(), Extents::default());
    world.planes.clear();
    assert_eq!(world.extents(), Extents::default());
    world.object.points.clear();
    assert_eq!(world.extents(), Extents::default());
}

#[test]
fn outliers_are_those_of_the_options_of_the_run() {
    let azimuths: Vec<f64> = (0..12).map(|k| 30.0 * f64::from(k)).collect();
    let mut world = world(&azimuths).drive();
    let default = world.extents();
    assert!(default.length.is_some());
    world.options.joint.contact.max_deviation = 0.9;
    assert_ne!(world.extents(), default);
}
