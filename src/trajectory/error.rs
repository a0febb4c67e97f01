//! Why there is no scale ratio.

use thiserror::Error;

/// Why an estimator has no answer. The messages are made to be shown to the user as they are.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ScaleError {
    /// Not enough frames have everything that an equation needs.
    #[error(
        "only {usable} frames have a camera in the background, a camera in the object's model and a local ground plane \
         ({paired} have both cameras, {planes} have a plane); at least {needed} are needed"
    )]
    TooFewViews {
        /// Frames with all three.
        usable: usize,
        /// Frames with both cameras.
        paired: usize,
        /// Frames with a plane.
        planes: usize,
        /// What the estimator needs.
        needed: usize,
    },
    /// The object's model has no points.
    #[error("the object's model has no points")]
    NoPoints,
    /// The equations of all view pairs give a ratio that is negative, zero or not finite.
    #[error(
        "none of {num_pairs} view pairs gives a positive scale ratio: the camera's height over the ground does not \
         change beyond its noise, or the local planes are wrong"
    )]
    NoPositivePair {
        /// Pairs looked at.
        num_pairs: usize,
    },
    /// No ray towards an object point meets its plane in front of the camera.
    #[error("in none of {num_views} frames does a ray towards an object point meet the local ground plane")]
    NoIntersection {
        /// Frames looked at.
        num_views: usize,
    },
    /// The least squares solution over all frames is not positive.
    #[error(
        "the least squares ratio over {num_views} frames is {ratio:.3e}: the camera's height over the ground does not \
         change beyond its noise"
    )]
    NotPositive {
        /// Frames used.
        num_views: usize,
        /// The solution.
        ratio: f64,
    },
    /// The adjustment with the ground cannot be done.
    #[error("the adjustment of the object with the ground failed: {0}")]
    Adjustment(String),
    /// What the object's pictures say and what the ground says does not fit together.
    #[error(
        "with the object on the ground its image positions are off by {after_px:.2} px (median) instead of \
         {before_px:.2}: the local planes are wrong, or the object does not stand on the ground"
    )]
    GroundContradicts {
        /// Median error before.
        before_px: f64,
        /// And after.
        after_px: f64,
    },
}
