//! Code shared by the formats with positions from the image's center and without its size: NVM and Bundler.

use std::collections::BTreeMap;
use std::path::Path;

use nalgebra::{Point2, Point3, Vector2};

use super::assembly::{Losses, Short, add_point, picture_size, unsupported_camera};
use super::words::Words;
use crate::camera::{Camera, HigherTerms};
use crate::io::IoError;
use crate::scene::{CameraId, ImageId, Point3dId, Reconstruction};

/// A point and its observations: pixels right and down from the image center.
pub struct Centered {
    pub position: Point3<f64>,
    pub rgb: [u8; 3],
    pub seen: Vec<(ImageId, Point2<f64>)>,
}

impl Centered {
    /// Reads a point: position, color, number of observations, and for each its camera, the feature and its position.
    /// `down` is 1 if the format's y axis points down, −1 if it points up.
    pub fn read(words: &mut Words<'_>, num_cameras: usize, down: f64) -> Result<Self, IoError> {
        let position = Point3::from(words.finites::<3>("position of a point")?);
        let rgb = [words.number("red")?, words.number("green")?, words.number("blue")?];
        let count = words.count("number of views of a point", 8)?;
        let mut seen = Vec::with_capacity(count);
        for _ in 0..count {
            let view: usize = words.number("view of a point")?;
            if view >= num_cameras {
                return Err(words.error("view of a point", format!("camera {view} does not exist")));
            }
            let _feature: u64 = words.number("index of a feature")?;
            let [x, y] = words.finites("position of a feature")?;
            seen.push((ImageId(view as u32 + 1), Point2::new(x, down * y)));
        }
        Ok(Self { position, rgb, seen })
    }
}

/// Widths and heights of images, pixels.
pub type Sizes = BTreeMap<ImageId, (u32, u32)>;

/// Sizes of the image files that are next to `path`.
pub fn sizes_of_files(path: &Path, model: &Reconstruction) -> Sizes {
    model.images.iter().filter_map(|(id, image)| Some((*id, picture_size(path, &image.name)?))).collect()
}

/// Sets the image size of every camera, which belongs to one image: the known size, otherwise the smallest even one
/// that contains all observations. The principal point is the center.
pub fn set_picture_sizes(model: &mut Reconstruction, points: &[Centered], known: &Sizes) {
    let mut reach: BTreeMap<ImageId, [f64; 2]> = BTreeMap::new();
    for (image, place) in points.iter().flat_map(|point| &point.seen) {
        let largest = reach.entry(*image).or_default();
        *largest = [largest[0].max(place.x.abs()), largest[1].max(place.y.abs())];
    }
    for (id, image) in &model.images {
        let Some(camera) = model.cameras.get_mut(&image.camera) else { continue };
        let half = reach.get(id).copied().unwrap_or_default();
        let even = |half: f64| 2 * (half.ceil().clamp(1.0, 1e6) as u32);
        let (width, height) = known.get(id).copied().unwrap_or((even(half[0]), even(half[1])));
        let principal = [f64::from(width) / 2.0, f64::from(height) / 2.0];
        *camera = Camera { width, height, principal, ..*camera };
    }
}

/// Adds points in the order of the file; ids are their indices in it plus one.
///
/// # Errors
/// A number that is not finite; readers find all others before.
pub fn add_points(path: &Path, model: &mut Reconstruction, points: Vec<Centered>) -> Result<(), IoError> {
    for (index, Centered { position, rgb, seen }) in (1..).zip(points) {
        let middle: BTreeMap<ImageId, Vector2<f64>> = seen
            .iter()
            .filter_map(|(id, _)| Some((*id, Vector2::from(model.camera_of(model.images.get(id)?).principal))))
            .collect();
        let seen = seen.into_iter().filter_map(|(id, place)| Some((id, place + middle.get(&id)?)));
        add_point(model, Point3dId(index), position, rgb, seen)
            .ok_or_else(|| IoError::content(path, format!("point {index} is not finite")))?;
    }
    Ok(())
}

/// Refuses a camera with two focal lengths.
pub fn check_one_focal_length(path: &Path, id: CameraId, camera: &Camera, format: &str) -> Result<(), IoError> {
    let [fx, fy] = camera.focal;
    if fx == fy {
        return Ok(());
    }
    Err(unsupported_camera(path, id, &format!("focal lengths {} and {}", Short(fx), Short(fy)), format))
}

/// Refuses a camera with more than one focal length, k₁ and k₂.
pub fn check_two_radial(path: &Path, id: CameraId, camera: &Camera, format: &str) -> Result<(), IoError> {
    check_one_focal_length(path, id, camera, format)?;
    match camera.higher == HigherTerms::ZERO {
        true => Ok(()),
        false => Err(unsupported_camera(path, id, "tangential or third radial distortion terms", format)),
    }
}

/// Indices of images in the file.
pub fn places(model: &Reconstruction) -> BTreeMap<ImageId, usize> {
    model.images.keys().enumerate().map(|(place, id)| (*id, place)).collect()
}

/// Data that these formats cannot represent.
pub fn losses(model: &Reconstruction) -> Losses {
    let is_off = |camera: &&Camera| camera.principal != [f64::from(camera.width) / 2.0, f64::from(camera.height) / 2.0];
    Losses::default()
        .with("image sizes are not stored in the format".to_owned())
        .counted(
            model.cameras.values().filter(is_off).count(),
            "camera has its principal point off the image center; features are relative to that point",
            "cameras have their principal point off the image center; features are relative to that point",
        )
        .unmatched_features(model)
}
