//! Errors of a whole reconstruction.

use crate::features::FeatureError;
use crate::mapper::MapperError;

/// Error of [`reconstruct_pictures`](super::reconstruct_pictures).
#[derive(Debug, thiserror::Error)]
pub enum SfmError {
    /// Features could not be detected or tracked.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// The mapper refused its input.
    #[error(transparent)]
    Mapper(#[from] MapperError),
    /// The images do not determine a model, although the input is valid.
    #[error("nothing reconstructed: {reason}")]
    Failed {
        /// Missing input.
        reason: String,
    },
}
