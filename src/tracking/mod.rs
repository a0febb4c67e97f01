//! Multi-object tracking by masks: association of detections with objects.
//!
//! Inputs are boxes of a detector, of motion detection, or of both, and a [`BoxSegmenter`] that is prompted for their
//! masks in some frames. An instance segmentation network serves as detector and, by its
//! [`KnownMasks`](crate::networks::KnownMasks), as box segmenter. Each frame is processed after Bullinger et al.,
//! *Instance Flow Based Online Multiple Object Tracking*, 2017:
//!
//! - *Prediction* (`propagation.rs`): optical flow propagates the mask of an object to the next frame. Pixels of
//!   occluders are removed from it (`occlusion.rs`). The outline of the whole object is propagated as well, and
//!   prompted until all of it is visible again.
//! - *Box grouping* (`box_groups.rs`): boxes of one frame that show one object are merged. A motion box that covers
//!   several objects counts for each. Boxes without a track are pending: flow moves them until the next frame with
//!   segmentation.
//! - *Segmentation* (`prompting.rs`): the segmenter is prompted with boxes, and with the boxes of propagated masks that
//!   no other box repeats. Tracks thus survive where the detector fails.
//! - *Association* (`boxes.rs`, `assignment.rs`): masks and boxes are assigned to tracks by overlap (Hungarian
//!   algorithm), to a track of a part of a vehicle by the motion of the rest, to lost tracks by position and
//!   appearance.
//! - *Update* (`choice.rs`, `track.rs`): a track takes the mask, new or propagated, that agrees best with its size,
//!   colors, position and box. No two tracks take the same mask. An object is lost after more than `MAX_FAILED_PROMPTS`
//!   consecutive failed prompts, once its mask has been propagated for `MAX_PROPAGATED_FRAMES` frames. A new mask is
//!   propagated back to the frames that are nearer to it than to the last one (`retrace.rs`):
//!   [`Tracker::take_corrections`].
//! - *Confirmation*: an object gets an id with its third box, at any time, unless it was lost before. Every mask is
//!   reported at once under a provisional id; [`Tracker::finish`] maps provisional ids to objects.
//! - *Loss and re-identification*: a lost object is not reported, and its predicted position moves with the
//!   background's flow plus its own velocity. After a brief loss ([`Gap`]) it is re-detected by position and colors. An
//!   object that appears there later is a new one with a [`Predecessor`]; [`merging`] decides by more evidence.
//!
//! After the last frame, objects are tracked backward from their first masks ([`BackwardTracker`]). [`support`] decides
//! which objects have enough evidence of being vehicles for a trajectory.
//!
//! The tracker is a pure function of its inputs: with the detections of an interrupted run it gives the same ids.

mod affine;
mod appearance;
mod assignment;
mod backward;
mod box_groups;
#[cfg(test)]
mod box_tests;
mod boxes;
mod choice;
pub mod merging;
mod occlusion;
mod prompting;
mod propagation;
mod region;
mod retrace;
mod support;
#[cfg(test)]
mod tests;
mod track;
mod track_statistics;
mod tracker;
#[cfg(test)]
mod world;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use self::backward::BackwardTracker;
pub use self::retrace::Correction;
pub use self::support::{MaskEvidence, Unsupported, support};
pub use self::tracker::Tracker;
use crate::checks::{Checked, some_of, within};
use crate::networks::BoxSegmenter;
use crate::scene::{
    BoxDetection, Detection, DetectionCounts, DetectionSource, FrameId, Gap, IdentityEvidence, Mask, ObjectId, Outline,
};

/// Input of the tracker for one frame.
pub struct FrameInput<'a> {
    /// Boxes of a detector, of motion, or of both; may be empty.
    pub found: Vec<DetectedBox>,
    /// Sources of boxes that ran on the frame.
    pub by: BoxSource,
    /// Segmenter to prompt for the masks of boxes; `None` where masks are only propagated.
    pub segmenter: Option<&'a mut dyn BoxSegmenter>,
}

/// Box detected in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct DetectedBox {
    /// Detection, with its source.
    pub found: BoxDetection,
    /// True if its points show that it is stationary ([`shows_stationary`](crate::motion::shows_stationary)).
    pub is_stationary: bool,
}

impl DetectedBox {
    /// Bounding boxes of the masks of a segmentation network; empty masks are skipped.
    pub fn of_masks(detections: &[Detection]) -> Vec<Self> {
        let of_mask = |found: &Detection| {
            let rect = found.mask.bounding_box()?.into();
            let (class, confidence, finder) = (found.class.clone(), found.confidence, DetectionSource::Detector);
            Some(BoxDetection { class, confidence, rect, finder }.into())
        };
        detections.iter().filter_map(of_mask).collect()
    }
}

impl From<BoxDetection> for DetectedBox {
    /// Box without evidence from points: not stationary.
    fn from(found: BoxDetection) -> Self {
        Self { found, is_stationary: false }
    }
}

/// Detector boxes that start no track: stationary, with too low a confidence ([`TrackerOptions::start_standing`]).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IgnoredBoxes {
    /// Number of such boxes in frames with segmentation.
    pub num_boxes: usize,
    /// Maximum confidence of the detector, 0 to 1.
    pub max_confidence: f64,
}

/// Sources of boxes that ran on a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoxSource {
    /// Detector and motion detection.
    Detector,
    /// Motion detection only.
    Motion,
}

