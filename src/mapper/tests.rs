//! The mapper on worlds whose truth is known.

use nalgebra::{Point2, Point3, UnitQuaternion, Vector3};
use rand::Rng as _;
use rand_distr::{Distribution, Normal};

mod far_vehicle;
mod held_poses;
mod joints;
mod lens;
mod long_video;
mod motion;
mod repetition;
mod several_cameras;

use super::*;
use crate::bundle::{self, CameraBlock, Problem};
use crate::features::tracks::{Feature, Track};
use crate::math::{Rigid3, Rng, seeded_rng, umeyama};
use crate::scene::ImageId;
use crate::synthetic::{empty_table, observe};

/// Camera on an arc that looks at a box of points.
struct World {
    camera: Camera,
    poses: Vec<Rigid3>,
    points: Vec<Point3<f64>>,
}

fn look_at(center: Point3<f64>, target: Point3<f64>) -> Rigid3 {
    let forward = (target - center).normalize();
    let right = forward.cross(&Vector3::new(0.0, 0.0, 1.0)).normalize();
    let down = forward.cross(&right);
    let rotation = nalgebra::Rotation3::from_basis_unchecked(&[right, down, forward]).inverse();
    Rigid3::from_rotation_and_center(UnitQuaternion::from_rotation_matrix(&rotation), center)
}

fn world(num_views: u32, num_points: usize) -> World {
    let mut rng = seeded_rng(4, 4);
    let pose = |i: u32| {
        let t = f64::from(i) / 20.0;
        look_at(Point3::new(12.0 * t.cos(), 12.0 * t.sin(), 5.0 + t), Point3::origin())
    };
    let points = (0..num_points).map(|_| Point3::from(Vector3::from_fn(|_, _| rng.random_range(-3.0..3.0)))).collect();
    World { camera: Camera::with_focal(960, 540, 900.0), poses: (0..num_views).map(pose).collect(), points }
}

/// Tracks of all points over windows of fifteen views, with noise; `wrong` of them are outliers from halfway on.
fn tracks(world: &World, noise_px: f64, wrong: usize, rng: &mut Rng) -> TrackTable {
    tracks_over(15, world, noise_px, wrong, rng)
}

/// Tracks of all points over windows of some views, with noise; `wrong` of them are outliers from halfway on.
fn tracks_over(window: usize, world: &World, noise_px: f64, wrong: usize, rng: &mut Rng) -> TrackTable {
    let normal = Normal::new(0.0, noise_px.max(1e-12)).unwrap();
    let mut table = empty_table(world.poses.len());
    for (index, point) in world.points.iter().enumerate() {
        // Windows extend over both ends, so that the first and the last view observe as much as the others.
        let end = rng.random_range(window / 2..world.poses.len() + window / 2);
        let first = end.saturating_sub(window);
        let mut track = Track::new();
        for view in first..end.min(world.poses.len()) {
            let Some(mut pixel) = world.camera.pixel_from_cam(world.poses[view] * *point) else { continue };
            pixel += nalgebra::Vector2::new(normal.sample(rng), normal.sample(rng));
            if index < wrong && view > first + window / 2 {
                pixel = Point2::new(rng.random_range(0.0..960.0), rng.random_range(0.0..540.0));
            }
            observe(&mut table, &mut track, view, pixel);
        }
        table.tracks.push(track);
    }
    table
}

/// Root mean square distance of the centers after alignment, in units of the world.
fn center_error(reconstruction: &Reconstruction, world: &World) -> f64 {
    let (found, truth): (Vec<_>, Vec<_>) = reconstruction
        .images
        .iter()
        .map(|(id, image)| (image.cam_from_world.center(), world.poses[id.0 as usize - 1].center()))
        .unzip();
    let similarity = umeyama(&found, &truth).unwrap();
    let sum: f64 = found.iter().zip(&truth).map(|(a, b)| (similarity * *a - b).norm_squared()).sum();
    (sum / found.len() as f64).sqrt()
}

