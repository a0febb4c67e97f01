//! Scale estimators of a model that stays as it is, by method.
//!
//! A new estimator is a file here, a row in the table of [`ScaleMethod`], and an arm of [`estimate()`], which the
//! compiler asks for. Options, verdict, benchmark, charts, report and documents follow the table.

mod camera_height;
mod motion;
mod ozden_axis;
mod ozden_heading;
mod ozden_plane;
#[cfg(test)]
mod tests;
mod yuan;

use self::motion::Motion;
use super::{Options, ScaleError, Views, constant_distance, intersection, least_squares};
use crate::scene::ScaleMethod;

/// A scale ratio by one estimator.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// r > 0.
    pub ratio: f64,
    /// Its standard deviation, where the estimator has one.
    pub std: Option<f64>,
}

impl Estimate {
    /// A standard deviation that is not finite is none.
    pub fn new(ratio: f64, std: Option<f64>) -> Self {
        Self { ratio, std: std.filter(|std| std.is_finite()) }
    }
}

/// Estimates the ratio of one object by a method.
///
/// # Errors
/// [`ScaleError`] if the data leave the ratio undetermined, or are not there; [`ScaleError::NoAnswer`] for
/// [`ScaleMethod::Joint`], which makes a model of its own ([`joint`](super::joint())).
pub fn estimate(method: ScaleMethod, views: &Views, options: &Options) -> Result<Estimate, ScaleError> {
    let alone = |ratio: fn(&Motion) -> Result<f64, ScaleError>| Motion::new(views)?.jackknifed(ratio);
    match method {
        ScaleMethod::ConstantDistance => constant_distance::estimate(views, options),
        ScaleMethod::Intersection => Ok(Estimate::new(intersection::intersection(views)?.ratio, None)),
        ScaleMethod::RobustLeastSquares => least_squares::estimate(views, options),
        ScaleMethod::Joint => Err(ScaleError::NoAnswer(method)),
        ScaleMethod::OzdenPlane => ozden_plane::estimate(views),
        ScaleMethod::OzdenAxis => alone(ozden_axis::ratio),
        ScaleMethod::OzdenHeading => ozden_heading::estimate(views),
        ScaleMethod::CameraHeight => camera_height::estimate(views, options),
        ScaleMethod::Yuan => alone(yuan::ratio),
        ScaleMethod::YuanLocal => alone(yuan::local_ratio),
    }
}

/// Returns true if only a change of the camera's height above ground determines a method's ratio.
pub(super) fn needs_climb(method: ScaleMethod) -> bool {
    matches!(method, ScaleMethod::ConstantDistance | ScaleMethod::RobustLeastSquares | ScaleMethod::Joint)
}
