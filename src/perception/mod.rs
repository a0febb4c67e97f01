//! Segmentation, optical flow and mask tracking.
//!
//! Three models stand behind three traits, so that the networks can be exchanged: a [`Segmenter`] finds objects in one
//! frame, a [`GroundSegmenter`] finds the ground in one frame, a [`FlowEstimator`] says where each pixel of one frame
//! lies in another. The [`Tracker`] joins detections of successive frames into tracks.
//!
//! Networks are ONNX files; their family is recognised from the names and shapes of inputs and outputs, and what cannot
//! be seen from these (the preprocessing of a semantic network) stands in `models/models.toml` or in a file of the same
//! form beside the network, `network.toml` for `network.onnx`. See `docs/perception.md`.

mod description;
mod error;
mod flow;
mod ground;
mod prompt;
mod segmentation;
mod tensor;
mod tracking;

pub use self::description::{ModelDescription, Preprocessing};
pub use self::error::PerceptionError;
pub use self::flow::{DisFlow, DisPreset, FlowEstimator, FlowOptions, OnnxFlow, load_flow};
pub use self::ground::{GroundOptions, GroundSegmenter, load_ground_segmenter};
pub use self::prompt::{Prompted, Prompter};
pub use self::segmentation::{Detector, SegmentationOptions, Segmenter, Tiling, load_segmenter};
pub use self::tracking::{Evidence, TrackSummary, TrackedMask, Tracker, TrackerOptions};

/// Longer sides of pictures, pixels, that networks are asked about: below, there is nothing to see; beyond, memory
/// ends.
const INPUT_SIZES: std::ops::RangeInclusive<u32> = 32..=8192;
