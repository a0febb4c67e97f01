//! OpenSfM's `reconstruction.json`, and the `tracks.csv` next to it.
//!
//! Conventions are those of OpenSfM's documentation (`doc/source/geometry.rst`, `doc/source/dataset.rst`) and of its
//! `opensfm/io.py`. Shots have `cam_from_world` as a rotation vector and a translation; camera axes are this program's.
//! Image coordinates are *normalized*: with s = max(width, height) a pixel (u, v), counted from the corner, is at
//!
//! ```text
//! ((u − width/2) / s, (v − height/2) / s),
//! ```
//!
//! and focal lengths and principal points are divided by s in the same way. Distortion acts on the plane z = 1, as
//! here. `perspective`, `simple_radial`, `radial` and `brown` are exact; `fisheye` is COLMAP's RADIAL_FISHEYE,
//! `fisheye_opencv` its OPENCV_FISHEYE, `spherical` its EQUIRECTANGULAR.
//!
//! Points have no observations in the JSON; these are in `tracks.csv` (versions 1 and 2), which is read and written
//! next to it. Names of shots are names of images, in whose order ids are assigned. Of several reconstructions in one
//! file the largest is read. `reference_lla` is skipped: models are not georeferenced.

mod document;
mod tracks;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::assembly::{Losses, add_point, check_finite, check_line_names, foreign_camera, written_camera};
use crate::camera::{Camera, HigherTerms, Model};
use crate::io::{IoError, atomic, json};
use crate::math::Rigid3;
use crate::scene::{CameraForm, CameraId, Image, ImageId, Point3dId, Reconstruction};
use document::{CameraEntry, Document, PointEntry, ShotEntry};

/// The files that are written: the reconstruction and its tracks.
pub fn files(path: &Path) -> [PathBuf; 2] {
    [path.to_path_buf(), path.with_file_name("tracks.csv")]
}

/// Reads the largest reconstruction of a file, with the observations of `tracks.csv` if that is next to it.
///
/// # Errors
/// A missing file, JSON of another structure, a camera of an unknown kind, a shot with a missing camera, or an invalid
/// line of the tracks.
pub fn read(path: &Path) -> Result<Reconstruction, IoError> {
    let list: Vec<Document> = json::read_model(path, "OpenSfM's reconstruction.json")?;
    let largest = list.into_iter().rev().max_by_key(|document| document.shots.len());
    let document = largest.filter(|document| !document.shots.is_empty());
    let document = document.ok_or_else(|| IoError::content(path, "no reconstruction with a shot in the file"))?;
    let mut model = Reconstruction::default();
    let mut cameras = BTreeMap::new();
    for (id, (name, entry)) in (1..).map(CameraId).zip(&document.cameras) {
        let unknown = |what| IoError::unsupported(path, format!("camera '{name}': {what}"), "use perspective or brown");
        let (camera, form) = camera(entry).map_err(unknown)?;
        cameras.insert(name.as_str(), id);
        model.cameras.insert(id, camera);
        model.camera_forms.extend(form.map(|form| (id, form)));
    }
    for (id, (name, shot)) in (1..).map(ImageId).zip(&document.shots) {
        let problem = |what: &str| IoError::content(path, format!("shot '{name}': {what}"));
        let camera = *cameras.get(shot.camera.as_str()).ok_or_else(|| problem("its camera does not exist"))?;
        if !shot.rotation.iter().chain(&shot.translation).all(|v| v.is_finite()) {
            return Err(problem("its pose is not finite"));
        }
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(shot.rotation));
        let cam_from_world = Rigid3::new(rotation, Vector3::from(shot.translation));
        model.images.insert(id, Image { name: name.clone(), camera, cam_from_world, observations: Vec::new() });
    }
    let seen = tracks::read(&files(path)[1], &model)?;
    for (id, (key, point)) in point_ids(&document.points) {
        let [r, g, b] = point.color.map(|c| c.round().clamp(0.0, 255.0) as u8);
        let seen = seen.get(key.as_str()).into_iter().flatten().copied();
        add_point(&mut model, id, Point3::from(point.coordinates), [r, g, b], seen)
            .ok_or_else(|| IoError::content(path, format!("point '{key}' is not finite")))?;
    }
    Ok(model)
}

/// Number of images in the other reconstructions of a file, which are not read.
pub fn num_images_skipped(path: &Path) -> usize {
    let list: Vec<Document> = json::read_model(path, "OpenSfM's reconstruction.json").unwrap_or_default();
    let counts = list.iter().map(|document| document.shots.len());
    counts.clone().sum::<usize>() - counts.max().unwrap_or(0)
}

/// Ids of points: their keys if all of them are positive numbers, otherwise consecutive numbers.
fn point_ids(points: &BTreeMap<String, PointEntry>) -> Vec<(Point3dId, (&String, &PointEntry))> {
    let number = |key: &str| key.parse::<u64>().ok().filter(|id| *id > 0 && id.to_string() == key);
    let own: Option<Vec<_>> = points.iter().map(|(key, point)| Some((Point3dId(number(key)?), (key, point)))).collect();
    own.unwrap_or_else(|| (1..).map(Point3dId).zip(points).collect())
}

