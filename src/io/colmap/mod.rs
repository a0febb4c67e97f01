//! COLMAP models: `cameras`, `images` and `points3D`, as text (`.txt`) or binary (`.bin`).
//!
//! The formats are those of COLMAP's documentation, `doc/format.rst`. Poses are `cam_from_world`, quaternions w x y z,
//! the corner of the image is (0, 0): as everywhere in this program, so nothing is converted. `rigs` and `frames`,
//! which COLMAP 4 writes beside, are not needed to read a model and are not written; COLMAP makes them up from the
//! images.
//!
//! Only registered images are written, as COLMAP does. Numbers in text files are the shortest that read back as the
//! same double, so both forms give back exactly what was written.

mod binary;
mod camera_model;
mod text;

use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::{IoError, atomic};
use crate::camera::Camera;
use crate::scene::{CameraId, ImageId, Point3dId, Reconstruction};

/// Reads the model in a folder: binary if `cameras.bin` is there, else text.
///
/// # Errors
/// A missing file, a wrong field (with its place), a camera model with more than two radial coefficients, or parts that
/// refer to what is not there.
pub fn read(folder: &Path) -> Result<Reconstruction, IoError> {
    let mut model = Reconstruction::default();
    if folder.join("cameras.bin").exists() {
        model.cameras = binary::read_cameras(&folder.join("cameras.bin"))?;
        model.images = binary::read_images(&folder.join("images.bin"))?;
        model.points = binary::read_points(&folder.join("points3D.bin"))?;
    } else {
        model.cameras = text::read_cameras(&folder.join("cameras.txt"))?;
        model.images = text::read_images(&folder.join("images.txt"))?;
        model.points = text::read_points(&folder.join("points3D.txt"))?;
    }
    check_references(folder, &model)?;
    Ok(model)
}

/// Names of a model's files, as text and binary.
pub const FILES: [&str; 6] = ["cameras.txt", "images.txt", "points3D.txt", "cameras.bin", "images.bin", "points3D.bin"];

/// Reads the cameras of one file alone: `cameras.txt`, or `cameras.bin` if the name ends so.
pub fn read_cameras(path: &Path) -> Result<std::collections::BTreeMap<CameraId, Camera>, IoError> {
    if path.extension().is_some_and(|e| e == "bin") { binary::read_cameras(path) } else { text::read_cameras(path) }
}

/// Whether a folder holds a COLMAP model, as far as its file names tell.
pub fn is_model(folder: &Path) -> bool {
    folder.join("cameras.bin").exists() || folder.join("cameras.txt").exists()
}

/// Writes a model as text: `cameras.txt`, `images.txt`, `points3D.txt`, each whole.
///
/// # Errors
/// A system error, or a number that is not finite, or an image name that cannot stand in a line of text, or a binary
/// model in the same folder: every reader would take that one.
pub fn write_text(folder: &Path, model: &Reconstruction) -> Result<(), IoError> {
    check_writable(folder, model)?;
    if folder.join("cameras.bin").exists() {
        return Err(IoError::content(folder, "a binary model is in this folder; write text into another one"));
    }
    atomic::write_with(&folder.join("cameras.txt"), |out| text::write_cameras(out, model))?;
    atomic::write_with(&folder.join("images.txt"), |out| text::write_images(out, model))?;
    atomic::write_with(&folder.join("points3D.txt"), |out| text::write_points(out, model))
}

/// Writes a model as binary: `cameras.bin`, `images.bin`, `points3D.bin`, each whole.
///
/// # Errors
/// As [`write_text`].
pub fn write_binary(folder: &Path, model: &Reconstruction) -> Result<(), IoError> {
    check_writable(folder, model)?;
    atomic::write_with(&folder.join("cameras.bin"), |out| binary::write_cameras(out, model))?;
    atomic::write_with(&folder.join("images.bin"), |out| binary::write_images(out, model))?;
    atomic::write_with(&folder.join("points3D.bin"), |out| binary::write_points(out, model))
}

/// A unit quaternion from its stored parts; parts that are of unit length to rounding are kept as they are.
fn unit_quaternion([w, x, y, z]: [f64; 4]) -> Result<UnitQuaternion<f64>, String> {
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    if (norm - 1.0).abs() < 1e-12 {
        Ok(UnitQuaternion::new_unchecked(quaternion))
    } else if norm > 1e-6 && norm.is_finite() {
        Ok(UnitQuaternion::new_normalize(quaternion))
    } else {
        Err(format!("the quaternion ({w}, {x}, {y}, {z}) is not a rotation"))
    }
}

/// The parts of a model must refer to one another: each track element to an observation that names its point, and each
/// observation with a point to a track that holds it.
fn check_references(folder: &Path, model: &Reconstruction) -> Result<(), IoError> {
    let problem = |text: String| Err(IoError::content(folder, text));
    for (id, image) in &model.images {
        if !model.cameras.contains_key(&image.camera) {
            return problem(format!(
                "image {} ('{}') has camera {}, which is not there",
                id.0, image.name, image.camera.0
            ));
        }
    }
    let mut num_in_tracks = 0;
    for (id, point) in &model.points {
        for element in &point.track {
            if !sees(model, element.image, element.observation_idx, *id) {
                return problem(format!(
                    "the track of point {} names observation {} of image {}, which does not see it",
                    id.0, element.observation_idx, element.image.0
                ));
            }
        }
        num_in_tracks += point.track.len();
    }
    let num_observing: usize =
        model.images.values().map(|i| i.observations.iter().filter(|o| o.point.is_some()).count()).sum();
    if num_observing != num_in_tracks {
        return problem(format!(
            "the images observe points {num_observing} times, but the points' tracks hold {num_in_tracks} observations"
        ));
    }
    Ok(())
}

fn sees(model: &Reconstruction, image: ImageId, observation_idx: u32, point: Point3dId) -> bool {
    let observations = model.images.get(&image).map(|i| &i.observations);
    observations.and_then(|o| o.get(observation_idx as usize)).is_some_and(|o| o.point == Some(point))
}

/// What a file cannot hold is an error before anything is written.
fn check_writable(folder: &Path, model: &Reconstruction) -> Result<(), IoError> {
    let finite = |v: &Vector3<f64>| v.iter().all(|c| c.is_finite());
    for (id, camera) in &model.cameras {
        if !camera.intrinsics().iter().all(|p| p.is_finite()) {
            return Err(IoError::content(folder, format!("camera {} has a parameter that is not finite", id.0)));
        }
    }
    for (id, image) in &model.images {
        let pose = &image.cam_from_world;
        if !finite(&pose.translation) || !pose.rotation.coords.iter().all(|c| c.is_finite()) {
            return Err(IoError::content(folder, format!("image {} has a pose that is not finite", id.0)));
        }
        let name = image.name.as_str();
        if name.is_empty() || name.trim() != name || name.contains(['\n', '\r', '\0']) {
            return Err(IoError::content(folder, format!("image {}: the name {name:?} cannot be written", id.0)));
        }
    }
    for (id, point) in &model.points {
        if !finite(&point.position.coords) || !point.error_px.is_finite() {
            return Err(IoError::content(folder, format!("point {} is not finite", id.0)));
        }
    }
    check_references(folder, model)
}

#[cfg(test)]
mod tests;
