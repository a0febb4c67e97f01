//! Conversion of the file to a reconstruction.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use nalgebra::{Matrix3, Point2, Point3, Vector2};

use super::document::{Document, Entry, Extrinsic, Intrinsic, Landmark, Polymorphic, Size, View};
use super::{FIRST_USE, PIXEL_OFFSET, UNDEFINED};
use crate::camera::{Camera, Model};
use crate::io::interchange::assembly::{add_point, foreign_camera, rotation};
use crate::io::interchange::model::Intrinsics;
use crate::io::{IoError, json};
use crate::math::Rigid3;
use crate::scene::{CameraForm, CameraId, Image, ImageId, Point3dId, Reconstruction};

/// Reads a reconstruction. Points have no color there and are white; their errors are computed.
///
/// # Errors
/// A missing file, JSON of another structure, a camera of an unknown kind, no view with a pose, a pose that is not
/// rigid, or dangling references.
pub fn read(path: &Path) -> Result<Reconstruction, IoError> {
    read_with(path, Intrinsics::Required)
}

pub(in crate::io::interchange) fn read_with(path: &Path, wanted: Intrinsics) -> Result<Reconstruction, IoError> {
    let document: Document = json::read_model(path, "OpenMVG's sfm_data.json")?;
    let mut model = Reconstruction::default();
    add_cameras(path, &document.intrinsics, &mut model)?;
    let poses = poses(path, &document.extrinsics)?;
    let views: BTreeSet<u32> = document.views.iter().map(|view| view.key).collect();
    for Entry { key, value } in &document.views {
        add_image(path, *key, &value.ptr_wrapper.data, &poses, &mut model, wanted)?;
    }
    if model.images.is_empty() {
        return Err(IoError::content(path, nothing_posed(document.views.len())));
    }
    for Entry { key, value } in &document.structure {
        if let Some(o) = value.observations.iter().find(|o| !views.contains(&o.key)) {
            return Err(IoError::content(
                path,
                format!("point {key}: observed in view {}, which does not exist", o.key),
            ));
        }
        add_landmark(&mut model, Point3dId(u64::from(*key) + 1), value)
            .ok_or_else(|| IoError::content(path, format!("point {key} is not finite")))?;
    }
    Ok(model)
}

fn nothing_posed(num_views: usize) -> String {
    format!(
        "none of its {num_views} views has a pose: this is an image list (from SfMInit_ImageListing); give the file \
         that OpenMVG's reconstruction writes"
    )
}

/// Ids start at 1 here, keys at 0 there.
fn id(path: &Path, key: u32) -> Result<u32, IoError> {
    key.checked_add(1).ok_or_else(|| IoError::content(path, format!("key {key} is out of range")))
}

fn add_image(
    path: &Path,
    key: u32,
    view: &View,
    poses: &BTreeMap<u32, Rigid3>,
    model: &mut Reconstruction,
    wanted: Intrinsics,
) -> Result<(), IoError> {
    let Some(&cam_from_world) = poses.get(&view.id_pose).filter(|_| view.id_pose != UNDEFINED) else { return Ok(()) };
    let camera = CameraId(view.id_intrinsic.wrapping_add(1));
    if !model.cameras.contains_key(&camera) && wanted == Intrinsics::Optional {
        model.cameras.insert(camera, Camera::prior(1, 1));
        model.camera_forms.insert(camera, CameraForm::Unknown);
    } else if !model.cameras.contains_key(&camera) {
        return Err(IoError::content(path, format!("view {key}: its intrinsics do not exist")));
    }
    let folder = view.local_path.trim_end_matches('/');
    let name = if folder.is_empty() { view.filename.clone() } else { format!("{folder}/{}", view.filename) };
    let image = Image { name, camera, cam_from_world, observations: Vec::new() };
    match model.images.insert(ImageId(id(path, key)?), image) {
        Some(_) => Err(IoError::content(path, format!("view {key} occurs twice"))),
        None => Ok(()),
    }
}

