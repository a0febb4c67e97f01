//! Tests of the contact with the ground.

use nalgebra::{Matrix3, Point2, Rotation3};

use super::silhouette::convex_hull;
use super::*;
use crate::math::Rigid3;
use crate::scene::{CameraId, ImageId, Mask, Point3d, Point3dId};
use crate::synthetic::drive::{Options, drive};

fn rectangle(width: u32, height: u32, [x0, y0, x1, y1]: [u32; 4]) -> Mask {
    Mask::from_fn(width, height, |x, y| (x0..x1).contains(&x) && (y0..y1).contains(&y))
}

#[test]
fn outlines_are_hulls_of_whole_masks() {
    let mut mask = rectangle(40, 30, [5, 6, 25, 16]);
    let found = Silhouette::of(&mask).unwrap();
    let corners = [[5.5, 6.5], [24.5, 6.5], [24.5, 15.5], [5.5, 15.5]].map(|[x, y]| Point2::new(x, y));
    assert_eq!(found.hull.len(), 4);
    assert!(corners.iter().all(|corner| found.hull.contains(corner)), "{found:?}");
    // A dent does not change the hull.
    mask.fill(15..16, 6, false);
    assert_eq!(Silhouette::of(&mask), Some(found));
    for cut in [[0, 6, 25, 16], [5, 0, 25, 16], [5, 6, 40, 16], [5, 6, 25, 30], [5, 6, 9, 9]] {
        assert_eq!(Silhouette::of(&rectangle(40, 30, cut)), None, "{cut:?}");
    }
    assert_eq!(Silhouette::of(&Mask::empty(40, 30)), None);
}

/// The synthetic vehicle in a side view; its wheels are part of the outline, but not reconstructed.
#[test]
fn outlines_determine_the_ground() {
    let options = Options { object_unit_m: 1.0, ..Options::default() };
    let (whole, body) = (drive(&options, 2), drive(&Options { has_wheels: false, ..options }, 2));
    // Same seed, same frame: z up with the ground at zero.
    let to_vehicle = |world: &crate::synthetic::drive::Drive| {
        let mut object = world.object.clone();
        let first = object.images.keys().next().unwrap().frame();
        let metric = world.background_from_metric.inverse() * world.world_from_object[&first];
        object.transform(&metric);
        object
    };
    let (whole, body) = (to_vehicle(&whole), to_vehicle(&body));
    let silhouettes = whole.images.iter().map(|(id, image)| {
        let camera = whole.camera_of(image);
        let seen = whole.points.values().filter_map(|p| camera.pixel_from_cam(image.cam_from_world * p.position));
        (id.frame(), Silhouette { hull: seen.collect() })
    });
    let silhouettes = silhouettes.collect();
    let options = ContactOptions { side: [0.0, 0.05], lowest: [0.0, 0.07], ..ContactOptions::default() };
    let forward = Some(Vector3::x_axis());
    let seen = contact(&body, &silhouettes, forward, &options).unwrap();
    let guessed = contact(&body, &silhouettes, None, &options).unwrap();
    assert!(seen.num_frames > 20 && seen.z.abs() < 0.15 && seen.std < 0.12, "{seen:?}");
    assert!(guessed.num_frames == 0 && guessed.z > 0.25, "{guessed:?}");
    assert_eq!(contact(&Reconstruction::default(), &silhouettes, forward, &options), None);
}

#[test]
fn outlines_with_an_occluded_lower_part_do_not_raise_the_ground() {
    let (model, mut silhouettes) = from_behind(15.0);
    let found = |outlines: &BTreeMap<FrameId, Silhouette>| {
        contact(&model, outlines, Some(Vector3::x_axis()), &ContactOptions::default()).unwrap()
    };
    let whole = found(&silhouettes);
    // More than half of the frames, in which only the part above the hood is visible.
    let above_hood = |outline: &Silhouette| {
        let rows = outline.hull.iter().map(|p| p.y);
        let (top, bottom) = (rows.clone().fold(f64::INFINITY, f64::min), rows.fold(0.0, f64::max));
        let cut = |p: &Point2<f64>| Point2::new(p.x, p.y.min(0.5 * (top + bottom)));
        Silhouette { hull: convex_hull(outline.hull.iter().map(cut).collect()) }
    };
    let more: Vec<(FrameId, Silhouette)> =
        silhouettes.iter().skip(3).map(|(id, outline)| (*id, above_hood(outline))).collect();
    silhouettes.extend(more);
    let options = ContactOptions { min_frames: 3, ..ContactOptions::default() };
    let cut = contact(&model, &silhouettes, Some(Vector3::x_axis()), &options).unwrap();
    assert_eq!(cut.num_frames, 3);
    assert!((cut.z - whole.z).abs() < 0.02, "{cut:?}, {whole:?}");
    // If too few frames are unoccluded, all are used.
    assert_eq!(found(&silhouettes).num_frames, 8);
}

