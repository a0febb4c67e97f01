//! Errors of the scale estimation.

use thiserror::Error;

use crate::math::rounding::figure;
use crate::scene::ScaleMethod;

/// Reason why an estimator has no result. The messages are meant for the user.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ScaleError {
    /// Too few frames have all the data that an equation needs.
    #[error(
        "only {usable} frames have a background camera, an object camera and a local ground plane ({paired} have both \
         cameras, {planes} a plane); at least {needed} needed"
    )]
    TooFewViews {
        /// Frames with all three.
        usable: usize,
        /// Frames with both cameras.
        paired: usize,
        /// Frames with a plane.
        planes: usize,
        /// Minimum number for the estimator.
        needed: usize,
    },
    /// The object's model has no points.
    #[error("the object's model has no points")]
    NoPoints,
    /// Too few of the model's points are observed often enough to determine the contact with the ground.
    #[error(
        "none of the model's {num_points} points is observed in {min_track} frames or more and near the others: the \
         contact with the ground is undetermined"
    )]
    NoSolidPoints {
        /// Points of the model.
        num_points: usize,
        /// Minimum number of observations of a point that is used.
        min_track: usize,
    },
    /// The normals of the planes have no mean direction.
    #[error("normals of the {num_views} local ground planes have no mean direction in the object's frame")]
    NoMeanNormal {
        /// Number of planes.
        num_views: usize,
    },
    /// No observation of the object's model can be compared with its point.
    #[error("no observation of the object's model can be compared with its point")]
    NoObservations,
    /// The adjustment leaves the size undetermined.
    #[error(
        "adjustment with the ground leaves the size undetermined: too little of the object is visible in some frames"
    )]
    NoCovariance,
    /// The adjusted points cannot be aligned with the original ones.
    #[error("adjusted points cannot be aligned with the original reconstruction")]
    NoSimilarity,
    /// No frame is registered in both reconstructions.
    #[error("no frame is registered in both the background and the object")]
    NoCommonFrame,
    /// The requested method needs an adjustment of the model.
    #[error("{} cannot be used without adjusting the model", .0.name())]
    NoAnswer(ScaleMethod),
    /// The camera does not translate.
    #[error("the camera does not translate: its height above ground does not change")]
    CameraHovers,
    /// The equations of all view pairs give a ratio that is negative, zero or not finite.
    #[error(
        "none of {num_pairs} view pairs gives a positive scale ratio: the camera height above ground does not change \
         beyond its noise, or the ground planes are wrong"
    )]
    NoPositivePair {
        /// Number of pairs.
        num_pairs: usize,
    },
    /// No ray to an object point intersects its plane in front of the camera.
    #[error("in none of {num_views} frames does a ray to an object point intersect the local ground plane")]
    NoIntersection {
        /// Number of frames.
        num_views: usize,
    },
    /// The least squares solution over all frames is not positive.
    #[error(
        "{}: the camera height above ground does not change beyond its noise",
        least_squares_words(*num_views, *ratio)
    )]
    NotPositive {
        /// Frames used.
        num_views: usize,
        /// The solution.
        ratio: f64,
    },
    /// The criterion of an estimator has no solution for this motion.
    #[error("scale undetermined: {0}")]
    Undetermined(&'static str),
    /// The adjustment with the ground cannot be done.
    #[error("adjustment with the ground failed: {0}")]
    Adjustment(String),
    /// The object's images and the ground contradict each other.
    #[error(
        "median reprojection error {after_px:.2} px with the object on the ground, {before_px:.2} px without: wrong \
         ground planes, or the object is not on the ground"
    )]
    GroundContradicts {
        /// Median reprojection error before, pixels.
        before_px: f64,
        /// Median reprojection error after, pixels.
        after_px: f64,
    },
}

fn least_squares_words(num_views: usize, ratio: f64) -> String {
    match ratio.is_finite() {
        true => format!("least squares over {num_views} frames gives {}", figure(ratio)),
        false => format!("least squares over {num_views} frames has no solution"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nan_is_not_printed() {
        let nowhere = ScaleError::NotPositive { num_views: 3, ratio: f64::NAN }.to_string();
        assert!(!nowhere.contains("NaN") && nowhere.contains("no solution"), "{nowhere}");
    }
}
