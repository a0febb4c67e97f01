//! Tracked objects, with their properties before any reconstruction.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{FrameId, ObjectId};

/// Number of frames of an object by the source of its mask.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct DetectionCounts {
    /// Frames in which its mask was given.
    pub given: usize,
    /// Frames with a detection by the detector alone, or by a segmentation network.
    pub detector: usize,
    /// Frames with a detection by motion alone.
    pub motion: usize,
    /// Frames with detections by both.
    pub both: usize,
    /// Frames without a detection, in which the mask network was prompted at its predicted position.
    pub prompted: usize,
    /// Frames in which its mask was propagated by optical flow.
    pub carried: usize,
}

impl DetectionCounts {
    /// Frames with a detection by the detector or a segmentation network.
    pub fn by_detector(&self) -> usize {
        self.detector + self.both
    }

    /// Frames with a detection by any source.
    pub fn detected(&self) -> usize {
        self.by_detector() + self.motion
    }

    /// Sums of both counts.
    pub fn plus(&self, other: &Self) -> Self {
        Self {
            given: self.given + other.given,
            detector: self.detector + other.detector,
            motion: self.motion + other.motion,
            both: self.both + other.both,
            prompted: self.prompted + other.prompted,
            carried: self.carried + other.carried,
        }
    }

    /// Frames with a detection by motion.
    pub fn by_motion(&self) -> usize {
        self.motion + self.both
    }
}

impl fmt::Display for DetectionCounts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [
            ("given", self.given),
            ("detector and motion", self.both),
            ("detector only", self.detector),
            ("motion only", self.motion),
            ("box prompt at the predicted position", self.prompted),
            ("propagated by optical flow", self.carried),
        ];
        let texts = parts.iter().filter(|(_, frames)| *frames > 0);
        let texts: Vec<String> = texts.map(|(what, frames)| format!("{what} {frames}")).collect();
        if texts.is_empty() { f.write_str("nothing") } else { f.write_str(&texts.join(", ")) }
    }
}

/// Source of the outlines of an object's masks, the best first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Outline {
    /// Given by the user.
    Given,
    /// By a network.
    #[default]
    Network,
    /// By colors inside a box: sufficient to locate the object, not for its outline.
    Coarse,
}

/// Motion state of an object relative to the background while it was visible.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Movement {
    /// Moving, at least for a part of the time.
    Moving,
    /// Stationary all the time.
    #[serde(rename = "standing", alias = "stationary")]
    Stationary,
    /// The observations do not decide.
    Undetermined,
}

with_names!(Movement { Moving = "moving", Stationary = "stationary", Undetermined = "undetermined" });

/// Motion state of an object, with the reason.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct MovementFinding {
    /// Motion state.
    pub state: Movement,
    /// Reason, in words.
    pub reason: String,
}

/// Evidence that two detections show one object. `None` marks evidence that is not available.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct IdentityEvidence {
    /// Distance of the second from its position predicted by the first, as a share of the tolerance: 0 to 1.
    pub place: Option<f64>,
    /// Similarity of their colors (Bhattacharyya coefficient), 0 to 1.
    pub colours: Option<f64>,
    /// Ratio of areas, second to first, corrected for the distance to the camera.
    pub size: Option<f64>,
    /// Points matched between both at consistent positions on the object.
    pub num_points: Option<usize>,
    /// Matches by appearance, of which `num_points` are a part.
    pub num_matches: Option<usize>,
}

impl fmt::Display for IdentityEvidence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [
            self.place
                .map(|place| format!("{:.0} % of the tolerated distance from the predicted position", 100.0 * place)),
            self.colours.map(|colours| format!("color similarity {:.0} %", 100.0 * colours)),
            self.size.map(|size| format!("{size:.2} times as large")),
            self.num_points.map(|points| format!("{points} points in common")),
            self.num_matches.map(|matches| format!("of {matches} matches")),
        ];
        let texts: Vec<String> = parts.into_iter().flatten().collect();
        if texts.is_empty() { f.write_str("nothing") } else { f.write_str(&texts.join(", ")) }
    }
}

/// Gap in an object's track, or the seam between two adjacent pieces of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Gap {
    /// The last frame before it.
    pub last: FrameId,
    /// The first frame after it.
    pub first: FrameId,
    /// Evidence that it is the same object afterwards.
    pub evidence: IdentityEvidence,
}

/// Object that might be identical with another one, but was not merged with it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct UnmergedTrack {
    /// The other object, which appears later.
    pub object: ObjectId,
    /// Evidence that both are one object.
    pub evidence: IdentityEvidence,
    /// Reason why they are not merged, in words.
    pub reason: String,
}

/// Object tracked through the frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrackedObject {
    /// Its id, from 1.
    pub id: ObjectId,
    /// Its class name; `vehicle` if unknown.
    pub class: String,
    /// Mean score of its detections, 0 to 1; 1 for given masks.
    pub confidence: f64,
    /// Sources of its detections.
    pub found_in: DetectionCounts,
    /// Source of its outline.
    pub outline: Outline,
    /// Mask quality by the mask network's own estimate: the expected intersection over union with the truth, 0 to 1.
    /// `None` if unknown.
    pub mask_quality: Option<f64>,
    /// Motion state.
    pub movement: MovementFinding,
    /// Reason why it is not reconstructed, where that is decided already: neither class nor motion supports it.
    pub left_out: Option<String>,
    /// Frames in which it has a mask, ascending.
    pub frames: Vec<FrameId>,
    /// Gaps between loss and re-detection, ascending.
    #[serde(default)]
    pub gaps: Vec<Gap>,
    /// Later objects that might be identical with this one.
    #[serde(default)]
    pub apart: Vec<UnmergedTrack>,
}

impl TrackedObject {
    /// Returns true if it has a mask in a frame.
    pub fn is_visible_in(&self, frame: FrameId) -> bool {
        self.frames.binary_search(&frame).is_ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn detection_counts_are_displayed() {
        let found = DetectionCounts { both: 12, motion: 3, carried: 40, ..DetectionCounts::default() };
        assert_eq!(found.to_string(), "detector and motion 12, motion only 3, propagated by optical flow 40");
        assert_eq!((found.by_detector(), found.by_motion()), (12, 15));
        assert_eq!(DetectionCounts::default().to_string(), "nothing");
    }

    #[test]
    fn identity_evidence_is_displayed() {
        let evidence = IdentityEvidence { place: Some(0.25), num_points: Some(17), ..IdentityEvidence::default() };
        assert_eq!(
            evidence.to_string(),
            "25 % of the tolerated distance from the predicted position, 17 points in common"
        );
        assert_eq!(IdentityEvidence::default().to_string(), "nothing");
    }
}
