use nalgebra::{Matrix3, Point3, Vector2};
use rand::Rng as _;
use rand_distr::StandardNormal;

use super::*;
use crate::math::{Rng, seeded_rng};
use crate::scene::{ContactError, ImageId};
use crate::synthetic::drive::{self, Drive, Route, drive};
use crate::trajectory::contact::convex_hull;
use crate::trajectory::{CommonStd, PositionError, PositionMeasurement, smooth};

const ID: ObjectId = ObjectId(1);

fn description() -> ObjectDescription {
    ObjectDescription { id: ID, class: "car".into(), confidence: 0.5 }
}

/// Outline of the vehicle in every frame, moved by `shift`: down the image and along it, pixels.
fn outlines(world: &Drive, mut shift: impl FnMut() -> Vector2<f64>) -> BTreeMap<FrameId, Silhouette> {
    let outline = |frame: &Frame| {
        let image = &world.background.images[&ImageId::from(frame.id)];
        let camera = world.background.camera_of(image);
        let placed = world.object.points.values().map(|point| world.world_from_object[&frame.id] * point.position);
        let shift = shift();
        let pixels = placed.filter_map(|point| camera.pixel_from_cam(image.cam_from_world * point));
        Some((frame.id, Silhouette { hull: convex_hull(pixels.map(|pixel| pixel + shift).collect()) }))
    };
    world.frames.iter().filter_map(outline).collect()
}

fn track(world: &Drive, planes: &BTreeMap<FrameId, GroundPlane>, outlines: &Outlines) -> Result<GroundTrack, String> {
    let frames: Vec<&Frame> = world.frames.iter().collect();
    let evidence = ContactEvidence {
        background: &world.background,
        planes,
        outlines,
        frames: &frames,
        focal: FocalError::default(),
    };
    ground_track(description(), &evidence, "too small".into()).map(|(track, _)| track)
}

fn normal(rng: &mut Rng) -> f64 {
    rng.sample(StandardNormal)
}

/// Standard deviations of the heights of simulated planes, meters: common to all frames, and independent in each.
const PLANE_M: [f64; 2] = [0.05, 0.03];

/// Planes with height errors, and their standard deviations.
fn disturbed(world: &Drive, rng: &mut Rng) -> BTreeMap<FrameId, GroundPlane> {
    let scale = world.background_from_metric.scale;
    let [common, own] = PLANE_M.map(|std| std * scale);
    let shift = common * normal(rng);
    let plane = |(frame, plane): (&FrameId, &GroundPlane)| {
        let off = shift + own * normal(rng);
        let point = plane.point + plane.normal * off;
        (*frame, GroundPlane { point, height_std: common.hypot(own), common_height_std: common, ..*plane })
    };
    world.planes.iter().map(plane).collect()
}

/// A far, small car: 12 to 30 pixels wide.
fn far(seed: u64, route: Route) -> Drive {
    let options = drive::Options {
        num_frames: 40,
        route,
        camera_height_m: 30.0,
        distance_m: [120.0, 160.0],
        num_ground_points: 20,
        num_other_points: 20,
        ..drive::Options::default()
    };
    drive(&options, seed)
}

#[test]
fn positions_without_noise_are_on_the_ground_below_the_vehicle() {
    let world = far(1, Route::Straight);
    let found = track(&world, &world.planes, &[(ID, outlines(&world, Vector2::zeros))].into()).unwrap();
    assert_eq!((found.positions.len(), found.omissions()), (40, None));
    let unit_m = 1.0 / world.background_from_metric.scale;
    for at in &found.positions {
        let plane = &world.planes[&at.frame];
        let point = Point3::from(at.position);
        assert!(plane.signed_distance(point).abs() < 1e-9);
        let middle = world.background_from_metric.inverse()
            * world.world_from_object[&at.frame]
            * crate::trajectory::object_center(&world.object);
        let away_m = (world.background_from_metric.inverse() * point - middle).xy().norm();
        assert!(away_m < 1.0, "{away_m} m");
    }
    assert!((12.0..40.0).contains(&(found.apparent_size[0] * unit_m * 900.0 / 140.0)), "{:?}", found.apparent_size);
}

