//! What varies, what is held, and what was observed.

use nalgebra::{Point2, Point3};
use thiserror::Error;

use crate::camera::{Camera, NUM_INTRINSICS};
use crate::math::Rigid3;
use crate::sfm::Whitening;

/// Everything that [`super::adjust`] reads and writes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Problem {
    /// Sets of intrinsics; one may serve many poses.
    pub cameras: Vec<CameraBlock>,
    /// One per image, in order of time for a video: neighbours in this list should see common points.
    pub poses: Vec<PoseBlock>,
    /// Points of the scene.
    pub points: Vec<PointBlock>,
    /// Image measurements, in any order.
    pub observations: Vec<Observation>,
    /// Other knowledge; empty by default.
    pub priors: Priors,
}

/// Intrinsics and which of them may change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraBlock {
    /// The intrinsics.
    pub camera: Camera,
    /// Whether fx, fy, cx, cy, k1, k2 (in this order) are free.
    pub free: [bool; NUM_INTRINSICS],
    /// One focal length: fx is free if `free[0]`, and fy follows with the ratio fy / fx that it has at the start;
    /// `free[1]` is not looked at.
    pub tie_focal: bool,
}

impl CameraBlock {
    /// Intrinsics that stay as they are.
    pub fn fixed(camera: Camera) -> Self {
        Self { camera, free: [false; NUM_INTRINSICS], tie_focal: true }
    }

    /// One free focal length and free radial distortion; principal point and aspect stay.
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
    /// Pixels, first pixel centre at (0.5, 0.5).
    pub pixel: Point2<f64>,
    /// How exactly the position is known; the identity gives costs in squared pixels.
    pub whitening: Whitening,
}

impl Observation {
    /// With a standard deviation of one pixel.
    pub fn new(pose: u32, point: u32, pixel: Point2<f64>) -> Self {
        Self { pose, point, pixel, whitening: Whitening::IDENTITY }
    }
}

/// Knowledge that does not come from image positions, as independent Gaussians.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Priors {
    /// On poses.
    pub poses: Vec<PosePrior>,
    /// On intrinsics.
    pub intrinsics: Vec<IntrinsicsPrior>,
}

/// A pose is near a known one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PosePrior {
    /// Index in [`Problem::poses`].
    pub pose: usize,
    /// The known pose.
    pub cam_from_world: Rigid3,
    /// Standard deviation of the rotation about each axis, radians; infinite leaves the rotation out.
    pub sigma_rotation: f64,
    /// Standard deviation of each coordinate of the camera centre, world units; infinite leaves the centre out.
    pub sigma_center: f64,
}

/// Intrinsics are near known ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IntrinsicsPrior {
    /// Index in [`Problem::cameras`].
    pub camera: usize,
    /// Known fx, fy, cx, cy, k1, k2.
    pub values: [f64; NUM_INTRINSICS],
    /// Their standard deviations; an infinite one leaves that parameter out.
    pub sigma: [f64; NUM_INTRINSICS],
}

/// Why a problem could not be adjusted.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum BundleError {
    /// An index points past its list.
    #[error("{what} {index} refers to {target} {value}, but there are only {count}")]
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
    #[error("{what} {index} holds a value that is not finite or not in range; remove it before the adjustment")]
    Value {
        /// The block at fault.
        what: &'static str,
        /// Its position in its list.
        index: usize,
    },
    /// An option out of range.
    #[error("bundle option {name} = {value} is out of range")]
    Option {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// More blocks or observations than 32-bit indices count.
    #[error("{count} {what} are more than the adjuster can index")]
    TooLarge {
        /// Which list.
        what: &'static str,
        /// Its length.
        count: usize,
    },
    /// The normal equations are singular where a covariance was asked for.
    #[error(
        "the covariance is not determined: the normal equations are singular at parameter {pivot}; hold the gauge or remove what nothing observes"
    )]
    Singular {
        /// Index in the reduced system, with the points behind the cameras.
        pivot: usize,
    },
    /// A covariance was asked for a block that is held or that nothing observes.
    #[error("{what} {index} has no covariance: it is held, or nothing observes it")]
    NoCovariance {
        /// The list.
        what: &'static str,
        /// Index in it.
        index: usize,
    },
    /// The threads could not be started.
    #[error("could not start {threads} threads: {message}")]
    Threads {
        /// How many.
        threads: usize,
        /// The system's words.
        message: String,
    },
}

impl Problem {
    /// Looks through all indices and values.
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
        for (index, prior) in self.priors.poses.iter().enumerate() {
            in_range("pose prior", index, "pose", prior.pose, self.poses.len())?;
            let Rigid3 { rotation, translation } = prior.cam_from_world;
            let finite = rotation.coords.iter().chain(translation.iter()).all(|v| v.is_finite());
            require(finite && prior.sigma_rotation > 0.0 && prior.sigma_center > 0.0, "pose prior", index)?;
        }
        for (index, prior) in self.priors.intrinsics.iter().enumerate() {
            in_range("intrinsics prior", index, "camera", prior.camera, self.cameras.len())?;
            let good = prior.values.iter().all(|v| v.is_finite()) && prior.sigma.iter().all(|s| *s > 0.0);
            require(good, "intrinsics prior", index)?;
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
