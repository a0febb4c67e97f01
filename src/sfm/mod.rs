//! Structure from motion: cameras and points of the background, and of each object, from what is seen of them.
//!
//! [`features`](crate::features) makes tracks of image points, [`mapper`](crate::mapper) reconstructs cameras and
//! points from them. Both serve background and objects alike; only their [`Options`] differ. [`reconstruct_pictures`]
//! runs both:
//!
//! ```no_run
//! use tractrix::camera::Camera;
//! use tractrix::mapper::Intrinsics;
//! use tractrix::sfm;
//! use tractrix::video::{self, Source};
//!
//! let source = Source::open("photos".as_ref(), &video::Options::default())?;
//! let camera = Camera::prior_of_photograph(source.info().width, source.info().height);
//! let pictures = source.frames()?.filter_map(Result::ok).map(|(frame, picture)| (frame, picture, None));
//! let options = sfm::Options::unordered();
//! let (model, report) = sfm::reconstruct_pictures(pictures, camera, Intrinsics::GUESSED, &options, 0)?;
//! println!("{} pictures, {} points", report.num_registered(), model.points.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod error;
mod pictures;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use error::SfmError;
pub use pictures::reconstruct_pictures;

use crate::checks::{Checked, under};
use crate::features::sift_front_end::{Pairing, SiftOptions};
use crate::features::{FrontEndKind, FrontEndOptions, Target};

/// Options of the reconstruction of one target.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// From frames to tracks. `features`, where it is not `auto`, goes before the kind, and frames in no order are
    /// worked on by `sift` with pairs of any distance in time: with the options that are set here if that is the kind,
    /// else with the defaults of an object, and for the background with 5000 features of a contrast from 0.02 on and
    /// tracks from two views.
    pub front_end: FrontEndOptions,
    /// From tracks to a map.
    pub mapper: crate::mapper::Options,
}

impl Options {
    /// For a target in a video.
    pub fn of(target: Target) -> Self {
        match target {
            Target::Background => Self::background(),
            Target::Object => Self::object(),
        }
    }

    /// For the background of a video.
    pub fn background() -> Self {
        Self { front_end: FrontEndOptions::of(Target::Background), mapper: crate::mapper::Options::background() }
    }

    /// For one object of a video.
    pub fn object() -> Self {
        Self { front_end: FrontEndOptions::of(Target::Object), mapper: crate::mapper::Options::object() }
    }

    /// For photographs in no order.
    pub fn unordered() -> Self {
        Self::background().without_order(Target::Background)
    }

    /// The same for pictures in no order: SIFT, pairs by similarity, and no neighbours in time.
    pub fn without_order(self, target: Target) -> Self {
        let mut front_end = self.front_end;
        front_end.sift = match (front_end.kind, target) {
            (FrontEndKind::Sift, _) => front_end.sift,
            (FrontEndKind::Video, Target::Object) => SiftOptions::object(),
            (FrontEndKind::Video, Target::Background) => SiftOptions::unordered(),
        };
        front_end.kind = FrontEndKind::Sift;
        if let Pairing::Sequential { .. } = front_end.sift.pairing {
            front_end.sift.pairing = Pairing::UNORDERED;
        }
        Self { front_end, mapper: crate::mapper::Options { ordered: false, ..self.mapper } }
    }

    /// Rejects what cannot be worked with.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        under("front_end", self.front_end.check())?;
        under("mapper", self.mapper.check())
    }
}
