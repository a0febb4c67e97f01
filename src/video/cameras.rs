//! Cameras of a folder of images.

use crate::scene::FrameId;

/// Number of cameras of a folder's images.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Cameras {
    /// No: those of another size than the first are left out.
    One,
    /// Yes: as many as sizes, orientations and EXIF data tell apart.
    Several,
}

/// A camera that took some of the pictures.
#[derive(Clone, Debug, PartialEq)]
pub struct PictureCamera {
    /// Width of its pictures as they are given out (turned, resized), pixels.
    pub width: u32,
    /// Height of its pictures as they are given out, pixels.
    pub height: u32,
    /// Width before resizing, pixels.
    pub source_width: u32,
    /// Height before resizing, pixels.
    pub source_height: u32,
    /// Focal length that EXIF data state, in pixels of the pictures as they are given out.
    pub exif_focal_px: Option<f64>,
    /// Its pictures, ascending; empty for a video, all frames of which are of its one camera.
    pub frames: Vec<FrameId>,
}