#[test]
fn exact_tracks_give_the_exact_trajectory() {
    let world = world(30, 400);
    let table = tracks(&world, 0.0, 0, &mut seeded_rng(1, 0));
    let (found, report) = reconstruct(&table, &[world.camera], Intrinsics::FIXED, &Options::background(), 1).unwrap();
    assert_eq!(report.num_registered(), 30);
    assert!(center_error(&found, &world) < 1e-4, "{}", center_error(&found, &world));
}

#[test]
fn noise_and_wrong_tracks_are_tolerated_and_seeds_repeat() {
    let world = world(40, 600);
    let table = tracks(&world, 0.3, 80, &mut seeded_rng(2, 0));
    let run = || reconstruct(&table, &[world.camera], Intrinsics::FIXED, &Options::background(), 1).unwrap();
    let (found, report) = run();
    assert_eq!(report.num_registered(), 40);
    // 0.3 px at 900 px focal length and 13 units distance are 4 mm; hundreds of points average that down.
    assert!(center_error(&found, &world) < 0.01, "{}", center_error(&found, &world));
    assert_eq!(run().0, found);
}

#[test]
fn two_threads_agree_with_one() {
    // Over windows of most views so many pairs see common points that the reduced system, of more than a thousand
    // unknowns, is dense: the one thing that two threads compute in another order.
    let world = world(180, 400);
    let table = tracks_over(150, &world, 0.3, 20, &mut seeded_rng(6, 0));
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let work = || reconstruct(&table, &[world.camera], Intrinsics::FIXED, &Options::background(), 1);
        pool.install(work).unwrap().0
    };
    let (one, two) = (on(1), on(2));
    assert!(one.images.len() == 180 && one.images.keys().eq(two.images.keys()));
    assert_eq!(one.points.len(), two.points.len());
    let centers = |of: &Reconstruction| of.images.values().map(|i| i.cam_from_world.center()).collect::<Vec<_>>();
    let (one, two) = (centers(&one), centers(&two));
    let length: f64 = one.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let largest = one.iter().zip(&two).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    // Rounding errors of 1e-16 are magnified by the condition of the system, about 1e7 here.
    assert!(largest < 1e-8 * length, "centres differ by {largest} on a path of {length}");
}

#[test]
fn unknown_focal_length_is_found() {
    let world = world(40, 600);
    let table = tracks(&world, 0.2, 20, &mut seeded_rng(3, 0));
    let guess = Camera::prior(960, 540);
    let (found, report) = reconstruct(&table, &[guess], Intrinsics::GUESSED, &Options::background(), 1).unwrap();
    assert_eq!(report.num_registered(), 40);
    let focal = found.cameras.values().next().unwrap().mean_focal();
    assert!((focal / 900.0 - 1.0).abs() < 0.01, "{focal}");
}

#[test]
fn the_principal_point_is_estimated_only_where_views_rotate() {
    let off_center = |mut world: World| {
        world.camera.principal = [492.0, 262.0];
        let table = tracks(&world, 0.2, 20, &mut seeded_rng(3, 0));
        let guess = Camera::prior(960, 540);
        let (found, report) = reconstruct(&table, &[guess], Intrinsics::GUESSED, &Options::background(), 1).unwrap();
        assert_eq!(report.num_registered(), world.poses.len());
        found.cameras[&crate::scene::CameraId(1)].principal
    };
    // Round the scene, with the camera rolled by a right angle in every other view.
    let mut turning = world(40, 600);
    for (k, pose) in turning.poses.iter_mut().enumerate() {
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), (k % 2) as f64 * std::f64::consts::FRAC_PI_2);
        *pose = Rigid3::new(roll, Vector3::zeros()) * *pose;
    }
    let [x, y] = off_center(turning);
    assert!((x - 492.0).abs() < 1.5 && (y - 262.0).abs() < 1.5, "{x} {y}");
    // Straight on, looking aside: a shift of the principal point is the same as a turn of all views.
    let mut straight = world(40, 600);
    for (k, pose) in straight.poses.iter_mut().enumerate() {
        let center = Point3::new(12.0, -6.0 + 0.3 * k as f64, 0.0);
        *pose = look_at(center, center - Vector3::x());
    }
    let [x, y] = off_center(straight);
    assert!((x - 480.0).abs() < 12.0 && (y - 270.0).abs() < 8.0, "{x} {y}");
}

