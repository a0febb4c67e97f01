use super::*;
use crate::features::tracks::Feature;
use crate::math::seeded_rng;
use crate::synthetic::empty_table;
use nalgebra::{Point2, Point3};
use rand::Rng as _;
use rand_distr::StandardNormal;

/// Sixty views of a camera 40 m above a plane, which sways by `sway_m` and pans by 10°.
pub(in crate::mapper) fn views(sway_m: f64) -> (TrackTable, Camera, Vec<UnitQuaternion<f64>>) {
    views_along(|phase| Vector3::new(phase.sin(), phase.cos(), 0.3 * phase.sin()) * sway_m)
}

/// Sixty views of a camera with the given trajectory above a plane.
///
/// * `center` – by a tenth of the view's number, meters; the third axis points down.
pub(crate) fn views_along(center: impl Fn(f64) -> Vector3<f64>) -> (TrackTable, Camera, Vec<UnitQuaternion<f64>>) {
    let camera = Camera::with_focal(1280, 720, 1000.0);
    let mut rng = seeded_rng(5, 0);
    let points: Vec<Point3<f64>> =
        (0..400).map(|_| Point3::new(rng.random_range(-60.0..60.0), rng.random_range(-60.0..20.0), 40.0)).collect();
    let mut table = empty_table(60);
    table.tracks = vec![Vec::new(); points.len()];
    let down = UnitQuaternion::from_euler_angles(-0.5, 0.0, 0.0);
    let mut rotations = Vec::new();
    for view in 0..60u32 {
        let phase = f64::from(view) / 10.0;
        let rotation = UnitQuaternion::from_euler_angles(0.01 * phase.sin(), 0.03 * phase, 0.0) * down;
        let center = center(phase);
        rotations.push(rotation);
        for (track, point) in points.iter().enumerate() {
            let Some(pixel) = camera.pixel_from_cam(Point3::from(rotation * (point.coords - center))) else {
                continue;
            };
            let noise = [0, 1].map(|_| 0.3 * rng.sample::<f64, _>(StandardNormal));
            let pixel = Point2::new(pixel.x + noise[0], pixel.y + noise[1]);
            if camera.contains(pixel) {
                let feature = table.views[view as usize].pixels.len() as u32;
                table.views[view as usize].pixels.push(pixel);
                table.tracks[track].push(Feature { view, feature });
            }
        }
    }
    (table, camera, rotations)
}

fn worst_deg(found: &RotatingCamera, truth: &[UnitQuaternion<f64>]) -> f64 {
    let turn = |k: usize| truth[k] * truth[0].inverse();
    let angle = |k: usize| found.poses[k].map_or(f64::INFINITY, |pose| pose.rotation.angle_to(&turn(k)));
    (0..truth.len()).map(angle).fold(0.0, f64::max).to_degrees()
}

#[test]
fn rotations_of_a_hovering_camera_are_found() {
    for (sway_m, limit_deg) in [(0.0, 0.03), (0.1, 0.3)] {
        let (table, camera, truth) = views(sway_m);
        let found = rotating_camera(&table, &camera).unwrap();
        let worst = worst_deg(&found, &truth);
        assert!(worst < limit_deg, "{sway_m}: {worst}");
    }
}

#[test]
fn views_with_occluded_background_are_interpolated() {
    let (mut table, camera, truth) = views(0.0);
    let occluded = 25..31;
    // No point is observed before and after; in between only vehicles that move to both sides are visible.
    let mut tracks = Vec::new();
    for track in std::mem::take(&mut table.tracks) {
        let (before, after): (Vec<Feature>, Vec<Feature>) =
            track.into_iter().partition(|feature| feature.view < occluded.end);
        tracks.push(before.into_iter().filter(|feature| feature.view < occluded.start).collect());
        tracks.push(after);
    }
    for k in 0..40 {
        let mut of_vehicle = Vec::new();
        for view in occluded.clone() {
            let pixels = &mut table.views[view as usize].pixels;
            of_vehicle.push(Feature { view, feature: pixels.len() as u32 });
            let displacement = 40.0 * f64::from(view - 25) * if k % 2 == 0 { 1.0 } else { -1.0 };
            pixels.push(Point2::new(640.0 + displacement, f64::from(100 + 12 * k)));
        }
        tracks.push(of_vehicle);
    }
    table.tracks = tracks;
    let found = rotating_camera(&table, &camera).unwrap();
    // No point shows how far the camera pans in between, 1.2°.
    let worst = worst_deg(&found, &truth);
    assert!(worst < 1.5, "{worst}");
    let turn = |view: usize| found.poses[view].unwrap().rotation;
    let [before, between, after] = [24, 28, 31].map(turn);
    assert!(between.angle_to(&before).max(between.angle_to(&after)) <= before.angle_to(&after) + 1e-9);
}

#[test]
fn a_translating_camera_is_rejected() {
    let (table, camera, _) = views(8.0);
    assert!(rotating_camera(&table, &camera).is_none());
    assert!(rotating_camera(&TrackTable::default(), &camera).is_none());
}
