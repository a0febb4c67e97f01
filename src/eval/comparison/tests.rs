use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::*;
use crate::math::seeded_rng;
use crate::scene::{CameraId, Image, Observation, Point3d, Point3dId, TrackElement};
use rand::Rng as _;

fn flight(num_images: u32, center: impl Fn(f64) -> Point3<f64>) -> Side {
    let mut model = Reconstruction::default();
    model.cameras.insert(CameraId(1), Camera::with_focal(960, 540, 880.0));
    for k in 0..num_images {
        let t = f64::from(k);
        let rotation = UnitQuaternion::from_euler_angles(0.1 * t.sin(), -0.05 * t, 0.02 * t);
        let cam_from_world = Rigid3::from_rotation_and_center(rotation, center(t));
        let name = format!("{k:06}.jpg");
        let image = Image { name, camera: CameraId(1), cam_from_world, observations: vec![] };
        model.images.insert(ImageId(k + 1), image);
    }
    Side { name: "model".into(), model, cost: None }
}

fn curve(t: f64) -> Point3<f64> {
    Point3::new(1000.0 * t, 40.0 * t * t, 500.0 * t.sin())
}

fn similarity() -> Sim3 {
    Sim3::new(1e-4, UnitQuaternion::from_euler_angles(1.0, 2.0, 0.3), Vector3::new(1.0, 2.0, 3.0))
}

fn compared(reference: &Side, other: &Side) -> Against {
    compare(reference, std::slice::from_ref(other), LengthUnit::Reference, MatchBy::Name).others.remove(0)
}

/// A point in front of a camera, seen with an error in pixels.
fn see(side: &mut Side, id: u64, images: [u32; 2], error_px: f64) {
    let camera = side.model.cameras[&CameraId(1)];
    let first = side.model.images[&ImageId(images[0])].cam_from_world;
    let position = first.inverse() * Point3::new(0.1, 0.2, 50.0 * 1000.0);
    let mut track = Vec::new();
    for image in images.map(ImageId) {
        let seen = side.model.images.get_mut(&image).unwrap();
        let Some(pixel) = camera.pixel_from_cam(seen.cam_from_world * position) else { panic!("behind {image:?}") };
        track.push(TrackElement { image, observation_idx: seen.observations.len() as u32 });
        let pixel = pixel + nalgebra::Vector2::new(error_px, 0.0);
        seen.observations.push(Observation { pixel, point: Some(Point3dId(id)) });
    }
    // What files say of errors is not believed.
    side.model.points.insert(Point3dId(id), Point3d { position, rgb: [0; 3], error_px: 77.0, track });
}

#[test]
fn a_similarity_apart_is_no_difference() {
    let a = flight(12, curve);
    let mut b = a.clone();
    b.model.transform(&similarity());
    b.model.images.remove(&ImageId(3));
    let against = compared(&a, &b);
    assert_eq!((against.num_common, against.only_in_reference.as_slice()), (11, ["000002.jpg".to_owned()].as_slice()));
    let alignment = against.alignment.as_ref().unwrap();
    assert!((alignment.reference_from_other.scale - 1e4).abs() < 1e-6);
    assert_eq!((alignment.num_kept, alignment.basis), (11, Basis::Centers));
    let cameras = against.cameras.as_ref().unwrap();
    assert!(cameras.center_share_of_extent < 1e-12 && cameras.rotation_max_deg < 1e-5);
    // Eleven of twelve images: 55 of 66 pairs, each without an error.
    let relative = against.relative.as_ref().unwrap();
    assert_eq!((relative.num_pairs, relative.num_failed), (66, 11));
    assert!((relative.auc[0] - 55.0 / 66.0).abs() < 1e-4, "{:?}", relative.auc);
}

