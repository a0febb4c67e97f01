//! How far a trajectory can be trusted, and how that is said.

use serde::Serialize;

use super::data::Fact;
use super::words::percent;
use crate::scene::ScaleEstimate;

/// A relative standard deviation of the scale ratio up to which it counts as well determined.
const GOOD_STD: f64 = 0.03;
/// A relative standard deviation, or disagreement between methods, beyond which the scale is called weak.
const WEAK_STD: f64 = 0.10;

/// Whose figure it is that stands before.
const OWN_ESTIMATE: &str = "by the run's own estimate (one standard deviation)";

/// How far a trajectory can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// The scale is known to 3 % or better (one standard deviation).
    Good,
    /// Between the two bounds.
    Fair,
    /// Worse than 10 %, or the methods contradict each other by more than that.
    Weak,
    /// No standard deviation is known, and nothing contradicts the scale.
    Unrated,
    /// The motion leaves the scale undetermined.
    Degenerate,
    /// No trajectory.
    Missing,
}

impl Verdict {
    /// All of them, the best first.
    pub const ALL: [Self; 6] = [Self::Good, Self::Fair, Self::Weak, Self::Unrated, Self::Degenerate, Self::Missing];

    /// Of an object's scale ratio; `None` where it has no trajectory.
    pub fn of(scale: Option<&ScaleEstimate>) -> Self {
        let Some(scale) = scale else { return Self::Missing };
        let contradicted = disagreement(scale).is_some_and(|d| d > WEAK_STD);
        match relative_std(scale) {
            _ if scale.degenerate => Self::Degenerate,
            Some(std) if std > WEAK_STD => Self::Weak,
            Some(std) if std > GOOD_STD => Self::Fair,
            Some(_) => Self::Good,
            None if contradicted => Self::Weak,
            None => Self::Unrated,
        }
    }

    /// What the badge says.
    pub fn label(self) -> &'static str {
        match self {
            Self::Good => "scale well determined",
            Self::Fair => "scale fairly determined",
            Self::Weak => "scale weakly determined",
            Self::Unrated => "scale without error estimate",
            Self::Degenerate => "scale undetermined",
            Self::Missing => "no trajectory",
        }
    }

    /// What it means for the object of which it is, in a sentence.
    pub fn sentence(self, scale: Option<&ScaleEstimate>) -> String {
        let (std, contradiction) = (scale.and_then(relative_std), scale.and_then(disagreement));
        match (self, std, contradiction) {
            (Self::Good | Self::Fair, Some(std), _) => {
                format!("Size and distance of this path are right to about {}, {OWN_ESTIMATE}.", percent(std))
            }
            (Self::Weak, Some(std), _) => {
                format!("Size and distance of this path may well be wrong by {}, {OWN_ESTIMATE}.", percent(std))
            }
            (Self::Weak, None, Some(contradiction)) => {
                let most = percent(contradiction);
                format!("The methods differ by up to {most}: size and distance of this path may be wrong by as much.")
            }
            (Self::Degenerate, ..) => "The motion does not tell how large and how far away this path is. Look at its \
                                       shape; do not measure with it."
                .into(),
            (Self::Missing, ..) => "Where this vehicle drove is not known.".into(),
            _ => "How exact size and distance of this path are is not known; no other method contradicts.".into(),
        }
    }

    /// What it means in general.
    fn meaning(self) -> String {
        let [good, weak] = [GOOD_STD, WEAK_STD].map(|limit| format!("{:.0} %", 100.0 * limit));
        match self {
            Self::Good => format!("The run puts the standard deviation of r at {good} or less."),
            Self::Fair => format!("It puts it at more than {good}, but not at more than {weak}."),
            Self::Weak => {
                format!("At more than {weak}; or it is not known, and another method differs by more than {weak}.")
            }
            Self::Unrated => {
                "The method in use gives no standard deviation, and no other method contradicts it.".into()
            }
            Self::Degenerate => "The motion of camera and vehicle leaves r open. The path is drawn dashed.".into(),
            Self::Missing => "The vehicle was seen, but not reconstructed; its card says why.".into(),
        }
    }

    /// All badges and their meanings, for the glossary.
    pub(super) fn glossary() -> Vec<Fact> {
        Self::ALL.iter().map(|verdict| Fact::new(verdict.label(), verdict.meaning())).collect()
    }
}

/// Standard deviation of the ratio as a fraction of it.
pub(super) fn relative_std(scale: &ScaleEstimate) -> Option<f64> {
    scale.std.map(|s| s / scale.ratio).filter(|s| s.is_finite() && *s >= 0.0)
}

/// The largest deviation of another method's ratio, as a fraction.
fn disagreement(scale: &ScaleEstimate) -> Option<f64> {
    let others = scale.alternatives.iter().filter(|(method, _)| **method != scale.method);
    others.map(|(_, r)| (r / scale.ratio - 1.0).abs()).filter(|d| d.is_finite()).reduce(f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;
    use crate::scene::ScaleMethod;

    fn scale(ratio: f64, std: Option<f64>, other: Option<f64>) -> ScaleEstimate {
        let alternatives = other.map(|r| (ScaleMethod::Intersection, r)).into_iter().collect();
        let method = ScaleMethod::ConstantDistance;
        ScaleEstimate { ratio, std, method, degenerate: false, reason: None, alternatives, as_reconstructed: None }
    }

    #[test]
    fn uncertainty_is_relative_and_other_methods_are_heard() {
        assert_eq!(relative_std(&scale(2.0, Some(0.1), None)), Some(0.05));
        assert_eq!(relative_std(&scale(2.0, None, None)), None);
        assert_eq!(disagreement(&scale(2.0, None, Some(2.5))), Some(0.25));
        assert_eq!(disagreement(&scale(2.0, None, None)), None);
    }

    #[test]
    fn every_verdict_is_said_with_its_figure() {
        let mut world = testing::world();
        let degenerate = ScaleEstimate { degenerate: true, ..scale(2.0, Some(0.1), None) };
        for (scale, verdict, word) in [
            (scale(2.0, Some(0.02), None), Verdict::Good, "about 1.0 %"),
            (scale(2.0, Some(0.1), Some(9.0)), Verdict::Fair, "about 5.0 %"),
            (scale(2.0, Some(0.5), None), Verdict::Weak, "wrong by 25 %"),
            (scale(2.0, None, Some(2.5)), Verdict::Weak, "differ by up to 25 %"),
            (scale(2.0, None, Some(2.1)), Verdict::Unrated, "not known"),
            (scale(2.0, Some(f64::NAN), None), Verdict::Unrated, "not known"),
            (degenerate, Verdict::Degenerate, "do not measure"),
        ] {
            world.trajectory.scale = scale;
            let data = world.data();
            let scale = data.objects[0].scale();
            assert_eq!(Verdict::of(scale), verdict);
            let sentence = verdict.sentence(scale);
            assert!(sentence.contains(word), "{verdict:?}: {sentence}");
        }
        assert_eq!(Verdict::of(world.data().objects[1].scale()), Verdict::Missing);
    }
}
