//! A COLMAP workspace: `images/`, `masks/` and `sparse/0`, ready for `image_undistorter` and densification.
//!
//! The images are those of the registered frames, upright and at the size of the model, under its names. A mask has
//! the image's name with `.png` appended. It is 0 on objects that move or may move, widened to cover their outlines,
//! and 255 elsewhere.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use ::image::codecs::jpeg::JpegEncoder;
use ::image::{ImageFormat, RgbImage};

use super::annotate::masks_of;
use super::results::there;
use super::write::Pictures;
use super::{ExportError, RegisteredFrame, Results};
use crate::io::interchange::colmap;
use crate::io::{ExportFolder, IoError, RunFolder, masks};
use crate::scene::{FrameId, Mask, Movement, ObjectId};

/// Writes the workspace into an empty folder.
///
/// # Errors
/// Names that are no file names; an input that is missing or does not match; a frame that cannot be decoded.
pub(super) fn write(folder: &Path, results: &Results, pictures: &Pictures) -> Result<(), ExportError> {
    check_names(folder, results)?;
    let stationary = stationary_objects(pictures.folder)?;
    let views: BTreeMap<FrameId, &RegisteredFrame> = results.views.iter().map(|view| (view.frame.id, view)).collect();
    let mut missing: BTreeSet<&str> = results.views.iter().map(|view| view.frame.name.as_str()).collect();
    for found in pictures.source()?.frames_at(views.keys().copied().collect())? {
        let (frame, picture) = found?;
        let Some(view) = views.get(&frame.id).filter(|view| view.frame.name == frame.name) else {
            return Err(pictures.other(format!("frame {} is named {}", frame.id.0, frame.name)));
        };
        if picture.dimensions() != (view.camera.width, view.camera.height) {
            pictures.check_size(&picture, results)?;
        }
        save(&folder.join(ExportFolder::IMAGES).join(&frame.name), &picture)?;
        let path = folder.join(ExportFolder::MASKS).join(RunFolder::mask_name(&frame));
        masks::write_mask(&path, &static_mask(pictures.folder, &view.frame, picture.dimensions(), &stationary)?)?;
        missing.remove(view.frame.name.as_str());
        (pictures.on_step)();
    }
    if let Some(name) = missing.first() {
        return Err(pictures.other(format!("{} of its frames are missing, the first: {name}", missing.len())));
    }
    Ok(colmap::write_binary(&folder.join(ExportFolder::SPARSE).join("0"), &results.background)?)
}

/// Checks that every image name of the model is a file name: models made elsewhere may have folders in theirs.
fn check_names(folder: &Path, results: &Results) -> Result<(), ExportError> {
    let is_file_name = |name: &str| !name.starts_with('.') && !name.contains(['/', '\0']) && !name.is_empty();
    match results.background.images.values().find(|image| !is_file_name(&image.name)) {
        None => Ok(()),
        Some(image) => Err(IoError::content(folder, format!("image name {:?} is not a file name", image.name)).into()),
    }
}

/// The objects that were stationary throughout: they belong to the background.
fn stationary_objects(folder: &RunFolder) -> Result<BTreeSet<ObjectId>, ExportError> {
    let tracked = there(folder.read_tracked())?.unwrap_or_default();
    let stationary = tracked.iter().filter(|object| object.movement.state == Movement::Stationary);
    Ok(stationary.map(|object| object.id).collect())
}

/// Mask of the static part of an image.
fn static_mask(
    folder: &RunFolder,
    frame: &crate::scene::Frame,
    (width, height): (u32, u32),
    stationary: &BTreeSet<ObjectId>,
) -> Result<Mask, ExportError> {
    let mut moving = Mask::empty(width, height);
    for (id, mask) in masks_of(folder, frame, (width, height))? {
        if !stationary.contains(&id) {
            moving.union_with(&mask);
        }
    }
    // Margin by which masks are widened, as a share of the longer side.
    let margin_px = (0.004 * f64::from(width.max(height))).ceil() as u32;
    Ok(moving.dilated(margin_px).complement())
}

/// Writes an image in the format of its name's extension: PNG, else JPEG.
fn save(path: &Path, picture: &RgbImage) -> Result<(), ExportError> {
    let failed = |error: ::image::ImageError| IoError::content(path, format!("cannot be written: {error}"));
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).map_err(IoError::system("create", folder))?;
    }
    let is_png = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
    if is_png {
        return Ok(picture.save_with_format(path, ImageFormat::Png).map_err(failed)?);
    }
    let file = BufWriter::new(File::create(path).map_err(IoError::system("write", path))?);
    // Nearly lossless.
    Ok(JpegEncoder::new_with_quality(file, 96).encode_image(picture).map_err(failed)?)
}
