//! Multi-object tracking of masks: which detection is which object.
//!
//! Input are boxes of a detector, of motion, or of both, and a [`BoxSegmenter`] that is asked for their masks in some
//! frames. A segmentation network is a detector and a box segmenter that knows the answer
//! ([`KnownMasks`](crate::networks::KnownMasks)). For every frame, after Bullinger et al., *Instance Flow Based Online
//! Multiple Object Tracking*, 2017:
//!
//! - *Prediction* (`propagation.rs`): optical flow carries the mask of an object to the next frame. Pixels of occluders
//!   are taken out of it (`occlusion.rs`); the outline of the whole object is carried, too, and its mask requested
//!   until all of it is visible again.
//! - *Boxes* of one frame that mean one object are joined (`box_groups.rs`). A box of motion that covers several
//!   objects counts for each. Boxes without a track wait, moved by flow, until masks are requested.
//! - *Segmentation* (`prompting.rs`): the mask of every box is requested, and of every carried mask that no box
//!   repeats: a track lives on where the detector is blind.
//! - *Association* (`boxes.rs`, `assignment.rs`): masks and boxes meet the tracks by overlap (Hungarian algorithm),
//!   tracks of a part of a vehicle by the motion of the rest, lost ones by place and appearance.
//! - *Update* (`choice.rs`, `track.rs`): of the new masks and the carried one an object gets the one that fits its
//!   size, colours, place and box best. No two objects get the same. A mask may fail twice in a row; then the object
//!   is lost once its mask is older than `MAX_CARRIED` frames. A new mask is carried back to the
//!   frames that are nearer to it than to the last one (`retrace.rs`): [`Tracker::take_corrections`].
//! - *Confirmation*: the third box gives an id, whenever it comes, if the object was never lost. Every mask is reported
//!   at once under a provisional id; [`Tracker::finish`] relates them to objects.
//! - *Loss and re-identification*: a lost object is not reported, and its place moves on with the background's flow
//!   plus its own velocity. For a moment ([`Gap`]) it is found again by place and colours. Later, an object that
//!   appears there is new and remembers its [`Predecessor`]; [`merging`] decides by more evidence.
//!
//! Objects that were found late are followed back in time when all frames are through ([`BackwardTracker`]);
//! [`support`] says which objects are vehicles enough for a trajectory.
//!
//! The tracker is a plain function of its inputs: fed again with the detections that a killed run left behind, it gives
//! the same ids.

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
    /// Who looked for them.
    pub by: BoxSource,
    /// Whom to ask for the masks of boxes; `None` where masks are carried from earlier frames.
    pub prompter: Option<&'a mut dyn BoxSegmenter>,
}

/// A box that was found in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct DetectedBox {
    /// Detection, with its source.
    pub found: BoxDetection,
    /// True if its points show that it is stationary ([`shows_standing`](crate::motion::shows_standing)).
    pub stands: bool,
}

impl DetectedBox {
    /// The boxes of masks that a segmentation network found; empty masks have none.
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
    /// A box of which no points say anything.
    fn from(found: BoxDetection) -> Self {
        Self { found, stands: false }
    }
}

/// Boxes of a detector that started no track, since they show something that stands
/// ([`TrackerOptions::start_standing`]).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct IgnoredBoxes {
    /// Number of them, in the frames in which masks are segmented.
    pub num_boxes: usize,
    /// Maximum confidence of the detector, 0 to 1.
    pub max_confidence: f64,
}

/// Who looked for boxes in a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoxSource {
    /// The detector, and motion besides.
    Detector,
    /// Motion alone: the detector passed the frame over.
    Motion,
}

/// Evidence for a mask.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Evidence {
    /// A box of this frame agrees with the mask, which may be carried.
    Detected {
        /// The model's score, 0 to 1.
        confidence: f64,
    },
    /// A mask asked for in the place to which that of an earlier frame was carried; no box of this frame shows it.
    Prompted {
        /// Mask quality by the segmenter's own estimate, 0 to 1.
        quality: f64,
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
    /// Evidence for the mask.
    pub evidence: Evidence,
}

