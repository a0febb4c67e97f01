use nalgebra::Point3;

use super::*;
use crate::ground::local_planes;
use crate::ground::vehicle_trajectory::SHAPE;
use crate::scene::ObjectId;
use crate::synthetic::drive::{self, Drive, Noise, drive};

/// Straight road along x; next to the lane, 1.6 m from its center line, a curb of 13 cm.
fn street(options: drive::Options, is_lane: impl Fn(&Point3<f64>) -> bool) -> Drive {
    let noise = Noise { pixel_px: 0.3, ..Noise::default() };
    let mut world = drive(&drive::Options { num_ground_points: 15_000, noise, ..options }, 4);
    let metric_from_background = world.background_from_metric.inverse();
    for id in &world.ground_points {
        let Some(point) = world.background.points.get_mut(id) else { continue };
        let position = metric_from_background * point.position;
        if !is_lane(&position) {
            point.position = world.background_from_metric * Point3::new(position.x, position.y, position.z + 0.13);
        }
    }
    world
}

fn on_lane(position: &Point3<f64>) -> bool {
    position.y.abs() < 1.6
}

fn before_and_after(world: &Drive) -> [BTreeMap<FrameId, GroundPlane>; 2] {
    let options = Options::default();
    let all = local_planes(&world.background, &world.ground_points, ObjectId(1), &world.object, &options, 3).planes;
    let corrected =
        corrected_by_path(&world.background, &world.ground_points, &world.object, all.clone(), &options, &SHAPE);
    [all, corrected]
}

/// Height errors below the vehicle by frame, meters.
fn errors(world: &Drive, planes: &BTreeMap<FrameId, GroundPlane>) -> Vec<f64> {
    let error = |(frame, plane): (&FrameId, &GroundPlane)| -plane.signed_distance(world.planes[frame].point);
    planes.iter().map(error).map(|error| error / world.background_from_metric.scale).collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn points_on_the_path_correct_planes_that_include_a_curb() {
    let world = street(drive::Options::default(), on_lane);
    let [all, corrected] = before_and_after(&world);
    let [before, after] = [&all, &corrected].map(|planes| rms(&errors(&world, planes)));
    assert!(before > 0.04, "the kerb does not show: {before} m");
    assert!(after < 0.015, "{before} m before, {after} m after");
    assert!(corrected.values().filter(|plane| plane.basis == PlaneBasis::Path).count() >= 50);
}

#[test]
fn height_stds_of_path_planes_are_calibrated() {
    let world = street(drive::Options::default(), on_lane);
    let [_, corrected] = before_and_after(&world);
    let scale = world.background_from_metric.scale;
    let relative: Vec<f64> = errors(&world, &corrected)
        .iter()
        .zip(corrected.values())
        .map(|(error, plane)| error * scale / plane.height_std)
        .collect();
    let within_two = relative.iter().filter(|x| x.abs() <= 2.0).count();
    assert!(within_two * 10 >= relative.len() * 9, "{within_two} of {}", relative.len());
}

#[test]
fn frames_without_points_on_the_lane_are_shifted_by_the_offset_of_the_others() {
    // Beyond 30 m there are no points on the lane.
    let world = street(drive::Options::default(), on_lane);
    let metric_from_background = world.background_from_metric.inverse();
    let is_bare = |id: &Point3dId| {
        let position = metric_from_background * world.background.points[id].position;
        on_lane(&position) && position.x > 30.0
    };
    let shown: Vec<Point3dId> = world.ground_points.iter().filter(|id| !is_bare(id)).copied().collect();
    let options = Options::default();
    let all = local_planes(&world.background, &shown, ObjectId(1), &world.object, &options, 3).planes;
    let corrected = corrected_by_path(&world.background, &shown, &world.object, all.clone(), &options, &SHAPE);
    let [before, after] = [&all, &corrected].map(|planes| rms(&errors(&world, planes)[50..]));
    assert!(corrected.values().skip(50).all(|plane| plane.basis != PlaneBasis::Path));
    assert!(after < 0.6 * before, "{before} m before, {after} m after");
}

#[test]
fn a_stationary_vehicle_has_no_path() {
    let world = street(drive::Options { speed_m_s: 0.0, ..Default::default() }, on_lane);
    let [all, corrected] = before_and_after(&world);
    assert_eq!(all, corrected);
}

#[test]
fn exact_planes_stay_exact() {
    let world = drive(&drive::Options { num_ground_points: 15_000, ..Default::default() }, 1);
    let [_, corrected] = before_and_after(&world);
    assert!(rms(&errors(&world, &corrected)) < 1e-6);
}
