//! OpenMVG's `sfm_data.json`, reading only.
//!
//! Two conventions differ from this program's and are converted on the way in. OpenMVG stores a camera's rotation with
//! its *centre*, not its translation (`src/openMVG/geometry/pose3.hpp`). And it puts (0, 0) on the centre of the first
//! pixel, so half a pixel is added to principal points and observations (triangulating its tracks with true poses and
//! intrinsics leaves the smallest residual at +0.42 ± 0.1 px). A principal point that its user gave in the other
//! convention stays off by that half pixel.
//!
//! View, structure and intrinsic keys become image, point and camera ids by adding one. Views without a pose are left
//! out. Distortion up to k₃ is refitted with k₁ and k₂ over the image, if they follow it to a tenth of a pixel.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Matrix2, Matrix3, Point2, Point3, Rotation3, UnitQuaternion, Vector2};
use serde::Deserialize;

use super::{IoError, json};
use crate::camera::Camera;
use crate::math::Rigid3;
use crate::scene::{CameraId, Image, ImageId, Observation, Point3d, Point3dId, Reconstruction, TrackElement};

/// From OpenMVG's pixel coordinates to ours.
const PIXEL_OFFSET: f64 = 0.5;

/// How far the refitted distortion may lie from the stored one, pixels.
const MAX_REFIT_ERROR_PX: f64 = 0.1;

/// The bit that marks the first use of a polymorphic type in cereal's files.
const FIRST_USE: u32 = 1 << 31;

#[derive(Deserialize)]
struct Document {
    views: Vec<Entry<Polymorphic<View>>>,
    intrinsics: Vec<Entry<Polymorphic<Intrinsic>>>,
    extrinsics: Vec<Entry<Extrinsic>>,
    structure: Vec<Entry<Landmark>>,
}

#[derive(Deserialize)]
struct Entry<T> {
    key: u32,
    value: T,
}

#[derive(Deserialize)]
struct Polymorphic<T> {
    polymorphic_id: u32,
    /// Given only where a type occurs first.
    #[serde(default)]
    polymorphic_name: Option<String>,
    ptr_wrapper: Pointer<T>,
}

#[derive(Deserialize)]
struct Pointer<T> {
    data: T,
}

#[derive(Deserialize)]
struct View {
    filename: String,
    id_intrinsic: u32,
    id_pose: u32,
}

#[derive(Deserialize)]
struct Intrinsic {
    width: u32,
    height: u32,
    focal_length: f64,
    principal_point: [f64; 2],
    #[serde(default)]
    disto_k1: Vec<f64>,
    #[serde(default)]
    disto_k3: Vec<f64>,
    #[serde(default)]
    disto_t2: Vec<f64>,
}

#[derive(Deserialize)]
struct Extrinsic {
    rotation: [[f64; 3]; 3],
    center: [f64; 3],
}

#[derive(Deserialize)]
struct Landmark {
    #[serde(rename = "X")]
    position: [f64; 3],
    observations: Vec<Entry<Feature>>,
}

#[derive(Deserialize)]
struct Feature {
    x: [f64; 2],
}

/// Reads a reconstruction. Points have no colour there and are white; their errors are computed.
///
/// # Errors
/// A missing file, JSON of another shape, a camera model that is no pinhole with radial distortion, a pose that is not
/// rigid, or parts that refer to what is not there.
pub fn read(path: &Path) -> Result<Reconstruction, IoError> {
    let document: Document = json::read(path)?;
    let mut model = Reconstruction { cameras: cameras(path, &document.intrinsics)?, ..Default::default() };
    let poses = poses(path, &document.extrinsics)?;
    let mut is_view = std::collections::BTreeSet::new();
    for Entry { key, value } in document.views {
        is_view.insert(key);
        let view = value.ptr_wrapper.data;
        let camera = CameraId(view.id_intrinsic.wrapping_add(1));
        let Some(&cam_from_world) = poses.get(&view.id_pose) else { continue };
        if !model.cameras.contains_key(&camera) {
            return Err(IoError::content(path, format!("view {key} names intrinsics that are not there")));
        }
        let image = Image { name: view.filename, camera, cam_from_world, observations: Vec::new() };
        model.images.insert(ImageId(id(path, key)?), image);
    }
    for Entry { key, value } in document.structure {
        if let Some(o) = value.observations.iter().find(|o| !is_view.contains(&o.key)) {
            return Err(IoError::content(path, format!("point {key} is seen in view {}, which is not there", o.key)));
        }
        add_point(&mut model, Point3dId(u64::from(key) + 1), &value)
            .ok_or_else(|| IoError::content(path, format!("point {key} is not finite")))?;
    }
    Ok(model)
}

