//! A change of the focal length in a video.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::FrameId;

/// A change of the focal length between two frames: a zoom, a switch of lenses, a crop by an editor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FocalChange {
    /// Last frame before the change.
    pub first: FrameId,
    /// First frame after it.
    pub last: FrameId,
    /// Focal length after the change over that before it.
    pub factor: f64,
}

impl fmt::Display for FocalChange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { first, last, factor } = self;
        write!(f, "focal length changes by a factor of {factor:.2} in frames {}–{}", first.0, last.0)
    }
}
