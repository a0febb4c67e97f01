//! Structure from motion: cameras and points of the background, and of each object, from what is seen of them.
//!
//! A [`FrontEnd`] turns frames and masks into a [`TrackTable`]; [`reconstruct`] turns that into a reconstruction. Both
//! serve background and objects alike; only their [`Options`] differ. [`reconstruct_pictures`] does both in one call:
//!
//! ```no_run
//! use tractrix::camera::Camera;
//! use tractrix::sfm::{self, Intrinsics};
//! use tractrix::video::{self, Source};
//!
//! let source = Source::open("photos".as_ref(), &video::Options::default())?;
//! let camera = Camera::prior(source.info().width, source.info().height);
//! let pictures = source.frames()?.filter_map(Result::ok).map(|(frame, picture)| (frame, picture, None));
//! let options = sfm::Options::unordered();
//! let (model, report) = sfm::reconstruct_pictures(pictures, camera, Intrinsics::Refined, &options, 0)?;
//! println!("{} pictures, {} points", report.num_registered(), model.points.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod features;
pub mod mapper;
pub mod matching;
pub mod order;
pub mod patch;
pub mod refinement;
pub mod resection;
pub mod sift;
pub mod sift_front_end;
pub mod silhouette;
pub mod solvers;
pub mod tracks;
pub mod triangulation;
pub mod two_view;
pub mod video_front_end;

mod error;
mod front_end;
mod lucas_kanade;
mod pictures;

use serde::{Deserialize, Serialize};

pub use error::SfmError;
pub use front_end::{FrontEnd, FrontEndOptions};
pub use mapper::{Intrinsics, Report, cut_long_tracks, reconstruct, reconstruct_watched};
pub use pictures::reconstruct_pictures;
use sift_front_end::{Pairing, SiftOptions};
pub use tracks::TrackTable;
use video_front_end::VideoOptions;

/// How one target is reconstructed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// From frames to tracks.
    pub front_end: FrontEndOptions,
    /// From tracks to a map.
    pub mapper: mapper::Options,
}

impl Options {
    /// For the background of a video.
    pub fn background() -> Self {
        let front_end = FrontEndOptions::Video(VideoOptions::background());
        Self { front_end, mapper: mapper::Options::background() }
    }

    /// For one object of a video.
    pub fn object() -> Self {
        Self { front_end: FrontEndOptions::Video(VideoOptions::object()), mapper: mapper::Options::object() }
    }

    /// For photographs in no order.
    pub fn unordered() -> Self {
        Self::background().without_order(false)
    }

    /// The same by SIFT in every frame, matched between frames; SIFT options that are there already stay.
    pub fn with_sift(self, object: bool) -> Self {
        let default = || if object { SiftOptions::object() } else { SiftOptions::background() };
        let sift = match self.front_end {
            FrontEndOptions::Sift(sift) => sift,
            FrontEndOptions::Video(_) => default(),
        };
        Self { front_end: FrontEndOptions::Sift(sift), ..self }
    }

    /// The same by points followed from frame to frame; such options that are there already stay.
    pub fn with_video(self, object: bool) -> Self {
        let default = || if object { VideoOptions::object() } else { VideoOptions::background() };
        let video = match self.front_end {
            FrontEndOptions::Video(video) => video,
            FrontEndOptions::Sift(_) => default(),
        };
        Self { front_end: FrontEndOptions::Video(video), ..self }
    }

    /// The same for pictures in no order: SIFT, all pairs, and no neighbours in time.
    pub fn without_order(self, object: bool) -> Self {
        let front_end = match self.front_end {
            FrontEndOptions::Sift(sift) => FrontEndOptions::Sift(SiftOptions { pairing: Pairing::Exhaustive, ..sift }),
            FrontEndOptions::Video(_) if object => {
                FrontEndOptions::Sift(SiftOptions { pairing: Pairing::Exhaustive, ..SiftOptions::object() })
            }
            FrontEndOptions::Video(_) => FrontEndOptions::unordered(),
        };
        Self { front_end, mapper: mapper::Options { ordered: false, ..self.mapper } }
    }
}
