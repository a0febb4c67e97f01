//! Estimated focal lengths and their standard deviations.

use super::*;
use crate::mapper::adjustment::Freedom;
use crate::mapper::focal_length::{focal_evidence, linearized_focal_std};
use crate::scene::CameraId;

/// A camera that flies straight ahead through points on all sides.
fn forward_flight(num_views: u32, step: f64) -> World {
    let mut rng = seeded_rng(11, 0);
    let pose = |k: u32| Rigid3::from_rotation_and_center(UnitQuaternion::identity(), ahead(step * f64::from(k)));
    let ahead_of = |rng: &mut Rng| {
        Point3::new(rng.random_range(-6.0..6.0), rng.random_range(-3.0..3.0), rng.random_range(12.0..30.0))
    };
    let points = (0..600).map(|_| ahead_of(&mut rng)).collect();
    World { camera: Camera::with_focal(960, 540, 900.0), poses: (0..num_views).map(pose).collect(), points }
}

fn ahead(z: f64) -> Point3<f64> {
    Point3::new(0.02 * z.sin(), 0.0, z)
}

/// Error of ln f, and its reported standard deviation.
fn found(world: &World, guess_px: f64, intrinsics: Intrinsics) -> (f64, f64) {
    let table = tracks(world, 0.3, 30, &mut seeded_rng(12, 0));
    let guess = Camera::with_focal(960, 540, guess_px);
    let (model, report) = reconstruct(&table, &[guess], intrinsics, &Options::background(), 1).unwrap();
    assert_eq!(report.num_registered(), world.poses.len());
    let focal = model.cameras.values().next().unwrap().mean_focal();
    ((focal / 900.0).ln(), report.focal_deviation().unwrap())
}

#[test]
fn focal_length_errors_are_within_three_sigma() {
    let (round, weak) = (world(40, 600), forward_flight(12, 0.3));
    let (off_round, std_round) = found(&round, 1152.0, Intrinsics::GUESSED);
    let (off_weak, std_weak) = found(&weak, 1152.0, Intrinsics::GUESSED);
    assert!(off_round.abs() <= 3.0 * std_round && std_round < 0.01, "{off_round} {std_round}");
    assert!(off_weak.abs() <= 3.0 * std_weak && std_weak < 0.5, "{off_weak} {std_weak}");
    assert!(std_weak > 2.0 * std_round, "{std_weak} {std_round}");
}

#[test]
fn the_prior_of_a_file_dominates_a_weak_motion_but_not_a_strong_one() {
    let (off, std) = found(&forward_flight(12, 0.3), 930.0, Intrinsics::STATED);
    assert!(off.abs() < 0.1 && std <= 0.1, "{off} {std}");
    // Where the motion determines it, a wrong prior does no harm.
    let (off, std) = found(&world(40, 600), 990.0, Intrinsics::STATED);
    assert!(off.abs() < 0.02 && std < 0.015, "{off} {std}");
}

/// The arc with a focal length 2 % longer, a principal point off by 1 % of the width, and more distortion than
/// calibrated.
fn wrongly_calibrated() -> (World, Camera, TrackTable) {
    let mut world = world(40, 600);
    let given = world.camera;
    world.camera = Camera { principal: [470.4, 279.6], radial: [0.03, 0.0], ..Camera::with_focal(960, 540, 918.0) };
    let table = tracks(&world, 0.2, 20, &mut seeded_rng(3, 0));
    (world, given, table)
}

fn reconstructed(table: &TrackTable, camera: Camera, known: Intrinsics) -> (Reconstruction, Report) {
    reconstruct(table, &[camera], known, &Options::background(), 1).unwrap()
}

#[test]
fn a_wrong_calibration_is_adjusted_and_detected() {
    let (world, given, table) = wrongly_calibrated();
    let id = CameraId(1);
    let [exact, adjusted, held] =
        [(world.camera, Intrinsics::FIXED), (given, Intrinsics::GIVEN), (given, Intrinsics::FIXED)].map(
            |(camera, known)| {
                let (found, report) = reconstructed(&table, camera, known);
                assert_eq!(report.num_registered(), 40);
                let fit = calibration_fit(&found, id, &camera, Intrinsics::GIVEN).unwrap().unwrap();
                (center_error(&found, &world), fit, found.cameras[&id], report.focal_deviation())
            },
        );
    assert!(adjusted.0 < 1.5 * exact.0 + 0.001, "{} {}", adjusted.0, exact.0);
    assert!(held.0 > 3.0 * adjusted.0, "{} {}", held.0, adjusted.0);
    let off = (adjusted.2.mean_focal() / 918.0).ln().abs();
    assert!(adjusted.3.is_some_and(|std| off < 3.0 * std && std < 0.01), "{off} {:?}", adjusted.3);
    assert!(!exact.1.is_bad(), "{:?}", exact.1);
    for (_, fit, ..) in [adjusted, held] {
        assert!(fit.gain > 9.0 && fit.gain > exact.1.gain && fit.adjusted_px < fit.given_px, "{fit:?}");
        assert!((fit.adjusted.mean_focal() / 918.0).ln().abs() < 0.01, "{fit:?}");
    }
}

