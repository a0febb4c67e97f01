//! Motion that determines no depth, or little.

use super::*;

const POINTS: usize = 400;

/// Tracks of all points in all views that observe them, with noise.
pub fn observed_by_all(camera: &Camera, poses: &[Rigid3], points: &[Point3<f64>], noise_px: f64) -> TrackTable {
    let mut rng = seeded_rng(21, 0);
    let normal = Normal::new(0.0, noise_px).unwrap();
    let empty = World { camera: *camera, poses: poses.to_vec(), points: Vec::new() };
    let mut table = tracks(&empty, noise_px, 0, &mut rng);
    for point in points {
        let mut track = Track::new();
        for (view, pose) in poses.iter().enumerate() {
            let Some(pixel) = camera.pixel_from_cam(*pose * *point).filter(|p| camera.contains(*p)) else { continue };
            let source = &mut table.views[view];
            track.push(Feature { view: view as u32, feature: source.pixels.len() as u32 });
            source.pixels.push(pixel + nalgebra::Vector2::from_fn(|_, _| normal.sample(&mut rng)));
            source.rgb.push([120; 3]);
        }
        table.tracks.push(track);
    }
    table.tracks.retain(|t| t.len() >= 2);
    table
}

/// Landscape in front of the camera, from 6 to 30 units away.
fn landscape() -> Vec<Point3<f64>> {
    landscape_along(0.0)
}

/// Landscape in front of a camera that moves to the right by a distance.
pub fn landscape_along(length: f64) -> Vec<Point3<f64>> {
    let mut rng = seeded_rng(22, 0);
    let mut point = || {
        let z = rng.random_range(6.0..30.0);
        let along = if length > 0.0 { rng.random_range(0.0..length) } else { 0.0 };
        Point3::new(along + z * rng.random_range(-0.9..0.9), z * rng.random_range(-0.4..0.4), z)
    };
    (0..POINTS).map(|_| point()).collect()
}

fn turned(angle: f64, center: Point3<f64>) -> Rigid3 {
    let rotation = UnitQuaternion::from_euler_angles(0.2 * angle, angle, 0.05 * angle);
    Rigid3::from_rotation_and_center(rotation.inverse(), center)
}

fn both(table: &TrackTable, camera: &Camera) -> [(Reconstruction, Report); 2] {
    let options = Options::background();
    let known = reconstruct(table, &[*camera], Intrinsics::FIXED, &options, 0).unwrap();
    let guess = Camera::prior(camera.width, camera.height);
    [known, reconstruct(table, &[guess], Intrinsics::GUESSED, &options, 0).unwrap()]
}

pub fn camera() -> Camera {
    Camera::with_focal(960, 540, 900.0)
}

#[test]
fn a_stationary_camera_is_reported() {
    let poses: Vec<Rigid3> = (0..15).map(|_| Rigid3::identity()).collect();
    for (found, report) in both(&observed_by_all(&camera(), &poses, &landscape(), 0.2), &camera()) {
        assert!(found.is_empty());
        assert!(report.failure.clone().unwrap().contains("camera stationary"), "{:?}", report.failure);
    }
}

#[test]
fn a_rotating_camera_gives_no_map() {
    let poses: Vec<Rigid3> = (0..15).map(|k| turned(0.03 * f64::from(k), Point3::origin())).collect();
    for (found, report) in both(&observed_by_all(&camera(), &poses, &landscape(), 0.2), &camera()) {
        assert!(found.is_empty(), "{} views, {} points", found.images.len(), found.points.len());
        assert!(report.failure.clone().unwrap().contains("only rotates"), "{:?}", report.failure);
    }
}

#[test]
fn a_rotating_and_translating_camera_gives_a_map() {
    let center = |k: f64| Point3::new(0.25 * k, 0.02 * k * k, 0.0);
    let poses: Vec<Rigid3> = (0..15).map(|k| turned(0.02 * f64::from(k), center(f64::from(k)))).collect();
    for (found, report) in both(&observed_by_all(&camera(), &poses, &landscape(), 0.2), &camera()) {
        assert_eq!(found.images.len(), 15);
        let weak = |r: &ModelWeakness| matches!(r, ModelWeakness::PlanarScene { .. } | ModelWeakness::ForwardMotion);
        assert!(report.failure.is_none() && !report.remarks.iter().any(weak), "{:?}", report.remarks);
    }
}

