//! Mask tracking: which detection is which object.
//!
//! After Bullinger et al., *Instance Flow Based Online Multiple Object Tracking*, 2017: the mask of an object in frame
//! t is carried to t + 1 by optical flow, and the carried masks are assigned to the new detections by mask overlap with
//! the Hungarian algorithm. Beyond that:
//!
//! - An object without a detection keeps its carried mask for some frames ([`Evidence::Carried`]), as long as enough of
//!   its pixels have a consistent flow and keep their colours: this bridges missed detections.
//! - After that it is lost: nothing is reported, its place moves on with the background's flow plus its own velocity,
//!   and it is found again by place and appearance.
//! - Lasting ids are given when an object was detected several times within a few frames, so that a false alarm gets
//!   none. Its masks from before are not lost: every mask is reported at once under a provisional id, and
//!   [`Tracker::finish`] says which provisional ids became which objects.
//!
//! The tracker is a plain function of its inputs: fed again with the detections that a killed run left behind, it gives
//! the same ids.

mod appearance;
mod assignment;
mod carry;
mod region;
#[cfg(test)]
mod tests;
mod track;
mod tracker;
#[cfg(test)]
mod world;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use self::tracker::Tracker;
use crate::limits::{Checked, ordered, some_of, within};
use crate::scene::{FrameId, Mask, ObjectId};

/// What a mask rests on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Evidence {
    /// A detection of this frame.
    Detected {
        /// The model's score, 0 to 1.
        confidence: f64,
    },
    /// The mask of an earlier frame, carried by optical flow.
    Carried,
}

/// Where an object is in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackedMask {
    /// Provisional id; [`TrackSummary::provisional`] joins it to the lasting one.
    pub object: ObjectId,
    /// Its pixels; the masks of one frame do not overlap.
    pub mask: Mask,
    /// What the mask rests on.
    pub evidence: Evidence,
}

/// What is known of an object when all frames are through.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrackSummary {
    /// Lasting id: dense from 1 in the order in which the objects were confirmed.
    pub id: ObjectId,
    /// The id under which [`Tracker::advance`] reported its masks.
    pub provisional: ObjectId,
    /// The class that its detections name most, weighed by their confidence.
    pub class: String,
    /// Mean confidence of its detections.
    pub confidence: f64,
    /// The first frame in which it was detected.
    pub first: FrameId,
    /// The last frame in which it was detected. Masks carried beyond it are guesses without confirmation: drop them.
    pub last: FrameId,
    /// Frames with a detection.
    pub num_detected: usize,
    /// Frames between `first` and `last` with a carried mask.
    pub num_carried: usize,
    /// Mean number of pixels of its detected masks.
    pub mean_area_px2: f64,
}

/// Options of the tracker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TrackerOptions {
    /// Names of the classes that are tracked; detections of others are passed over.
    pub track_classes: Vec<String>,
    /// A track starts with a detection of at least this confidence; weaker ones only continue tracks.
    #[schemars(extend("unit" = "score, 0 to 1"))]
    pub start_confidence: f64,
    /// Detections with fewer pixels are passed over.
    pub min_area_px2: usize,
    /// Overlap (intersection over union) that a detection must have with the carried mask of its object.
    #[schemars(extend("unit" = "share"))]
    pub min_overlap: f64,
    /// Of two detections of which one lies in the other by more than this share, only the surer one counts.
    #[schemars(extend("unit" = "share"))]
    pub duplicate_overlap: f64,
    /// Detections that give an object its lasting id, if they lie within `confirm_window` frames.
    #[schemars(extend("unit" = "detections"))]
    pub min_detections: usize,
    /// Frames within which `min_detections` detections must lie.
    #[schemars(extend("unit" = "frames"))]
    pub confirm_window: usize,
    /// Frames for which a mask is carried without a detection.
    #[schemars(extend("unit" = "frames"))]
    pub max_carried: usize,
    /// Share of a mask's pixels that must be carried by consistent flow for the carried mask to count.
    #[schemars(extend("unit" = "share"))]
    pub min_carried_share: f64,
    /// Seconds for which a lost object may be found again.
    pub max_lost_secs: f64,
    /// Similarity of colours (Bhattacharyya coefficient) that a lost object must have to be found again.
    #[schemars(extend("unit" = "0 to 1"))]
    pub min_similarity: f64,
}

/// Vehicles, in the words of COCO, Cityscapes and the common drone data sets.
const VEHICLES: [&str; 12] = [
    "car",
    "truck",
    "bus",
    "van",
    "motorcycle",
    "motor",
    "motorbike",
    "trailer",
    "caravan",
    "vehicle",
    "tricycle",
    "awning-tricycle",
];

impl Default for TrackerOptions {
    fn default() -> Self {
        Self {
            track_classes: VEHICLES.map(str::to_owned).to_vec(),
            start_confidence: 0.35,
            min_area_px2: 40,
            min_overlap: 0.2,
            duplicate_overlap: 0.7,
            min_detections: 3,
            confirm_window: 6,
            max_carried: 8,
            min_carried_share: 0.4,
            max_lost_secs: 3.0,
            min_similarity: 0.6,
        }
    }
}

impl TrackerOptions {
    /// Refuses values that make no sense.
    ///
    /// # Errors
    /// [`OptionError`](crate::limits::OptionError) names the option.
    pub fn check(&self) -> Checked {
        some_of("track_classes", &self.track_classes)?;
        within("start_confidence", self.start_confidence, 0.0..=1.0)?;
        within("min_overlap", self.min_overlap, 0.0..=1.0)?;
        within("duplicate_overlap", self.duplicate_overlap, 0.0..=1.0)?;
        within("min_detections", self.min_detections, 1..=1_000_000)?;
        ordered(("min_detections", self.min_detections), ("confirm_window", self.confirm_window))?;
        within("min_carried_share", self.min_carried_share, 0.0..=1.0)?;
        within("max_lost_secs", self.max_lost_secs, 0.0..=1e9)?;
        within("min_similarity", self.min_similarity, 0.0..=1.0)
    }
}
