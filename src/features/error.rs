//! Errors of feature detection and tracking.

/// Error of a front end.
#[derive(Debug, thiserror::Error)]
pub enum FeatureError {
    /// An invalid option.
    #[error(transparent)]
    Option(#[from] crate::checks::OptionError),
    /// A failed check of OpenCV, which its message names.
    #[error("OpenCV: {0}")]
    OpenCv(#[from] opencv::Error),
    /// A pixel buffer could not be converted.
    #[error(transparent)]
    Image(#[from] crate::image::ImageError),
    /// A frame is reported to be of a camera that was not given.
    #[error("camera {camera} of {count} does not exist: give its intrinsics, or an estimate, with the others")]
    NoCamera {
        /// Its index in the list, from 0.
        camera: usize,
        /// Number given.
        count: usize,
    },
    /// A mask has another size than its image.
    #[error("mask of {name}: {found:?} pixels, its image has {expected:?}: give masks at the size of the frames")]
    MaskSize {
        /// Image name.
        name: String,
        /// Width and height of the image.
        expected: (u32, u32),
        /// Width and height of the mask.
        found: (u32, u32),
    },
}
