//! Free and constant parameters, and observations.

use nalgebra::{Point2, Point3, Vector2, Vector3};
use thiserror::Error;

use super::whitening::Whitening;
use crate::camera::{Camera, NUM_INTRINSICS};
use crate::math::{Rigid3, RobustLoss};

/// Bundle adjustment problem: input and output of [`super::adjust`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Problem {
    /// Sets of intrinsics; one may serve many poses.
    pub cameras: Vec<CameraBlock>,
    /// One per image, in order of time for a video: neighbors in this list should see common points.
    pub poses: Vec<PoseBlock>,
    /// Points of the scene.
    pub points: Vec<PointBlock>,
    /// Observations, in any order.
    pub observations: Vec<Observation>,
    /// Priors; empty by default.
    pub priors: Priors,
}

/// Intrinsics, free or constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraBlock {
    /// The intrinsics.
    pub camera: Camera,
    /// True for each of fx, fy, cx, cy, k1, k2 (in this order) that is free.
    pub free: [bool; NUM_INTRINSICS],
    /// Single focal length: fx is free if `free[0]`, and the initial ratio fy / fx is kept; `free[1]` is ignored.
    pub tie_focal: bool,
}

impl CameraBlock {
    /// Constant intrinsics.
    pub fn fixed(camera: Camera) -> Self {
        Self { camera, free: [false; NUM_INTRINSICS], tie_focal: true }
    }

    /// Single free focal length and free radial distortion; principal point and aspect ratio are constant.
    pub fn free_focal_and_radial(camera: Camera) -> Self {
        Self { camera, free: [true, true, false, false, true, true], tie_focal: true }
    }
}

/// An image's pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseBlock {
    /// World to camera.
    pub cam_from_world: Rigid3,
    /// Index in [`Problem::cameras`].
    pub camera: usize,
    /// Held where it is.
    pub fixed: bool,
}

/// A point of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointBlock {
    /// Position in the world.
    pub position: Point3<f64>,
    /// Held where it is.
    pub fixed: bool,
}

/// One measured image position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Index in [`Problem::poses`].
    pub pose: u32,
    /// Index in [`Problem::points`].
    pub point: u32,
    /// Pixels, first pixel center at (0.5, 0.5).
    pub pixel: Point2<f64>,
    /// Whitening of the residual; the identity gives costs in squared pixels.
    pub whitening: Whitening,
}

impl Observation {
    /// Observation with a standard deviation of one pixel.
    pub fn new(pose: u32, point: u32, pixel: Point2<f64>) -> Self {
        Self { pose, point, pixel, whitening: Whitening::IDENTITY }
    }
}

/// Independent Gaussian priors on parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Priors {
    /// Priors on intrinsics.
    pub intrinsics: Vec<IntrinsicsPrior>,
    /// Priors on poses, from planes known in the camera frames.
    pub planes: Vec<PlanePrior>,
    /// Priors on observed points.
    pub points: Vec<PointPrior>,
}

impl Priors {
    /// Returns true if a prior ties the world to a given frame, so that the gauge is not free.
    pub(super) fn hold_gauge(&self) -> bool {
        !self.planes.is_empty() || !self.points.is_empty()
    }
}

/// Prior on a pose: a plane known in the camera frame, n · x + h = 0, passes near a world point and is nearly level.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanePrior {
    /// Index in [`Problem::poses`].
    pub pose: usize,
    /// n: the plane's unit normal in the camera's frame.
    pub normal_in_cam: Vector3<f64>,
    /// h: signed distance of the camera from the plane, positive on the normal's side, world units.
    pub camera_height: f64,
    /// The point of the world through which the plane passes.
    pub point: Point3<f64>,
    /// The unit vector of the world that is the plane's normal.
    pub up: Vector3<f64>,
    /// Standard deviation of the point's distance to the plane, world units; infinite disables the distance residual.
    pub sigma_distance: f64,
    /// Standard deviation of the tilt about each axis in the plane, radians; infinite disables the tilt residual.
    pub sigma_tilt: f64,
    /// Robust loss on distance and tilt each, in standard deviations: some planes are wrong.
    pub loss: RobustLoss,
}

/// Prior on the position of a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PointPrior {
    /// Index in [`Problem::points`].
    pub point: usize,
    /// Prior position.
    pub position: Point3<f64>,
    /// Standard deviation of each coordinate, world units.
    pub sigma: f64,
}

/// Prior on intrinsics.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntrinsicsPrior {
    /// Index in [`Problem::cameras`].
    pub camera: usize,
    /// Prior values of fx, fy, cx, cy, k1, k2.
    pub values: [f64; NUM_INTRINSICS],
    /// Their standard deviations; an infinite one disables the prior on that parameter.
    pub sigma: [f64; NUM_INTRINSICS],
}

