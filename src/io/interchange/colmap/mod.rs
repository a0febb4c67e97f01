//! COLMAP models: `cameras`, `images` and `points3D`, as text (`.txt`) or binary (`.bin`).
//!
//! The formats are those of COLMAP's documentation, `doc/format.rst`. Poses are `cam_from_world`, quaternions w x y z,
//! the corner of the image is (0, 0): as everywhere in this program, so nothing is converted. `rigs` and `frames`, part
//! of COLMAP's models since version 3.12, are written (see `rigs`) and are not needed to read a model.
//!
//! A camera is written under the model of its source file, if that still represents it. Cameras estimated by this
//! program are written as the smallest model that represents them: one focal length as `SIMPLE_PINHOLE`,
//! `SIMPLE_RADIAL` or `RADIAL`, so that an adjustment by other programs keeps it one.
//!
//! Only registered images are written, as COLMAP does. Numbers in text files are the shortest that read back as the
//! same double, so both forms round-trip exactly.

mod binary;
mod camera_model;
mod rigs;
mod text;

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Quaternion, UnitQuaternion};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::assembly::{self, check_finite};
use crate::camera::Camera;
use crate::io::{IoError, atomic, extent};
use crate::scene::{CameraForm, CameraId, ImageId, Point3dId, Reconstruction};
pub(super) use camera_model::refuse_foreign;
#[cfg(feature = "database")]
pub(super) use camera_model::written as written_camera;
pub use rigs::num_of_several as num_rigs_of_several;

/// Cameras by id, and their form in the file.
type Cameras = (BTreeMap<CameraId, Camera>, BTreeMap<CameraId, CameraForm>);

/// Reads the model in a folder for geometry: binary if `cameras.bin` is there, else text.
///
/// # Errors
/// As [`read_any`]; a camera that this program cannot project with.
pub fn read(folder: &Path) -> Result<Reconstruction, IoError> {
    let model = read_any(folder)?;
    refuse_foreign(folder, &model)?;
    Ok(model)
}

/// As [`read`], for comparing and converting: cameras of every model that COLMAP has.
///
/// # Errors
/// A missing file, an invalid field (with its position), an unknown camera model, or dangling references.
pub fn read_any(folder: &Path) -> Result<Reconstruction, IoError> {
    let mut model = Reconstruction::default();
    if folder.join("cameras.bin").exists() {
        (model.cameras, model.camera_forms) = binary::read_cameras(&folder.join("cameras.bin"))?;
        model.images = binary::read_images(&folder.join("images.bin"))?;
        model.points = binary::read_points(&folder.join("points3D.bin"))?;
    } else {
        (model.cameras, model.camera_forms) = text::read_cameras(&folder.join("cameras.txt"))?;
        model.images = text::read_images(&folder.join("images.txt"))?;
        model.points = text::read_points(&folder.join("points3D.txt"))?;
    }
    check_references(folder, &model)?;
    match extent::beyond(&model) {
        Some(problem) => Err(IoError::content(folder, problem)),
        None => Ok(model),
    }
}

/// Names of a model's files as text.
pub const TEXT_FILES: [&str; 5] = ["cameras.txt", "images.txt", "points3D.txt", "rigs.txt", "frames.txt"];

/// Names of a model's files as binary.
pub const BINARY_FILES: [&str; 5] = ["cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin"];

/// Returns true if a name is that of a model's file.
pub fn is_file_name(name: &str) -> bool {
    TEXT_FILES.contains(&name) || BINARY_FILES.contains(&name)
}

/// Reads the cameras of one file, for geometry: `cameras.txt`, or `cameras.bin` if the name ends so.
///
/// # Errors
/// As [`read`].
pub fn read_cameras(path: &Path) -> Result<BTreeMap<CameraId, Camera>, IoError> {
    let is_binary = path.extension().is_some_and(|e| e == "bin");
    let (cameras, camera_forms) = if is_binary { binary::read_cameras(path) } else { text::read_cameras(path) }?;
    let model = Reconstruction { cameras, camera_forms, ..Reconstruction::default() };
    refuse_foreign(path, &model)?;
    Ok(model.cameras)
}

/// Returns true if a folder contains a COLMAP model, by its file names.
pub fn is_model(folder: &Path) -> bool {
    folder.join("cameras.bin").exists() || folder.join("cameras.txt").exists()
}

/// Encoding of a model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Encoding {
    /// Text, or binary if an image name contains a space.
    // COLMAP's own reader of text cuts such names.
    #[default]
    Auto,
    /// `cameras.txt`, `images.txt`, `points3D.txt`.
    Text,
    /// `cameras.bin`, `images.bin`, `points3D.bin`.
    Binary,
}

/// Writes a model in one of the two forms.
///
/// # Errors
/// As [`write_text`].
pub fn write(folder: &Path, model: &Reconstruction, encoding: Encoding) -> Result<(), IoError> {
    match encoding {
        Encoding::Auto if check_text_names(folder, model).is_ok() => write_text(folder, model),
        Encoding::Text => write_text(folder, model),
        Encoding::Auto | Encoding::Binary => write_binary(folder, model),
    }
}

