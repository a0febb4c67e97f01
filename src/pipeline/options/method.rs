//! Methods: named sets of options.

use super::{GroundLabels, Options};
use crate::checks::OptionError;
use crate::scene::ScaleMethod;

/// A whole method, from features to the scale ratio.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Method {
    /// The program's own.
    Default,
    /// The published method to the letter (`docs/paper.md`).
    Paper,
    /// Its baseline to the letter.
    PaperBaseline,
}

/// Options that switch off everything that the paper does not have.
const PAPER: [(&str, &str); 11] = [
    ("features", "sift"),
    ("vehicles.motion", "off"),
    ("masking.dilation", "0"),
    ("tuning.background.mapper.max_track_views", "1000000"),
    ("tuning.objects.mapper.max_track_views", "1000000"),
    ("tuning.objects.mapper.pose_priors", "false"),
    ("tuning.ground.vehicle_path", "false"),
    ("tuning.ground.labels_only", "true"),
    ("tuning.scale.method_only", "true"),
    ("tuning.scale.stationary", "none"),
    ("metric.telemetry", "none"),
];

with_names!(Method { Default = "default", Paper = "paper", PaperBaseline = "paper-baseline" });

impl Method {
    /// Options with those of the method.
    ///
    /// # Errors
    /// [`OptionError`] if the options do not have one of them.
    pub fn applied(self, options: &Options) -> Result<Options, OptionError> {
        let method = match self {
            Self::Default => return Ok(options.clone()),
            Self::Paper => ScaleMethod::ConstantDistance,
            Self::PaperBaseline => ScaleMethod::Intersection,
        };
        let set = |options: Options, (key, value): &(&str, &str)| options.with_value(key, value);
        let mut options = PAPER.iter().try_fold(options.clone(), set)?;
        options.scale.method = method;
        Ok(options)
    }

    /// The method whose options these are.
    pub fn of(options: &Options) -> Self {
        let is_same = |method: &Self| method.applied(options).is_ok_and(|applied| applied == *options);
        [Self::Paper, Self::PaperBaseline].into_iter().find(is_same).unwrap_or(Self::Default)
    }
}

impl Options {
    /// Refuses a ground from labels only where there are no labels.
    ///
    /// # Errors
    /// [`OptionError`] names the option.
    pub fn check_labels(&self) -> Result<(), OptionError> {
        if !self.ground.labels_only || self.ground_labels != GroundLabels::Geometric {
            return Ok(());
        }
        let reason = "no ground labels, which --method paper needs; give --ground-masks or --ground-model";
        Err(OptionError::new("ground_labels", reason))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_method_is_recognized_by_its_options() {
        for method in Method::ALL {
            let options = method.applied(&Options::default()).unwrap();
            assert_eq!(Method::of(&options), method);
            assert!(options.check().is_ok(), "{:?}", options.check());
            let changed = Options { seed: 7, ..options.clone() };
            assert_eq!(Method::of(&changed), method, "inputs and seeds belong to no method");
        }
        let paper = Method::Paper.applied(&Options::default()).unwrap();
        let different = paper.with_value("tuning.ground.vehicle_path", "true").unwrap();
        assert_eq!(Method::of(&different), Method::Default);
    }

    #[test]
    fn every_option_of_the_paper_differs_from_the_default() {
        let paper = Method::Paper.applied(&Options::default()).unwrap();
        let differing = Options::default().differing(&paper);
        for (key, _) in PAPER {
            assert!(differing.iter().any(|other| other == key), "{key}: {differing:?}");
        }
        assert_eq!(differing.len(), PAPER.len() + 1, "{differing:?}");
    }

    #[test]
    fn a_ground_from_labels_needs_labels() {
        let paper = Method::Paper.applied(&Options::default()).unwrap();
        assert!(paper.check_labels().unwrap_err().to_string().contains("--ground-masks"));
        assert!(Options::default().check_labels().is_ok());
        let labelled = Options { ground_labels: GroundLabels::Model("m.onnx".into()), ..paper };
        assert!(labelled.check_labels().is_ok());
    }
}
