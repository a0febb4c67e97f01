//! Cameras of a folder of images.

use crate::scene::FrameId;

/// Number of cameras of a folder's images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cameras {
    /// One camera: images of another size than the common one are skipped.
    One,
    /// Several cameras, distinguished by image size, orientation and EXIF data.
    Several,
}

/// Camera of a subset of the images.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureCamera {
    /// Image width after rotation and resizing, pixels.
    pub width: u32,
    /// Image height after rotation and resizing, pixels.
    pub height: u32,
    /// Width before resizing, pixels.
    pub source_width: u32,
    /// Height before resizing, pixels.
    pub source_height: u32,
    /// Focal length from EXIF data, pixels of the rotated and resized images.
    pub exif_focal_px: Option<f64>,
    /// Its images, ascending; empty for a video, all frames of which have the same camera.
    pub frames: Vec<FrameId>,
}
