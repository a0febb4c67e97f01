use std::collections::BTreeMap;

use nalgebra::{Point2, Point3, Vector3};
use rand::Rng as _;

use super::*;
use crate::camera::Model;
use crate::io::testing::{in_data, in_repository};
use crate::math::{Rigid3, seeded_rng};
use crate::scene::{Image, Observation, Point3d, TrackElement};

/// A small model of random numbers, every kind of camera in it, observations with and without points.
fn sample() -> Reconstruction {
    let mut rng = seeded_rng(7, 0);
    let third = 1.0 / 3.0;
    let camera = |values: &[f64]| Camera::prior(960, 540).with_parameters(values).unwrap();
    let cameras = [
        (CameraId(1), camera(&[880.0, 880.0, 480.1, third])),
        (CameraId(4), camera(&[880.0, 881.0 + 1e-13, 480.1, third])),
        (CameraId(5), camera(&[0.1 + 0.2, 0.1 + 0.2, 480.1, third, -0.1, 1e-17])),
        (CameraId(9), camera(&[880.0, 881.0, 480.1, third, 0.05, 0.0, 1e-3, -2e-3, 0.01])),
        (CameraId(10), camera(&[880.0, 880.0, 480.0, 270.0])),
    ];
    let mut camera_forms: BTreeMap<_, _> =
        cameras.iter().map(|(id, camera)| (*id, CameraForm::Covered(Model::of(camera)))).collect();
    // A model with more parameters than its values need.
    camera_forms.insert(CameraId(10), CameraForm::Covered(Model::FullOpenCv));
    let camera_ids: Vec<_> = cameras.iter().map(|(id, _)| *id).collect();
    let mut images = BTreeMap::new();
    for index in 0..4u32 {
        let mut number = || rng.random_range(-10.0..10.0);
        let rotation = UnitQuaternion::from_euler_angles(number(), number(), number());
        let cam_from_world = Rigid3::new(rotation, Vector3::new(number(), number() * 1e-9, number() * 1e12));
        let observations = (0..5u64)
            .map(|k| Observation {
                pixel: Point2::new(number() + 100.0, number() + 100.0),
                point: (k % 2 == 0).then_some(Point3dId(1 + k)),
            })
            .collect();
        let name = format!("{index:06}.jpg");
        let camera = camera_ids[index as usize];
        images.insert(ImageId(index + 1), Image { name, camera, cam_from_world, observations });
    }
    images.insert(
        ImageId(9),
        Image {
            name: "empty.jpg".into(),
            camera: CameraId(1),
            cam_from_world: Rigid3::identity(),
            observations: vec![],
        },
    );
    let points = [1, 3, 5].map(|id| {
        let track = (1..5).map(|i| TrackElement { image: ImageId(i), observation_idx: id as u32 - 1 }).collect();
        let position = Point3::new(rng.random(), rng.random::<f64>() * 1e-20, rng.random());
        (Point3dId(id), Point3d { position, rgb: [0, 128, 255], error_px: rng.random(), track })
    });
    Reconstruction { cameras: cameras.into(), camera_forms, images, points: points.into() }
}

fn written(model: &Reconstruction, binary: bool) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    if binary { write_binary(folder.path(), model) } else { write_text(folder.path(), model) }.unwrap();
    folder
}

#[test]
fn both_forms_round_trip_exactly() {
    for model in [sample(), Reconstruction::default()] {
        for binary in [false, true] {
            assert_eq!(read(written(&model, binary).path()).unwrap(), model, "binary: {binary}");
        }
    }
}