#[test]
fn a_clearly_wrong_calibration_is_detected_whatever_its_prior() {
    let mut world = world(40, 600);
    let given = world.camera;
    world.camera = Camera { principal: [470.4, 279.6], radial: [-0.1, 0.0], ..Camera::with_focal(960, 540, 945.0) };
    let table = tracks(&world, 0.2, 20, &mut seeded_rng(3, 0));
    let narrow = Intrinsics { distortion: 0.05, ..Intrinsics::GIVEN };
    let [of_default, of_narrow] = [Intrinsics::GIVEN, narrow].map(|known| {
        let found = reconstructed(&table, given, known).0;
        let fit = calibration_fit(&found, CameraId(1), &given, known).unwrap().unwrap();
        assert!(fit.is_bad() && fit.adjusted_px < fit.given_px, "{fit:?}");
        fit.gain
    });
    // The cost of the prior is no part of the gain.
    assert!((of_narrow / of_default - 1.0).abs() < 0.1, "{of_narrow} {of_default}");
}

#[test]
fn a_prior_goes_from_held_to_free() {
    let (_, given, table) = wrongly_calibrated();
    let focal = |known| reconstructed(&table, given, known).0.cameras[&CameraId(1)].mean_focal();
    let tiny = Intrinsics { focal: 1e-7, principal: 1e-7, distortion: 1e-7 };
    let wide = Intrinsics { focal: 1.0, principal: 1.0, distortion: 10.0 };
    assert_eq!(focal(Intrinsics::FIXED), given.mean_focal());
    assert!((focal(tiny) / given.mean_focal() - 1.0).abs() < 1e-5, "{}", focal(tiny));
    let (free, given) = (focal(wide), focal(Intrinsics::GIVEN));
    for focal in [focal(Intrinsics::GUESSED), given] {
        assert!((free / focal - 1.0).abs() < 1.5e-2, "{free} {focal}");
    }
    // Each parameter separately: a fixed one stays, whatever the others do.
    let known = Intrinsics { principal: 0.0, ..Intrinsics::GIVEN };
    let (found, _) = reconstructed(&table, Camera::with_focal(960, 540, 900.0), known);
    let camera = found.cameras[&CameraId(1)];
    assert!(camera.principal == [480.0, 270.0] && camera.radial[0] != 0.0 && camera.focal[0] != 900.0, "{camera:?}");
}

#[test]
fn fixed_intrinsics_have_no_std() {
    let world = world(12, 300);
    let table = tracks(&world, 0.2, 0, &mut seeded_rng(3, 0));
    let (_, report) = reconstruct(&table, &[world.camera], Intrinsics::FIXED, &Options::background(), 1).unwrap();
    assert_eq!(report.focal_deviation(), None);
}

#[test]
fn the_linearized_std_of_a_focal_length_is_that_of_three_adjustments() {
    for world in [world(40, 600), forward_flight(12, 0.3)] {
        let table = tracks(&world, 0.3, 30, &mut seeded_rng(12, 0));
        let (cameras, known) = ([Camera::with_focal(960, 540, 990.0)], KnownIntrinsics::from(Intrinsics::GUESSED));
        let options = Options::background();
        let attempt = initialization::InitializationAttempt {
            table: &table,
            cameras: &cameras,
            known: &known,
            options: &options,
            poses: None,
        };
        let mapper = attempt.grow(1, &mut |_| {}).unwrap().unwrap();
        let sigma_px = mapper.map().noise().unwrap();
        let here = linearized_focal_std(mapper.map(), 0, sigma_px, &options).unwrap();
        let adjusted =
            focal_evidence(mapper.map(), &[0], Freedom::FocalAndRadial, sigma_px, &options).unwrap().fully_correlated;
        // Beyond a factor of e the focal length is unknown, and the value does not matter.
        assert!((here.min(1.0) / adjusted.min(1.0)).ln().abs() < 0.25, "{here} {adjusted}");
    }
}
