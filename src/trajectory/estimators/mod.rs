//! Scale estimators that do not change the model, by method.
//!
//! A new estimator is a file here, a row in the table of [`ScaleMethod`], and an arm of [`estimate()`], which the
//! compiler requires. Options, verdict, benchmark, charts, report and documents follow the table.

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

/// Scale ratio by one estimator.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// r > 0.
    pub ratio: f64,
    /// Its standard deviation; `None` where the estimator has none.
    pub std: Option<f64>,
}

impl Estimate {
    /// Estimate; a standard deviation that is not finite becomes `None`.
    pub fn new(ratio: f64, std: Option<f64>) -> Self {
        Self { ratio, std: std.filter(|std| std.is_finite()) }
    }
}

/// Estimates the ratio of one object by a method.
///
/// # Errors
/// [`ScaleError`] if data are missing, or leave the ratio undetermined; [`ScaleError::NoAnswer`] for
/// [`ScaleMethod::Joint`], which adjusts the model ([`joint`](super::joint())).
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