#[test]
fn every_camera_model_is_read_or_refused_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cameras.txt");
    let read_line = |line: &str| {
        std::fs::write(&path, format!("# comment\n\n{line}\n")).unwrap();
        read_cameras(&path).map(|cameras| cameras[&CameraId(3)].parameters())
    };
    let cases: [(&str, &[f64]); 6] = [
        ("3 SIMPLE_PINHOLE 8 6 5 4 3", &[5.0, 5.0, 4.0, 3.0]),
        ("3 PINHOLE 8 6 5 5.5 4 3", &[5.0, 5.5, 4.0, 3.0]),
        ("3 SIMPLE_RADIAL 8 6 5 4 3 0.1", &[5.0, 5.0, 4.0, 3.0, 0.1]),
        ("3 RADIAL 8 6 5 4 3 0.1 -0.2", &[5.0, 5.0, 4.0, 3.0, 0.1, -0.2]),
        ("3 OPENCV 8 6 5 5.5 4 3 0.1 -0.2 0.3 0.4", &[5.0, 5.5, 4.0, 3.0, 0.1, -0.2, 0.3, 0.4]),
        ("3 FULL_OPENCV 8 6 5 5.5 4 3 0.1 -0.2 0.3 0.4 0.5 0 0 0", &[5.0, 5.5, 4.0, 3.0, 0.1, -0.2, 0.3, 0.4, 0.5]),
    ];
    for (line, expected) in cases {
        let expected = Camera::prior(8, 6).with_parameters(expected).unwrap();
        assert_eq!(read_line(line).unwrap(), expected.parameters(), "{line}");
    }
    let refused = [
        ("3 FULL_OPENCV 8 6 5 5.5 4 3 0 0 0 0 0 0 0 0.1", "FULL_OPENCV with k4, k5 or k6"),
        ("3 OPENCV_FISHEYE 8 6 5 5.5 4 3 0 0 0 0", "OPENCV_FISHEYE"),
        ("3 EQUIRECTANGULAR 8 6 8 6", "EQUIRECTANGULAR"),
        ("3 LATER_MODEL 8 6 8 6", "LATER_MODEL"),
        ("3 PINHOLE 8 6 5 5.5 4", "line 3: camera parameter: the line ends here"),
        ("3 PINHOLE 8 6 5 5.5 4 3 2", "line 3: end of line: unexpected '2'"),
        ("3 PINHOLE 0 6 5 5.5 4 3", "line 3: image size"),
        ("3 PINHOLE 8 6 5 nan 4 3", "line 3: camera parameter: NaN"),
        ("x PINHOLE 8 6 5 5 4 3", "line 3: camera id: 'x' is not a number"),
        ("3 PINHOLE 8 6 5 5 4 3\n3 PINHOLE 8 6 5 5 4 3", "line 4: camera id: 3 occurs twice"),
    ];
    for (line, expected) in refused {
        let error = read_line(line).unwrap_err().to_string();
        assert!(error.contains(expected) && error.contains("cameras.txt"), "{line}: {error}");
    }
}

/// COLMAP's reader of text truncates a name at its first blank.
#[test]
fn names_with_blanks_go_to_binary_files() {
    let mut model = sample();
    model.images.get_mut(&ImageId(3)).unwrap().name = "a/name with blanks.jpg".into();
    let folder = tempfile::tempdir().unwrap();
    let refused = write_text(folder.path(), &model).unwrap_err().to_string();
    assert!(refused.contains("name with blanks") && refused.contains("binary"), "{refused}");
    write(folder.path(), &model, Encoding::Auto).unwrap();
    assert!(folder.path().join("images.bin").is_file());
    assert_eq!(read(folder.path()).unwrap(), model);
    let plain = tempfile::tempdir().unwrap();
    write(plain.path(), &sample(), Encoding::Auto).unwrap();
    assert!(plain.path().join("images.txt").is_file());
}

/// Names with blanks in text files of earlier versions of this program are read completely.
#[test]
fn names_with_blanks_are_read_from_text() {
    let folder = written(&sample(), false);
    let path = folder.path().join("images.txt");
    let text = std::fs::read_to_string(&path).unwrap().replace("000001.jpg", "with a blank.jpg");
    std::fs::write(&path, text).unwrap();
    assert_eq!(read(folder.path()).unwrap().images[&ImageId(2)].name, "with a blank.jpg");
}

