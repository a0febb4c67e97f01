use std::collections::BTreeMap;

use nalgebra::{Point2, Vector3};

use super::*;
use crate::math::Rigid3;
use crate::scene::{FrameId, ObjectId};
use crate::synthetic::drive::{Drive, Noise, Options, drive};
use crate::trajectory::contact::Silhouette;
use crate::trajectory::{Evidence, ModelOrigin, ObjectDescription, place};

const NOISE: Noise = Noise { pixel_px: 0.3, plane_height_m: 0.03, plane_tilt_deg: 0.5, bad_planes: 0.0 };

/// Ideal masks of the vehicle: the convex hulls of its points, wheels included.
fn silhouettes(world: &Drive) -> BTreeMap<FrameId, Silhouette> {
    let hull = |image: &crate::scene::Image| {
        let camera = world.object.camera_of(image);
        let pixels =
            world.object.points.values().filter_map(|p| camera.pixel_from_cam(image.cam_from_world * p.position));
        Silhouette { hull: pixels.collect::<Vec<Point2<f64>>>() }
    };
    world.object.images.iter().map(|(id, image)| (id.frame(), hull(image))).collect()
}

fn evidence<'a>(
    world: &'a Drive,
    object: &'a Reconstruction,
    silhouettes: &'a BTreeMap<FrameId, Silhouette>,
) -> Evidence<'a> {
    let description = ObjectDescription { id: ObjectId(1), class: "car".to_owned(), confidence: 1.0 };
    let (origin, focal_std) = (ModelOrigin::Reconstructed, Some(0.01));
    let Drive { background, planes, frames, .. } = world;
    Evidence { description, origin, background, object, planes, silhouettes, frames, focal_std }
}

fn solve(
    world: &Drive,
    object: &Reconstruction,
    silhouettes: &BTreeMap<FrameId, Silhouette>,
) -> Result<Joint, ScaleError> {
    let options = crate::trajectory::Options::default();
    let views = Views::new(&world.background, object, &world.planes, &options);
    joint(&evidence(world, object, silhouettes), &views, &options)
}

/// Relative error of the ratio for the adjusted size of the object.
fn error(world: &Drive, found: &Joint) -> f64 {
    let size = |object: &Reconstruction| {
        let ids: Vec<_> = found.object.points.keys().collect();
        let distance = |k: usize| (object.points[ids[k]].position - object.points[ids[0]].position).norm();
        (1..ids.len()).map(distance).sum::<f64>()
    };
    found.ratio * size(&found.object) / (world.ratio * size(&world.object)) - 1.0
}

/// Simulated drift of a chain of frames: the object approaches, by a share of its distance from the first frame to the
/// last.
fn drifted(world: &Drive, share: f64) -> Reconstruction {
    let mut object = world.object.clone();
    let center = crate::trajectory::object_center(&object);
    let count = object.images.len() as f64;
    for (k, image) in object.images.values_mut().enumerate() {
        let cam_from_world = image.cam_from_world;
        let away = cam_from_world.center() - center;
        let nearer = center + away * (1.0 + share * (0.5 - k as f64 / count));
        image.cam_from_world = Rigid3::from_rotation_and_center(cam_from_world.rotation, nearer);
    }
    object
}

#[test]
fn drift_is_removed_and_the_std_is_calibrated() {
    let mut squares = 0.0;
    for seed in 0..5 {
        let world = drive(&Options { noise: NOISE, ..Options::default() }, seed);
        let found = solve(&world, &drifted(&world, 0.03), &silhouettes(&world)).unwrap();
        let error = error(&world, &found);
        assert!(error.abs() < 0.015 && found.contact.num_frames > 20, "seed {seed}: {error}, {found:?}");
        let std = found.shares.total();
        assert!((1e-4..0.02).contains(&std), "{std}");
        squares += (error / std).powi(2) / 5.0;
    }
    assert!(squares < 6.0, "{squares}");
}

