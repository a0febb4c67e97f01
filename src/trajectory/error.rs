//! Why there is no scale ratio.

use thiserror::Error;

use crate::math::rounding::figure;
use crate::scene::ScaleMethod;

/// Why an estimator has no answer. The messages are made to be shown to the user as they are.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ScaleError {
    /// Not enough frames have everything that an equation needs.
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
        /// Number that the estimator needs.
        needed: usize,
    },
    /// The object's model has no points.
    #[error("the object's model has no points")]
    NoPoints,
    /// The model has points, and too few of them are seen often enough to show where the vehicle touches the ground.
    #[error(
        "none of the model's {num_points} points is observed in {min_track} frames or more and near the others: the \
         contact with the ground is undetermined"
    )]
    NoSolidPoints {
        /// Points of the model.
        num_points: usize,
        /// Observations that a point needs to count.
        min_track: usize,
    },
    /// The planes point everywhere.
    #[error("normals of the {num_views} local ground planes have no mean direction in the object's frame")]
    NoMeanNormal {
        /// Planes looked at.
        num_views: usize,
    },
    /// No observation of the object's model can be compared with its point.
    #[error("no observation of the object's model can be compared with its point")]
    NoObservations,
    /// The adjustment left something undetermined.
    #[error(
        "adjustment with the ground leaves the size undetermined: too little of the object is visible in some frames"
    )]
    NoCovariance,
    /// The adjusted points cannot be brought back.
    #[error("adjusted points cannot be aligned with the original reconstruction")]
    NoSimilarity,
    /// The object is nowhere.
    #[error("no frame is registered in both the background and the object")]
    NoCommonFrame,
    /// A method that gives no answer of this kind was asked for.
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
        /// Pairs looked at.
        num_pairs: usize,
    },
    /// No ray towards an object point meets its plane in front of the camera.
    #[error("in none of {num_views} frames does a ray to an object point intersect the local ground plane")]
    NoIntersection {
        /// Frames looked at.
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
    /// The motion leaves the criterion of an estimator without a solution.
    #[error("scale undetermined: {0}")]
    Undetermined(&'static str),
    /// The adjustment with the ground cannot be done.
    #[error("adjustment with the ground failed: {0}")]
    Adjustment(String),
    /// The object's images and the ground contradict one another.
    #[error(
        "median reprojection error {after_px:.2} px with the object on the ground, {before_px:.2} px without: wrong \
         ground planes, or the object is not on the ground"
    )]
    GroundContradicts {
        /// Median error before.
        before_px: f64,
        /// And after.
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
    fn what_is_no_number_is_not_printed() {
        let nowhere = ScaleError::NotPositive { num_views: 3, ratio: f64::NAN }.to_string();
        assert!(!nowhere.contains("NaN") && nowhere.contains("no solution"), "{nowhere}");
    }
}