/// Unsupported camera models and models with zeros are preserved; only geometry refuses the first.
#[test]
fn every_camera_model_round_trips_through_text_and_binary() {
    let mut model = Reconstruction::default();
    for (k, form) in (1..).zip(Model::ALL) {
        let params: Vec<f64> = (0..form.num_params()).map(|i| 2.0 + 0.125 * i as f64).collect();
        let (camera, form) = camera_model::camera(form, 8, 6, params);
        model.cameras.insert(CameraId(k), camera);
        model.camera_forms.insert(CameraId(k), form);
    }
    for binary in [false, true] {
        let folder = written(&model, binary);
        assert_eq!(read_any(folder.path()).unwrap(), model, "binary: {binary}");
        let error = read(folder.path()).unwrap_err().to_string();
        assert!(error.contains("camera 6: camera model OPENCV_FISHEYE"), "binary: {binary}: {error}");
    }
}

#[test]
fn an_adjusted_camera_outgrows_the_model_of_its_file() {
    let mut model = Reconstruction::default();
    let camera = Camera { radial: [0.1, 0.0], ..Camera::with_focal(8, 6, 5.0) };
    model.cameras.insert(CameraId(1), camera);
    model.camera_forms.insert(CameraId(1), CameraForm::Covered(Model::Pinhole));
    assert_eq!(camera_model::written(&model, CameraId(1), &camera).0, Model::SimpleRadial);
    let straight = Camera { radial: [0.0; 2], ..camera };
    assert_eq!(camera_model::written(&model, CameraId(1), &straight).0, Model::Pinhole);
}

#[test]
fn a_binary_camera_of_an_unknown_model_is_refused_by_number() {
    let folder = written(&sample(), true);
    let path = folder.path().join("cameras.bin");
    let mut bytes = std::fs::read(&path).unwrap();
    bytes[12] = 99;
    std::fs::write(&path, bytes).unwrap();
    assert!(read(folder.path()).unwrap_err().to_string().contains("camera 1: camera model 99"));
}

#[test]
fn a_truncated_binary_model_is_an_error() {
    let folder = written(&sample(), true);
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let path = folder.path().join(name);
        let whole = std::fs::read(&path).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            let error = read(folder.path()).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("byte"), "{name} cut at {length}: {error}");
        }
        std::fs::write(&path, [whole.as_slice(), &[0]].concat()).unwrap();
        assert!(read(folder.path()).unwrap_err().to_string().contains("1 bytes follow"));
        std::fs::write(&path, whole).unwrap();
    }
    assert_eq!(read(folder.path()).unwrap(), sample());
}

#[test]
fn a_count_beyond_the_file_allocates_nothing() {
    let folder = written(&sample(), true);
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let path = folder.path().join(name);
        let whole = std::fs::read(&path).unwrap();
        for count in [u64::MAX, 1 << 40, 1000] {
            std::fs::write(&path, [&count.to_le_bytes(), &whole[8..]].concat()).unwrap();
            let error = read(folder.path()).unwrap_err().to_string();
            assert!(error.contains("do not fit"), "{name}: {error}");
        }
        std::fs::write(&path, whole).unwrap();
    }
}

#[test]
fn damaged_bytes_never_panic() {
    let folder = written(&sample(), true);
    let mut rng = seeded_rng(11, 0);
    for name in ["cameras.bin", "images.bin", "points3D.bin"] {
        let path = folder.path().join(name);
        let whole = std::fs::read(&path).unwrap();
        for _ in 0..300 {
            let mut damaged = whole.clone();
            for _ in 0..rng.random_range(1..6) {
                let at = rng.random_range(0..damaged.len());
                damaged[at] = rng.random();
            }
            std::fs::write(&path, damaged).unwrap();
            let _ = read(folder.path());
        }
        std::fs::write(&path, whole).unwrap();
    }
}

