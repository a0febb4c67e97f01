//! The verdict on a trajectory in words.

use serde::Serialize;

use super::data::Fact;
use super::words::{percent, plain};
use crate::scene::{ObjectTrajectory, Reason, ReasonKind, ScaleEstimate, Trust};

/// Trust in a trajectory: the words of [`Trust`], and those for a missing verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// All evidence agrees, and the scale is well determined.
    Good,
    /// At most minor evidence against it.
    Fair,
    /// Evidence against it, or a weakly determined scale.
    Doubtful,
    /// Rejected by evidence, or of undetermined scale.
    Rejected,
    /// No verdict in the result.
    Unjudged,
    /// No trajectory.
    Missing,
}

impl Verdict {
    /// All verdicts, the best first.
    pub const ALL: [Self; 6] = [Self::Good, Self::Fair, Self::Doubtful, Self::Rejected, Self::Unjudged, Self::Missing];

    /// Verdict on an object's trajectory, `None` if it is missing.
    pub fn of(trajectory: Option<&ObjectTrajectory>) -> Self {
        let Some(trajectory) = trajectory else { return Self::Missing };
        match trajectory.verdict.as_ref().map(|verdict| verdict.state) {
            Some(Trust::Good) => Self::Good,
            Some(Trust::Fair) => Self::Fair,
            Some(Trust::Doubtful) => Self::Doubtful,
            Some(Trust::Rejected) => Self::Rejected,
            None => Self::Unjudged,
        }
    }

    /// The word on the badge.
    pub fn label(self) -> &'static str {
        match self {
            Self::Good => Trust::Good.name(),
            Self::Fair => Trust::Fair.name(),
            Self::Doubtful => Trust::Doubtful.name(),
            Self::Rejected => Trust::Rejected.name(),
            Self::Unjudged => "not judged",
            Self::Missing => "no trajectory",
        }
    }

    /// The meaning for the judged trajectory, in a sentence.
    pub fn sentence(self, trajectory: Option<&ObjectTrajectory>) -> String {
        let std = trajectory.and_then(|trajectory| relative_std(&trajectory.scale));
        let first = trajectory.and_then(|trajectory| trajectory.verdict.as_ref()?.complaints().next());
        let is_degenerate = trajectory.is_some_and(|trajectory| trajectory.scale.degenerate);
        match (self, std, first) {
            (Self::Good | Self::Fair, Some(std), _) => {
                format!("Estimated error of this vehicle's size and distance: ±{} (1σ).", percent(std))
            }
            (Self::Rejected, ..) if is_degenerate => {
                "Shape only: the motion does not determine the scale of this trajectory.".into()
            }
            (Self::Doubtful, Some(std), Some(first)) if first.kind == ReasonKind::Deviation => {
                format!("Scale weakly determined: size, distance and speed ±{} (1σ).", percent(std))
            }
            (Self::Rejected, _, Some(first)) => format!("Do not use for measurement: {}.", said(first)),
            (Self::Doubtful, _, Some(first)) => format!("Possibly wrong: {}.", said(first)),
            (Self::Unjudged, ..) => "No verdict in this result.".into(),
            (Self::Missing, ..) => "No 3D trajectory.".into(),
            _ => "Uncertainty of size and distance unknown.".into(),
        }
    }

    /// The meaning in general.
    fn meaning(self) -> &'static str {
        match self {
            Self::Good => "Scale known to ±3 % or better (1σ), and all evidence agrees.",
            Self::Fair => "Scale known to ±10 % or better, and at most minor evidence against it; see the card.",
            Self::Doubtful => "Scale uncertainty above ±10 %, or evidence against the trajectory.",
            Self::Rejected => {
                "The motion does not determine the scale, or the path is physically impossible, or the object is not a \
                 vehicle. The trajectory is dashed; do not use it for measurement."
            }
            Self::Unjudged => "The result was written by a version without verdicts.",
            Self::Missing => "The vehicle was detected but not reconstructed; its card has the reason.",
        }
    }

    /// All badges and their meanings, for the glossary.
    pub(super) fn glossary() -> Vec<Fact> {
        Self::ALL.iter().map(|verdict| Fact::new(verdict.label(), verdict.meaning())).collect()
    }
}

/// A reason as displayed to readers.
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
    use crate::scene;

    fn judged(state: Trust, reasons: Vec<Reason>) -> Option<scene::Verdict> {
        Some(scene::Verdict { state, reasons })
    }

    #[test]
    fn every_verdict_is_explained_with_its_figure() {
        let weak = || Reason::doubts(ReasonKind::Deviation, 1.0, "size and distance");
        let size = || Reason::refutes(ReasonKind::Size, "a tenth as large as the others");
        let scale = testing::world().trajectory.scale;
        let with = |relative: Option<f64>, degenerate| ScaleEstimate {
            std: relative.map(|std| std * scale.ratio),
            degenerate,
            ..scale.clone()
        };
        for (scale, judged, verdict, word) in [
            (with(Some(0.01), false), judged(Trust::Good, vec![]), Verdict::Good, "±1.0 %"),
            (with(Some(0.05), false), judged(Trust::Fair, vec![]), Verdict::Fair, "±5.0 %"),
            (with(Some(0.25), false), judged(Trust::Doubtful, vec![weak()]), Verdict::Doubtful, "speed ±25 %"),
            (with(None, false), judged(Trust::Doubtful, vec![]), Verdict::Doubtful, "unknown"),
            (with(Some(f64::NAN), false), judged(Trust::Doubtful, vec![]), Verdict::Doubtful, "unknown"),
            (with(Some(0.01), false), judged(Trust::Doubtful, vec![size()]), Verdict::Doubtful, "a tenth as large"),
            (
                with(Some(0.01), false),
                judged(Trust::Rejected, vec![size()]),
                Verdict::Rejected,
                "Do not use for measurement",
            ),
            (with(Some(0.01), true), judged(Trust::Rejected, vec![]), Verdict::Rejected, "Shape only"),
            (with(Some(0.01), false), None, Verdict::Unjudged, "No verdict"),
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
