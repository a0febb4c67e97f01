//! Photographs of several cameras in one map.

use super::*;

const NUM_VIEWS: usize = 30;
/// View 7 is the only one of the third camera; of the others two in three are of the first.
fn camera_of(view: usize) -> usize {
    match view {
        7 => 2,
        _ if view.is_multiple_of(3) => 1,
        _ => 0,
    }
}

/// The usual camera; one turned by a right angle and scaled to a half; a narrower lens on a larger image.
fn cameras() -> [Camera; 3] {
    [Camera::with_focal(960, 540, 900.0), Camera::with_focal(270, 480, 450.0), Camera::with_focal(1200, 900, 1700.0)]
}

/// Tracks of the world's points as these cameras observe them.
fn observed(world: &World, noise_px: f64) -> TrackTable {
    let mut table = tracks(world, noise_px, 30, &mut seeded_rng(21, 0));
    let cameras = cameras();
    for (v, view) in table.views.iter_mut().enumerate() {
        view.camera = camera_of(v);
        let camera = &cameras[view.camera];
        for pixel in &mut view.pixels {
            *pixel = camera.pixel_from_normalized(world.camera.normalized_from_pixel(*pixel));
        }
    }
    table
}

fn unordered() -> Options {
    Options { ordered: false, ..Options::background() }
}

#[test]
fn each_camera_gets_its_own_focal_length() {
    let world = world(NUM_VIEWS as u32, 500);
    let table = observed(&world, 0.2);
    let guesses = cameras().map(|camera| Camera::prior_of_photograph(camera.width, camera.height));
    let (found, report) = reconstruct(&table, &guesses, Intrinsics::GUESSED, &unordered(), 1).unwrap();
    assert_eq!(report.num_registered(), NUM_VIEWS, "{:?}", report.failures().collect::<Vec<_>>());
    assert!(center_error(&found, &world) < 0.02, "{}", center_error(&found, &world));
    for ((camera, truth), focal_std) in found.cameras.values().zip(cameras()).zip(&report.focal_deviations) {
        let off = (camera.mean_focal() / truth.mean_focal()).ln().abs();
        let std = focal_std.unwrap();
        assert!(off < 0.02 && off < 4.0 * std && std < 0.05, "{off} {std}");
        assert_eq!((camera.width, camera.height), (truth.width, truth.height));
    }
    for (view, image) in found.images.values().enumerate() {
        assert_eq!(image.camera.0 as usize, camera_of(view) + 1);
    }
}

#[test]
fn the_calibration_of_one_camera_is_fixed_and_the_others_are_estimated() {
    let world = world(NUM_VIEWS as u32, 500);
    let table = observed(&world, 0.2);
    let [first, second, third] = cameras();
    let cameras = [first, Camera::prior_of_photograph(270, 480), Camera::with_focal(1200, 900, 1750.0)];
    let known = vec![Intrinsics::FIXED, Intrinsics::GUESSED, Intrinsics::STATED];
    let (found, report) = reconstruct(&table, &cameras, known, &unordered(), 1).unwrap();
    assert_eq!(report.num_registered(), NUM_VIEWS);
    let found: Vec<&Camera> = found.cameras.values().collect();
    assert_eq!((*found[0], report.focal_deviations[0]), (first, None));
    for (found, truth) in [(found[1], second), (found[2], third)] {
        assert!((found.mean_focal() / truth.mean_focal()).ln().abs() < 0.02, "{found:?}");
    }
}
