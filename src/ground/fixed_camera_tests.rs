//! Tests on a drive with a vehicle-mounted camera, and a bank next to the road with more points than the road.

use nalgebra::{Point2, Point3, UnitQuaternion, Vector3};
use rand::Rng as _;

use super::vehicle_trajectory::SHAPE;
use super::{GroundChain, MountFailure, Options, find_mount};
use crate::camera::Camera;
use crate::math::{Rigid3, seeded_rng};
use crate::scene::{
    CameraId, FrameId, Image, ImageId, ObjectId, Observation, PlaneBasis, Point3d, Point3dId, Reconstruction,
    TrackElement,
};

/// Height of the camera over the road, in units of the background.
pub(super) const HEIGHT: f64 = 0.4;
const NUM_FRAMES: u32 = 60;

/// Drive along z over the road y = 0 (y down).
///
/// The height of the road is `hill` · sin(z / 10 + `phase`). `climb` is the relative change of the camera's height over
/// the road from the middle of the drive to its end.
pub(super) struct Drive {
    pub turn: f64,
    pub hill: f64,
    pub phase: f64,
    pub climb: f64,
}

impl Drive {
    pub(super) const STRAIGHT: Self = Self { turn: 0.0, hill: 0.0, phase: 0.0, climb: 0.0 };

    fn road_at(&self, z: f64) -> f64 {
        -self.hill * (z / 10.0 + self.phase).sin()
    }

    fn height(&self, k: u32) -> f64 {
        HEIGHT * (1.0 + self.climb * (2.0 * f64::from(k) / f64::from(NUM_FRAMES) - 1.0))
    }

    fn pose(&self, k: u32) -> Rigid3 {
        let z = 0.3 * f64::from(k);
        let center = Point3::new(0.0, self.road_at(z) - self.height(k), z);
        let slope = -self.hill / 10.0 * (z / 10.0 + self.phase).cos();
        let pitch = UnitQuaternion::from_euler_angles(0.04 + slope.atan(), 0.0, 0.0);
        let turn = UnitQuaternion::from_euler_angles(0.0, self.turn * (f64::from(k) * 0.2).sin(), 0.0);
        Rigid3::from_rotation_and_center(pitch * turn, center)
    }

    pub(super) fn background(&self, num_road: usize, num_slope: usize, noise_px: f64) -> Reconstruction {
        let rng = &mut seeded_rng(5, 1);
        let mut uniform = |low: f64, high: f64| low + (high - low) * rng.random::<f64>();
        let mut positions: Vec<Point3<f64>> = Vec::new();
        for k in 0..num_road + num_slope {
            let z = uniform(1.0, 30.0);
            let on_slope = k >= num_road;
            let x = if on_slope { uniform(2.0, 6.0) } else { uniform(-2.0, 2.0) };
            let lift = if on_slope { 0.27 * (x - 2.0) } else { 0.0 };
            positions.push(Point3::new(x, self.road_at(z) - lift, z));
        }
        let camera = Camera::with_focal(960, 540, 800.0);
        let mut model = Reconstruction::default();
        model.cameras.insert(CameraId(1), camera);
        let mut tracks = vec![Vec::new(); positions.len()];
        for k in 0..NUM_FRAMES {
            let cam_from_world = self.pose(k);
            let id = ImageId::from(FrameId(k));
            let mut observations = Vec::new();
            for (idx, position) in positions.iter().enumerate() {
                let in_cam = cam_from_world * *position;
                let near = in_cam.z > 0.5 && in_cam.z < 12.0;
                let Some(pixel) = camera.pixel_from_cam(in_cam).filter(|p| near && camera.contains(*p)) else {
                    continue;
                };
                tracks[idx].push(TrackElement { image: id, observation_idx: observations.len() as u32 });
                let noise = Point2::new(uniform(-noise_px, noise_px), uniform(-noise_px, noise_px));
                observations.push(Observation { pixel: pixel + noise.coords, point: Some(Point3dId(idx as u64 + 1)) });
            }
            let name = format!("{k:06}.jpg");
            model.images.insert(id, Image { name, camera: CameraId(1), cam_from_world, observations });
        }
        for (idx, track) in tracks.into_iter().enumerate() {
            // Height error of one pixel at the mean depth.
            let error = Vector3::new(0.0, uniform(-noise_px, noise_px) * 4.0 / 800.0, 0.0);
            let position = positions[idx] + error;
            model.points.insert(Point3dId(idx as u64 + 1), Point3d { position, rgb: [0; 3], error_px: 0.5, track });
        }
        model
    }

