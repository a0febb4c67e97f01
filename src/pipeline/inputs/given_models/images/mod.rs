//! Relation of the images of a given model to the frames, and conversion of the model to pixels of the frames.
//!
//! An image of the model is its frame, or
//!
//! * the frame before `--max-dimension` reduced it;
//! * the frame as the file stores it, rotated by 90° from upright: a clockwise rotation of an image of height h maps
//!   (x, y) to (h − y, x), and the camera rotates about its optical axis with it;
//! * the undistorted frame, if the intrinsics of the frames are given: a feature is moved to the distorted projection
//!   of its ray.
//!
//! None of these changes a ray, and so neither points nor poses (except by the rotation). A rotation by 180° does not
//! change the size of an image, so such an image is assumed to be upright.

#[cfg(test)]
mod tests;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use nalgebra::{Point2, UnitQuaternion, Vector2, Vector3};

use crate::camera::{Camera, HigherTerms};
use crate::math::Rigid3;
use crate::pipeline::{PipelineError, Result};
use crate::scene::{CameraId, FrameId, Reconstruction, Topic, Warning};

/// Known properties of the frames' images.
pub(super) struct Pictures<'a> {
    /// Width and height of the frames, pixels.
    pub(super) frame: (u32, u32),
    /// The same before `--max-dimension`.
    pub(super) source: (u32, u32),
    /// The intrinsics of the frames, if they are given.
    pub(super) lens: Option<Camera>,
    /// Clockwise rotations by 90° from the stored image to the frame; `None` if it is mirrored as well.
    pub(super) turns: &'a dyn Fn(FrameId) -> Option<u8>,
}

/// Transformation of an image to its frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ImageTransform {
    num_turns: u8,
    /// The camera of the rotated image.
    turned: Camera,
    /// The camera of the frame.
    camera: Camera,
    /// True if the image has no distortion, but its frame has.
    is_undistorted: bool,
}

impl ImageTransform {
    fn pixel(&self, pixel: Point2<f64>, stored: (u32, u32)) -> Point2<f64> {
        let pixel = turned_pixel(pixel, stored, self.num_turns);
        if self.is_undistorted {
            return self.camera.pixel_from_normalized(self.turned.normalized_from_pixel(pixel));
        }
        let scale = |to: u32, from: u32| f64::from(to) / f64::from(from);
        Point2::new(
            pixel.x * scale(self.camera.width, self.turned.width),
            pixel.y * scale(self.camera.height, self.turned.height),
        )
    }

    fn is_none(&self) -> bool {
        self.num_turns == 0 && !self.is_undistorted && self.turned == self.camera
    }
}

/// Converts a model whose images are frames to the pixels of the frames, and reports the assumptions made.
///
/// * `unstated` – cameras whose image size is not in the file: the size in the model contains their features, and its
///   center is that of the image.
///
/// # Errors
/// [`PipelineError::Options`] with both sizes if the images are not the frames.
pub(super) fn fit(
    path: &Path,
    model: &mut Reconstruction,
    unstated: &BTreeSet<CameraId>,
    pictures: &Pictures,
) -> Result<Vec<Warning>> {
    complete_sizes(model, unstated, pictures);
    let mut known: BTreeMap<(CameraId, u8), CameraId> = BTreeMap::new();
    let mut cameras = BTreeMap::new();
    let mut is_undistorted = false;
    let stored = std::mem::take(&mut model.cameras);
    for (id, image) in &mut model.images {
        let Some(camera) = stored.get(&image.camera) else { continue };
        let turns = (pictures.turns)(id.frame());
        let fit = fit_of(camera, turns, pictures)
            .ok_or_else(|| PipelineError::Options(other_pictures(path, camera, pictures)))?;
        is_undistorted |= fit.is_undistorted;
        let key = (image.camera, fit.num_turns);
        let fresh = fresh_id(image.camera, &stored, &cameras);
        let own = *known.entry(key).or_insert(fresh);
        if !fit.is_none() {
            image.cam_from_world = about_axis(fit.num_turns) * image.cam_from_world;
            let size = (camera.width, camera.height);
            image.observations.iter_mut().for_each(|seen| seen.pixel = fit.pixel(seen.pixel, size));
        }
        if own != image.camera || fit.is_undistorted {
            model.camera_forms.remove(&own);
        }
        cameras.insert(own, fit.camera);
        image.camera = own;
    }
    model.cameras = cameras;
    let is_half_turned = model.images.keys().any(|id| (pictures.turns)(id.frame()) == Some(2));
    let path = path.display();
    Ok([
        is_undistorted.then(|| {
            format!(
                "{path}: model without distortion, but --intrinsics with distortion: its images are assumed to be the \
                 undistorted frames"
            )
        }),
        is_half_turned
            .then(|| format!("{path}: frames are stored upside down; the model's images are assumed to be upright")),
    ]
    .into_iter()
    .flatten()
    .map(|text| Topic::GivenModelDoesNotFit.warning(text))
    .collect())
}

