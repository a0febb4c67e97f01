//! Errors of the mapper other than degenerate geometry, which is an answer.

/// Error of a reconstruction.
#[derive(Debug, thiserror::Error)]
pub enum MapperError {
    /// An invalid option.
    #[error(transparent)]
    Option(#[from] crate::checks::OptionError),
    /// The mapper handed over an adjustment problem that contradicts itself.
    #[error("bundle adjustment: {0}")]
    Bundle(#[from] crate::bundle::BundleError),
}