    /// Model of a vehicle at the distance `ahead` of the camera, with a few observations in every frame.
    fn vehicle(&self, ahead: f64) -> Reconstruction {
        let mut model = Reconstruction::default();
        let camera = Camera::with_focal(960, 540, 800.0);
        model.cameras.insert(CameraId(1), camera);
        for k in 0..NUM_FRAMES {
            let cam_from_world = self.pose(k);
            let z = 0.3 * f64::from(k) + ahead;
            let observations = [0.0, 0.1, 0.2].into_iter().filter_map(|up| {
                let point = Point3::new(0.2, self.road_at(z) - up, z);
                let pixel = camera.pixel_from_cam(cam_from_world * point)?;
                Some(Observation { pixel, point: Some(Point3dId(1)) })
            });
            let observations = observations.collect();
            let image = Image { name: format!("{k:06}.jpg"), camera: CameraId(1), cam_from_world, observations };
            model.images.insert(ImageId::from(FrameId(k)), image);
        }
        model
    }
}

#[test]
fn the_road_is_found_although_the_bank_has_more_points() {
    for (num_road, noise) in [(60, 0.0), (40, 0.5)] {
        let model = Drive::STRAIGHT.background(num_road, 400, noise);
        let found = find_mount(&model, None, &Options::default(), 3).unwrap();
        assert_eq!(found, find_mount(&model, None, &Options::default(), 3).unwrap());
        let roll = found.normal_in_cam.x.asin();
        assert!((found.height / HEIGHT - 1.0).abs() < 0.02 && roll.abs() < 0.01, "{found:?}");
        assert!(found.drift < 0.02 && found.height_std < 0.02 * HEIGHT, "{found:?}");
    }
}

#[test]
fn cameras_that_are_not_mounted_are_rejected_with_the_reason() {
    let failure = |drive: Drive| find_mount(&drive.background(80, 0, 0.0), None, &Options::default(), 3).unwrap_err();
    assert!(matches!(failure(Drive { turn: 0.5, ..Drive::STRAIGHT }), MountFailure::Turns { .. }));
    let model = Drive::STRAIGHT.background(5, 0, 0.0);
    assert!(matches!(find_mount(&model, None, &Options::default(), 3), Err(MountFailure::TooFewPoints { .. })));
    let nothing = Reconstruction::default();
    assert!(matches!(find_mount(&nothing, None, &Options::default(), 3), Err(MountFailure::TooFewFrames { .. })));
}

/// A climbing drone along a road keeps its viewing direction like a mounted camera. Few points are on any plane below
/// it, and they are observed on a part of the trajectory only.
#[test]
fn a_camera_that_climbs_is_not_fixed_to_a_vehicle_however_few_points_there_are() {
    for climb in [-0.4, 0.25, 0.5] {
        for num_road in [20, 40, 80, 160] {
            let model = Drive { climb, ..Drive::STRAIGHT }.background(num_road, 0, 0.3);
            let found = find_mount(&model, None, &Options::default(), 3);
            assert!(found.is_err(), "{num_road} points, {climb}: {found:?}");
        }
    }
    // As few points suffice for a mounted camera.
    let found = find_mount(&Drive::STRAIGHT.background(40, 0, 0.3), None, &Options::default(), 3);
    assert!(found.as_ref().is_ok_and(|mount| (mount.height / HEIGHT - 1.0).abs() < 0.02), "{found:?}");
}