/// The camera, and its form if it cannot project.
fn camera(entry: &CameraEntry) -> Result<(Camera, Option<CameraForm>), String> {
    let kind = entry.projection_type.as_str();
    let (width, height) = (entry.width, entry.height);
    if width == 0 || height == 0 {
        return Err("image without size".to_owned());
    }
    let side = f64::from(width.max(height));
    let fx = entry.focal_x.or(entry.focal).unwrap_or(f64::NAN) * side;
    let fy = entry.focal_y.or(entry.focal).unwrap_or(f64::NAN) * side;
    let cx = entry.c_x * side + f64::from(width) / 2.0;
    let cy = entry.c_y * side + f64::from(height) / 2.0;
    let CameraEntry { k1, k2, k3, k4, p1, p2, .. } = *entry;
    let foreign = |model: Model, params: &[f64]| {
        let (camera, form) = foreign_camera(model, width, height, params);
        Ok((camera, Some(form)))
    };
    if kind == "spherical" || kind == "equirectangular" {
        return foreign(Model::Equirectangular, &[f64::from(width), f64::from(height)]);
    }
    let all = [fx, fy, cx, cy, k1, k2, k3, k4, p1, p2];
    if !(all.iter().all(|v| v.is_finite()) && fx > 0.0 && fy > 0.0) {
        return Err(format!("'{kind}' with invalid parameters"));
    }
    match kind {
        "perspective" | "simple_radial" | "radial" | "brown" => {
            let all = [fx, fy, cx, cy, k1, k2, p1, p2, k3];
            Ok((Camera::prior(width, height).with_parameters(&all).ok_or("camera with invalid parameters")?, None))
        }
        "fisheye" if fx == fy => foreign(Model::RadialFisheye, &[fx, cx, cy, k1, k2]),
        "fisheye_opencv" => foreign(Model::OpenCvFisheye, &[fx, fy, cx, cy, k1, k2, k3, k4]),
        _ => Err(format!("projection '{kind}'")),
    }
}

/// Writes a reconstruction and its tracks, and returns the losses of the format.
///
/// # Errors
/// A system error, a number that is not finite, a camera model that OpenSfM does not have, or a name that no line can
/// represent.
pub fn write(path: &Path, model: &Reconstruction) -> Result<Losses, IoError> {
    check_finite(path, model)?;
    check_line_names(path, model)?;
    let mut cameras = BTreeMap::new();
    for (id, camera) in &model.cameras {
        let covered = || Ok(covered_entry(camera));
        let foreign = |form: Model, params: &[f64]| foreign_entry(form, params, camera);
        cameras.insert(camera_name(*id), written_camera(path, model, *id, "OpenSfM's format", covered, foreign)?);
    }
    let shots = model.images.values().map(|image| (image.name.clone(), shot(image))).collect();
    let point = |point: &crate::scene::Point3d| PointEntry {
        color: point.rgb.map(f64::from),
        coordinates: point.position.coords.into(),
    };
    let points = model.points.iter().map(|(id, p)| (id.0.to_string(), point(p))).collect();
    let [json, tracks] = files(path);
    atomic::write_with(&tracks, |out| tracks::write(out, model))?;
    atomic::write_json(&json, &[Document { cameras, shots, points }])?;
    Ok(Losses::default().unmatched_features(model))
}

fn camera_name(id: CameraId) -> String {
    format!("camera {}", id.0)
}

fn shot(image: &Image) -> ShotEntry {
    let pose = &image.cam_from_world;
    ShotEntry {
        rotation: pose.rotation.scaled_axis().into(),
        translation: pose.translation.into(),
        camera: camera_name(image.camera),
    }
}

/// `perspective` if that suffices, otherwise `brown`.
fn covered_entry(camera: &Camera) -> CameraEntry {
    let [width, height] = [camera.width, camera.height].map(f64::from);
    let side = width.max(height);
    let ([fx, fy], [cx, cy], [k1, k2]) = (camera.focal, camera.principal, camera.radial);
    if fx == fy && [cx, cy] == [width / 2.0, height / 2.0] && camera.higher.are_zero() {
        return CameraEntry {
            projection_type: "perspective".to_owned(),
            focal: Some(fx / side),
            width: camera.width,
            height: camera.height,
            k1,
            k2,
            ..CameraEntry::default()
        };
    }
    let HigherTerms { k3, tangential: [p1, p2] } = camera.higher;
    CameraEntry { projection_type: "brown".to_owned(), k1, k2, k3, p1, p2, ..without_terms(camera) }
}

fn foreign_entry(form: Model, params: &[f64], camera: &Camera) -> Result<CameraEntry, String> {
    let (name, [k1, k2, k3, k4]) = match (form, params) {
        (Model::Equirectangular, _) => ("spherical", [0.0; 4]),
        (Model::OpenCvFisheye, &[_, _, _, _, k1, k2, k3, k4]) => ("fisheye_opencv", [k1, k2, k3, k4]),
        _ => return Err(format!("camera model {}", form.name())),
    };
    Ok(CameraEntry { projection_type: name.to_owned(), k1, k2, k3, k4, ..without_terms(camera) })
}

/// A camera's size, focal lengths and principal point.
fn without_terms(camera: &Camera) -> CameraEntry {
    let [width, height] = [camera.width, camera.height].map(f64::from);
    let side = width.max(height);
    CameraEntry {
        width: camera.width,
        height: camera.height,
        focal_x: Some(camera.focal[0] / side),
        focal_y: Some(camera.focal[1] / side),
        c_x: (camera.principal[0] - width / 2.0) / side,
        c_y: (camera.principal[1] - height / 2.0) / side,
        ..CameraEntry::default()
    }
}

#[cfg(test)]
mod tests;
