//! Registry of the scale estimators: one trait, one table.
//!
//! A new estimator is a file here with an [`Estimator`], a row in the table of [`ScaleMethod`], and an arm of
//! [`estimator()`], which the compiler asks for. Options, verdict, benchmark, charts, report and documents follow the
//! table.

mod camera_height;
mod kundu;
mod motion;
mod ozden_axis;
mod ozden_heading;
mod ozden_independence;
mod ozden_plane;
mod park;
mod park_family;
mod search;
#[cfg(test)]
mod tests;
mod valmadre;
mod yuan;
mod zheng;

use self::camera_height::CameraHeight;
use self::kundu::Kundu;
use self::ozden_axis::OzdenAxis;
use self::ozden_heading::OzdenHeading;
use self::ozden_independence::{OzdenIndependence, OzdenVelocity};
use self::ozden_plane::OzdenPlane;
use self::park::Park;
use self::park_family::ParkFamily;
use self::valmadre::Valmadre;
use self::yuan::{Yuan, YuanLocal};
use self::zheng::Zheng;
use super::{
    ConstantDistanceMethod, Grounded, IntersectionMethod, Joint, JointMethod, LeastSquaresMethod, Options, ScaleError,
    Views,
};
use crate::scene::ScaleMethod;

/// Data of one object that an estimator may use.
#[derive(Clone, Copy, Debug)]
pub struct EstimatorInput<'a> {
    /// Views and points of the object's model.
    pub views: &'a Views,
    /// The models themselves, for estimators that adjust the object's; `None` if it must stay as it is.
    pub grounded: Option<&'a Grounded<'a>>,
}

impl<'a> EstimatorInput<'a> {
    /// For a model that stays as it is.
    pub fn unchanged(views: &'a Views) -> Self {
        Self { views, grounded: None }
    }
}

/// A scale ratio by one estimator.
#[derive(Clone, Debug, PartialEq)]
pub struct Estimate {
    /// r > 0.
    pub ratio: f64,
    /// Its standard deviation, where the estimator has one.
    pub std: Option<f64>,
    /// The object's adjusted model, to which `ratio` refers; `None` if it stays as it is.
    pub adjusted: Option<Box<Joint>>,
}

impl Estimate {
    /// For a model that stays as it is; a standard deviation that is not finite is none.
    pub fn new(ratio: f64, std: Option<f64>) -> Self {
        Self { ratio, std: std.filter(|std| std.is_finite()), adjusted: None }
    }
}

/// An estimator of the scale ratio.
pub trait Estimator: Sync {
    /// Its row in the table of methods: name, source, assumption.
    fn method(&self) -> ScaleMethod;

    /// Estimates the ratio of one object.
    ///
    /// # Errors
    /// [`ScaleError`] if the data leave the ratio undetermined, or are not there.
    fn estimate(&self, input: &EstimatorInput, options: &Options) -> Result<Estimate, ScaleError>;

    /// Returns true if only a change of the camera's height above ground determines the ratio.
    fn needs_climb(&self) -> bool {
        false
    }

    /// Relative standard deviation with which the ratio counts against that of another method in a verdict; `None` if
    /// it has none. Not finite where the data determine nothing.
    fn std_in_verdict(&self, _ratio: f64, _views: &Views, _options: &Options) -> Option<f64> {
        None
    }
}

/// The estimator of a method.
pub fn estimator(method: ScaleMethod) -> &'static dyn Estimator {
    match method {
        ScaleMethod::ConstantDistance => &ConstantDistanceMethod,
        ScaleMethod::Intersection => &IntersectionMethod,
        ScaleMethod::RobustLeastSquares => &LeastSquaresMethod,
        ScaleMethod::Joint => &JointMethod,
        ScaleMethod::OzdenIndependence => &OzdenIndependence,
        ScaleMethod::OzdenVelocity => &OzdenVelocity,
        ScaleMethod::OzdenPlane => &OzdenPlane,
        ScaleMethod::OzdenAxis => &OzdenAxis,
        ScaleMethod::OzdenHeading => &OzdenHeading,
        ScaleMethod::Zheng => &Zheng,
        ScaleMethod::CameraHeight => &CameraHeight,
        ScaleMethod::Yuan => &Yuan,
        ScaleMethod::YuanLocal => &YuanLocal,
        ScaleMethod::Park => &Park,
        ScaleMethod::ParkFamily => &ParkFamily,
        ScaleMethod::Valmadre => &Valmadre,
        ScaleMethod::Kundu => &Kundu,
    }
}