/// Beyond the last camera position the road is extrapolated: over many hills σ matches the errors.
#[test]
fn the_std_of_an_extrapolated_road_is_calibrated() {
    let (mut squares, mut count, mut stds): (f64, f64, Vec<f64>) = (0.0, 0.0, Vec::new());
    for phase in 0..12 {
        let drive = Drive { hill: 0.3, phase: 0.5 * f64::from(phase), ..Drive::STRAIGHT };
        let (model, vehicle) = (drive.background(300, 0, 0.0), drive.vehicle(8.0));
        let Ok(mount) = find_mount(&model, None, &Options::default(), 3) else { continue };
        let chain = GroundChain {
            background: &model,
            labeled: &[],
            dominant: None,
            mount: Some(&mount),
            hovering: None,
            shape: SHAPE,
        };
        let found = chain.planes(ObjectId(1), &vehicle, &Options::default(), 3);
        for (frame, plane) in found.planes.iter().filter(|(frame, _)| frame.0 >= 40) {
            let z = 0.3 * f64::from(frame.0) + 8.0;
            let error = plane.signed_distance(Point3::new(0.2, drive.road_at(z), z)) / plane.height_std;
            squares += error * error;
            count += 1.0;
            if phase == 0 {
                stds.push(plane.height_std);
            }
        }
    }
    let typical = (squares / count).sqrt();
    assert!(count >= 200.0 && (0.4..1.5).contains(&typical), "{typical} deviations in {count} frames");
    assert!(stds.windows(2).all(|pair| pair[0] <= 1.05 * pair[1]), "it grows with the distance: {stds:?}");
}

#[test]
fn the_road_ahead_follows_later_camera_positions() {
    let drive = Drive { hill: 0.3, ..Drive::STRAIGHT };
    let (model, vehicle) = (drive.background(300, 0, 0.0), drive.vehicle(6.0));
    let mount = find_mount(&model, None, &Options::default(), 3).unwrap();
    let chain = GroundChain {
        background: &model,
        labeled: &[],
        dominant: None,
        mount: Some(&mount),
        hovering: None,
        shape: SHAPE,
    };
    let found = chain.planes(ObjectId(1), &vehicle, &Options::default(), 3);
    assert_eq!((found.planes.len(), found.skipped.len()), (NUM_FRAMES as usize, 0));
    for (frame, plane) in &found.planes {
        assert_eq!(plane.basis, PlaneBasis::Mount);
        assert!(plane.common_height_std <= plane.height_std && plane.height_std.is_finite());
        let z = 0.3 * f64::from(frame.0) + 6.0;
        let error = plane.signed_distance(Point3::new(0.2, drive.road_at(z), z));
        // Covered by later camera positions; beyond the last one the road is extrapolated.
        let is_covered = z < 17.0;
        assert!(!is_covered || error.abs() < 0.1 * HEIGHT, "{frame:?}: {error}");
    }
}

/// A plane of few noisy points varies from frame to frame; where the points confirm the road, the road is better.
#[test]
fn the_road_replaces_planes_of_points_that_confirm_it() {
    let (model, vehicle) = (Drive::STRAIGHT.background(250, 0, 1.5), Drive::STRAIGHT.vehicle(6.0));
    let mount = find_mount(&model, None, &Options::default(), 3).unwrap();
    let mut lifted = model.clone();
    lifted.points.values_mut().for_each(|point| point.position.y -= 0.3 * HEIGHT);
    let labeled: Vec<Point3dId> = model.points.keys().copied().collect();
    let num_on_road = |background: &Reconstruction| {
        let chain = GroundChain {
            background,
            labeled: &labeled,
            dominant: None,
            mount: Some(&mount),
            hovering: None,
            shape: SHAPE,
        };
        let found = chain.planes(ObjectId(1), &vehicle, &Options { num_neighbors: 15, ..Options::default() }, 3);
        found.planes.values().filter(|plane| plane.basis == PlaneBasis::Mount).count()
    };
    let [confirmed, contradicted] = [num_on_road(&model), num_on_road(&lifted)];
    assert!(confirmed >= 10 && contradicted == 0, "{confirmed} and {contradicted} of {NUM_FRAMES} frames");
}
