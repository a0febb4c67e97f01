//! Loading what finds objects as boxes.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::yolox::{self, Yolox};
use super::{Detector, movable};
use crate::checks::{Checked, some_of, within};
use crate::ffi::onnx::{Model, Resources};
use crate::networks::{INPUT_SIZES, PerceptionError};

/// At most so many looks at one frame.
const MAX_SCALES: usize = 8;

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
    /// Refuses values that make no sense.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("confidence", self.confidence, 0.0..=1.0)?;
        within("nms_iou", self.nms_iou, 0.0..=1.0)?;
        some_of("classes", &self.classes)?;
        within("input_size", self.input_size, INPUT_SIZES)?;
        some_of("scales", &self.scales)?;
        within("scales", self.scales.len(), 1..=MAX_SCALES)?;
        self.scales.iter().try_for_each(|&scale| within("scales", scale, 0.1..=1.0))
    }
}

/// Loads a network that finds boxes; its family is recognised from its inputs and outputs. `resources` is what it may
/// take, or a number of threads; 0 is one per core.
///
/// # Errors
/// [`PerceptionError::Option`] for options that make no sense; [`PerceptionError::UnknownLayout`] lists what was found
/// and what is supported; [`PerceptionError::NoClassNames`] and [`PerceptionError::NoWantedClass`] say what is wrong
/// with its classes; errors of the runtime say how to get it.
pub fn load_detector(
    path: &Path,
    options: &DetectorOptions,
    resources: impl Into<Resources>,
) -> Result<Box<dyn Detector>, PerceptionError> {
    options.check()?;
    let model = Model::load(path, resources)?;
    if yolox::recognise(&model) {
        return Ok(Box::new(Yolox::new(model, options)?));
    }
    Err(PerceptionError::UnknownLayout {
        path: path.to_path_buf(),
        task: "detection",
        inputs: model.inputs().to_vec(),
        outputs: model.outputs().to_vec(),
        supported: "the YOLOX family: one image [1, 3, h, w] in; [1, n, 5 + classes] out, one row per cell of the \
                    strides 8, 16 and 32, not decoded",
    })
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
