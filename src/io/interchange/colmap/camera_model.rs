//! Cameras as COLMAP's files describe them.

use std::path::Path;

use crate::camera::{Camera, Model};
use crate::io::IoError;
use crate::scene::{CameraForm, CameraId, Reconstruction};

/// Says what to do about a camera that this program cannot project with.
const CURE: &str = "undistort the images, or calibrate with PINHOLE, RADIAL, OPENCV, or FULL_OPENCV with k4 to k6 zero";

/// The error about a camera of a model that is not known at all.
pub fn unknown(path: &Path, id: CameraId, model: &str) -> IoError {
    unsupported(
        path,
        id,
        &format!("camera model {model}"),
        "convert it to OPENCV with the COLMAP version that wrote \
         it",
    )
}

/// The error about a camera that cannot be projected with.
pub fn foreign(path: &Path, id: CameraId, model: &str) -> IoError {
    let detail = if model == Model::FullOpenCv.name() { " with k4, k5 or k6" } else { "" };
    unsupported(path, id, &format!("camera model {model}{detail}"), CURE)
}

fn unsupported(path: &Path, id: CameraId, what: &str, cure: &str) -> IoError {
    IoError::Unsupported { path: path.to_path_buf(), what: format!("camera {}: {what}", id.0), cure: cure.into() }
}

/// A camera and its form from stored values.
pub fn camera(model: Model, width: u32, height: u32, params: Vec<f64>) -> (Camera, CameraForm) {
    match model.camera(width, height, &params) {
        Some(camera) => (camera, CameraForm::Covered(model)),
        None => (model.pinhole_part(width, height, &params), CameraForm::Foreign(model, params)),
    }
}

/// The model and parameters under which a camera is written: those of its file if they still hold it, else the smallest
/// model that does.
pub fn written(model: &Reconstruction, id: CameraId, camera: &Camera) -> (Model, Vec<f64>) {
    let smallest = || {
        let smallest = Model::of(camera);
        (smallest, smallest.params_of(camera).unwrap_or_default())
    };
    match model.camera_forms.get(&id) {
        Some(CameraForm::Foreign(name, params)) => (*name, params.clone()),
        Some(CameraForm::Covered(name)) => name.params_of(camera).map_or_else(smallest, |params| (*name, params)),
        Some(CameraForm::Unknown) | None => smallest(),
    }
}
