//! Tests of the ground below a camera that does not translate.

use std::f64::consts::FRAC_PI_2;

use nalgebra::UnitQuaternion;
use rand::Rng as _;
use rand_distr::StandardNormal;

use super::vehicle_sizes::VehicleImage;
use super::*;
use crate::camera::{Camera, up_in_cam};
use crate::math::{Rigid3, median, seeded_rng};
use crate::scene::{CameraId, ImageId, Observation, Point3dId};

/// Stationary camera, inclined down by `pitch`, rolled by `roll`; vehicles of 4.5 m drive on straight lines.
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
            let driven = 0.5 * f64::from(frame);
            let (x, y) = (start[0] + driven * heading.cos(), start[1] + driven * heading.sin());
            let point = Point3::from(right * x + ahead * y - up * HEIGHT);
            let Some(pixel) = camera.pixel_from_cam(point).filter(|pixel| camera.contains(*pixel)) else {
                continue;
            };
            let noise = (0.02 * rng.sample::<f64, _>(StandardNormal)).exp();
            let forward = right * heading.cos() + ahead * heading.sin();
            let image = VehicleImage {
                camera,
                cam_from_world: UnitQuaternion::identity(),
                ray: up,
                neighbors: [up; 2],
                log_extent: 0.0,
            };
            let box_px = image.box_extent_px(&(point.coords / HEIGHT), &forward, &up).unwrap();
            let extent_px = noise * size / HEIGHT * box_px;
            let half = Vector2::repeat(0.5 * extent_px);
            images.extend(Rect::around(&[pixel - half, pixel + half]).map(|bounds| (FrameId(frame), bounds)));
        }
        images
    };
    (background, (0..6).map(|_| vehicle()).collect(), up)
}

#[test]
fn sizes_of_vehicles_determine_the_ground() {
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
    // In views near the nadir few paths determine the ground; then there is no result.
    let within = found.iter().filter(|(_, error, std)| *error <= 2.0 * std).count();
    assert!(found.len() * 3 >= all * 2 && within * 10 >= found.len() * 9, "{} of {all}: {found:?}", found.len());
}

#[test]
fn the_tilt_std_grows_with_the_noise_of_the_sizes() {
    // In nadir views, extents that grow along each path would be explained by an inclined ground.
    let mut errors = Vec::new();
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
        errors.extend(solver.tilt(&[]).map(|tilt| {
            (solver.problem.normal(tilt.angles).angle(&up), tilt.covariance.trace().sqrt(), solver.problem.noise)
        }));
    }
    let within = errors.iter().filter(|(error, std, _)| error <= std).count();
    assert!(errors.len() > 6 && within * 3 >= errors.len() * 2, "{errors:?}");
    assert!(errors.iter().all(|(error, std, _)| *error < 3.0 * std), "{errors:?}");
    assert!(median(errors.iter().map(|(.., noise)| *noise).collect()).unwrap() > 1.5, "{errors:?}");
}

#[test]
fn a_given_vertical_determines_the_ground_in_nadir_views_too() {
    for (pitch, tilt) in [(0.6, 0.02), (FRAC_PI_2, 0.03), (1.6, -0.01)] {
        let (background, ..) = scene(1.0, 0.0, 1);
        let up = up_in_cam(Vector2::new(pitch, tilt));
        let found = hovering_ground(
            &background,
            &[],
            vec![TiltEstimate {
                kind: TiltKind::Vertical,
                ..TiltEstimate::of_up("telemetry", &up, &(Matrix3::identity() * 4e-4))
            }],
            0.0,
        )
        .unwrap();
        assert!(found.normal_in_world.angle(&up) < 1e-4 && (found.tilt_std - 0.0283).abs() < 1e-3, "{found:?}");
    }
}