#[test]
fn outlines_determine_what_parallel_motion_does_not() {
    for seed in 0..3 {
        let world = drive(&Options { noise: NOISE, camera_climb_m: 0.0, ..Options::default() }, seed);
        let found = solve(&world, &world.object, &silhouettes(&world)).unwrap();
        let error = error(&world, &found);
        assert!(error.abs() < 0.02, "seed {seed}: {error}");
        // Without outlines only the lowest points are used, which is less certain.
        let guessed = solve(&world, &world.object, &BTreeMap::new()).unwrap();
        assert!(guessed.contact.num_frames == 0 && guessed.shares.total() > found.shares.total());
    }
}

#[test]
fn inconsistent_planes_contradict_the_object_or_do_not_distort_it() {
    let mut world = drive(&Options { noise: NOISE, ..Options::default() }, 1);
    // Planes that jump up and down by two meters are inconsistent with the object.
    for (frame, plane) in &mut world.planes {
        let jump = if frame.0 % 2 == 0 { 0.5 } else { -0.5 };
        plane.point += plane.normal * jump;
        plane.normal = (plane.normal + Vector3::new(jump, -jump, 0.3 * jump)).normalize();
    }
    match solve(&world, &world.object, &silhouettes(&world)) {
        Err(ScaleError::GroundContradicts { before_px, after_px }) => assert!(after_px > before_px),
        Err(other) => panic!("{other}"),
        Ok(found) => assert!(found.error_px[1] <= 3.0 * found.error_px[0]),
    }
}

#[test]
fn too_few_frames_or_points_are_an_error() {
    let world = drive(&Options { num_frames: 2, ..Options::default() }, 3);
    assert!(matches!(solve(&world, &world.object, &BTreeMap::new()), Err(ScaleError::TooFewViews { .. })));
    let mut empty = world.object.clone();
    let all: Vec<_> = empty.points.keys().copied().collect();
    empty.remove_points(&all);
    assert_eq!(solve(&world, &empty, &BTreeMap::new()), Err(ScaleError::NoPoints));
}

#[test]
fn uncertain_points_are_removed_but_never_most() {
    let world = drive(&Options { noise: NOISE, num_frames: 20, ..Options::default() }, 2);
    let mut object = world.object.clone();
    // A point that only two neighboring frames observe has no certain depth.
    let id = *object.points.keys().nth(5).unwrap();
    let track: Vec<_> = object.points[&id].track.clone();
    for element in &track[2..] {
        object.images.get_mut(&element.image).unwrap().observations[element.observation_idx as usize].point = None;
    }
    object.points.get_mut(&id).unwrap().track.truncate(2);
    let std = |covariance: Option<nalgebra::Matrix3<f64>>| {
        covariance.map_or(f64::INFINITY, |c| c.symmetric_eigenvalues().max().sqrt())
    };
    let stds = point_covariances(&object).into_iter().map(|(id, c)| (id, std(c))).collect();
    assert_eq!(uncertain_points(&stds, 0.05 * object_radius(&object), 0.5), [id]);
    let count = object.points.len();
    assert_eq!(uncertain_points(&stds, 0.0, 0.5).len(), count / 2);
    assert!(uncertain_points(&stds, f64::INFINITY, 0.5).is_empty());
}

#[test]
fn options_that_pass_the_check_do_no_harm() {
    let small =
        Options { noise: NOISE, num_frames: 8, num_object_points: 60, num_ground_points: 100, ..Options::default() };
    let world = drive(&small, 1);
    let silhouettes = silhouettes(&world);
    let evidence = evidence(&world, &world.object, &silhouettes);
    let mut num_passed = 0;
    for (changed, options) in crate::checks::testing::variations(&crate::trajectory::Options::default()) {
        if options.check().is_err() {
            continue;
        }
        num_passed += 1;
        if let Ok(trajectory) = place(&evidence, &options).trajectory {
            assert!(trajectory.scale.ratio > 0.0 && trajectory.scale.ratio.is_finite(), "{changed}");
        }
    }
    assert!(num_passed > 60, "{num_passed}");
}
