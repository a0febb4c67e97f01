//! Detection of vehicles without given masks or a segmentation network.

use std::path::PathBuf;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::limits::{Checked, within};

/// The detector.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum DetectorChoice {
    /// The one that comes with the program.
    #[default]
    Default,
    /// None: vehicles are found by their motion alone.
    None,
    /// An ONNX file of the same family.
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
    /// The mask network that comes with the program.
    #[default]
    Default,
    /// Colours alone (`GrabCut`): coarse masks.
    None,
}

/// Detection of vehicles by their motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MotionChoice {
    /// Everything that moves against the background is a vehicle, whatever it looks like.
    #[default]
    On,
    /// Motion finds nothing; it still says whether what the detector finds moves.
    Off,
}

impl FromStr for MaskChoice {
    type Err = String;

    /// `default` or `none`.
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "default" => Ok(Self::Default),
            "none" => Ok(Self::None),
            _ => Err(format!("'{text}': expected default or none")),
        }
    }
}

impl FromStr for MotionChoice {
    type Err = String;

    /// `on` or `off`.
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "on" => Ok(Self::On),
            "off" => Ok(Self::Off),
            _ => Err(format!("'{text}': expected on or off")),
        }
    }
}

/// Detection of vehicles where `instances` is `vehicles`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct VehicleOptions {
    /// Vehicle detector.
    pub detector: DetectorChoice,
    /// Detection by motion.
    pub motion: MotionChoice,
    /// Segmenter of their boxes.
    pub mask_network: MaskChoice,
    /// Every so many frames the mask network is asked again; between, masks are carried by optical flow. Without a
    /// number as many frames as there are in 0.4 seconds, but from 2 to 12.
    #[schemars(extend("unit" = "frames"))]
    pub segment_every: Option<u32>,
}

impl Default for VehicleOptions {
    fn default() -> Self {
        Self {
            detector: DetectorChoice::Default,
            motion: MotionChoice::On,
            mask_network: MaskChoice::Default,
            segment_every: None,
        }
    }
}

impl VehicleOptions {
    /// Rejects what cannot be worked with.
    ///
    /// # Errors
    /// [`OptionError`](crate::limits::OptionError) names the option.
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
    fn choices_are_words_or_files() {
        assert_eq!("none".parse(), Ok(DetectorChoice::None));
        assert_eq!("nets/none.onnx".parse(), Ok(DetectorChoice::File("nets/none.onnx".into())));
        assert!("colours".parse::<MaskChoice>().is_err() && "maybe".parse::<MotionChoice>().is_err());
    }
}