#[test]
fn a_lost_camera_smears_nothing_and_is_named() {
    let a = flight(20, curve);
    let mut b = a.clone();
    let lost = b.model.images.get_mut(&ImageId(8)).unwrap();
    lost.cam_from_world = Rigid3::from_rotation_and_center(UnitQuaternion::identity(), Point3::new(-9e6, 4e6, 7e5));
    let mut rng = seeded_rng(4, 0);
    for image in b.model.images.values_mut() {
        image.cam_from_world.translation += Vector3::from_fn(|_, _| rng.random_range(-0.5..0.5));
    }
    b.model.transform(&similarity());
    let against = compared(&a, &b);
    let (alignment, cameras) = (against.alignment.as_ref().unwrap(), against.cameras.as_ref().unwrap());
    assert_eq!(alignment.lost, ["000007.jpg"]);
    assert!((0.2..0.8).contains(&cameras.center_rmse), "{cameras:?}");
    assert!(cameras.center_rmse_of_all > 1e6 && cameras.center_median < 1.0);
    assert!(against.images[0].lost && against.images[0].name == "000007.jpg");
    assert!(against.images.windows(2).all(|pair| pair[0].center >= pair[1].center));
}

#[test]
fn centres_on_a_line_are_aligned_by_directions() {
    let a = flight(6, |t| Point3::new(1e-4 * t, 0.0, 0.0));
    let mut b = a.clone();
    b.model.transform(&Sim3::new(7.0, UnitQuaternion::from_euler_angles(0.4, 0.0, 1.0), Vector3::zeros()));
    let against = compared(&a, &b);
    assert_eq!(against.alignment.as_ref().unwrap().basis, Basis::CentersAndDirections);
    let cameras = against.cameras.as_ref().unwrap();
    assert!(cameras.center_share_of_extent < 1e-9 && cameras.rotation_max_deg < 1e-5);
}

#[test]
fn errors_are_recomputed_per_observation_and_per_point() {
    let mut a = flight(8, |t| Point3::new(10.0 * t, 0.0, 0.0));
    see(&mut a, 1, [1, 2], 0.5);
    see(&mut a, 2, [1, 2], 0.1);
    // The second point is seen again, without an error.
    let point = a.model.points[&Point3dId(2)].position;
    let third = a.model.images.get_mut(&ImageId(3)).unwrap();
    let pixel = a.model.cameras[&CameraId(1)].pixel_from_cam(third.cam_from_world * point).unwrap();
    third.observations.push(Observation { pixel, point: Some(Point3dId(2)) });
    let element = TrackElement { image: ImageId(3), observation_idx: 0 };
    a.model.points.get_mut(&Point3dId(2)).unwrap().track.push(element);
    let figures = ModelFigures::new(&a.model);
    let found = figures.reprojection.unwrap();
    assert!((found.mean_px - 1.2 / 5.0).abs() < 1e-9, "{found:?}");
    assert!((found.mean_per_point_px - 0.5 * (0.5 + 0.2 / 3.0)).abs() < 1e-9, "{found:?}");
    assert!((found.median_px - 0.1).abs() < 1e-9 && found.num_behind == 0);
    assert_eq!((figures.track_lengths[0], figures.track_lengths[1], figures.num_observations), (1, 1, 5));
    assert_eq!(figures.errors.iter().sum::<usize>(), 5);
}

#[test]
fn other_names_are_matched_by_stem_or_order() {
    let a = flight(7, curve);
    let mut b = a.clone();
    for image in b.model.images.values_mut() {
        image.name = format!("left/{}", image.name.replace("jpg", "png"));
    }
    let matched = |b: &Side, by| compare(&a, std::slice::from_ref(b), LengthUnit::Reference, by);
    let by_name = matched(&b, MatchBy::Name);
    assert!(!by_name.has_result() && by_name.others[0].num_common == 0);
    assert!(by_name.to_string().contains("0 images are registered in both"), "{by_name}");
    assert_eq!((by_name.others[0].only_in_reference.len(), by_name.others[0].only_in_other.len()), (7, 7));
    for by in [MatchBy::Stem, MatchBy::Order] {
        let found = matched(&b, by);
        assert!(found.has_result() && found.others[0].num_common == 7);
    }
    // Two images of one stem: nobody knows which is meant.
    b.model.images.get_mut(&ImageId(2)).unwrap().name = "right/000000.png".into();
    assert_eq!(matched(&b, MatchBy::Stem).others[0].num_common, 5);
}

#[test]
fn intrinsics_stand_side_by_side_also_for_pictures_of_another_size() {
    let a = flight(9, curve);
    let mut b = a.clone();
    b.model.cameras.insert(CameraId(1), Camera::with_focal(480, 270, 444.4));
    let pair = &compared(&a, &b).intrinsics[0];
    assert_eq!(pair.num_images, 9);
    assert!((pair.focal_difference - 0.01).abs() < 1e-9, "{}", pair.focal_difference);
}