/// Ids start at 1 here, keys at 0 there.
fn id(path: &Path, key: u32) -> Result<u32, IoError> {
    key.checked_add(1).ok_or_else(|| IoError::content(path, format!("the key {key} is beyond all use")))
}

fn cameras(path: &Path, entries: &[Entry<Polymorphic<Intrinsic>>]) -> Result<BTreeMap<CameraId, Camera>, IoError> {
    let mut names = BTreeMap::new();
    let mut cameras = BTreeMap::new();
    for Entry { key, value } in entries {
        if let Some(name) = &value.polymorphic_name {
            names.insert(value.polymorphic_id & !FIRST_USE, name.as_str());
        }
        let name = names.get(&(value.polymorphic_id & !FIRST_USE)).copied().unwrap_or("unnamed");
        let camera = camera(name, &value.ptr_wrapper.data).map_err(|what| IoError::Unsupported {
            path: path.into(),
            what: format!("intrinsic {key}: {what}"),
            cure: "use pinhole, pinhole_radial_k1 or pinhole_radial_k3".into(),
        })?;
        cameras.insert(CameraId(id(path, *key)?), camera);
    }
    Ok(cameras)
}

fn camera(name: &str, intrinsic: &Intrinsic) -> Result<Camera, String> {
    let Intrinsic { width, height, focal_length, principal_point: [cx, cy], .. } = *intrinsic;
    let coefficients = match name {
        "pinhole" => &[][..],
        "pinhole_radial_k1" => &intrinsic.disto_k1,
        "pinhole_radial_k3" => &intrinsic.disto_k3,
        "pinhole_brown_t2" => match intrinsic.disto_t2[..] {
            [.., t1, t2] if t1 != 0.0 || t2 != 0.0 => return Err(format!("{name} with tangential distortion")),
            ref all => &all[..all.len().min(3)],
        },
        _ => return Err(format!("the camera model '{name}'")),
    };
    let numbers = [focal_length, cx, cy];
    let finite = numbers.iter().chain(coefficients).all(|v| v.is_finite());
    if !finite || focal_length <= 0.0 || width == 0 || height == 0 || coefficients.len() > 3 {
        return Err(format!("the parameters of this {name}"));
    }
    let principal = [cx + PIXEL_OFFSET, cy + PIXEL_OFFSET];
    let camera = Camera { width, height, focal: [focal_length; 2], principal, radial: [0.0; 2] };
    with_distortion(camera, coefficients)
}

/// The camera with k₁, k₂ as stored, or, if there is a k₃, with those that come nearest over the image in the sense of
/// least squares: minimise Σ (k₁' r³ + k₂' r⁵ − k₁ r³ − k₂ r⁵ − k₃ r⁷)² over radii r up to the farthest corner.
fn with_distortion(camera: Camera, coefficients: &[f64]) -> Result<Camera, String> {
    let at = |index: usize| coefficients.get(index).copied().unwrap_or(0.0);
    let [k1, k2, k3] = [at(0), at(1), at(2)];
    if k3 == 0.0 {
        return Ok(Camera { radial: [k1, k2], ..camera });
    }
    let (focal, [cx, cy]) = (camera.focal[0], camera.principal);
    let half = [cx.max(f64::from(camera.width) - cx), cy.max(f64::from(camera.height) - cy)];
    let farthest = half[0].hypot(half[1]) / focal;
    let radii = || (1..=100).map(|i| farthest * f64::from(i) / 100.0);
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for r in radii() {
        let row = Vector2::new(r.powi(3), r.powi(5));
        normal += row * row.transpose();
        right += row * (k1 * r.powi(3) + k2 * r.powi(5) + k3 * r.powi(7));
    }
    let fitted = normal.try_inverse().ok_or("a distortion that cannot be refitted")? * right;
    let error = |r: f64| ((fitted.x - k1) * r.powi(3) + (fitted.y - k2) * r.powi(5) - k3 * r.powi(7)).abs() * focal;
    let worst_px = radii().map(error).fold(0.0, f64::max);
    if worst_px > MAX_REFIT_ERROR_PX {
        return Err(format!("a k3 of {k3}, which k1 and k2 follow only to {worst_px:.2} px"));
    }
    Ok(Camera { radial: fitted.into(), ..camera })
}

