//! Prior knowledge of the intrinsics of each camera.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::camera::{Camera, NUM_INTRINSICS};
use crate::checks::{Checked, within};

/// Prior standard deviations of intrinsics about their initial values: zero holds a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Intrinsics {
    /// Standard deviation of the focal length, as a share of it.
    #[schemars(extend("unit" = "share"))]
    pub focal: f64,
    /// Standard deviation of each coordinate of the principal point, as a share of the longer side of the image.
    #[schemars(extend("unit" = "share"))]
    pub principal: f64,
    /// Standard deviation of the radial distortion coefficients k1 and k2.
    #[schemars(extend("unit" = "coefficient"))]
    pub distortion: f64,
}

impl Intrinsics {
    /// All parameters fixed.
    pub const FIXED: Self = Self { focal: 0.0, principal: 0.0, distortion: 0.0 };

    /// Prior of a calibration.
    ///
    /// Calibrations of the same lens differ by some tenths of a percent with temperature, focus and the choice of
    /// views, and by a percent and more if the video mode crops or stabilizes. Distortion is often given as zero where
    /// the lens has some. A narrower prior bends the trajectory under weak motion instead: see
    /// docs/benchmarks/intrinsics.md.
    pub const GIVEN: Self = Self { focal: 0.01, principal: 0.01, distortion: 0.1 };

    /// Prior of the focal length of an EXIF block.
    ///
    /// It is rounded to a millimeter of 24 and more. It is that of the lens and not of the image where the camera crops
    /// a margin (rectification, stabilization: up to a tenth). It is relative to the width of the image or to its
    /// diagonal. Together this is 8 %.
    pub const STATED: Self = Self { focal: 0.08, ..Self::GUESSED };

    /// Prior of the focal length of a drone's log.
    ///
    /// As [`Self::STATED`], and many video modes show less than the whole width of the sensor (stabilization, high
    /// frame rates): together 12 %.
    pub const LOGGED: Self = Self { focal: 0.12, ..Self::GUESSED };

    /// Prior of a guess.
    ///
    /// Cameras in practice are within two standard deviations of 0.4 of ln f: from 0.34 to 1.67 longer sides for videos
    /// ([`Camera::prior`](crate::camera::Camera::prior)), from 0.45 to 2.2 for photographs
    /// ([`Camera::prior_of_photograph`](crate::camera::Camera::prior_of_photograph)). The principal point is near the
    /// center as lenses are built, within a hundredth of the image. It moves freely where views rotate and spread. It
    /// stays on a single flight looking straight down, where it could absorb common errors.
    pub const GUESSED: Self = Self { focal: 0.4, principal: 0.01, distortion: 0.2 };

    /// Returns true if no parameter may change.
    pub fn is_fixed(&self) -> bool {
        *self == Self::FIXED
    }

    /// Returns for each of fx, fy, cx, cy, k1, k2 whether it may change.
    pub(super) fn may_change(&self) -> [bool; NUM_INTRINSICS] {
        let [focal, principal, distortion] = [self.focal, self.principal, self.distortion].map(|std| std > 0.0);
        [focal, focal, principal, principal, distortion, distortion]
    }

    /// Standard deviations of fx, fy, cx, cy, k1, k2 of a camera.
    pub fn std_of(&self, camera: &Camera) -> [f64; NUM_INTRINSICS] {
        let [fx, fy] = camera.focal.map(|focal| self.focal * focal);
        let principal = self.principal * f64::from(camera.width.max(camera.height));
        [fx, fy, principal, principal, self.distortion, self.distortion]
    }

    /// Rejects standard deviations that are negative or beyond any lens.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("focal", self.focal, 0.0..=1.0)?;
        within("principal", self.principal, 0.0..=1.0)?;
        within("distortion", self.distortion, 0.0..=10.0)
    }
}

impl Default for Intrinsics {
    fn default() -> Self {
        Self::GIVEN
    }
}

/// Prior knowledge of the intrinsics of every camera; the last entry holds for all further cameras.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownIntrinsics(Vec<Intrinsics>);

impl From<Intrinsics> for KnownIntrinsics {
    fn from(all: Intrinsics) -> Self {
        Self(vec![all])
    }
}

impl From<Vec<Intrinsics>> for KnownIntrinsics {
    fn from(each: Vec<Intrinsics>) -> Self {
        Self(each)
    }
}

impl KnownIntrinsics {
    /// Prior knowledge of a camera.
    pub fn of(&self, camera: usize) -> Intrinsics {
        self.0.get(camera).or(self.0.last()).copied().unwrap_or(Intrinsics::GUESSED)
    }

    /// Prior knowledge of the less known of two cameras.
    pub(super) fn of_pair(&self, cameras: [usize; 2]) -> Intrinsics {
        let [first, second] = cameras.map(|camera| self.of(camera));
        if first.focal < second.focal { second } else { first }
    }
}
