//! Cameras as described in COLMAP's files.

use std::path::Path;

use crate::camera::{Camera, Model};
use crate::io::IoError;
use crate::io::interchange::assembly::foreign_camera;
use crate::scene::{CameraForm, CameraId, Reconstruction};

/// Error about a camera of an unknown model.
pub fn unknown(path: &Path, id: CameraId, model: &str) -> IoError {
    let cure = "convert it to OPENCV with the COLMAP version that wrote it";
    IoError::unsupported(path, format!("camera {}: camera model {model}", id.0), cure)
}

/// Refuses a camera that cannot project.
pub fn refuse_foreign(path: &Path, model: &Reconstruction) -> Result<(), IoError> {
    let Some((id, model)) = model.first_foreign() else { return Ok(()) };
    let detail = if model == Model::FullOpenCv.name() { " with k4, k5 or k6" } else { "" };
    let cure = "undistort the images, or calibrate with PINHOLE, RADIAL, OPENCV, or FULL_OPENCV with k4 to k6 zero";
    Err(IoError::unsupported(path, format!("camera {}: camera model {model}{detail}", id.0), cure))
}

/// A camera and its form from stored values.
pub fn camera(model: Model, width: u32, height: u32, params: Vec<f64>) -> (Camera, CameraForm) {
    match model.camera(width, height, &params) {
        Some(camera) => (camera, CameraForm::Covered(model)),
        None => foreign_camera(model, width, height, &params),
    }
}

/// Model and parameters under which a camera is written: those of its file if they still represent it, otherwise the
/// smallest model that does.
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
