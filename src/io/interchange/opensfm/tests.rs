use super::*;
use crate::io::testing::{damaged_text_never_panics, near, odd_model};
use nalgebra::Point2;

const GOLDEN: &str = r#"[{"cameras": {"v2 a": {"projection_type": "brown", "width": 1000, "height": 500, "focal_x": 0.8,
    "focal_y": 0.9, "c_x": 0.01, "c_y": -0.02, "k1": 0.1, "k2": 0.2, "k3": 0.3, "p1": 0.4, "p2": 0.5}},
  "shots": {"b.jpg": {"rotation": [0.0, 0.0, 1.5707963267948966], "translation": [1.0, 2.0, 3.0], "camera": "v2 a",
    "orientation": 1, "gps_dop": 15.0}},
  "points": {"17": {"color": [1.0, 2.0, 3.0], "coordinates": [0.5, 0.25, 2.0]}}, "reference_lla": {"latitude": 1.0}}]"#;

const TRACKS: &str = "OPENSFM_TRACKS_VERSION_v2\nb.jpg\t17\t5\t0.25\t-0.125\t0.001\t1\t2\t3\t-1\t-1\n\
                      gone.jpg\t17\t5\t0.25\t-0.125\t0.001\t1\t2\t3\t-1\t-1\n";

fn read_text(json: &str, tracks: &str) -> Result<Reconstruction, IoError> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("reconstruction.json");
    std::fs::write(&path, json).unwrap();
    std::fs::write(folder.path().join("tracks.csv"), tracks).unwrap();
    read(&path)
}

#[test]
fn normalized_values_become_pixels() {
    let model = read_text(GOLDEN, TRACKS).unwrap();
    let camera = model.cameras[&CameraId(1)];
    assert_eq!(camera.parameters(), [800.0, 900.0, 510.0, 230.0, 0.1, 0.2, 0.4, 0.5, 0.3]);
    let image = &model.images[&ImageId(1)];
    let at = image.cam_from_world * Point3::new(1.0, 0.0, 0.0);
    assert!((at - Point3::new(1.0, 3.0, 3.0)).norm() < 1e-12, "a quarter turn about z, then the translation");
    assert_eq!(image.observations[0].pixel, Point2::new(750.0, 125.0));
    assert_eq!((model.points[&Point3dId(17)].rgb, model.points[&Point3dId(17)].track.len()), ([1, 2, 3], 1));
}

#[test]
fn a_model_round_trips_with_its_tracks() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("reconstruction.json");
    let mut model = odd_model();
    // Ids follow the order of names in this format.
    let names: Vec<_> = model.images.values().map(|image| image.name.clone()).collect();
    let mut sorted = names.clone();
    sorted.sort();
    for (image, name) in model.images.values_mut().zip(sorted) {
        image.name = name;
    }
    assert_eq!(write(&path, &model).unwrap().sentences().len(), 1);
    let found = read(&path).unwrap();
    assert_eq!(
        found.points.values().map(|p| p.rgb).collect::<Vec<_>>(),
        model.points.values().map(|p| p.rgb).collect::<Vec<_>>()
    );
    let ids: BTreeMap<_, _> = model.images.keys().copied().zip((1..).map(ImageId)).collect();
    model.images = model.images.into_iter().map(|(id, image)| (ids[&id], image)).collect();
    model.points.values_mut().flat_map(|p| &mut p.track).for_each(|e| e.image = ids[&e.image]);
    near(&found, &model, 1e-9);
}

#[test]
fn unsupported_cameras_are_preserved_and_unknown_ones_named() {
    let fisheye = GOLDEN.replace("brown", "fisheye_opencv").replace("\"p1\"", "\"k4\"");
    let model = read_text(&fisheye, TRACKS).unwrap();
    let params = vec![800.0, 900.0, 510.0, 230.0, 0.1, 0.2, 0.3, 0.4];
    assert_eq!(model.camera_forms[&CameraId(1)], CameraForm::Foreign(Model::OpenCvFisheye, params));
    let error = read_text(&GOLDEN.replace("brown", "fisheye62"), TRACKS).unwrap_err().to_string();
    assert!(error.contains("camera 'v2 a': projection 'fisheye62'"), "{error}");
    let error = read_text(&GOLDEN.replace("\"v2 a\",", "\"v3\","), TRACKS).unwrap_err().to_string();
    assert!(error.contains("shot 'b.jpg': its camera does not exist"), "{error}");
    let error = read_text(GOLDEN, &TRACKS.replace("0.25", "x")).unwrap_err().to_string();
    assert!(error.contains("tracks.csv, line 2: x: 'x'"), "{error}");
    assert!(read_text("[]", TRACKS).unwrap_err().to_string().contains("no reconstruction with a shot"));
}

#[test]
fn damage_never_panics() {
    damaged_text_never_panics(GOLDEN, |text| read_text(text, TRACKS).is_ok());
    damaged_text_never_panics(TRACKS, |text| read_text(GOLDEN, text).is_ok());
}
