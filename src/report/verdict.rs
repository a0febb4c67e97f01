//! How the verdict on a trajectory is said.

use serde::Serialize;

use super::data::Fact;
use super::words::{percent, plain};
use crate::scene::{self, ObjectTrajectory, Reason, ReasonKind, ScaleEstimate, Trust};

/// Whose figure it is that stands before.
const OWN_ESTIMATE: &str = "by the run's own estimate (one standard deviation)";

/// How far a trajectory can be trusted, in the words of the page.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Everything agrees, and the scale is well determined.
    Good,
    /// Nothing speaks against it that counts.
    Fair,
    /// The scale is weakly determined.
    Weak,
    /// No standard deviation of the scale is known.
    Unrated,
    /// Something else than the deviation speaks against it.
    Doubtful,
    /// The motion leaves the scale undetermined.
    Degenerate,
    /// Something else rules it out.
    Refuted,
    /// Nobody judged it.
    Unjudged,
    /// No trajectory.
    Missing,
}

impl Verdict {
    /// All of them, the best first.
    pub const ALL: [Self; 9] = [
        Self::Good,
        Self::Fair,
        Self::Weak,
        Self::Unrated,
        Self::Doubtful,
        Self::Degenerate,
        Self::Refuted,
        Self::Unjudged,
        Self::Missing,
    ];

    /// Of an object's trajectory; `None` where it has none.
    pub fn of(trajectory: Option<&ObjectTrajectory>) -> Self {
        let Some(trajectory) = trajectory else { return Self::Missing };
        let Some(verdict) = &trajectory.verdict else { return Self::Unjudged };
        let is_of_deviation = verdict.against().next().is_some_and(|reason| reason.kind == ReasonKind::Deviation);
        match verdict.state {
            Trust::Good => Self::Good,
            Trust::Fair => Self::Fair,
            Trust::Doubtful if !is_of_deviation => Self::Doubtful,
            Trust::Doubtful if relative_std(&trajectory.scale).is_none() => Self::Unrated,
            Trust::Doubtful => Self::Weak,
            Trust::NotToBeTrusted if trajectory.scale.degenerate => Self::Degenerate,
            Trust::NotToBeTrusted => Self::Refuted,
        }
    }

    /// What the badge says.
    pub fn label(self) -> &'static str {
        match self {
            Self::Good => "scale well determined",
            Self::Fair => "scale fairly determined",
            Self::Weak => "scale weakly determined",
            Self::Unrated => "scale without error estimate",
            Self::Doubtful => "doubtful",
            Self::Degenerate => "scale undetermined",
            Self::Refuted => "not to be trusted",
            Self::Unjudged => "not judged",
            Self::Missing => "no trajectory",
        }
    }

    /// What it means for the trajectory of which it is, in a sentence.
    pub fn sentence(self, trajectory: Option<&ObjectTrajectory>) -> String {
        let std = trajectory.and_then(|trajectory| relative_std(&trajectory.scale));
        let first = trajectory.and_then(|trajectory| first_against(trajectory.verdict.as_ref()));
        match (self, std, first) {
            (Self::Good | Self::Fair, Some(std), _) => {
                format!("Size and distance of this path are right to about {}, {OWN_ESTIMATE}.", percent(std))
            }
            (Self::Weak, Some(std), _) => {
                format!("Size and distance of this path may well be wrong by {}, {OWN_ESTIMATE}.", percent(std))
            }
            (Self::Degenerate, ..) => "The motion does not tell how large and how far away this path is. Look at its \
                                       shape; do not measure with it."
                .into(),
            (Self::Refuted, _, Some(first)) => format!("This path cannot be right: {first}. Do not measure with it."),
            (Self::Doubtful, _, Some(first)) => format!("This path may well be wrong: {first}."),
            (Self::Unjudged, ..) => "How far this path can be trusted was not judged.".into(),
            (Self::Missing, ..) => "Where this vehicle drove is not known.".into(),
            _ => "How exact size and distance of this path are is not known.".into(),
        }
    }

    /// What it means in general.
    fn meaning(self) -> &'static str {
        match self {
            Self::Good => {
                "The run puts the standard deviation of r at 3 % or less, and all else that is known of the vehicle \
                 agrees."
            }
            Self::Fair => {
                "It puts it at 10 % or less, and at most something small speaks against the path; the card says what."
            }
            Self::Weak => "It puts it at more than 10 %.",
            Self::Unrated => "The method in use gives no standard deviation.",
            Self::Doubtful => "Whatever the deviation is, something else speaks against the path.",
            Self::Degenerate => "The motion of camera and vehicle leaves r open. The path is drawn dashed.",
            Self::Refuted => "No vehicle can have driven so, or it is none. The path is drawn dashed.",
            Self::Unjudged => "The result was made before the program judged trajectories.",
            Self::Missing => "The vehicle was seen, but not reconstructed; its card says why.",
        }
    }

    /// All badges and their meanings, for the glossary.
    pub(super) fn glossary() -> Vec<Fact> {
        Self::ALL.iter().map(|verdict| Fact::new(verdict.label(), verdict.meaning())).collect()
    }
}