#[test]
fn a_comparison_is_a_table_and_json() {
    let a = flight(12, curve);
    let mut b = a.clone();
    b.model.transform(&similarity());
    b.cost = Some(Cost { cpu_s: 12.5, wall_s: 7.0, peak_rss_mib: 250.0 });
    let comparison = compare(&a, &[b.clone(), b], LengthUnit::Metre, MatchBy::Name);
    let json = serde_json::to_string(&comparison).unwrap();
    assert_eq!(serde_json::from_str::<Comparison>(&json).unwrap(), comparison);
    let text = comparison.to_string();
    for part in ["registered in both", "AUC at 5°", "centers, RMSE, m", "12.5", "aligned by 12 of 12 camera centers"] {
        assert!(text.contains(part), "{part} is missing in\n{text}");
    }
}

#[test]
fn nothing_at_all_is_compared_without_a_panic() {
    let (a, b) = (flight(0, curve), flight(5, curve));
    for (reference, other) in [(&a, &b), (&b, &a), (&a, &a)] {
        let against = compared(reference, other);
        assert!(against.alignment.as_ref().is_err() && against.relative.as_ref().is_err());
        assert!(against.images.is_empty());
    }
    let still = flight(8, |_| Point3::new(1.0, 2.0, 3.0));
    assert!(compared(&still, &b).alignment.as_ref().unwrap_err().contains("coincide"));
}

/// Points all over the view of every camera, seen half a pixel off at the most.
fn see_all_over(side: &mut Side) {
    let camera = side.model.cameras[&CameraId(1)];
    let mut rng = seeded_rng(9, 0);
    for id in 0..60 {
        let around = |limit: f64, rng: &mut crate::math::Rng| rng.random_range(-limit..limit);
        let position =
            Point3::new(35.0 + around(60.0, &mut rng), around(25.0, &mut rng), 100.0 + around(30.0, &mut rng));
        let mut track = Vec::new();
        for (image, seen) in &mut side.model.images {
            let Some(pixel) = camera.pixel_from_cam(seen.cam_from_world * position) else { continue };
            track.push(TrackElement { image: *image, observation_idx: seen.observations.len() as u32 });
            let pixel = pixel + nalgebra::Vector2::from_fn(|_, _| around(0.5, &mut rng));
            seen.observations.push(Observation { pixel, point: Some(Point3dId(id)) });
        }
        side.model.points.insert(Point3dId(id), Point3d { position, rgb: [0; 3], error_px: 0.3, track });
    }
}

#[test]
fn deviations_are_held_against_the_reference_in_the_gauge_of_the_covariance() {
    let mut other = flight(8, |t| Point3::new(10.0 * t, 0.3 * t * t, 0.0));
    let mut reference = other.clone();
    reference.model.transform(&similarity());
    assert!(compared(&reference, &other).coverage.as_ref().is_err(), "nothing is observed");
    see_all_over(&mut other);
    let found = *compared(&reference, &other).coverage.as_ref().unwrap();
    assert_eq!((found.num_images, found.within), (7, [1.0; 3]));
    assert!(found.median_in_deviations < 1e-6, "{found:?}");
    // One camera of the reference lies a third of the path away.
    let moved = reference.model.images.get_mut(&ImageId(4)).unwrap();
    let center = moved.cam_from_world.center() + Vector3::new(0.0, 0.0, 2e-3);
    moved.cam_from_world = Rigid3::from_rotation_and_center(moved.cam_from_world.rotation, center);
    let comparison = compare(&reference, std::slice::from_ref(&other), LengthUnit::Metre, MatchBy::Name);
    let found = comparison.others[0].coverage.as_ref().unwrap();
    assert!((found.within[2] - 6.0 / 7.0).abs() < 1e-12, "{found:?}");
    assert!(comparison.to_string().contains("86, 86, 86 %"), "{comparison}");
    // The image that holds the gauge is not in the reference.
    reference.model.images.remove(&ImageId(1));
    assert!(compared(&reference, &other).coverage.as_ref().unwrap_err().contains("gauge"));
}