/// Refuses image names that COLMAP's reader of text would truncate at a blank.
pub(super) fn check_text_names(folder: &Path, model: &Reconstruction) -> Result<(), IoError> {
    match model.images.values().find(|image| image.name.contains(char::is_whitespace)) {
        None => Ok(()),
        Some(image) => {
            let what = format!("name {:?} with a space, which ends a name in COLMAP's text files,", image.name);
            Err(IoError::unsupported(folder, what, "write binary files"))
        }
    }
}

/// Writes a model as text, [`TEXT_FILES`], each whole.
///
/// # Errors
/// A system error, or a number that is not finite, or an image name that cannot be part of a line of text, or a binary
/// model in the same folder: every reader would prefer that one.
pub fn write_text(folder: &Path, model: &Reconstruction) -> Result<(), IoError> {
    check_writable(folder, model)?;
    check_text_names(folder, model)?;
    if folder.join("cameras.bin").exists() {
        return Err(IoError::content(folder, "the folder holds a binary model; write text into another folder"));
    }
    atomic::write_with(&folder.join("cameras.txt"), |out| text::write_cameras(out, model))?;
    atomic::write_with(&folder.join("images.txt"), |out| text::write_images(out, model))?;
    atomic::write_with(&folder.join("points3D.txt"), |out| text::write_points(out, model))?;
    atomic::write_with(&folder.join("rigs.txt"), |out| rigs::write_rigs_text(out, model))?;
    atomic::write_with(&folder.join("frames.txt"), |out| rigs::write_frames_text(out, model))
}

/// Writes a model as binary, [`BINARY_FILES`], each whole.
///
/// # Errors
/// As [`write_text`].
pub fn write_binary(folder: &Path, model: &Reconstruction) -> Result<(), IoError> {
    check_writable(folder, model)?;
    atomic::write_with(&folder.join("cameras.bin"), |out| binary::write_cameras(out, model))?;
    atomic::write_with(&folder.join("images.bin"), |out| binary::write_images(out, model))?;
    atomic::write_with(&folder.join("points3D.bin"), |out| binary::write_points(out, model))?;
    atomic::write_with(&folder.join("rigs.bin"), |out| rigs::write_rigs_binary(out, model))?;
    atomic::write_with(&folder.join("frames.bin"), |out| rigs::write_frames_binary(out, model))
}

/// A unit quaternion from its stored parts; parts that are of unit length to rounding are kept as they are.
fn unit_quaternion([w, x, y, z]: [f64; 4]) -> Result<UnitQuaternion<f64>, String> {
    assembly::unit_quaternion(Quaternion::new(w, x, y, z))
        .ok_or_else(|| format!("quaternion ({w}, {x}, {y}, {z}) is not a rotation"))
}

/// Checks that the parts of a model refer to one another: each track element to an observation with its point, and each
/// observation with a point to a track with that observation.
fn check_references(folder: &Path, model: &Reconstruction) -> Result<(), IoError> {
    let problem = |text: String| Err(IoError::content(folder, text));
    for (id, image) in &model.images {
        if !model.cameras.contains_key(&image.camera) {
            return problem(format!("image {} ('{}'): camera {} does not exist", id.0, image.name, image.camera.0));
        }
    }
    let mut num_in_tracks = 0;
    for (id, point) in &model.points {
        for element in &point.track {
            if !sees(model, element.image, element.observation_idx, *id) {
                return problem(format!(
                    "point {}: its track names observation {} of image {}, which does not observe it",
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
            "images observe points {num_observing} times, but tracks have {num_in_tracks} observations"
        ));
    }
    Ok(())
}

fn sees(model: &Reconstruction, image: ImageId, observation_idx: u32, point: Point3dId) -> bool {
    let observations = model.images.get(&image).map(|i| &i.observations);
    observations.and_then(|o| o.get(observation_idx as usize)).is_some_and(|o| o.point == Some(point))
}

/// Checks that the files can represent the model, before anything is written.
fn check_writable(folder: &Path, model: &Reconstruction) -> Result<(), IoError> {
    check_finite(folder, model)?;
    if let Some((id, _)) = model.camera_forms.iter().find(|(_, form)| **form == CameraForm::Unknown) {
        let what = format!("camera {} without intrinsics in its source file", id.0);
        return Err(IoError::unsupported(folder, what, "give the model that the camera path was made from"));
    }
    for (id, image) in &model.images {
        let name = image.name.as_str();
        if name.is_empty() || name.trim() != name || name.contains(['\n', '\r', '\0']) {
            return Err(IoError::content(folder, format!("image {}: name {name:?} cannot be written", id.0)));
        }
    }
    check_references(folder, model)
}

#[cfg(test)]
mod tests;
