//! Errors of structure from motion other than degenerate geometry, which is an answer.

/// An error of this room.
#[derive(Debug, thiserror::Error)]
pub enum SfmError {
    /// An option that cannot be worked with.
    #[error(transparent)]
    Option(#[from] crate::limits::OptionError),
    /// OpenCV refused; its message says which check failed.
    #[error("OpenCV: {0}")]
    OpenCv(#[from] opencv::Error),
    /// A pixel buffer could not be converted.
    #[error(transparent)]
    Image(#[from] crate::image::ImageError),
    /// The mapper handed over an adjustment problem that contradicts itself.
    #[error("bundle adjustment: {0}")]
    Bundle(#[from] crate::bundle::BundleError),
    /// The pictures do not give a start; nothing is wrong with how they were given.
    #[error("nothing reconstructed: {reason}")]
    Failed {
        /// Missing input.
        reason: String,
    },
    /// A frame is reported to be of a camera that was not given.
    #[error("camera {camera} of {count} does not exist: give its intrinsics, or an estimate, with the others")]
    NoCamera {
        /// Its place in the list, from 0.
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
