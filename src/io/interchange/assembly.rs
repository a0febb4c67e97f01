//! Code shared by readers and writers of reconstructions.

use std::fmt;
use std::path::Path;

use nalgebra::{Matrix3, Point2, Point3, Quaternion, Rotation3, UnitQuaternion};

use crate::camera::{Camera, Model};
use crate::io::{IoError, extent};
use crate::scene::{CameraForm, CameraId, ImageId, Observation, Point3d, Point3dId, Reconstruction, TrackElement};

/// Rotation of a matrix; `None` if the matrix is not a rotation to 10⁻⁵.
pub fn rotation(matrix: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let error = (matrix * matrix.transpose() - Matrix3::identity()).norm();
    let is_rotation = error < 1e-5 && matrix.determinant() > 0.0;
    let found =
        is_rotation.then(|| UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*matrix)))?;
    // For a matrix that is a rotation only to 10⁻⁵, the quaternion has unit length only to that precision.
    unit_quaternion(found.into_inner())
}

/// Normalizes a quaternion; one of unit length to rounding is unchanged. `None` if the length is nearly zero, or too
/// large to be a number.
pub fn unit_quaternion(stored: Quaternion<f64>) -> Option<UnitQuaternion<f64>> {
    let norm = stored.norm();
    if (norm - 1.0).abs() < 1e-12 {
        return Some(UnitQuaternion::new_unchecked(stored));
    }
    (norm > 1e-6 && norm.is_finite()).then(|| UnitQuaternion::new_normalize(stored))
}

/// Adds a point and its observations, pixels of this program, in those images that the model has; its error is their
/// mean. `None` if a number in it is not finite.
pub fn add_point(
    model: &mut Reconstruction,
    id: Point3dId,
    position: Point3<f64>,
    rgb: [u8; 3],
    seen: impl Iterator<Item = (ImageId, Point2<f64>)>,
) -> Option<()> {
    let mut track = Vec::new();
    for (image_id, pixel) in seen {
        pixel.iter().all(|c| c.is_finite()).then_some(())?;
        let Some(image) = model.images.get_mut(&image_id) else { continue };
        track.push(TrackElement { image: image_id, observation_idx: image.observations.len() as u32 });
        image.observations.push(Observation { pixel, point: Some(id) });
    }
    position.iter().all(|c| c.is_finite()).then_some(())?;
    let mut point = Point3d { position, rgb, error_px: 0.0, track };
    // COLMAP writes −1 for an unknown error.
    point.error_px = model.errors_of(&point).map_or(-1.0, |errors| mean(&errors));
    model.points.insert(id, point);
    Some(())
}

fn mean(values: &[f64]) -> f64 {
    if values.is_empty() { 0.0 } else { values.iter().sum::<f64>() / values.len() as f64 }
}

/// Refuses impossible numbers: not finite, or coordinates beyond the limit.
pub fn check_finite(path: &Path, model: &Reconstruction) -> Result<(), IoError> {
    let refuse = |what: String| Err(IoError::content(path, format!("{what} is not finite")));
    for (id, camera) in &model.cameras {
        if !camera.parameters().iter().all(|p| p.is_finite()) {
            return refuse(format!("a parameter of camera {}", id.0));
        }
    }
    for (id, image) in &model.images {
        let pose = &image.cam_from_world;
        if !pose.translation.iter().chain(pose.rotation.coords.iter()).all(|c| c.is_finite()) {
            return refuse(format!("the pose of image {}", id.0));
        }
    }
    for (id, point) in &model.points {
        if !point.position.iter().all(|c| c.is_finite()) || !point.error_px.is_finite() {
            return refuse(format!("point {}", id.0));
        }
    }
    match extent::beyond(model) {
        Some(problem) => Err(IoError::content(path, problem)),
        None => Ok(()),
    }
}

/// Refuses a camera that cannot project, for a format that has pinholes only.
pub fn check_lenses(path: &Path, model: &Reconstruction, format: &str) -> Result<(), IoError> {
    let Some((id, name)) = model.first_foreign() else { return Ok(()) };
    Err(unsupported_camera(path, id, &format!("camera model {name}"), format))
}