/// Evidence for a mask.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Evidence {
    /// A box of this frame matches the mask, which is new or propagated.
    Detected {
        /// The model's score, 0 to 1.
        confidence: f64,
    },
    /// New mask, prompted at the position of the propagated one; no box of this frame shows the object.
    Prompted {
        /// Mask quality by the segmenter's own estimate, 0 to 1.
        quality: f64,
    },
    /// Mask of an earlier frame, propagated by optical flow.
    Carried,
}

/// Mask of an object in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackedMask {
    /// Provisional id; [`TrackSummary::provisional`] maps it to the final one.
    pub object: ObjectId,
    /// Its pixels; the masks of one frame do not overlap.
    pub mask: Mask,
    /// Evidence for the mask.
    pub evidence: Evidence,
}

/// Confirmed object that is still tracked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConfirmedObject<'a> {
    /// Final id.
    pub id: ObjectId,
    /// Id under which [`Tracker::advance`] reports its masks.
    pub provisional: ObjectId,
    /// Class with the most votes of its detections so far.
    pub class: &'a str,
    /// Mean confidence of its detections, 0 to 1.
    pub confidence: f64,
    /// Object that was lost where this one appeared, if both may be the same.
    pub after: Option<Predecessor>,
}

/// Summary of an object over all frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrackSummary {
    /// Final id: dense from 1 in the order of confirmation.
    pub id: ObjectId,
    /// Id under which [`Tracker::advance`] reported its masks.
    pub provisional: ObjectId,
    /// Class with the most votes of its detections, weighted by their confidence.
    pub class: String,
    /// Mean confidence of its detections.
    pub confidence: f64,
    /// First frame with a mask.
    pub first: FrameId,
    /// Last frame with a new mask, or with one propagated from it before a prompt failed. Masks propagated beyond it
    /// are unconfirmed: drop them.
    pub last: FrameId,
    /// Number of frames between `first` and `last` with a propagated mask.
    pub num_carried: usize,
    /// Number of its detections by source.
    pub found: DetectionCounts,
    /// Number of frames of its life that were searched for objects.
    pub num_looks: usize,
    /// Number of those in which the detector ran.
    pub num_detector_looks: usize,
    /// Mean confidence of the detector's boxes, 0 to 1; 0 if there is none.
    pub class_confidence: f64,
    /// Mean quality of the prompted masks, 0 to 1 (1 for [`KnownMasks`](crate::networks::KnownMasks)).
    pub mask_quality: Option<f64>,
    /// Quality of its outlines.
    pub outline: Outline,
    /// Brief losses that ended with a re-detection, ascending.
    pub gaps: Vec<Gap>,
    /// Object that was lost for longer where this one appeared, if both may be the same.
    pub after: Option<Predecessor>,
}

/// Track that an object may continue.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Predecessor {
    /// Provisional id of the lost object.
    pub provisional: ObjectId,
    /// Evidence that both are one object, from the images alone.
    pub evidence: IdentityEvidence,
}

/// Options of the tracker.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TrackerOptions {
    /// Classes that are tracked; other detections are only kept out of the background.
    pub track_classes: Vec<String>,
    /// Minimum confidence of a detection that starts a track; weaker ones only continue tracks.
    #[schemars(extend("unit" = "score, 0 to 1"))]
    pub start_confidence: f64,
    /// The same for an object that is stationary by the points in its box. A less certain one gets no trajectory while
    /// it stays stationary, so its masks are not needed. When it drives off, motion detection finds it, and it is
    /// tracked backward.
    #[schemars(extend("unit" = "score, 0 to 1"))]
    pub start_standing: f64,
    /// Minimum confidence of motion detection to start a track without a detector: trees, poles and reflections move,
    /// too.
    #[schemars(extend("unit" = "0 to 1"))]
    pub start_motion: f64,
    /// Minimum overlap (intersection over union) of a detection with the propagated mask of its object.
    #[schemars(extend("unit" = "share"))]
    pub min_overlap: f64,
    /// Number of detections that confirm an object.
    #[schemars(extend("unit" = "detections"))]
    pub min_detections: usize,
    /// Maximum time for which the mask of a stationary object is reused, seconds; at 0 such objects are prompted as
    /// often as all others.
    pub max_rest_secs: f64,
}

/// Minimum number of pixels of a mask; smaller ones are skipped.
const MIN_AREA_PX2: usize = 40;
/// Minimum similarity of colors (Bhattacharyya coefficient) of two views of one object.
const MIN_SIMILARITY: f64 = 0.6;
/// Similarity of colors from which they are evidence of identity.
const SURE_SIMILARITY: f64 = 0.8;

/// Vehicle classes of COCO, Cityscapes and the common drone data sets.
const VEHICLES: &str = "car truck bus van motorcycle motor motorbike trailer caravan vehicle tricycle awning-tricycle";

impl Default for TrackerOptions {
    fn default() -> Self {
        Self {
            track_classes: VEHICLES.split(' ').map(str::to_owned).collect(),
            start_confidence: 0.35,
            start_standing: support::MIN_STATIONARY_CONFIDENCE,
            start_motion: 0.85,
            min_overlap: 0.2,
            min_detections: 3,
            max_rest_secs: 1.0,
        }
    }
}

impl TrackerOptions {
    /// Rejects values out of range.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        some_of("track_classes", &self.track_classes)?;
        within("start_confidence", self.start_confidence, 0.0..=1.0)?;
        within("start_standing", self.start_standing, 0.0..=1.0)?;
        within("start_motion", self.start_motion, 0.0..=1.0)?;
        within("min_overlap", self.min_overlap, 0.0..=1.0)?;
        within("min_detections", self.min_detections, 1..=1_000_000)?;
        within("max_rest_secs", self.max_rest_secs, 0.0..=1e9)
    }
}