#[test]
fn the_plane_of_a_map_is_used_without_fusion() {
    let (background, vehicles, up) = scene(0.6, 0.0, 1);
    let of_map = up_in_cam(Vector2::new(0.63, 0.01));
    let tilt = |kind| TiltEstimate { kind, ..TiltEstimate::of_up("map", &of_map, &(Matrix3::identity() * 4e-4)) };
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
    // The ground is higher by a tenth of the camera's height where the ray of the image center meets it.
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
        let tilt = TiltEstimate { kind, ..TiltEstimate::of_up("map", &up, &(Matrix3::identity() * 4e-4)) };
        let ground = hovering_ground(&background, &vehicles, vec![tilt], 0.0).unwrap();
        let planes = ground.planes(&background, &background).planes;
        let plane = planes.values().next().unwrap();
        (plane.signed_distance(Point3::origin()), plane.normal.angle(&up))
    };
    let (level, lifted) = (height(Vec::new()), height(relief));
    assert!((level.0 - 1.0).abs() < 1e-6 && (lifted.0 - 0.9).abs() < 2e-3 && lifted.1 < 0.01, "{level:?} {lifted:?}");
}

#[test]
fn a_change_of_the_focal_length_rotates_the_ground_as_predicted() {
    let (mut background, vehicles, _) = scene(0.8, 0.0, 3);
    let focal_std = 0.1;
    let found = |background: &Reconstruction| hovering_ground(background, &vehicles, Vec::new(), focal_std).unwrap();
    let original = found(&background);
    let camera = background.cameras[&CameraId(1)];
    background.cameras.insert(CameraId(1), camera.zoomed(focal_std.exp()));
    let turned = found(&background).normal_in_world - original.normal_in_world;
    assert!(turned.norm() > 0.01, "{turned}");
    assert!((turned - original.normal_by_focal).norm() < 0.3 * turned.norm(), "{turned} {original:?}");
    assert!(original.total_tilt_std() > original.tilt_std);
}

#[test]
fn sources_that_disagree_have_a_larger_std() {
    let (background, ..) = scene(0.6, 0.0, 1);
    let tilt = |pitch: f64| TiltEstimate {
        source: "pitch".to_owned(),
        angles: [pitch, 0.0],
        std: [Some(0.02), Some(0.02)],
        kind: TiltKind::Vertical,
    };
    let found = |other: f64| hovering_ground(&background, &[], vec![tilt(0.6), tilt(other)], 0.0).unwrap();
    let (agreed, contradictory) = (found(0.61), found(0.72));
    assert!((agreed.tilt_std - 0.02).abs() < 1e-3, "{agreed:?}");
    assert!((contradictory.pitch - 0.66).abs() < 1e-3 && contradictory.tilt_std > 0.05, "{contradictory:?}");
    assert_eq!(contradictory.contradictions.len(), 2);
}

#[test]
fn a_given_pitch_determines_the_ground_and_no_source_does_not() {
    let (background, vehicles, up) = scene(0.6, 0.0, 1);
    let pitch = |pitch: f64| {
        vec![TiltEstimate {
            source: "pitch".to_owned(),
            angles: [pitch, 0.0],
            std: [Some(0.01), None],
            kind: TiltKind::Ground,
        }]
    };
    let by_pitch = hovering_ground(&background, &[], pitch(0.6), 0.0).unwrap();
    assert!(by_pitch.normal_in_world.angle(&up) < 1e-3 && by_pitch.tilt_std < 0.04, "{by_pitch:?}");
    assert_eq!(hovering_ground(&background, &[], Vec::new(), 0.0), None);
    assert_eq!(by_pitch.by_vehicles, None);
    let both = hovering_ground(&background, &vehicles, pitch(0.6), 0.0).unwrap();
    let alone = hovering_ground(&background, &vehicles, Vec::new(), 0.0).unwrap();
    assert_eq!(both.by_vehicles.as_ref().map(|tilt| tilt.angles[0]), Some(alone.pitch));
    assert!(both.tilt_std <= by_pitch.tilt_std && both.num_vehicles > 3 && both.contradictions.is_empty());
    let wrong = hovering_ground(&background, &vehicles, pitch(1.2), 0.0).unwrap();
    assert!(wrong.contradictions[0].deviations > 3.0 && wrong.contradictions[0].angle > 0.3, "{wrong:?}");
    let planes = both.planes(&background, &background);
    assert!(planes.planes.is_empty() && planes.skipped.len() == 100);
}
