//! Neural networks for detection, segmentation and optical flow.
//!
//! A [`Segmenter`] segments the objects of a frame, a [`Yolox`] detects them as boxes, a [`BoxSegmenter`] segments
//! objects from box prompts, a [`GroundSegmenter`] segments the ground, and a [`FlowEstimator`] estimates optical flow
//! between two frames. A detector and a box segmenter come with the program ([`default_models`]).
//!
//! Networks are ONNX files; their family is recognised from the names and shapes of inputs and outputs. Further
//! properties (the preprocessing of a semantic network) are in `models/models.toml` or in a file of the same format
//! next to the network, `network.toml` for `network.onnx`. See `docs/perception.md`.

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

/// Valid range of the longer side of a network's input, pixels: smaller inputs show no detail, larger ones exceed
/// memory.
pub(crate) const INPUT_SIZES: std::ops::RangeInclusive<u32> = 32..=8192;