fn poses(path: &Path, entries: &[Entry<Extrinsic>]) -> Result<BTreeMap<u32, Rigid3>, IoError> {
    let pose = |entry: &Entry<Extrinsic>| {
        let [a, b, c] = entry.value.rotation;
        let rotation = Matrix3::new(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]);
        let error = (rotation * rotation.transpose() - Matrix3::identity()).norm();
        if !(error < 1e-5 && rotation.determinant() > 0.0 && entry.value.center.iter().all(|c| c.is_finite())) {
            return Err(IoError::content(path, format!("pose {} is not rigid", entry.key)));
        }
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        Ok((entry.key, Rigid3::from_rotation_and_center(rotation, Point3::from(entry.value.center))))
    };
    entries.iter().map(pose).collect()
}

/// Adds a point and its observations in registered views; `None` if a number in it is not finite.
fn add_point(model: &mut Reconstruction, id: Point3dId, landmark: &Landmark) -> Option<()> {
    let position = Point3::from(landmark.position);
    let finite = |numbers: &[f64]| numbers.iter().all(|n| n.is_finite());
    if !finite(&landmark.position) || !landmark.observations.iter().all(|o| finite(&o.value.x)) {
        return None;
    }
    let mut track = Vec::new();
    let mut sum_px = 0.0;
    for Entry { key, value } in &landmark.observations {
        let image_id = ImageId(key.wrapping_add(1));
        let Some(image) = model.images.get_mut(&image_id) else { continue };
        let pixel = Point2::from(value.x) + Vector2::repeat(PIXEL_OFFSET);
        let projected = model.cameras[&image.camera].pixel_from_cam(image.cam_from_world * position);
        sum_px += projected.map_or(0.0, |p| (p - pixel).norm());
        track.push(TrackElement { image: image_id, observation_idx: image.observations.len() as u32 });
        image.observations.push(Observation { pixel, point: Some(id) });
    }
    let error_px = if track.is_empty() { 0.0 } else { sum_px / track.len() as f64 };
    model.points.insert(id, Point3d { position, rgb: [255; 3], error_px, track });
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::testing::{in_data, in_repository};
    use serde_json::{Value, json};

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
    fn centres_and_pixels_take_our_conventions() {
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
    fn what_does_not_fit_is_refused() {
        let refused = |change: fn(&mut Value)| {
            let mut document = document();
            change(&mut document);
            read_value(&document).unwrap_err().to_string()
        };
        let fisheye = |d: &mut Value| d["intrinsics"][0]["value"]["polymorphic_name"] = json!("fisheye");
        assert!(refused(fisheye).contains("'fisheye'"));
        let strong = |d: &mut Value| {
            d["intrinsics"][0]["value"]["ptr_wrapper"]["data"]["disto_k3"] = json!([0.1, 0.0, 0.9]);
        };
        assert!(refused(strong).contains("k3 of 0.9"));
        assert!(refused(|d| d["extrinsics"][0]["value"]["rotation"][0][0] = json!(2)).contains("pose 0"));
        assert!(
            refused(|d| d["views"][0]["value"]["ptr_wrapper"]["data"]["id_intrinsic"] = json!(9)).contains("view 0")
        );
        let unknown = |d: &mut Value| d["structure"][0]["value"]["observations"][0]["key"] = json!(50);
        assert!(refused(unknown).contains("view 50"));
        assert!(refused(|d| d["views"] = json!(3)).contains("line 1"));
    }

    #[test]
    fn the_same_model_is_read_from_openmvg_and_colmap() {
        let model = read(&in_repository("tests/golden/models/openmvg/sfm_data.json")).unwrap();
        let colmap = crate::io::colmap::read(&in_repository("tests/golden/models/colmap_text")).unwrap();
        assert_eq!((model.images.len(), model.points.len()), (3, 12));
        assert_eq!(model.cameras, colmap.cameras);
        for (image, expected) in model.images.values().zip(colmap.images.values()) {
            assert_eq!((&image.name, image.camera), (&expected.name, expected.camera));
            let from_other = image.cam_from_world * expected.cam_from_world.inverse();
            assert!(from_other.rotation.angle() < 1e-7 && from_other.translation.norm() < 1e-12, "{}", image.name);
            // The keypoint that COLMAP's model holds without a point has no place in OpenMVG's.
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
        // Its k₃ of 0.012 is refitted; a wrong refit or a wrong convention would show in the errors.
        let fountain = read(&in_data("interchange/fountain-P11/openmvg_sfm_data.json")).unwrap();
        assert_eq!((fountain.images.len(), fountain.points.len()), (11, 3182));
        assert!(fountain.mean_reprojection_error_px().unwrap() < 0.5);
    }
}
