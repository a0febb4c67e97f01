//! COLMAP's camera models, as far as [`Camera`] covers them.

use crate::camera::Camera;

/// A camera model by name, binary id and number of parameters (COLMAP, `src/colmap/sensor/models.h`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Model {
    /// As in text files.
    pub name: &'static str,
    /// As in binary files.
    pub id: i32,
    /// Number of parameters.
    pub num_params: usize,
}

const SIMPLE_PINHOLE: Model = Model { name: "SIMPLE_PINHOLE", id: 0, num_params: 3 };
const PINHOLE: Model = Model { name: "PINHOLE", id: 1, num_params: 4 };
const SIMPLE_RADIAL: Model = Model { name: "SIMPLE_RADIAL", id: 2, num_params: 4 };
const RADIAL: Model = Model { name: "RADIAL", id: 3, num_params: 5 };
const OPENCV: Model = Model { name: "OPENCV", id: 4, num_params: 8 };
const FULL_OPENCV: Model = Model { name: "FULL_OPENCV", id: 6, num_params: 12 };

/// Those that can be read, where their parameters allow.
const MODELS: [Model; 6] = [SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV, FULL_OPENCV];

/// Says what the program does instead of an unknown model.
pub const CURE: &str = "undistort the images, or calibrate with PINHOLE, RADIAL or OPENCV without tangential terms";

/// The model of a text file.
pub fn by_name(name: &str) -> Option<Model> {
    MODELS.into_iter().find(|m| m.name == name)
}

/// The model of a binary file.
pub fn by_id(id: i32) -> Option<Model> {
    MODELS.into_iter().find(|m| m.id == id)
}

/// The camera that these parameters describe; an error says which parameter has no place in [`Camera`].
pub fn camera(model: Model, width: u32, height: u32, params: &[f64]) -> Result<Camera, String> {
    let make = |focal, principal, radial| Camera { width, height, focal, principal, radial };
    let camera = match *params {
        [f, cx, cy] => make([f; 2], [cx, cy], [0.0; 2]),
        [fx, fy, cx, cy] if model == PINHOLE => make([fx, fy], [cx, cy], [0.0; 2]),
        [f, cx, cy, k] => make([f; 2], [cx, cy], [k, 0.0]),
        [f, cx, cy, k1, k2] => make([f; 2], [cx, cy], [k1, k2]),
        [fx, fy, cx, cy, k1, k2, ref beyond @ ..] => {
            if let Some(value) = beyond.iter().find(|v| **v != 0.0) {
                return Err(format!("{} with tangential or higher distortion ({value})", model.name));
            }
            make([fx, fy], [cx, cy], [k1, k2])
        }
        _ => return Err(format!("{} with {} parameters", model.name, params.len())),
    };
    Ok(camera)
}

/// The smallest model that holds a camera, and its parameters.
pub fn model_of(camera: &Camera) -> (Model, Vec<f64>) {
    let ([fx, fy], [cx, cy], [k1, k2]) = (camera.focal, camera.principal, camera.radial);
    if [k1, k2] == [0.0; 2] {
        (PINHOLE, vec![fx, fy, cx, cy])
    } else if fx == fy {
        (RADIAL, vec![fx, cx, cy, k1, k2])
    } else {
        (OPENCV, vec![fx, fy, cx, cy, k1, k2, 0.0, 0.0])
    }
}
