//! Verdicts on trajectories, with their reasons.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Trust in a trajectory, the best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Trust {
    /// All evidence supports it, and its standard deviation is small.
    Good,
    /// No significant evidence against it, but a larger standard deviation or minor doubts.
    Fair,
    /// Evidence against it.
    Doubtful,
    /// It is refuted, or its scale is undetermined. `not-to-be-trusted` before version 3 of `trajectories.json`.
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
    /// Its size in the image.
    Pixels,
    /// Source and confidence of its detections.
    Detection,
    /// Motion, by its own points and by its trajectory.
    Movement,
    /// Contact with the ground, and its constancy.
    Ground,
    /// Proportions, compared with those of vehicles.
    Shape,
    /// Its size compared with that of the other vehicles.
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
    /// Evidence for the trajectory.
    Supports,
    /// Evidence against the trajectory.
    Doubts,
    /// Refutation of the trajectory.
    Refutes,
}

/// Evidence for or against a trajectory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Reason {
    /// Subject.
    pub kind: ReasonKind,
    /// Outcome.
    pub finding: Finding,
    /// Observation in words, with its figure.
    pub says: String,
    /// Weight, 0 to 1: doubts that sum to 1 make a trajectory doubtful; a refutation has weight 1. Support has weight
    /// 0, since it does not cancel doubts.
    pub weight: f64,
}

impl Reason {
    /// Evidence for the trajectory.
    pub fn supports(kind: ReasonKind, says: impl Into<String>) -> Self {
        Self { kind, finding: Finding::Supports, says: says.into(), weight: 0.0 }
    }

    /// Evidence against the trajectory, with its weight.
    pub fn doubts(kind: ReasonKind, weight: f64, says: impl Into<String>) -> Self {
        Self { kind, finding: Finding::Doubts, says: says.into(), weight }
    }

    /// Refutation of the trajectory.
    pub fn refutes(kind: ReasonKind, says: impl Into<String>) -> Self {
        Self { kind, finding: Finding::Refutes, says: says.into(), weight: 1.0 }
    }
}

/// Verdict on a trajectory, with its reasons.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Verdict {
    /// Trust, from all reasons.
    pub state: Trust,
    /// Reasons: refutations, then doubts by decreasing weight, then support.
    pub reasons: Vec<Reason>,
}

impl Verdict {
    /// Reasons against the trajectory, by decreasing weight.
    pub fn against(&self) -> impl Iterator<Item = &Reason> {
        self.reasons.iter().filter(|reason| reason.finding != Finding::Supports)
    }

    /// Evidence against the trajectory, the heaviest first, without a moderate standard deviation of the scale: that is
    /// an uncertainty, not a complaint.
    pub fn complaints(&self) -> impl Iterator<Item = &Reason> {
        self.against().filter(|reason| reason.kind != ReasonKind::Deviation || reason.weight >= 1.0)
    }

    /// Returns true if a reason refutes the trajectory.
    pub fn is_refuted(&self) -> bool {
        self.state == Trust::Rejected
    }
}
