//! Verdicts on trajectories, with their reasons.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Trust in a trajectory, the best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Trust {
    /// Everything that is known agrees with it, and its deviation is small.
    Good,
    /// Nothing speaks against it that counts; its deviation is larger, or something small is odd.
    Fair,
    /// Something speaks against it.
    Doubtful,
    /// It cannot be right, or its scale is undetermined. `not-to-be-trusted` before version 3 of
    /// `trajectories.json`.
    #[serde(alias = "not-to-be-trusted")]
    Rejected,
}

with_names!(Trust { Good = "good", Fair = "fair", Doubtful = "doubtful", Rejected = "rejected" });

/// Subject of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ReasonKind {
    /// Determinacy of the scale ratio by the motion.
    Determined,
    /// The standard deviation of the scale ratio.
    Deviation,
    /// Constancy of the video's focal length.
    FocalLength,
    /// Number of the object's points, and of frames in which it has a position.
    Amount,
    /// Its size in the picture.
    Pixels,
    /// Source and confidence of its detections.
    Detection,
    /// Motion, by its own points and by its trajectory.
    Movement,
    /// Contact with the ground, and its constancy.
    Ground,
    /// Proportions, compared with those of vehicles.
    Shape,
    /// Its size next to that of the other vehicles.
    Size,
    /// Its speed, measured with its own size.
    Speed,
    /// Drivability of its trajectory.
    Path,
}

/// Outcome of one check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Finding {
    /// It speaks for the trajectory.
    Supports,
    /// It speaks against it.
    Doubts,
    /// It rules it out.
    Refutes,
}

/// One thing that speaks for or against a trajectory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Reason {
    /// Subject.
    pub kind: ReasonKind,
    /// Outcome.
    pub finding: Finding,
    /// Observation in words, with its figure.
    pub says: String,
    /// Weight, 0 to 1: doubts that sum to 1 make a trajectory doubtful; one that refutes weighs 1. Support weighs
    /// nothing: it cancels no doubt.
    pub weight: f64,
}

impl Reason {
    /// Something that speaks for the trajectory.
    pub fn supports(kind: ReasonKind, says: impl Into<String>) -> Self {
        Self { kind, finding: Finding::Supports, says: says.into(), weight: 0.0 }
    }

    /// Something that speaks against it and counts `weight`.
    pub fn doubts(kind: ReasonKind, weight: f64, says: impl Into<String>) -> Self {
        Self { kind, finding: Finding::Doubts, says: says.into(), weight }
    }

    /// Something that rules it out.
    pub fn refutes(kind: ReasonKind, says: impl Into<String>) -> Self {
        Self { kind, finding: Finding::Refutes, says: says.into(), weight: 1.0 }
    }
}

/// Verdict on a trajectory, with its reasons.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Verdict {
    /// Trust that follows from all reasons.
    pub state: Trust,
    /// Reasons: refuting ones, then doubts by falling weight, then support.
    pub reasons: Vec<Reason>,
}

impl Verdict {
    /// Reasons against the trajectory, by falling weight.
    pub fn against(&self) -> impl Iterator<Item = &Reason> {
        self.reasons.iter().filter(|reason| reason.finding != Finding::Supports)
    }

    /// Evidence against the trajectory, the gravest first, without a moderate standard deviation of the scale: that is
    /// an uncertainty, and no complaint.
    pub fn complaints(&self) -> impl Iterator<Item = &Reason> {
        self.against().filter(|reason| reason.kind != ReasonKind::Deviation || reason.weight >= 1.0)
    }

    /// Returns true if a reason rules the trajectory out.
    pub fn is_refuted(&self) -> bool {
        self.state == Trust::Rejected
    }
}
