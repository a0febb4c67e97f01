use nalgebra::{Point2, Point3};
use serde_json::{Value, json};

use super::*;
use crate::camera::{Camera, Model};
use crate::io::IoError;
use crate::io::testing::{in_data, in_repository, near, odd_model};
use crate::scene::{CameraForm, CameraId, ImageId, Point3dId, Reconstruction};

fn document() -> Value {
    let view = |key: u32, pose: u32| {
        json!({"key": key, "value": {"polymorphic_id": 1073741824, "ptr_wrapper": {"id": 1, "data": {
            "local_path": "", "filename": format!("{key}.jpg"), "width": 640, "height": 480, "id_view": key,
            "id_intrinsic": key % 2, "id_pose": pose}}}})
    };
    let intrinsic = |key: u32, id: u32, name: Option<&str>| {
        let mut value = json!({"polymorphic_id": id, "ptr_wrapper": {"id": 1, "data": {"width": 640, "height": 480,
            "focal_length": 500.0, "principal_point": [319.5, 239.5], "disto_k3": [0.1, -0.02, 0.0]}}});
        if let Some(name) = name {
            value["polymorphic_name"] = json!(name);
        }
        json!({"key": key, "value": value})
    };
    let rotation = json!([[1, 0, 0], [0, 1, 0], [0, 0, 1]]);
    let pose = |key: u32, x: f64| json!({"key": key, "value": {"rotation": rotation, "center": [x, 0, -4]}});
    let seen = |key: u32, x: f64| json!({"key": key, "value": {"id_feat": 3, "x": [x, 239.5]}});
    json!({"sfm_data_version": "0.3", "root_path": "images",
        "views": [view(0, 0), view(1, 1), view(2, 4294967295)],
        "intrinsics": [intrinsic(0, 0x8000_0001, Some("pinhole_radial_k3")), intrinsic(1, 1, None)],
        "extrinsics": [pose(0, 0.0), pose(1, 1.0)],
        "structure": [{"key": 7, "value": {"X": [0, 0, 0],
            "observations": [seen(0, 319.5), seen(1, 193.75), seen(2, 3.0)]}}],
        "control_points": []})
}

fn read_value(document: &Value) -> Result<Reconstruction, IoError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sfm_data.json");
    std::fs::write(&path, document.to_string()).unwrap();
    read(&path)
}

#[test]
fn centers_and_pixels_are_converted_to_our_conventions() {
    let model = read_value(&document()).unwrap();
    assert_eq!(model.images.len(), 2, "the view without pose is not registered");
    assert_eq!(model.cameras[&CameraId(2)].principal, [320.0, 240.0]);
    assert_eq!(model.cameras[&CameraId(2)].radial, [0.1, -0.02]);
    let image = &model.images[&ImageId(2)];
    assert_eq!(image.name, "1.jpg");
    assert_eq!(image.cam_from_world.center(), Point3::new(1.0, 0.0, -4.0));
    assert_eq!(image.observations[0].pixel, Point2::new(194.25, 240.0));
    let point = &model.points[&Point3dId(8)];
    assert_eq!(point.track.len(), 2);
    // Seen exactly in view 0; in view 1 at x = −1/4, distorted by 1 + 0.1/16 − 0.02/256.
    let error: f64 = 125.0 * (1.0 + 0.1 / 16.0 - 0.02 / 256.0) - 125.75;
    assert!((point.error_px - error.abs() / 2.0).abs() < 1e-9);
}

#[test]
fn the_image_folder_is_part_of_the_name() {
    let mut document = document();
    for (view, path) in [(0, "left"), (1, "right/")] {
        let data = &mut document["views"][view]["value"]["ptr_wrapper"]["data"];
        data["local_path"] = json!(path);
        data["filename"] = json!("0.jpg");
    }
    let model = read_value(&document).unwrap();
    let names: Vec<_> = model.images.values().map(|image| image.name.as_str()).collect();
    assert_eq!(names, ["left/0.jpg", "right/0.jpg"]);
}

#[test]
fn every_camera_of_openmvg_is_read() {
    let read_as = |name: &str, data: Value| {
        let mut document = document();
        document["intrinsics"][0]["value"]["polymorphic_name"] = json!(name);
        let whole = &mut document["intrinsics"][0]["value"]["ptr_wrapper"]["data"];
        whole.as_object_mut().unwrap().remove("disto_k3");
        whole.as_object_mut().unwrap().extend(data.as_object().unwrap().clone());
        document["intrinsics"].as_array_mut().unwrap().truncate(1);
        document["views"].as_array_mut().unwrap().truncate(1);
        document["structure"] = json!([]);
        let model = read_value(&document).unwrap();
        (model.cameras[&CameraId(1)], model.camera_forms.get(&CameraId(1)).cloned())
    };
    let lens = |values: &[f64]| {
        let all = [&[500.0, 500.0, 320.0, 240.0], values].concat();
        (Camera::prior(640, 480).with_parameters(&all).unwrap(), None)
    };
    assert_eq!(read_as("pinhole", json!({})), lens(&[]));
    assert_eq!(read_as("pinhole_radial_k1", json!({"disto_k1": [0.1]})), lens(&[0.1]));
    assert_eq!(read_as("pinhole_radial_k3", json!({"disto_k3": [0.1, 0.2, 0.3]})), lens(&[0.1, 0.2, 0.0, 0.0, 0.3]));
    assert_eq!(read_as("pinhole_brown_t2", json!({"disto_t2": [1, 2, 3, 4, 5]})), lens(&[1.0, 2.0, 4.0, 5.0, 3.0]));
    let (camera, form) = read_as("fisheye", json!({"fisheye": [0.1, 0.2, 0.3, 0.4]}));
    assert_eq!((camera.focal, camera.radial), ([500.0; 2], [0.0; 2]));
    let params = vec![500.0, 500.0, 320.0, 240.0, 0.1, 0.2, 0.3, 0.4];
    assert_eq!(form, Some(CameraForm::Foreign(Model::OpenCvFisheye, params)));
    let (_, form) = read_as("spherical", json!({"value0": {"width": 640, "height": 320}}));
    assert_eq!(form, Some(CameraForm::Foreign(Model::Equirectangular, vec![640.0, 320.0])));
}