/// The first version of a camera keeps its id; others get new ones.
fn fresh_id(own: CameraId, stored: &BTreeMap<CameraId, Camera>, taken: &BTreeMap<CameraId, Camera>) -> CameraId {
    let last = stored.keys().chain(taken.keys()).max().map_or(0, |id| id.0);
    if taken.contains_key(&own) { CameraId(last.saturating_add(1)) } else { own }
}

/// Sets the missing image sizes to that of the frames, or to the frames' size before resizing.
fn complete_sizes(model: &mut Reconstruction, unstated: &BTreeSet<CameraId>, pictures: &Pictures) {
    let upright = [pictures.frame, pictures.source];
    for (id, image) in &mut model.images {
        let Some(camera) = model.cameras.get(&image.camera).filter(|_| unstated.contains(&image.camera)) else {
            continue;
        };
        let is_turned = is_odd((pictures.turns)(id.frame()));
        let turned = upright.iter().filter(|_| is_turned).map(|(width, height)| (*height, *width));
        let holds = |size: &(u32, u32)| camera.width <= size.0 && camera.height <= size.1;
        let Some((width, height)) = upright.into_iter().chain(turned).find(holds) else { continue };
        let middle = Vector2::new(f64::from(width), f64::from(height)) / 2.0;
        let shift = middle - Vector2::from(camera.principal);
        let completed = Camera { width, height, principal: middle.into(), ..*camera };
        image.observations.iter_mut().for_each(|seen| seen.pixel += shift);
        model.cameras.insert(image.camera, completed);
    }
}

fn is_odd(turns: Option<u8>) -> bool {
    turns.is_some_and(|turns| turns % 2 == 1)
}

fn is_landscape((width, height): (u32, u32)) -> bool {
    width > height
}

fn fit_of(camera: &Camera, turns: Option<u8>, pictures: &Pictures) -> Option<ImageTransform> {
    let lies = is_landscape((camera.width, camera.height)) != is_landscape(pictures.frame);
    let num_turns = turns.filter(|_| lies && is_odd(turns)).unwrap_or(0);
    let turned = (0..num_turns).fold(*camera, |camera, _| turned_camera(&camera));
    if let Some(lens) = pictures.lens.filter(|lens| has_distortion(lens) && !has_distortion(camera)) {
        return Some(ImageTransform { num_turns, turned, camera: lens, is_undistorted: true });
    }
    let (width, height) = pictures.frame;
    let is_known = [pictures.frame, pictures.source].contains(&(turned.width, turned.height));
    let camera = if (turned.width, turned.height) == pictures.frame { turned } else { turned.resized(width, height) };
    is_known.then_some(ImageTransform { num_turns, turned, camera, is_undistorted: false })
}

fn has_distortion(camera: &Camera) -> bool {
    camera.radial != [0.0; 2] || !camera.higher.are_zero()
}

/// The camera of an image rotated clockwise by 90°.
fn turned_camera(camera: &Camera) -> Camera {
    let ([fx, fy], [cx, cy], [p1, p2]) = (camera.focal, camera.principal, camera.higher.tangential);
    Camera {
        width: camera.height,
        height: camera.width,
        focal: [fy, fx],
        principal: [f64::from(camera.height) - cy, cx],
        radial: camera.radial,
        // Adding to zero avoids −0 for absent terms.
        higher: HigherTerms { tangential: [p2, 0.0 - p1], ..camera.higher },
    }
}

fn turned_pixel(pixel: Point2<f64>, (width, height): (u32, u32), num_turns: u8) -> Point2<f64> {
    match num_turns % 4 {
        0 => pixel,
        1 => Point2::new(f64::from(height) - pixel.y, pixel.x),
        2 => Point2::new(f64::from(width) - pixel.x, f64::from(height) - pixel.y),
        _ => Point2::new(pixel.y, f64::from(width) - pixel.x),
    }
}

/// Axes of the rotated camera from those of the camera.
fn about_axis(num_turns: u8) -> Rigid3 {
    let angle = f64::from(num_turns) * std::f64::consts::FRAC_PI_2;
    Rigid3::new(UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle), Vector3::zeros())
}

/// Reason why the images cannot be the frames, with both sizes and the remedy.
fn other_pictures(path: &Path, camera: &Camera, pictures: &Pictures) -> String {
    let shown = |(width, height): (u32, u32)| format!("{width}x{height}");
    let (own, frame, source) = ((camera.width, camera.height), pictures.frame, pictures.source);
    let before = if source == frame { String::new() } else { format!(" ({} before downscaling)", shown(source)) };
    let is_turned = [frame, source].contains(&(own.1, own.0));
    let cure = if is_turned {
        "they are rotated by 90° without a flag in the input; make the model from upright images"
    } else if has_distortion(camera) {
        "make the model from the frames as they are; models must be at the resolution of the frames, or of their source"
    } else {
        "models must be at the resolution of the frames, or of their source; for undistorted images give the lens of \
         the frames with --intrinsics fx,fy,cx,cy,k1,k2"
    };
    format!("{}: images of {} pixels, frames of {}{before}; {cure}", path.display(), shown(own), shown(frame))
}