#[test]
fn stds_of_far_vehicles_are_calibrated() {
    let mut counts = [0usize; 3];
    let mut all = 0;
    for seed in 0..60 {
        let route = if seed % 2 == 0 { Route::Straight } else { Route::Curve { radius_m: 40.0 } };
        let world = far(seed, route);
        let rng = &mut seeded_rng(seed, 7);
        let planes = disturbed(&world, rng);
        let bias = normal(rng);
        let noisy = outlines(&world, || Vector2::new(0.5 * normal(rng), bias + 0.5 * normal(rng)));
        let found = track(&world, &planes, &[(ID, noisy)].into()).unwrap();
        for at in found.positions.iter().step_by(13) {
            let image = &world.background.images[&ImageId::from(at.frame)];
            let truth = footprint(&world, at.frame);
            let error = Point3::from(at.position) - truth;
            let along = (truth - image.cam_from_world.center()).normalize();
            let std = (along.transpose() * at.error.covariance() * along)[0].sqrt();
            counts.iter_mut().zip([1.0, 2.0, 3.0]).for_each(|(count, k)| {
                *count += usize::from(error.dot(&along).abs() <= k * std);
            });
            all += 1;
        }
    }
    let share = counts.map(|count| count as f64 / all as f64);
    assert!(share[0] > 0.6 && share[0] < 0.97 && share[1] > 0.92 && share[2] > 0.97, "{share:?}");
}

#[test]
fn another_focal_length_moves_a_vehicle_by_the_reported_error() {
    let mut world = far(2, Route::Straight);
    let outlines: Outlines = [(ID, outlines(&world, Vector2::zeros))].into();
    let frames: Vec<Frame> = world.frames.clone();
    let frames: Vec<&Frame> = frames.iter().collect();
    let std = 0.1;
    let found = |world: &Drive| {
        let (background, planes) = (&world.background, &world.planes);
        let focal = FocalError { std, turns: Some(Vector3::zeros()) };
        contacts(ID, &ContactEvidence { background, planes, outlines: &outlines, frames: &frames, focal }).positions
    };
    let before = found(&world);
    world.background.cameras.values_mut().for_each(|camera| *camera = camera.zoomed(f64::exp(std)));
    for (before, after) in before.iter().zip(found(&world)) {
        let [moved, stated] =
            [Vector3::from(after.position) - Vector3::from(before.position), Vector3::from(before.error.focal)];
        assert!((moved - stated).norm() < 0.2 * moved.norm().max(0.05 * stated.norm()), "{moved} {stated}");
    }
}

/// True center of a vehicle's footprint.
fn footprint(world: &Drive, frame: FrameId) -> Point3<f64> {
    let plane = &world.planes[&frame];
    let middle = world.world_from_object[&frame] * crate::trajectory::object_center(&world.object);
    middle - plane.normal * plane.signed_distance(middle)
}

/// Measurements of a track in meters, z up.
fn in_meters(world: &Drive, found: &GroundTrack) -> Vec<PositionMeasurement> {
    let metric_from_world = world.background_from_metric.inverse();
    let measured = |at: &GroundPosition| PositionMeasurement {
        time_s: at.time_s,
        position_m: (metric_from_world * Point3::from(at.position)).coords,
        camera_m: (metric_from_world * world.background.images[&ImageId::from(at.frame)].cam_from_world.center())
            .coords,
        forward: None,
        error: PositionError::Contact(at.error.transformed(&metric_from_world)),
    };
    found.positions.iter().map(measured).collect()
}

#[test]
fn stds_of_speeds_of_far_vehicles_are_calibrated_also_in_a_curve() {
    let [mut within_1, mut within_2, mut all] = [0.0; 3];
    for seed in 0..24 {
        let route = if seed % 2 == 0 { Route::Straight } else { Route::Curve { radius_m: 40.0 } };
        let world = far(seed, route);
        let rng = &mut seeded_rng(seed, 8);
        let planes = disturbed(&world, rng);
        let bias = normal(rng);
        let noisy = outlines(&world, || Vector2::new(0.5 * normal(rng), bias + 0.5 * normal(rng)));
        let found = track(&world, &planes, &[(ID, noisy)].into()).unwrap();
        let smoothed =
            smooth(&in_meters(&world, &found), &CommonStd::default(), crate::scene::Movement::Undetermined).unwrap();
        for motion in smoothed.motions.iter().step_by(9) {
            let off = (motion.speed_m_s - 8.0).abs() / motion.speed_std_m_s;
            assert!(motion.speed_std_m_s < 8.0, "{motion:?}");
            within_1 += f64::from(off <= 1.0);
            within_2 += f64::from(off <= 2.0);
            all += 1.0;
        }
    }
    assert!(within_1 / all > 0.55 && within_2 / all > 0.88, "{} {}", within_1 / all, within_2 / all);
}