#[test]
fn failures_have_a_reason() {
    let empty = TrackTable::default();
    let camera = Camera::prior(960, 540);
    let (found, report) = reconstruct(&empty, &[camera], Intrinsics::FIXED, &Options::object(), 0).unwrap();
    assert!(found.is_empty() && report.failure.is_some());

    // A view without features, in the middle of a good sequence.
    let world = world(30, 300);
    let mut table = tracks(&world, 0.1, 0, &mut seeded_rng(5, 0));
    for track in &mut table.tracks {
        track.retain(|f| f.view != 12);
    }
    table.views[12].pixels.clear();
    table.views[12].rgb.clear();
    let (_, report) = reconstruct(&table, &[world.camera], Intrinsics::FIXED, &Options::background(), 0).unwrap();
    assert_eq!(report.failures().collect::<Vec<_>>(), [("000012.jpg", &Reason::NoFeatures)]);
}

#[test]
fn options_that_pass_the_check_do_no_harm() {
    let world = world(8, 60);
    let tracks = tracks(&world, 0.3, 6, &mut seeded_rng(7, 0));
    let mut num_passed = 0;
    for (changed, options) in crate::checks::testing::variations(&Options::object()) {
        let mut table = tracks.clone();
        if options.check().is_err() {
            continue;
        }
        num_passed += 1;
        cut_long_tracks(&mut table, &[world.camera], Intrinsics::GUESSED, &options, 1);
        let found = reconstruct(&table, &[world.camera], Intrinsics::GUESSED, &options, 1);
        assert!(found.is_ok(), "{changed}: {:?}", found.err());
    }
    assert!(num_passed > 50, "{num_passed}");
}

#[test]
fn options_that_do_not_pass_the_check_are_rejected() {
    let options = Options { min_error_px: 5.0, ..Options::object() };
    let rejected = reconstruct(&TrackTable::default(), &[], Intrinsics::FIXED, &options, 0);
    assert!(matches!(rejected, Err(MapperError::Option(error)) if error.key == "min_error_px"));
}

#[test]
fn the_result_is_at_its_minimum() {
    let world = world(30, 500);
    let mut rng = seeded_rng(8, 0);
    let mut table = tracks(&world, 0.1, 0, &mut rng);
    // One position in ten is off by more than the noise, and by less than the limits at unknown noise.
    for pixel in table.views.iter_mut().flat_map(|view| &mut view.pixels) {
        if rng.random_bool(0.1) {
            let (angle, distance) = (rng.random_range(0.0..std::f64::consts::TAU), rng.random_range(1.0..2.5));
            *pixel += distance * nalgebra::Vector2::new(f64::cos(angle), f64::sin(angle));
        }
    }
    let (found, _) = reconstruct(&table, &[world.camera], Intrinsics::FIXED, &Options::background(), 1).unwrap();
    let mut problem = Problem::from_reconstruction(&found, |_, camera| CameraBlock::fixed(*camera));
    let cost = |problem: &mut Problem| {
        let exactly = bundle::Options { function_tolerance: 1e-12, ..bundle::Options::default() };
        let summary = bundle::adjust(problem, &exactly).unwrap();
        (summary.initial_cost, summary.final_cost)
    };
    problem.poses.iter_mut().for_each(|pose| pose.fixed = true);
    let (written, least) = cost(&mut problem);
    assert!(written <= 1.01 * least, "points alone: {written} {least}");
    problem.poses.iter_mut().for_each(|pose| pose.fixed = false);
    let (_, least) = cost(&mut problem);
    assert!(written <= 1.02 * least, "with the cameras: {written} {least}");
}
