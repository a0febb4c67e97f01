//! From the frames of a source to tracks, by one of two ways.

use serde::{Deserialize, Serialize};

use super::sift_front_end::{Pairing, SiftFrontEnd, SiftOptions};
use super::tracks::TrackTable;
use super::video_front_end::{VideoFrontEnd, VideoOptions};
use super::{SfmError, features::FeatureOptions};
use crate::camera::Camera;
use crate::image::RgbImage;
use crate::scene::{Frame, Mask};

/// How tracks are made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum FrontEndOptions {
    /// Points followed from frame to frame: for videos, whose frames change little from one to the next.
    Video(VideoOptions),
    /// SIFT in every frame, matched between frames: for photographs, and for videos with wide steps.
    Sift(SiftOptions),
}

impl FrontEndOptions {
    /// For photographs in no order.
    pub fn unordered() -> Self {
        let features = FeatureOptions { max_features: 5000, contrast_threshold: 0.02, ..FeatureOptions::background() };
        Self::Sift(SiftOptions {
            features,
            pairing: Pairing::Exhaustive,
            // With refined positions points of two views help more than they harm.
            min_track_length: 2,
            ..SiftOptions::background()
        })
    }
}

/// Takes frames and gives tracks.
pub enum FrontEnd {
    /// See [`FrontEndOptions::Video`].
    Video(VideoFrontEnd),
    /// See [`FrontEndOptions::Sift`].
    Sift(SiftFrontEnd),
}

impl FrontEnd {
    /// Nothing seen yet. `camera` serves to verify matches; a guess will do.
    pub fn new(options: &FrontEndOptions, camera: Camera) -> Self {
        match options {
            FrontEndOptions::Video(o) => Self::Video(VideoFrontEnd::new(o.clone())),
            FrontEndOptions::Sift(o) => Self::Sift(SiftFrontEnd::new(o.clone(), camera)),
        }
    }

    /// Adds the next frame, looking only where the mask is set; the mask has the image's size.
    ///
    /// # Errors
    /// [`SfmError::MaskSize`] if the mask has not the image's size, [`SfmError::OpenCv`].
    pub fn push(&mut self, frame: &Frame, image: &RgbImage, mask: &Mask) -> Result<(), SfmError> {
        let (expected, found) = (image.dimensions(), (mask.width(), mask.height()));
        if expected != found {
            return Err(SfmError::MaskSize { name: frame.name.clone(), expected, found });
        }
        match self {
            Self::Video(f) => f.push(frame, image, mask),
            Self::Sift(f) => f.push(frame, image, mask),
        }
    }

    /// The tracks.
    ///
    /// # Errors
    /// [`SfmError::OpenCv`].
    pub fn finish(self, seed: u64) -> Result<TrackTable, SfmError> {
        match self {
            Self::Video(f) => Ok(f.finish()),
            Self::Sift(f) => f.finish(seed),
        }
    }
}
