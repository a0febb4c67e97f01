//! Image features and their tracks: from frames and masks to a [`TrackTable`].
//!
//! A [`FrontEnd`] follows points from frame to frame (`video_front_end`) or matches SIFT features between images
//! (`sift_front_end`). The [`mapper`](crate::mapper) reconstructs cameras and points from the tracks.

mod error;
mod front_end;
pub mod large_frames;
pub mod lines;
pub mod matching;
pub mod order;
pub mod patch;
pub mod refinement;
mod retrieval;
pub mod rootsift;
pub mod sift;
pub mod sift_front_end;
pub mod tracks;
pub mod video_front_end;

pub use error::FeatureError;
pub use front_end::{FrontEnd, FrontEndKind, FrontEndOptions};
pub use tracks::TrackTable;

/// Target of a reconstruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// The static background: most of the image, with many points.
    Background,
    /// One vehicle: a small part of the image, with few points.
    Object,
}