#[test]
fn broken_text_names_file_line_and_field() {
    let folder = written(&sample(), false);
    let cases = [
        ("images.txt", "1 1 0 0 0 0 0 0 1", "line 1: name"),
        ("images.txt", "1 0 0 0 0 0 0 0 1 a.jpg", "line 1: qw qx qy qz"),
        ("images.txt", "1 1 0 0 0 0 0 0 1 a.jpg\n1 2", "line 2: point id"),
        ("images.txt", "1 1 0 0 0 0 0 0 1 a.jpg\n1 2 -7", "line 2: point id: -7 is negative"),
        ("images.txt", "1 1 0 0 0 0 0 0 1 a.jpg\n\n1 1 0 0 0 0 0 0 1 a.jpg\n", "line 3: image id: 1 occurs twice"),
        ("points3D.txt", "1 0 0 inf 1 2 3 0.5", "line 1: z: inf"),
        ("points3D.txt", "1 0 0 0 1 2 256 0.5", "line 1: blue: '256'"),
        ("points3D.txt", "1 0 0 0 1 2 3 0.5 1", "line 1: observation index of a track"),
        ("points3D.txt", "1 0 0 0 1 2 3 0.5 77 0", "observation 0 of image 77"),
        ("points3D.txt", "", "tracks have 0 observations"),
        ("cameras.txt", "", "camera 1 does not exist"),
    ];
    for (name, content, expected) in cases {
        let path = folder.path().join(name);
        let whole = std::fs::read(&path).unwrap();
        std::fs::write(&path, content).unwrap();
        let error = read(folder.path()).unwrap_err().to_string();
        assert!(error.contains(expected), "{content:?}: {error}");
        std::fs::write(&path, whole).unwrap();
    }
    std::fs::write(folder.path().join("images.txt"), [0xff, 0xfe]).unwrap();
    assert!(read(folder.path()).unwrap_err().to_string().contains("UTF-8"));
    std::fs::remove_file(folder.path().join("images.txt")).unwrap();
    assert!(read(folder.path()).unwrap_err().is_not_found());
}

