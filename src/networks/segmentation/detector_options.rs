//! Options of the detector.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::movable;
use crate::checks::{Checked, some_of, within};
use crate::networks::INPUT_SIZES;

/// Options of the detector.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DetectorOptions {
    /// Minimum score of a detection.
    #[schemars(extend("unit" = "score, 0 to 1"))]
    pub confidence: f64,
    /// Maximum overlap (intersection over union) of two detections; of others the one with the higher score is kept.
    #[schemars(extend("unit" = "share"))]
    pub nms_iou: f64,
    /// Classes that are detected; all of them are kept out of the background.
    pub classes: Vec<String>,
    /// Longer side of the network's input, for networks with a free input size; larger finds smaller vehicles, at
    /// quadratic cost.
    #[schemars(extend("unit" = "pixels"))]
    pub input_size: u32,
    /// Scales of the input at which each frame is searched, since the network misses vehicles that are large in its
    /// input.
    #[schemars(extend("unit" = "share of input_size"))]
    pub scales: Vec<f64>,
}

impl Default for DetectorOptions {
    fn default() -> Self {
        Self { confidence: 0.25, nms_iou: 0.5, classes: movable(), input_size: 960, scales: vec![1.0, 0.5] }
    }
}

impl DetectorOptions {
    /// Rejects invalid values.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("confidence", self.confidence, 0.0..=1.0)?;
        within("nms_iou", self.nms_iou, 0.0..=1.0)?;
        some_of("classes", &self.classes)?;
        within("input_size", self.input_size, INPUT_SIZES)?;
        some_of("scales", &self.scales)?;
        // Limits the number of network runs per frame.
        within("scales", self.scales.len(), 1..=8)?;
        self.scales.iter().try_for_each(|&scale| within("scales", scale, 0.1..=1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_out_of_range_are_refused_by_name() {
        assert!(DetectorOptions::default().check().is_ok());
        let bad = DetectorOptions { input_size: 0, ..DetectorOptions::default() };
        assert!(bad.check().unwrap_err().to_string().contains("input_size"));
        let none = DetectorOptions { classes: Vec::new(), ..DetectorOptions::default() };
        assert!(none.check().is_err());
        let small = DetectorOptions { scales: vec![1.0, 0.01], ..DetectorOptions::default() };
        assert!(small.check().unwrap_err().to_string().contains("scales"));
    }
}
