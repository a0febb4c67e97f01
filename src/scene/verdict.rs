//! How far a trajectory can be trusted, and what says so.

use serde::{Deserialize, Serialize};

/// How far a trajectory can be trusted, the best first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Trust {
    /// Everything that is known agrees with it, and its deviation is small.
    Good,
    /// Nothing speaks against it that counts; its deviation is larger, or something small is odd.
    Fair,
    /// Something speaks against it.
    Doubtful,
    /// It cannot be as it stands.
    NotToBeTrusted,
}

impl Trust {
    /// In words, for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Fair => "fair",
            Self::Doubtful => "doubtful",
            Self::NotToBeTrusted => "not to be trusted",
        }
    }

    /// The name in files.
    pub fn key(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Fair => "fair",
            Self::Doubtful => "doubtful",
            Self::NotToBeTrusted => "not-to-be-trusted",
        }
    }
}

/// What was looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReasonKind {
    /// Whether the motion determines the scale ratio at all.
    Determined,
    /// The standard deviation of the scale ratio.
    Deviation,
    /// What other methods say of the scale ratio.
    Agreement,
    /// How many points the object has, and in how many frames it has a place.
    Amount,
    /// Its size in the picture.
    Pixels,
    /// What found it, and how surely.
    Detection,
    /// Whether it moves, by its own points and by its path.
    Movement,
    /// Whether it stands on the ground, and stays there.
    Ground,
    /// Whether a vehicle has such proportions.
    Shape,
    /// Its size beside that of the other vehicles.
    Size,
    /// Its speed, measured with its own size.
    Speed,
    /// Whether its path is one that a vehicle can drive.
    Path,
}

/// What one look came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// What was looked at.
    pub kind: ReasonKind,
    /// What it came to.
    pub finding: Finding,
    /// What was seen, in words, with its figure.
    pub says: String,
    /// How much it counts, 0 to 1: doubts that sum up to 1 make a trajectory doubtful, and one that refutes counts 1.
    /// What supports it counts nothing: it takes no doubt away.
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

/// How far a trajectory can be trusted, and why.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Verdict {
    /// What all reasons come to.
    pub state: Trust,
    /// What refutes it first, then what doubts it, the gravest first, then what supports it.
    pub reasons: Vec<Reason>,
}

impl Verdict {
    /// What speaks against the trajectory, the gravest first.
    pub fn against(&self) -> impl Iterator<Item = &Reason> {
        self.reasons.iter().filter(|reason| reason.finding != Finding::Supports)
    }

    /// Whether it rules the trajectory out.
    pub fn is_refuted(&self) -> bool {
        self.state == Trust::NotToBeTrusted
    }
}