#[test]
fn models_that_a_file_cannot_represent_are_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let mut model = sample();
    model.images.get_mut(&ImageId(1)).unwrap().name = "two\nlines".into();
    assert!(write_text(folder.path(), &model).unwrap_err().to_string().contains("two\\nlines"));
    let mut model = sample();
    model.points.get_mut(&Point3dId(3)).unwrap().position.y = f64::NAN;
    assert!(write_binary(folder.path(), &model).unwrap_err().to_string().contains("point 3"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    write_binary(folder.path(), &sample()).unwrap();
    assert!(write_text(folder.path(), &sample()).unwrap_err().to_string().contains("binary model"));
}

/// Recomputes the stored errors from poses, intrinsics and points: the conventions agree.
fn assert_errors_match(model: &Reconstruction, tolerance_px: f64) {
    for (id, point) in &model.points {
        let errors = point.track.iter().map(|e| {
            let image = &model.images[&e.image];
            let pixel = model.camera_of(image).pixel_from_cam(image.cam_from_world * point.position).unwrap();
            (pixel - image.observations[e.observation_idx as usize].pixel).norm()
        });
        let mean = errors.sum::<f64>() / point.track.len() as f64;
        assert!((mean - point.error_px).abs() < tolerance_px, "point {}: {mean} and {}", id.0, point.error_px);
    }
}

#[test]
fn a_model_in_colmaps_own_formats_is_read() {
    let binary = read(&in_repository("tests/golden/models/colmap_binary")).unwrap();
    let text = read(&in_repository("tests/golden/models/colmap_text")).unwrap();
    assert_eq!(binary, text);
    assert_eq!((text.cameras.len(), text.images.len(), text.points.len()), (2, 3, 12));
    assert_eq!(text.cameras[&CameraId(1)].radial, [0.05, 0.0]);
    assert_eq!(text.cameras[&CameraId(2)].principal, [318.0, 242.0]);
    let image = &text.images[&ImageId(3)];
    assert_eq!((image.name.as_str(), image.camera), ("right.jpg", CameraId(2)));
    assert!((image.cam_from_world.center() - Point3::new(0.7, 0.02, -3.9)).norm() < 1e-12);
    let unmatched = image.observations.last().unwrap();
    assert_eq!((unmatched.pixel, unmatched.point), (Point2::new(12.5, 20.25), None));
    // Every observation is a quarter of a pixel off its projection.
    assert!(text.points.values().all(|point| (point.error_px - 0.25).abs() < 1e-12));
    assert_errors_match(&text, 1e-9);
}

#[test]
#[ignore = "needs TRACTRIX_DATA"]
fn models_that_colmap_wrote_are_read() {
    let object = read(&in_data("interchange/right_curve/colmap_object_bin")).unwrap();
    assert_eq!((object.images.len(), object.points.len()), (60, 2128));
    assert_eq!(object.cameras[&CameraId(1)], Camera::with_focal(960, 540, 880.0));
    // COLMAP's own summary: the mean over points, not over observations.
    let mean_error_px = object.points.values().map(|p| p.error_px).sum::<f64>() / object.points.len() as f64;
    assert!((mean_error_px - 0.384257).abs() < 1e-6);
    let fountain = read(&in_data("interchange/fountain-P11/colmap_bin")).unwrap();
    assert_eq!((fountain.images.len(), fountain.points.len()), (11, 14002));
    let camera = &fountain.cameras[&CameraId(1)];
    assert!((camera.radial[0] + 0.00249982825).abs() < 1e-10 && camera.radial[1] == 0.0);
    assert_errors_match(&fountain, 1e-6);
}

/// Every camera is a rig and every image a frame, byte for byte as COLMAP 4.2.1 writes such a model.
#[test]
fn rigs_and_frames_are_written() {
    let model = sample();
    let binary = written(&model, true);
    let rigs = std::fs::read(binary.path().join("rigs.bin")).unwrap();
    assert_eq!(rigs.len(), 8 + 16 * model.cameras.len());
    assert_eq!(rigs[..24], [5, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0]);
    let frames = std::fs::read(binary.path().join("frames.bin")).unwrap();
    assert_eq!(frames.len(), 8 + (8 + 56 + 4 + 16) * model.images.len());
    let text = written(&model, false);
    let rigs = std::fs::read_to_string(text.path().join("rigs.txt")).unwrap();
    assert!(rigs.ends_with("1 1 CAMERA 1\n4 1 CAMERA 4\n5 1 CAMERA 5\n9 1 CAMERA 9\n10 1 CAMERA 10\n"), "{rigs}");
    let frames = std::fs::read_to_string(text.path().join("frames.txt")).unwrap();
    assert!(frames.ends_with("9 1 1 0 0 0 0 0 0 1 CAMERA 1 9\n"), "{frames}");
    assert_eq!((num_rigs_of_several(binary.path()), num_rigs_of_several(text.path())), (0, 0));
}

#[test]
fn rigs_of_several_cameras_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(num_rigs_of_several(folder.path()), 0);
    let text = "# comment\n1 1 CAMERA 1\n2 3 CAMERA 2 CAMERA 3 0 IMU 1 1 1 0 0 0 1 2 3\n";
    std::fs::write(folder.path().join("rigs.txt"), text).unwrap();
    assert_eq!(num_rigs_of_several(folder.path()), 1);
    std::fs::write(folder.path().join("cameras.bin"), 0u64.to_le_bytes()).unwrap();
    let mut rigs = 1u64.to_le_bytes().to_vec();
    rigs.extend([2u32, 3, 0, 2, 0, 3].iter().flat_map(|v| v.to_le_bytes()));
    rigs.push(0);
    rigs.extend([1u32, 1].iter().flat_map(|v| v.to_le_bytes()));
    rigs.push(1);
    rigs.extend([0; 56]);
    std::fs::write(folder.path().join("rigs.bin"), &rigs).unwrap();
    assert_eq!(num_rigs_of_several(folder.path()), 1);
    rigs.truncate(20);
    std::fs::write(folder.path().join("rigs.bin"), rigs).unwrap();
    assert_eq!(num_rigs_of_several(folder.path()), 0);
}