#[test]
fn rays_at_the_horizon_are_rejected() {
    // From two meters above the ground and 800 to 3000 m away a pixel is as large as the angle below the horizon.
    let options = drive::Options {
        camera_height_m: 2.0,
        camera_climb_m: 0.0,
        distance_m: [800.0, 3000.0],
        ..drive::Options::default()
    };
    let world = drive(&options, 3);
    let refused = track(&world, &world.planes, &[(ID, outlines(&world, Vector2::zeros))].into()).unwrap_err();
    assert!(refused.contains("in 0 frames only") && refused.contains("horizon"), "{refused}");
    // Nearer vehicles have a distance, and its standard deviation grows faster than the distance itself.
    let near = drive(&drive::Options { distance_m: [60.0, 240.0], ..options }, 3);
    let found = track(&near, &near.planes, &[(ID, outlines(&near, Vector2::zeros))].into()).unwrap();
    let share = |at: &GroundPosition| {
        let center = near.background.images[&ImageId::from(at.frame)].cam_from_world.center();
        let ray = Point3::from(at.position) - center;
        let along = ray.normalize();
        ((along.transpose() * at.error.covariance() * along)[0].sqrt() / ray.norm(), ray.norm())
    };
    let (first, last) = (share(&found.positions[0]), share(found.positions.last().unwrap()));
    assert!(last.1 > 2.0 * first.1 && last.0 > 2.0 * first.0, "{first:?} {last:?}");
}

#[test]
fn frames_without_a_contact_line_are_counted_with_the_reason() {
    let world = far(5, Route::Straight);
    let mut own = outlines(&world, Vector2::zeros);
    // The first five masks are truncated, the next ten occluded, and the five frames after them not registered.
    (0..5).for_each(|k| drop(own.remove(&FrameId(k))));
    let square = |middle: Point2<f64>| {
        let corner = |x: f64, y: f64| middle + Vector2::new(x, y);
        Silhouette {
            hull: convex_hull(vec![corner(-9.0, -2.0), corner(9.0, -2.0), corner(9.0, 9.0), corner(-9.0, 9.0)]),
        }
    };
    let before = (5..15).map(|k| {
        let hull = &own[&FrameId(k)].hull;
        let lowest = hull.iter().max_by(|a, b| a.y.total_cmp(&b.y)).unwrap();
        (FrameId(k), square(*lowest))
    });
    let all: Outlines = [(ObjectId(2), before.collect()), (ID, own)].into();
    let mut lost = world.clone();
    (15..20).for_each(|k| drop(lost.background.images.remove(&ImageId::from(FrameId(k)))));
    let mut planes = world.planes.clone();
    planes.retain(|frame, _| !(20..23).contains(&frame.0));
    let found = track(&lost, &planes, &all).unwrap();
    let expected =
        [(NoContact::NoCamera, 5), (NoContact::Truncated, 5), (NoContact::Occluded, 10), (NoContact::NoGroundPlane, 3)];
    assert_eq!(found.omitted, expected.into());
    assert_eq!((found.positions.len(), found.positions[0].frame), (17, FrameId(23)));
    assert!(found.omissions().unwrap().contains("10 frames: lower edge occluded"));
}

#[test]
fn a_transformed_error_has_the_transformed_covariance() {
    let error = ContactError {
        noise: [[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.0]],
        drift: [0.3, -0.1, 0.2],
        common: [0.0, 0.5, 0.0],
        focal: [0.1, 0.0, -0.4],
    };
    let target_from_source = far(1, Route::Straight).background_from_metric;
    let turned = error.transformed(&target_from_source);
    let rotation = target_from_source.rotation.to_rotation_matrix();
    let expected: Matrix3<f64> =
        rotation * error.covariance() * rotation.transpose() * target_from_source.scale.powi(2);
    assert!((turned.covariance() - expected).norm() < 1e-12);
}