fn first_against(verdict: Option<&scene::Verdict>) -> Option<String> {
    verdict?.against().next().map(said)
}

/// A reason as readers see it.
pub(super) fn said(reason: &Reason) -> String {
    plain(&reason.says)
}

/// Standard deviation of the ratio as a fraction of it.
pub(super) fn relative_std(scale: &ScaleEstimate) -> Option<f64> {
    scale.std.map(|s| s / scale.ratio).filter(|s| s.is_finite() && *s >= 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    fn judged(state: Trust, reasons: Vec<Reason>) -> Option<scene::Verdict> {
        Some(scene::Verdict { state, reasons })
    }

    #[test]
    fn every_verdict_is_said_with_its_figure() {
        let weak = || Reason::doubts(ReasonKind::Deviation, 1.0, "size and distance");
        let size = || Reason::refutes(ReasonKind::Size, "a tenth as large as the others");
        let scale = testing::world().trajectory.scale;
        let with = |relative: Option<f64>, degenerate| ScaleEstimate {
            std: relative.map(|std| std * scale.ratio),
            degenerate,
            ..scale.clone()
        };
        for (scale, judged, verdict, word) in [
            (with(Some(0.01), false), judged(Trust::Good, vec![]), Verdict::Good, "about 1.0 %"),
            (with(Some(0.05), false), judged(Trust::Fair, vec![]), Verdict::Fair, "about 5.0 %"),
            (with(Some(0.25), false), judged(Trust::Doubtful, vec![weak()]), Verdict::Weak, "wrong by 25 %"),
            (with(None, false), judged(Trust::Doubtful, vec![weak()]), Verdict::Unrated, "not known"),
            (with(Some(f64::NAN), false), judged(Trust::Doubtful, vec![weak()]), Verdict::Unrated, "not known"),
            (with(Some(0.01), false), judged(Trust::Doubtful, vec![size()]), Verdict::Doubtful, "a tenth as large"),
            (with(Some(0.01), false), judged(Trust::NotToBeTrusted, vec![size()]), Verdict::Refuted, "cannot be right"),
            (with(Some(0.01), true), judged(Trust::NotToBeTrusted, vec![]), Verdict::Degenerate, "do not measure"),
            (with(Some(0.01), false), None, Verdict::Unjudged, "not judged"),
        ] {
            let mut trajectory = testing::world().trajectory;
            (trajectory.scale, trajectory.verdict) = (scale, judged);
            assert_eq!(Verdict::of(Some(&trajectory)), verdict);
            let sentence = verdict.sentence(Some(&trajectory));
            assert!(sentence.contains(word), "{verdict:?}: {sentence}");
        }
        assert_eq!(Verdict::of(None), Verdict::Missing);
    }
}
