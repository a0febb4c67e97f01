//! Neural networks for detection, segmentation and optical flow.
//!
//! A [`Segmenter`] finds objects in one frame with their masks, a [`Yolox`] finds them as boxes, a [`BoxSegmenter`]
//! finds the masks of boxes, a [`GroundSegmenter`] finds the ground in one frame, a [`FlowEstimator`] estimates where
//! each pixel of one frame lies in another. A detector and a prompter come with the program ([`default_models`]).
//!
//! Networks are ONNX files; their family is recognised from the names and shapes of inputs and outputs, and what cannot
//! be seen from these (the preprocessing of a semantic network) stands in `models/models.toml` or in a file of the same
//! form next to the network, `network.toml` for `network.onnx`. See `docs/perception.md`.

mod default_models;
mod description;
mod error;
mod flow;
mod ground;
mod prompt;
mod segmentation;
mod tensor;

pub use self::description::{ModelDescription, Preprocessing};
pub use self::error::PerceptionError;
pub use self::flow::{DisFlow, FlowEstimator, OnnxFlow, load_flow};
pub use self::ground::{GroundOptions, GroundSegmenter, load_ground_segmenter};
pub use self::prompt::{
    BoxMask, BoxSegmenter, BySize, GrabCut, KnownMasks, PromptOptions, load_box_segmenter, load_small_box_segmenter,
};
pub use self::segmentation::{
    DetectorOptions, SegmentationOptions, Segmenter, Tiling, Yolox, load_detector, load_segmenter,
};
pub use default_models::{DefaultModels, default_descriptions, default_models};

/// Longer sides of pictures, pixels, that networks are asked about: below, there is nothing to see; beyond, memory
/// ends.
pub(crate) const INPUT_SIZES: std::ops::RangeInclusive<u32> = 32..=8192;