#[test]
fn a_plane_is_reconstructed_and_reported() {
    let mut rng = seeded_rng(23, 0);
    let points: Vec<Point3<f64>> =
        (0..POINTS).map(|_| Point3::new(rng.random_range(-6.0..6.0), rng.random_range(-6.0..6.0), 0.0)).collect();
    let pose = |k: u32| {
        let t = f64::from(k) / 20.0;
        look_at(Point3::new(9.0 * t.cos(), 9.0 * t.sin(), 7.0), Point3::origin())
    };
    let poses: Vec<Rigid3> = (0..20).map(pose).collect();
    let [(found, report), (_, guessed)] = both(&observed_by_all(&camera(), &poses, &points, 0.2), &camera());
    assert_eq!(found.images.len(), 20);
    let world = World { camera: camera(), poses, points };
    assert!(center_error(&found, &world) < 0.02, "{}", center_error(&found, &world));
    assert_eq!(report.remarks, [ModelWeakness::PlanarScene { intrinsics_refined: false }]);
    assert!(
        guessed.remarks.contains(&ModelWeakness::PlanarScene { intrinsics_refined: true }),
        "{:?}",
        guessed.remarks
    );
}

#[test]
fn forward_motion_is_reconstructed_and_reported() {
    let center = |k: f64| Point3::new(0.01 * k, 0.03 * k.sin(), 0.3 * k);
    let poses: Vec<Rigid3> = (0..15).map(|k| turned(0.004 * f64::from(k % 3), center(f64::from(k)))).collect();
    let table = observed_by_all(&camera(), &poses, &landscape(), 0.2);
    let (found, report) = reconstruct(&table, &[camera()], Intrinsics::FIXED, &Options::background(), 0).unwrap();
    assert_eq!(found.images.len(), 15);
    let world = World { camera: camera(), poses, points: Vec::new() };
    assert!(center_error(&found, &world) < 0.02, "{}", center_error(&found, &world));
    assert_eq!(report.remarks, [ModelWeakness::ForwardMotion]);
}

/// Over nearly flat ground, looking straight down, with a rolling shutter.
#[test]
fn a_single_flight_looking_down_keeps_the_simplest_intrinsics() {
    let mut rng = seeded_rng(24, 0);
    let points: Vec<Point3<f64>> = (0..1200)
        .map(|_| Point3::new(rng.random_range(-30.0..110.0), rng.random_range(-20.0..20.0), rng.random_range(0.0..1.0)))
        .collect();
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let center = |k: f64| Point3::new(6.0 * k, 0.3 * k.sin(), 40.0 + 0.2 * (2.0 * k).cos());
    let poses: Vec<Rigid3> = (0..14).map(|k| Rigid3::from_rotation_and_center(down, center(f64::from(k)))).collect();
    let mut table = observed_by_all(&camera(), &poses, &points, 0.2);
    for pixel in table.views.iter_mut().flat_map(|view| &mut view.pixels) {
        pixel.x += 3.0 * (pixel.y / 540.0 - 0.5);
    }
    let guess = Camera::prior(960, 540);
    let (found, report) = reconstruct(&table, &[guess], Intrinsics::GUESSED, &Options::background(), 0).unwrap();
    assert_eq!(found.images.len(), 14);
    assert!(report.remarks.iter().any(|r| matches!(r, ModelWeakness::LooseFocalLength { .. })), "{:?}", report.remarks);
    let lens = found.cameras.values().next().unwrap();
    assert_eq!((lens.radial[1], lens.principal), (0.0, [480.0, 270.0]));
    let world = World { camera: camera(), poses, points };
    // The height over the ground depends on the focal length, the trajectory does not.
    assert!(center_error(&found, &world) < 0.5, "{}", center_error(&found, &world));
}

/// Around a box of points, which determines all intrinsics.
#[test]
fn both_distortion_coefficients_are_estimated_where_determined() {
    let lens = Camera { radial: [-0.12, 0.04], ..camera() };
    let world = World { camera: lens, ..world(40, 600) };
    let table = tracks(&world, 0.2, 20, &mut seeded_rng(3, 0));
    let guess = Camera::prior(960, 540);
    let (found, report) = reconstruct(&table, &[guess], Intrinsics::GUESSED, &Options::background(), 1).unwrap();
    assert_eq!(report.num_registered(), 40);
    let found = found.cameras.values().next().unwrap();
    assert!((found.radial[0] + 0.12).abs() < 0.02 && (found.radial[1] - 0.04).abs() < 0.04, "{:?}", found.radial);
    assert!((found.mean_focal() / 900.0 - 1.0).abs() < 0.01 && report.remarks.is_empty(), "{:?}", report.remarks);
}