/// An object that has a lasting id, while it is followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConfirmedObject<'a> {
    /// Lasting id.
    pub id: ObjectId,
    /// The id under which [`Tracker::advance`] reports its masks.
    pub provisional: ObjectId,
    /// The class that its detections name most so far.
    pub class: &'a str,
    /// Mean confidence of its detections, 0 to 1.
    pub confidence: f64,
    /// The object that was lost where this one came up, if it may be the same.
    pub after: Option<Predecessor>,
}

/// Summary of an object over all frames.
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
    /// The last frame in which it was detected, or in which its mask was renewed or not yet due. Masks carried beyond
    /// it are guesses without confirmation: drop them.
    pub last: FrameId,
    /// Frames between `first` and `last` with a carried mask.
    pub num_carried: usize,
    /// Sources of its detections.
    pub found: DetectionCounts,
    /// Frames of its life that somebody looked at.
    pub num_looks: usize,
    /// Those at which the detector looked.
    pub num_detector_looks: usize,
    /// Mean confidence of the detector's boxes, 0 to 1; 0 if there is none.
    pub class_confidence: f64,
    /// Mean quality of the requested masks, 0 to 1 (1 for [`KnownMasks`](crate::networks::KnownMasks)).
    pub mask_quality: Option<f64>,
    /// Quality of its outlines.
    pub outline: Outline,
    /// Where it was lost for a moment and found again, ascending.
    pub gaps: Vec<Gap>,
    /// The object that was lost for longer where this one came up, if it may be the same.
    pub after: Option<Predecessor>,
}

/// Track that an object may continue.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Predecessor {
    /// Provisional id of the one that was lost.
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
    /// A track starts with a detection of at least this confidence; weaker ones only continue tracks.
    #[schemars(extend("unit" = "score, 0 to 1"))]
    pub start_confidence: f64,
    /// The same for what stands by the points in its box. What is named less surely gets no trajectory if it goes on
    /// standing, and a mask for nothing; when it drives off, motion finds it, and it is followed back from there.
    #[schemars(extend("unit" = "score, 0 to 1"))]
    pub start_standing: f64,
    /// A track starts with what only moves if motion is at least so sure of it: trees, poles and reflections move, too.
    #[schemars(extend("unit" = "0 to 1"))]
    pub start_motion: f64,
    /// Overlap (intersection over union) that a detection must have with the carried mask of its object.
    #[schemars(extend("unit" = "share"))]
    pub min_overlap: f64,
    /// Detections that give an object its lasting id.
    #[schemars(extend("unit" = "detections"))]
    pub min_detections: usize,
    /// Seconds for which the mask of what stands serves before a new one is asked for; at 0 it is asked for as often as
    /// those of all others.
    pub max_rest_secs: f64,
}

/// Detections with fewer pixels are skipped.
const MIN_AREA_PX2: usize = 40;
/// Similarity of colours (Bhattacharyya coefficient) that two views of one object have at least.
const MIN_SIMILARITY: f64 = 0.6;
/// Similarity of colours from which they count as evidence.
const SURE_SIMILARITY: f64 = 0.8;

/// Vehicles, in the words of COCO, Cityscapes and the common drone data sets.
const VEHICLES: &str = "car truck bus van motorcycle motor motorbike trailer caravan vehicle tricycle awning-tricycle";

impl Default for TrackerOptions {
    fn default() -> Self {
        Self {
            track_classes: VEHICLES.split(' ').map(str::to_owned).collect(),
            start_confidence: 0.35,
            start_standing: support::SURE_OF_STANDING,
            start_motion: 0.85,
            min_overlap: 0.2,
            min_detections: 3,
            max_rest_secs: 1.0,
        }
    }
}

impl TrackerOptions {
    /// Refuses values that make no sense.
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