fn add_cameras(
    path: &Path,
    entries: &[Entry<Polymorphic<Intrinsic>>],
    model: &mut Reconstruction,
) -> Result<(), IoError> {
    let mut names = BTreeMap::new();
    for Entry { key, value } in entries {
        if let Some(name) = &value.polymorphic_name {
            names.insert(value.polymorphic_id & !FIRST_USE, name.as_str());
        }
        let name = names.get(&(value.polymorphic_id & !FIRST_USE)).copied().unwrap_or("unnamed");
        let (camera, form) = camera(name, &value.ptr_wrapper.data).map_err(|what| {
            let cure = "use pinhole, pinhole_radial_k1, pinhole_radial_k3 or pinhole_brown_t2";
            IoError::unsupported(path, format!("intrinsic {key}: {what}"), cure)
        })?;
        let id = CameraId(id(path, *key)?);
        model.cameras.insert(id, camera);
        model.camera_forms.extend(form.map(|form| (id, form)));
    }
    Ok(())
}

/// The camera, and its form if it cannot project.
fn camera(name: &str, intrinsic: &Intrinsic) -> Result<(Camera, Option<CameraForm>), String> {
    let broken = || format!("{name} with invalid parameters");
    let size = intrinsic.value0.or(intrinsic.width.zip(intrinsic.height).map(|(width, height)| Size { width, height }));
    let Size { width, height } = size.filter(|size| size.width > 0 && size.height > 0).ok_or_else(broken)?;
    if name == "spherical" {
        return Ok(foreign(Model::Equirectangular, width, height, &[f64::from(width), f64::from(height)]));
    }
    let (focal, [cx, cy]) = intrinsic.focal_length.zip(intrinsic.principal_point).ok_or_else(broken)?;
    let (cx, cy) = (cx + PIXEL_OFFSET, cy + PIXEL_OFFSET);
    let distortion = match (name, &intrinsic.disto_k1[..], &intrinsic.disto_k3[..], &intrinsic.disto_t2[..]) {
        ("pinhole", ..) => [0.0; 5],
        ("pinhole_radial_k1", &[k1], ..) => [k1, 0.0, 0.0, 0.0, 0.0],
        ("pinhole_radial_k3", _, &[k1, k2, k3], _) => [k1, k2, 0.0, 0.0, k3],
        ("pinhole_brown_t2", .., &[k1, k2, k3, t1, t2]) => [k1, k2, t1, t2, k3],
        ("fisheye", ..) if intrinsic.fisheye.len() == 4 => [0.0; 5],
        ("pinhole_radial_k1" | "pinhole_radial_k3" | "pinhole_brown_t2" | "fisheye", ..) => return Err(broken()),
        _ => return Err(format!("camera model '{name}'")),
    };
    let all = [&[focal, focal, cx, cy][..], &distortion].concat();
    if !all.iter().chain(&intrinsic.fisheye).all(|v| v.is_finite()) || focal <= 0.0 {
        return Err(broken());
    }
    if name == "fisheye" {
        let params = [&[focal, focal, cx, cy], &intrinsic.fisheye[..]].concat();
        return Ok(foreign(Model::OpenCvFisheye, width, height, &params));
    }
    let camera = Camera::prior(width, height).with_parameters(&all).ok_or_else(broken)?;
    Ok((camera, None))
}

fn foreign(model: Model, width: u32, height: u32, params: &[f64]) -> (Camera, Option<CameraForm>) {
    let (camera, form) = foreign_camera(model, width, height, params);
    (camera, Some(form))
}

fn poses(path: &Path, entries: &[Entry<Extrinsic>]) -> Result<BTreeMap<u32, Rigid3>, IoError> {
    let pose = |entry: &Entry<Extrinsic>| {
        let [a, b, c] = entry.value.rotation;
        let rotation = rotation(&Matrix3::new(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]))
            .filter(|_| entry.value.center.iter().all(|c| c.is_finite()))
            .ok_or_else(|| IoError::content(path, format!("pose {} is not rigid", entry.key)))?;
        Ok((entry.key, Rigid3::from_rotation_and_center(rotation, Point3::from(entry.value.center))))
    };
    entries.iter().map(pose).collect()
}

/// Adds a point and its observations in registered views; `None` if a number in it is not finite.
fn add_landmark(model: &mut Reconstruction, id: Point3dId, landmark: &Landmark) -> Option<()> {
    let pixel = |x: [f64; 2]| Point2::from(x) + Vector2::repeat(PIXEL_OFFSET);
    let seen = landmark.observations.iter().map(|o| (ImageId(o.key.wrapping_add(1)), pixel(o.value.x)));
    add_point(model, id, Point3::from(landmark.position), [255; 3], seen)
}