#[test]
fn a_model_round_trips_except_for_colors_and_unmatched_features() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sfm_data.json");
    let model = odd_model();
    let losses = write(&path, &model).unwrap();
    assert_eq!(losses.sentences().len(), 2, "{losses:?}");
    near(&read(&path).unwrap(), &model, 1e-9);
}

#[test]
fn two_focal_lengths_are_refused() {
    let mut model = odd_model();
    model.cameras.values_mut().next().unwrap().focal = [500.0, 501.0];
    let folder = tempfile::tempdir().unwrap();
    let error = write(&folder.path().join("a.json"), &model).unwrap_err().to_string();
    assert!(error.contains("focal lengths 500.000 and 501.000"), "{error}");
}

#[test]
fn inconsistent_files_are_refused() {
    let refused = |change: fn(&mut Value)| {
        let mut document = document();
        change(&mut document);
        read_value(&document).unwrap_err().to_string()
    };
    let other = |d: &mut Value| d["intrinsics"][0]["value"]["polymorphic_name"] = json!("pinhole_later");
    assert!(refused(other).contains("'pinhole_later'"));
    let short = |d: &mut Value| d["intrinsics"][0]["value"]["ptr_wrapper"]["data"]["disto_k3"] = json!([0.1, 0.0]);
    assert!(refused(short).contains("pinhole_radial_k3 with invalid parameters"));
    assert!(refused(|d| d["extrinsics"] = json!([])).contains("image list"));
    assert!(refused(|d| d["extrinsics"][0]["value"]["rotation"][0][0] = json!(2)).contains("pose 0"));
    assert!(refused(|d| d["views"][0]["value"]["ptr_wrapper"]["data"]["id_intrinsic"] = json!(9)).contains("view 0"));
    let unknown = |d: &mut Value| d["structure"][0]["value"]["observations"][0]["key"] = json!(50);
    assert!(refused(unknown).contains("view 50"));
    assert!(refused(|d| d["views"] = json!(3)).contains("not valid in OpenMVG's sfm_data.json"));
}

#[test]
fn the_same_model_is_read_from_openmvg_and_colmap() {
    let model = read(&in_repository("tests/golden/models/openmvg/sfm_data.json")).unwrap();
    let colmap = crate::io::interchange::colmap::read(&in_repository("tests/golden/models/colmap_text")).unwrap();
    assert_eq!((model.images.len(), model.points.len()), (3, 12));
    assert_eq!(model.cameras, colmap.cameras);
    for (image, expected) in model.images.values().zip(colmap.images.values()) {
        assert_eq!((&image.name, image.camera), (&expected.name, expected.camera));
        let from_other = image.cam_from_world * expected.cam_from_world.inverse();
        assert!(from_other.rotation.angle() < 1e-7 && from_other.translation.norm() < 1e-12, "{}", image.name);
        // The keypoint without a point in COLMAP's model cannot be represented in OpenMVG's.
        let matched = expected.observations.iter().filter(|o| o.point.is_some());
        assert!(image.observations.iter().zip(matched).all(|(a, b)| (a.pixel - b.pixel).norm() < 1e-9));
    }
    for (point, expected) in model.points.values().zip(colmap.points.values()) {
        assert_eq!((point.position, &point.track), (expected.position, &expected.track));
        assert!((point.error_px - expected.error_px).abs() < 1e-9);
    }
}

#[test]
#[ignore = "needs TRACTRIX_DATA"]
fn models_that_openmvg_wrote_are_read() {
    let model = read(&in_data("interchange/right_curve/openmvg_background_sfm_data.json")).unwrap();
    assert_eq!((model.images.len(), model.points.len()), (60, 7486));
    assert!(model.mean_reprojection_error_px().unwrap() < 0.5);
    let fountain = read(&in_data("interchange/fountain-P11/openmvg_sfm_data.json")).unwrap();
    assert_eq!((fountain.images.len(), fountain.points.len()), (11, 3182));
    assert!(fountain.mean_reprojection_error_px().unwrap() < 0.5);
}
