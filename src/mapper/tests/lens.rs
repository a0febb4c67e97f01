//! Estimated focal lengths and their standard deviations.

use super::*;
use crate::mapper::focal_length::{focal_deviation_here, focal_evidence};

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
fn a_focal_length_is_no_farther_off_than_is_said() {
    let (round, weak) = (world(40, 600), forward_flight(12, 0.3));
    let (off_round, said_round) = found(&round, 1152.0, Intrinsics::Refined);
    let (off_weak, said_weak) = found(&weak, 1152.0, Intrinsics::Refined);
    assert!(off_round.abs() <= 3.0 * said_round && said_round < 0.01, "{off_round} {said_round}");
    assert!(off_weak.abs() <= 3.0 * said_weak && said_weak < 0.5, "{off_weak} {said_weak}");
    assert!(said_weak > 2.0 * said_round, "{said_weak} {said_round}");
}

#[test]
fn what_files_state_holds_a_weak_motion_and_gives_way_to_a_strong_one() {
    let (off, said) = found(&forward_flight(12, 0.3), 930.0, Intrinsics::Stated);
    assert!(off.abs() < 0.1 && said <= 0.1, "{off} {said}");
    // Where the motion tells it, what is stated wrongly does no harm.
    let (off, said) = found(&world(40, 600), 990.0, Intrinsics::Stated);
    assert!(off.abs() < 0.02 && said < 0.015, "{off} {said}");
}

#[test]
fn intrinsics_that_are_given_have_no_deviation() {
    let world = world(12, 300);
    let table = tracks(&world, 0.2, 0, &mut seeded_rng(3, 0));
    let (_, report) = reconstruct(&table, &[world.camera], Intrinsics::Fixed, &Options::background(), 1).unwrap();
    assert_eq!(report.focal_deviation(), None);
}

#[test]
fn the_normal_equations_say_of_a_focal_length_what_three_adjustments_say() {
    for world in [world(40, 600), forward_flight(12, 0.3)] {
        let table = tracks(&world, 0.3, 30, &mut seeded_rng(12, 0));
        let (cameras, known) = ([Camera::with_focal(960, 540, 990.0)], KnownIntrinsics::from(Intrinsics::Refined));
        let options = Options::background();
        let task = initialization::InitializationAttempt {
            table: &table,
            cameras: &cameras,
            known: &known,
            options: &options,
            beside: Priors::default(),
        };
        let growth = task.grow_from_starts(1, &mut |_| {}).unwrap().best.unwrap();
        let Noise::Measured { sigma_px } = growth.map().noise() else { panic!("a map has a noise") };
        let here = focal_deviation_here(growth.map(), 0, sigma_px, &options).unwrap();
        let adjusted = focal_evidence(growth.map(), &[0], sigma_px, &options).unwrap().together;
        // Beyond a factor of e nothing is known, by how much does not matter.
        assert!((here.min(1.0) / adjusted.min(1.0)).ln().abs() < 0.25, "{here} {adjusted}");
    }
}
