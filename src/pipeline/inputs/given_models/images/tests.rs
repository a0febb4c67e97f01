//! Images that are rotated, reduced, undistorted, or of unknown size.

use nalgebra::Point3;

use super::*;
use crate::io::testing::model_with;

fn lens(width: u32, height: u32, values: &[f64]) -> Camera {
    Camera::prior(width, height).with_parameters(values).unwrap()
}

/// A landscape camera with all distortion terms.
fn odd_lens() -> Camera {
    lens(960, 540, &[700.0, 710.0, 481.25, 269.5, -0.1, 0.02, 1e-3, -2e-3, 0.004])
}

fn fitted(mut model: Reconstruction, pictures: &Pictures) -> Result<(Reconstruction, Vec<String>), String> {
    let remarks = fit(Path::new("m"), &mut model, &BTreeSet::new(), pictures).map_err(|error| error.to_string())?;
    Ok((model, remarks.into_iter().map(|warning| warning.text).collect()))
}

/// The reprojection errors of all points, in pixels of the larger side's share.
fn assert_same_errors(found: &Reconstruction, before: &Reconstruction, scale: f64) {
    for (id, point) in &found.points {
        let (own, other) = (found.errors_of(point).unwrap(), before.errors_of(&before.points[id]).unwrap());
        assert!(own.len() == other.len() && !own.is_empty());
        assert!(own.iter().zip(&other).all(|(a, b)| (a - b * scale).abs() < 1e-8), "{own:?} {other:?}");
    }
}

#[test]
fn a_rotated_camera_projects_rotated_points() {
    let camera = odd_lens();
    let point = Point3::new(0.4, -0.3, 1.7);
    for num_turns in 0..4u8 {
        let turned = (0..num_turns).fold(camera, |camera, _| turned_camera(&camera));
        let seen = turned.pixel_from_cam(about_axis(num_turns) * point).unwrap();
        let expected = turned_pixel(camera.pixel_from_cam(point).unwrap(), (960, 540), num_turns);
        assert!((seen - expected).norm() < 1e-9, "{num_turns}: {seen} {expected}");
    }
}

#[test]
fn stored_images_are_rotated_individually() {
    let before = model_with(&[odd_lens()]);
    // Two of the images were rotated the other way.
    let turns = |id: FrameId| Some(if id.0.is_multiple_of(2) { 1 } else { 3 });
    for frame in [(540, 960), (270, 480)] {
        let pictures = Pictures { frame, source: (540, 960), lens: None, turns: &turns };
        let (found, _) = fitted(before.clone(), &pictures).unwrap();
        assert_eq!(found.cameras.len(), 2);
        assert!(found.cameras.values().all(|camera| (camera.width, camera.height) == frame));
        assert_same_errors(&found, &before, f64::from(frame.0) / 540.0);
        let centers = |model: &Reconstruction| {
            model.images.values().map(|image| image.cam_from_world.center()).collect::<Vec<_>>()
        };
        assert!(centers(&found).iter().zip(centers(&before)).all(|(a, b)| (a - b).norm() < 1e-12));
    }
    let pictures = Pictures { frame: (540, 960), source: (540, 960), lens: None, turns: &|_| Some(0) };
    let said = fitted(before, &pictures).unwrap_err();
    assert!(said.contains("960x540 pixels, frames of 540x960") && said.contains("upright"), "{said}");
}

#[test]
fn full_size_images_are_reduced() {
    let before = model_with(&[odd_lens()]);
    let pictures = Pictures { frame: (480, 270), source: (960, 540), lens: None, turns: &|_| Some(0) };
    let (found, remarks) = fitted(before.clone(), &pictures).unwrap();
    assert_eq!(found.cameras[&CameraId(1)].focal, [350.0, 355.0]);
    assert_same_errors(&found, &before, 0.5);
    assert!(remarks.is_empty());
    let pictures = Pictures { frame: (960, 540), ..pictures };
    assert_eq!(fitted(before.clone(), &pictures).unwrap().0, before);
    let pictures = Pictures { frame: (800, 600), source: (800, 600), ..pictures };
    let said = fitted(before, &pictures).unwrap_err();
    assert!(said.contains("960x540 pixels, frames of 800x600"), "{said}");
}

#[test]
fn undistorted_images_need_the_intrinsics_of_the_frames() {
    let before = model_with(&[lens(1000, 620, &[650.0, 650.0, 500.0, 310.0])]);
    let size = (960, 540);
    let unknown = Pictures { frame: size, source: size, lens: None, turns: &|_| Some(0) };
    let said = fitted(before.clone(), &unknown).unwrap_err();
    assert!(said.contains("1000x620 pixels, frames of 960x540") && said.contains("--intrinsics"), "{said}");
    let (found, remarks) = fitted(before.clone(), &Pictures { lens: Some(odd_lens()), ..unknown }).unwrap();
    assert!(remarks.len() == 1 && remarks[0].contains("model without distortion"), "{remarks:?}");
    let (own, other) = (&found.images, &before.images);
    for (image, before_image) in own.values().zip(other.values()) {
        assert_eq!(found.camera_of(image), &odd_lens());
        for (seen, at) in image.observations.iter().zip(&before_image.observations).skip(1) {
            let ray = odd_lens().ray_from_pixel(seen.pixel);
            let expected = before.camera_of(before_image).ray_from_pixel(at.pixel);
            assert!((ray - expected).norm() < 1e-9, "{ray} {expected}");
        }
    }
}

#[test]
fn missing_sizes_are_those_of_the_frames() {
    let mut model = model_with(&[lens(900, 500, &[700.0, 700.0, 450.0, 250.0])]);
    let before = model.clone();
    // One camera per image, as in the formats that have no sizes.
    model.images.retain(|id, _| id.0 == 1);
    let size = (960, 540);
    let pictures = Pictures { frame: size, source: size, lens: None, turns: &|_| Some(0) };
    fit(Path::new("m"), &mut model, &[CameraId(1)].into(), &pictures).unwrap();
    assert_eq!(model.cameras[&CameraId(1)].principal, [480.0, 270.0]);
    let (seen, at) = (&model.images.values().next().unwrap().observations, &before.images.values().next().unwrap());
    assert!(
        seen.iter().zip(&at.observations).all(|(a, b)| (a.pixel - b.pixel - Vector2::new(30.0, 20.0)).norm() < 1e-9)
    );
}