/// A box on four tires, 0.8 wide to either side, seen from behind by a low camera.
fn from_behind(distance: f64) -> (Reconstruction, BTreeMap<FrameId, Silhouette>) {
    let forward = Rotation3::from_matrix_unchecked(Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0));
    let poses = (0..8).map(|k| {
        let center = Point3::new(-distance - 0.3 * f64::from(k), 0.1, 1.4);
        Rigid3::from_rotation_and_center(forward.into(), center)
    });
    box_on_tires(poses, 0.75)
}

/// The same from its left side, from the heights above the ground, 20 away; its tires are at y = ±0.6.
fn from_the_side(heights: impl Iterator<Item = f64>) -> (Reconstruction, BTreeMap<FrameId, Silhouette>) {
    let poses = heights.map(|height| {
        let center = Point3::new(0.1, 20.0, height);
        let cam_from_world = Rotation3::face_towards(&-center.coords, &-Vector3::z()).inverse();
        Rigid3::from_rotation_and_center(cam_from_world.into(), center)
    });
    box_on_tires(poses, 0.6)
}

fn box_on_tires(poses: impl Iterator<Item = Rigid3>, tires_y: f64) -> (Reconstruction, BTreeMap<FrameId, Silhouette>) {
    let corners = |xs: [f64; 2], ys: [f64; 2], zs: [f64; 2]| {
        let all = xs.into_iter().flat_map(move |x| ys.into_iter().map(move |y| (x, y)));
        all.flat_map(move |(x, y)| zs.into_iter().map(move |z| Point3::new(x, y, z))).collect::<Vec<_>>()
    };
    let body = corners([-2.0, 2.0], [-0.8, 0.8], [0.3, 1.5]);
    let tires = corners([-1.3, 1.3], [-tires_y, tires_y], [0.0, 0.6]);
    let mut model = Reconstruction::default();
    let camera = crate::camera::Camera::with_focal(960, 540, 800.0);
    model.cameras.insert(CameraId(1), camera);
    for (k, position) in body.iter().enumerate() {
        let point = Point3d { position: *position, rgb: [0; 3], error_px: 0.5, track: Vec::new() };
        model.points.insert(Point3dId(k as u64 + 1), point);
    }
    let mut silhouettes = BTreeMap::new();
    for (k, cam_from_world) in (0..).zip(poses) {
        let seen = body.iter().chain(&tires).filter_map(|p| camera.pixel_from_cam(cam_from_world * *p));
        silhouettes.insert(FrameId(k), Silhouette { hull: convex_hull(seen.collect()) });
        let image = Image { name: k.to_string(), camera: CameraId(1), cam_from_world, observations: Vec::new() };
        model.images.insert(ImageId::from(FrameId(k)), image);
    }
    (model, silhouettes)
}

/// Tires with a larger setback than usual raise the ground in views from above, but hardly in low ones.
#[test]
fn low_views_determine_the_ground() {
    let found = |heights: &[f64]| {
        let (model, silhouettes) = from_the_side(heights.iter().copied());
        contact(&model, &silhouettes, Some(Vector3::x_axis()), &ContactOptions::default()).unwrap()
    };
    let (low, high) = ([1.5; 12], [20.0; 11]);
    let (flat, steep) = (found(&low), found(&high));
    assert!(flat.z.abs() < flat.std && steep.z > 0.06 && steep.std > flat.std, "{flat:?}, {steep:?}");
    let both = found(&[&high[..], &low[..]].concat());
    assert_eq!(both.num_frames, 23);
    assert!((both.z - flat.z).abs() < 1e-9 && (both.std - flat.std).abs() < 1e-9, "{both:?}, {flat:?}");
}

#[test]
fn noise_of_the_lower_points_does_not_raise_the_ground() {
    let found = |noise: f64| {
        let (mut model, silhouettes) = from_the_side([15.0; 11].into_iter());
        for k in 0..80_u32 {
            let off = noise * (f64::from(k % 10) / 4.5 - 1.0);
            let y = if k % 20 < 10 { 0.8 + off } else { -0.8 - off };
            let position = Point3::new(0.05 * f64::from(k) - 2.0, y, if k < 40 { 0.3 } else { 1.5 });
            let point = Point3d { position, rgb: [0; 3], error_px: 0.5, track: Vec::new() };
            model.points.insert(Point3dId(u64::from(k) + 100), point);
        }
        contact(&model, &silhouettes, Some(Vector3::x_axis()), &ContactOptions::default()).unwrap()
    };
    let (exact, noisy) = (found(0.0), found(0.15));
    // The outermost points are 0.15 farther out, which would raise it by 0.11.
    assert!((noisy.z - exact.z).abs() < 0.05, "{exact:?}, {noisy:?}");
}

#[test]
fn rear_tires_determine_the_ground_from_behind() {
    let found = |distance: f64| {
        let (model, silhouettes) = from_behind(distance);
        contact(&model, &silhouettes, Some(Vector3::x_axis()), &ContactOptions::default()).unwrap()
    };
    let [near, far] = [found(15.0), found(30.0)];
    assert!(near.num_frames == 8 && near.z.abs() < 2.0 * near.std && near.std < 0.045, "{near:?}");
    assert!(far.num_frames == 8 && far.z.abs() < 2.0 * far.std && far.std > 1.1 * near.std, "{far:?}");
}
