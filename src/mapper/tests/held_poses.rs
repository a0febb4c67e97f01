//! Points that are triangulated from known poses.

use super::*;

/// Model of a world whose points move by `step` from view to view.
fn found(step: f64) -> (Reconstruction, f64, World) {
    let mut world = world(40, 120);
    // A moving vehicle looks as if the cameras moved the other way.
    let known: Vec<Option<Rigid3>> = world.poses.iter().copied().map(Some).collect();
    for (view, pose) in world.poses.iter_mut().enumerate() {
        let moved = pose.center() - Vector3::new(0.0, 0.0, step * view as f64);
        *pose = Rigid3::from_rotation_and_center(pose.rotation, moved);
    }
    let table = tracks(&world, 0.3, 0, &mut seeded_rng(7, 7));
    let (model, report, explained) = triangulate(&table, &[world.camera], &known, &Options::object()).unwrap();
    assert_eq!(report.num_registered(), 40);
    (model, explained, world)
}

#[test]
fn stationary_points_are_accurate_and_all_inliers() {
    let (model, explained, world) = found(0.0);
    assert!(explained > 0.99, "{explained}");
    assert!(model.points.len() > 110);
    for point in model.points.values() {
        let error = world.points.iter().map(|truth| (truth - point.position).norm()).fold(f64::INFINITY, f64::min);
        assert!(error < 0.1, "{error}");
    }
    for (id, image) in &model.images {
        let held = world.poses[id.0 as usize - 1];
        assert!((image.cam_from_world.center() - held.center()).norm() < 1e-9);
    }
}

#[test]
fn moving_points_are_outliers() {
    // Across the trajectory of the cameras, by 4 px from one view to the next.
    let (_, explained, _) = found(0.06);
    assert!(explained < 0.8, "{explained}");
}
