//! Prior knowledge of the intrinsics of each camera.

use serde::{Deserialize, Serialize};

/// Prior knowledge of intrinsics.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Intrinsics {
    /// Given, or found on the background: not touched.
    Fixed,
    /// The focal length that the pictures' files state, right to some percent: refined with the map, as is radial
    /// distortion.
    Stated,
    /// A guess that may be far off: focal length and radial distortion are refined with the map.
    Refined,
}

impl Intrinsics {
    /// Standard deviation of ln f about the guess.
    ///
    /// The focal length of an EXIF block is rounded to a millimetre of 24 and more, is that of the lens and not of the
    /// picture where the camera cuts off a margin (straightened distortion, stabilisation: up to a tenth), and may
    /// stand for the width of the picture or for its diagonal: together 8 %. Cameras that are met in practice lie
    /// within two deviations of 0.4 about the guess: from 0.34 to 1.67 longer sides for videos
    /// ([`Camera::prior`](crate::camera::Camera::prior)), from 0.45 to 2.2 for photographs
    /// ([`Camera::prior_of_photograph`](crate::camera::Camera::prior_of_photograph)).
    pub(super) fn guess_deviation(self) -> f64 {
        match self {
            Self::Fixed => 0.0,
            Self::Stated => 0.08,
            Self::Refined => 0.4,
        }
    }
}

/// The same of every camera of a table of tracks.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum KnownIntrinsics {
    /// Alike of all.
    OfAll(Intrinsics),
    /// By camera; nothing is known of those beyond the last.
    OfEach(Vec<Intrinsics>),
}

impl From<Intrinsics> for KnownIntrinsics {
    fn from(all: Intrinsics) -> Self {
        Self::OfAll(all)
    }
}

impl From<Vec<Intrinsics>> for KnownIntrinsics {
    fn from(each: Vec<Intrinsics>) -> Self {
        Self::OfEach(each)
    }
}

impl KnownIntrinsics {
    /// Prior knowledge of a camera.
    pub fn of(&self, camera: usize) -> Intrinsics {
        match self {
            Self::OfAll(known) => *known,
            Self::OfEach(each) => each.get(camera).copied().unwrap_or(Intrinsics::Refined),
        }
    }

    /// Prior knowledge of the less known of two cameras.
    pub(super) fn of_pair(&self, cameras: [usize; 2]) -> Intrinsics {
        let [first, second] = cameras.map(|camera| self.of(camera));
        if first.guess_deviation() < second.guess_deviation() { second } else { first }
    }
}
