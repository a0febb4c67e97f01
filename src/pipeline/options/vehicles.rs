//! Detection of vehicles without given masks or a segmentation network.

use std::path::PathBuf;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{Checked, within};

/// The detector.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum DetectorChoice {
    /// Bundled detector.
    #[default]
    Default,
    /// Detection by motion only.
    None,
    /// ONNX file of the same family.
    File(PathBuf),
}

impl FromStr for DetectorChoice {
    type Err = std::convert::Infallible;

    /// `default`, `none`, or the path of a file.
    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Ok(match text {
            "default" => Self::Default,
            "none" => Self::None,
            path => Self::File(path.into()),
        })
    }
}

/// Segmenter of boxes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MaskChoice {
    /// Bundled network `MobileSAM`; the small one for boxes below 20 pixels, and for all where the camera does not
    /// translate.
    #[default]
    Default,
    /// Small bundled network for all boxes: a fifteenth of the time, and other outlines on real images.
    Small,
    /// Coarse masks from colors (`GrabCut`).
    None,
}

/// Detection of vehicles by their motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MotionChoice {
    /// Everything that moves against the background is a vehicle.
    #[default]
    On,
    /// Motion only classifies detections as moving or stationary.
    Off,
}

/// Detection of vehicles where `instances` is `vehicles`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct VehicleOptions {
    /// Vehicle detector.
    pub detector: DetectorChoice,
    /// Detection by motion.
    pub motion: MotionChoice,
    /// Segmentation of the detected boxes.
    pub mask_network: MaskChoice,
    /// Frames between two runs of the mask network; `null` for 0.4 s, 2 to 12 frames. Masks are propagated in between.
    #[schemars(extend("unit" = "frames"))]
    pub segment_every: Option<u32>,
}

impl VehicleOptions {
    /// Rejects what cannot be worked with.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        self.segment_every.map_or(Ok(()), |every| within("segment_every", every, 1..=1000))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_are_asked_for_now_and_then_at_least() {
        assert!(VehicleOptions { segment_every: Some(0), ..VehicleOptions::default() }.check().is_err());
    }

    #[test]
    fn detectors_are_words_or_files() {
        assert_eq!("none".parse(), Ok(DetectorChoice::None));
        assert_eq!("nets/none.onnx".parse(), Ok(DetectorChoice::File("nets/none.onnx".into())));
    }
}