/// Reason for which a problem could not be adjusted.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum BundleError {
    /// An index is out of range.
    #[error("{what} {index}: {target} {value} does not exist, only {count} do")]
    Index {
        /// The block that holds the index.
        what: &'static str,
        /// Its position in its list.
        index: usize,
        /// The list referred to.
        target: &'static str,
        /// The index.
        value: usize,
        /// Length of that list.
        count: usize,
    },
    /// A value that is not finite, or not positive where it must be.
    #[error("{what} {index}: value not finite or out of range; remove it before the adjustment")]
    Value {
        /// The block at fault.
        what: &'static str,
        /// Its position in its list.
        index: usize,
    },
    /// An option out of range.
    #[error("bundle option {name} = {value}: out of range")]
    Option {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// More blocks or observations than 32-bit indices count.
    #[error("{count} {what}: more than the adjuster can index")]
    TooLarge {
        /// Name of the list.
        what: &'static str,
        /// Its length.
        count: usize,
    },
    /// The normal equations are singular, so a covariance does not exist.
    #[error(
        "covariance undetermined: the normal equations are singular at parameter {pivot}; fix the gauge or remove \
         unobserved parameters"
    )]
    Singular {
        /// Index in the reduced system, with the points behind the cameras.
        pivot: usize,
    },
    /// A covariance was requested for a constant or unobserved block.
    #[error("{what} {index}: no covariance, it is constant or unobserved")]
    NoCovariance {
        /// The list.
        what: &'static str,
        /// Index in it.
        index: usize,
    },
    /// The threads could not be started.
    #[error("{threads} threads cannot be started: {message}")]
    Threads {
        /// Number of threads.
        threads: usize,
        /// Message of the system.
        message: String,
    },
}

impl Problem {
    /// Projected minus measured position of an observation, pixels.
    pub fn residual_px(&self, o: &Observation) -> Vector2<f64> {
        let pose = &self.poses[o.pose as usize];
        let point_in_cam = pose.cam_from_world * self.points[o.point as usize].position;
        self.cameras[pose.camera].camera.project(point_in_cam).pixel - o.pixel
    }

    /// Reprojection errors of the observations whose points lie in front of their cameras, pixels.
    pub fn errors_px(&self) -> impl Iterator<Item = f64> + '_ {
        self.observations.iter().filter_map(|o| {
            let pose = &self.poses[o.pose as usize];
            let point_in_cam = pose.cam_from_world * self.points[o.point as usize].position;
            let pixel = self.cameras[pose.camera].camera.pixel_from_cam(point_in_cam)?;
            Some((pixel - o.pixel).norm())
        })
    }

    /// Checks all indices and values.
    ///
    /// # Errors
    /// [`BundleError::Index`], [`BundleError::Value`] or [`BundleError::TooLarge`] for the first fault found.
    pub fn check(&self) -> Result<(), BundleError> {
        self.check_sizes()?;
        for (index, block) in self.cameras.iter().enumerate() {
            let positive = block.camera.focal.iter().all(|f| *f > 0.0);
            require(positive && block.camera.intrinsics().iter().all(|v| v.is_finite()), "camera", index)?;
        }
        for (index, block) in self.poses.iter().enumerate() {
            in_range("pose", index, "camera", block.camera, self.cameras.len())?;
            let Rigid3 { rotation, translation } = block.cam_from_world;
            let finite = rotation.coords.iter().chain(translation.iter()).all(|v| v.is_finite());
            require(finite, "pose", index)?;
        }
        for (index, block) in self.points.iter().enumerate() {
            require(block.position.coords.iter().all(|v| v.is_finite()), "point", index)?;
        }
        for (index, o) in self.observations.iter().enumerate() {
            in_range("observation", index, "pose", o.pose as usize, self.poses.len())?;
            in_range("observation", index, "point", o.point as usize, self.points.len())?;
            let good = o.pixel.coords.iter().all(|v| v.is_finite()) && o.whitening.is_valid();
            require(good, "observation", index)?;
        }
        self.check_priors()
    }

    fn check_sizes(&self) -> Result<(), BundleError> {
        let sizes = [
            ("cameras", self.cameras.len()),
            ("poses", self.poses.len()),
            ("points", self.points.len()),
            ("observations", self.observations.len()),
        ];
        let largest = u32::MAX as usize / 2;
        match sizes.into_iter().find(|(_, count)| *count > largest) {
            Some((what, count)) => Err(BundleError::TooLarge { what, count }),
            None => Ok(()),
        }
    }

    fn check_priors(&self) -> Result<(), BundleError> {
        for (index, prior) in self.priors.intrinsics.iter().enumerate() {
            in_range("intrinsics prior", index, "camera", prior.camera, self.cameras.len())?;
            let good = prior.values.iter().all(|v| v.is_finite()) && prior.sigma.iter().all(|s| *s > 0.0);
            require(good, "intrinsics prior", index)?;
        }
        for (index, prior) in self.priors.planes.iter().enumerate() {
            in_range("plane prior", index, "pose", prior.pose, self.poses.len())?;
            let numbers = prior.normal_in_cam.sum() + prior.camera_height + prior.point.coords.sum() + prior.up.sum();
            let good = numbers.is_finite() && prior.sigma_distance > 0.0 && prior.sigma_tilt > 0.0;
            require(good, "plane prior", index)?;
        }
        for (index, prior) in self.priors.points.iter().enumerate() {
            in_range("point prior", index, "point", prior.point, self.points.len())?;
            require(prior.position.coords.sum().is_finite() && prior.sigma > 0.0, "point prior", index)?;
        }
        Ok(())
    }
}

fn in_range(
    what: &'static str,
    index: usize,
    target: &'static str,
    value: usize,
    count: usize,
) -> Result<(), BundleError> {
    if value < count { Ok(()) } else { Err(BundleError::Index { what, index, target, value, count }) }
}

fn require(good: bool, what: &'static str, index: usize) -> Result<(), BundleError> {
    if good { Ok(()) } else { Err(BundleError::Value { what, index }) }
}
