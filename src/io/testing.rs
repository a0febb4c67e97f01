//! Shared parts of tests of formats: file paths, an unusual model, and a comparison of models.

use std::collections::BTreeMap;
use std::path::PathBuf;

use nalgebra::{Point2, Point3, UnitQuaternion};
use rand::Rng as _;

use crate::camera::Camera;
use crate::math::{Rigid3, seeded_rng};
use crate::scene::{CameraId, Image, ImageId, Observation, Point3dId, Reconstruction};

/// Path of a file or folder of the repository.
pub fn in_repository(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// Path in the data outside the repository, for tests marked `#[ignore = "needs TRACTRIX_DATA"]`.
pub fn in_data(path: &str) -> PathBuf {
    let data = std::env::var_os("TRACTRIX_DATA").expect("TRACTRIX_DATA names the folder of the data");
    PathBuf::from(data).join(path)
}

/// A small model in front of four cameras: distortion terms, names with folders, blanks and letters of all kinds, a gap
/// in the ids, features without a point. Every feature is slightly off its projection.
pub(crate) fn odd_model() -> Reconstruction {
    let lens = |values: &[f64]| Camera::prior(960, 540).with_parameters(values).unwrap();
    model_with(&[
        lens(&[700.0, 700.0, 481.25, 269.5, -0.1, 0.02, 1e-3, -2e-3, 0.004]),
        lens(&[710.0, 710.0, 480.0, 270.0, -0.08]),
        lens(&[720.0, 720.0, 480.0, 270.0]),
    ])
}

/// As [`odd_model`], with other cameras.
pub(crate) fn model_with(lenses: &[Camera]) -> Reconstruction {
    let mut rng = seeded_rng(5, 0);
    let cameras: BTreeMap<_, _> = (1..).map(CameraId).zip(lenses.iter().copied()).collect();
    let mut model = Reconstruction { cameras, ..Reconstruction::default() };
    let names = ["plain.jpg", "folder/plain.jpg", "deep/er/with blank.png", "Größe 7.JPG"];
    for (k, name) in names.into_iter().enumerate() {
        let turn = UnitQuaternion::from_euler_angles(0.1 * k as f64, -0.07 * k as f64, 0.3);
        let center = Point3::new(0.6 * k as f64 - 1.0, rng.random_range(-0.2..0.2), -6.0);
        let cam_from_world = Rigid3::from_rotation_and_center(turn, center);
        let camera = CameraId(1 + (k % lenses.len()) as u32);
        let feature = Observation { pixel: Point2::new(3.25, 7.5), point: None };
        let image = Image { name: name.into(), camera, cam_from_world, observations: vec![feature] };
        model.images.insert(ImageId(if k < 2 { 1 } else { 4 } + k as u32), image);
    }
    for k in 0..12u64 {
        let position =
            Point3::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
        let offset = nalgebra::Vector2::new(rng.random_range(-0.5..0.5), rng.random_range(-0.5..0.5));
        let seen: Vec<_> = model
            .images
            .iter()
            .filter(|(id, _)| !(u64::from(id.0) + k).is_multiple_of(4))
            .map(|(id, image)| {
                let pixel = model.camera_of(image).pixel_from_cam(image.cam_from_world * position).unwrap();
                (*id, pixel + offset)
            })
            .collect();
        let id = Point3dId(1 + k + 3 * (k / 6));
        super::interchange::assembly::add_point(&mut model, id, position, [10 * k as u8, 200, 3], seen.into_iter())
            .unwrap();
    }
    model
}

/// Asserts that two models agree: names, intrinsics, poses, points, and the observations of the points' tracks. Ids of
/// cameras, colors and features without a point are not compared.
pub(crate) fn near(found: &Reconstruction, expected: &Reconstruction, tolerance: f64) {
    let key = |model: &Reconstruction| model.images.keys().copied().collect::<Vec<_>>();
    assert_eq!(key(found), key(expected));
    for (a, b) in found.images.values().zip(expected.images.values()) {
        assert_eq!(a.name, b.name);
        let (lens, other) = (found.camera_of(a).parameters(), expected.camera_of(b).parameters());
        assert!(
            lens.iter().zip(&other).all(|(p, q)| (p - q).abs() < tolerance * 1e3),
            "{}: {lens:?} {other:?}",
            a.name
        );
        let apart = a.cam_from_world * b.cam_from_world.inverse();
        assert!(apart.rotation.angle() < 1e-7 && apart.translation.norm() < tolerance * 1e3, "{}: {apart:?}", a.name);
    }
    assert_eq!(found.points.len(), expected.points.len());
    for (a, b) in found.points.values().zip(expected.points.values()) {
        assert!((a.position - b.position).norm() < tolerance);
        assert_eq!(seen_by(found, a).len(), seen_by(expected, b).len());
        for ((image, pixel), (other, expected)) in seen_by(found, a).into_iter().zip(seen_by(expected, b)) {
            assert!(image == other && (pixel - expected).norm() < tolerance * 1e3, "{image}: {pixel} {expected}");
        }
        assert!((a.error_px - b.error_px).abs() < tolerance * 1e4, "{} {}", a.error_px, b.error_px);
    }
}

fn seen_by(model: &Reconstruction, point: &crate::scene::Point3d) -> Vec<(String, Point2<f64>)> {
    let seen = |element: &crate::scene::TrackElement| {
        let image = &model.images[&element.image];
        (image.name.clone(), image.observations[element.observation_idx as usize].pixel)
    };
    point.track.iter().map(seen).collect()
}

/// As [`near`], without sizes and principal points: positions are compared relative to the latter.
pub(crate) fn near_but_for_sizes(found: &Reconstruction, expected: &Reconstruction, tolerance: f64) {
    let centered = |model: &Reconstruction| {
        let mut model = model.clone();
        let principal: BTreeMap<_, _> = model.cameras.iter().map(|(id, c)| (*id, c.principal)).collect();
        for image in model.images.values_mut() {
            let [cx, cy] = principal[&image.camera];
            image.observations.iter_mut().for_each(|o| o.pixel -= nalgebra::Vector2::new(cx, cy));
        }
        model.cameras.values_mut().for_each(|c| c.principal = [0.0; 2]);
        // Ids are indices in the file.
        let ids: BTreeMap<_, _> = model.images.keys().copied().zip((1..).map(ImageId)).collect();
        model.images = model.images.into_iter().map(|(id, image)| (ids[&id], image)).collect();
        let renamed = |element: &mut crate::scene::TrackElement| element.image = ids[&element.image];
        model.points.values_mut().flat_map(|point| &mut point.track).for_each(renamed);
        model
    };
    near(&centered(found), &centered(expected), tolerance);
}

/// Reads a text truncated at every length, and with randomly changed bytes; the complete text must be readable.
pub(crate) fn damaged_text_never_panics(whole: &str, read: impl Fn(&str) -> bool) {
    assert!(read(whole));
    let mut rng = seeded_rng(13, 0);
    for length in (0..whole.len()).filter(|length| whole.is_char_boundary(*length)) {
        read(&whole[..length]);
    }
    for _ in 0..300 {
        let mut bytes = whole.as_bytes().to_vec();
        for _ in 0..rng.random_range(1..5) {
            let at = rng.random_range(0..bytes.len());
            bytes[at] = *b"0129-.e \n{}[],:\"x".get(rng.random_range(0..19)).unwrap_or(&b'7');
        }
        read(&String::from_utf8_lossy(&bytes));
    }
}