/// Refuses names that cannot be a line of text.
pub fn check_line_names(path: &Path, model: &Reconstruction) -> Result<(), IoError> {
    let cannot = |name: &str| name.is_empty() || name.trim() != name || name.contains(['\n', '\r', '\t', '\0', '"']);
    match model.images.iter().find(|(_, image)| cannot(&image.name)) {
        None => Ok(()),
        Some((id, image)) => {
            Err(IoError::content(path, format!("image {}: name {:?} cannot be written", id.0, image.name)))
        }
    }
}

/// Error about a camera that a format cannot represent.
pub fn unsupported_camera(path: &Path, id: CameraId, what: &str, format: &str) -> IoError {
    IoError::unsupported(path, format!("camera {}: {what} in {format}", id.0), "write a COLMAP model instead")
}

/// Converts a camera to a format: by `covered`, or by `foreign` if this program cannot project with it; the error of
/// either names the unsupported part.
pub fn written_camera<T>(
    path: &Path,
    model: &Reconstruction,
    id: CameraId,
    format: &str,
    covered: impl FnOnce() -> Result<T, String>,
    foreign: impl FnOnce(Model, &[f64]) -> Result<T, String>,
) -> Result<T, IoError> {
    let written = match model.camera_forms.get(&id) {
        Some(CameraForm::Foreign(form, params)) => foreign(*form, params),
        Some(CameraForm::Unknown) => Err("unknown camera model".to_owned()),
        Some(CameraForm::Covered(_)) | None => covered(),
    };
    written.map_err(|what| unsupported_camera(path, id, &what, format))
}

/// Creates a camera that this program cannot project with, and its form.
pub fn foreign_camera(model: Model, width: u32, height: u32, params: &[f64]) -> (Camera, CameraForm) {
    (model.pinhole_part(width, height, params), CameraForm::Foreign(model, params.to_vec()))
}

/// Width and height of the image at `name` next to the file at `path`, if there is one.
pub fn picture_size(path: &Path, name: &str) -> Option<(u32, u32)> {
    image::image_dimensions(path.with_file_name("").join(name)).ok()
}

/// Data that a format cannot represent, as sentences.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Losses(Vec<String>);

impl Losses {
    /// Each in its own sentence, without a full stop.
    pub fn sentences(&self) -> &[String] {
        &self.0
    }

    /// Adds a sentence.
    pub fn with(mut self, sentence: String) -> Self {
        self.0.push(sentence);
        self
    }

    /// Adds a count unless it is zero; `one` follows the number 1, `many` all others.
    pub fn counted(self, count: usize, one: &str, many: &str) -> Self {
        match count {
            0 => self,
            1 => self.with(format!("1 {one}")),
            _ => self.with(format!("{count} {many}")),
        }
    }

    /// Counts the colors that the format cannot represent.
    pub fn colors(self, model: &Reconstruction) -> Self {
        let colored = model.points.values().filter(|point| point.rgb != [255; 3]).count();
        self.counted(
            colored,
            "point loses its color, which the format does not store",
            "points lose their color, which the format does not store",
        )
    }

    /// Counts the features without a point that the format cannot represent.
    pub fn unmatched_features(self, model: &Reconstruction) -> Self {
        let features = model.images.values().flat_map(|image| &image.observations);
        let unmatched = features.filter(|o| o.point.is_none()).count();
        self.counted(
            unmatched,
            "feature without a point skipped, which the format does not store",
            "features without a point skipped, which the format does not store",
        )
    }
}

/// Number for messages, with six significant digits.
pub struct Short(pub f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = 5 - self.0.abs().max(1e-3).log10().floor() as i32;
        write!(f, "{:.*}", digits.clamp(0, 9) as usize, self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rotation_of_a_rough_matrix_is_of_unit_length() {
        let exact = UnitQuaternion::from_euler_angles(0.3, -0.2, 0.1);
        let matrix = exact.to_rotation_matrix().into_inner();
        let found = rotation(&(matrix * (1.0 + 2e-6))).unwrap();
        assert!((found.norm() - 1.0).abs() < 1e-15 && found.angle_to(&exact) < 1e-5, "{found}");
        assert!(rotation(&(matrix * 1.001)).is_none() && rotation(&-matrix).is_none());
    }
}
