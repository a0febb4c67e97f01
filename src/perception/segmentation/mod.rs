//! Instance segmentation: the objects of one frame, each with its own mask.

mod classes;
mod letterbox;
mod suppression;
mod views;
mod yolo;

use std::path::Path;

use ::image::RgbImage;
use serde::{Deserialize, Serialize};

use self::yolo::YoloSeg;
use super::PerceptionError;
use crate::ffi::onnx::Model;
use crate::scene::Detection;

/// Finds the movable objects of a frame.
pub trait Segmenter {
    /// The objects found in `image`, each with a mask of the image's size; highest confidence first.
    ///
    /// # Errors
    /// When the network cannot be run or answers in a shape that its family does not allow.
    fn segment(&mut self, image: &RgbImage) -> Result<Vec<Detection>, PerceptionError>;
}

/// Whether a frame that is larger than the network's input is also looked at piece by piece.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Tiling {
    /// The whole frame only, shrunk to the network's input.
    #[default]
    Off,
    /// The whole frame, and besides it overlapping tiles of the input's size at full resolution wherever the frame is
    /// larger than the input. Finds small objects; costs one run of the network per tile.
    On,
}

/// Options of instance segmentation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SegmentationOptions {
    /// Objects with a lower score are not reported (0 to 1). The tracker starts tracks only from higher scores of its own
    /// choice, but follows them with everything that is reported.
    pub confidence: f64,
    /// Of two objects of one class whose boxes overlap by more than this (intersection over union), only the one with the
    /// higher score is kept.
    pub nms_iou: f64,
    /// Names of the classes that are reported: everything that may move by itself, for nothing of it may serve as background.
    pub classes: Vec<String>,
    /// Whether large frames are also looked at in tiles.
    pub tiling: Tiling,
    /// Overlap of neighbouring tiles, as a fraction of a tile's side: larger than the objects that the tiles are to find.
    pub tile_overlap: f64,
    /// Longer side of the input, pixels, for networks that leave it open.
    pub input_size: u32,
    /// Threads that the network runs on; 0 is one per core.
    pub num_threads: usize,
}

/// What moves by itself, in the words of COCO, Cityscapes and the common drone data sets.
const MOVABLE: [&str; 25] = [
    "car",
    "truck",
    "bus",
    "van",
    "motorcycle",
    "motor",
    "motorbike",
    "bicycle",
    "person",
    "pedestrian",
    "people",
    "rider",
    "train",
    "tram",
    "tricycle",
    "awning-tricycle",
    "trailer",
    "caravan",
    "vehicle",
    "boat",
    "airplane",
    "dog",
    "horse",
    "cow",
    "sheep",
];

impl Default for SegmentationOptions {
    fn default() -> Self {
        Self {
            confidence: 0.25,
            nms_iou: 0.6,
            classes: MOVABLE.map(str::to_owned).to_vec(),
            tiling: Tiling::Off,
            tile_overlap: 0.2,
            input_size: 640,
            num_threads: 0,
        }
    }
}

impl SegmentationOptions {
    /// Refuses values that make no sense.
    ///
    /// # Errors
    /// [`PerceptionError::Option`] names the option.
    pub fn check(&self) -> Result<(), PerceptionError> {
        let fraction = |option: &'static str, value: f64, top: f64| {
            if (0.0..=top).contains(&value) {
                return Ok(());
            }
            Err(PerceptionError::Option { option, reason: format!("{value} is not between 0 and {top}") })
        };
        fraction("confidence", self.confidence, 1.0)?;
        fraction("nms_iou", self.nms_iou, 1.0)?;
        fraction("tile_overlap", self.tile_overlap, 0.8)?;
        if self.classes.is_empty() {
            return Err(PerceptionError::Option { option: "classes", reason: "no class is asked for".into() });
        }
        if !(32..=8192).contains(&self.input_size) {
            let reason = format!("{} is not between 32 and 8192 pixels", self.input_size);
            return Err(PerceptionError::Option { option: "input_size", reason });
        }
        Ok(())
    }
}

/// Loads a network for instance segmentation; its family is recognised from its inputs and outputs.
///
/// # Errors
/// [`PerceptionError::UnknownLayout`] lists what was found and what is supported; [`PerceptionError::NoClassNames`] and
/// [`PerceptionError::NoWantedClass`] say what is wrong with its classes; errors of the runtime say how to get it.
pub fn load_segmenter(path: &Path, options: &SegmentationOptions) -> Result<Box<dyn Segmenter>, PerceptionError> {
    options.check()?;
    let model = Model::load(path, options.num_threads)?;
    if yolo::recognise(&model) {
        return Ok(Box::new(YoloSeg::new(model, options)?));
    }
    Err(PerceptionError::UnknownLayout {
        path: path.to_path_buf(),
        task: "instance segmentation",
        inputs: model.inputs().to_vec(),
        outputs: model.outputs().to_vec(),
        supported: "the YOLO-seg family (YOLOv8-seg, YOLO11-seg): one image [1, 3, h, w] in; \
                    [1, 4 + classes + k, n] and prototypes [1, k, h, w] out",
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_out_of_range_are_refused_by_name() {
        assert!(SegmentationOptions::default().check().is_ok());
        let bad = SegmentationOptions { nms_iou: 1.5, ..SegmentationOptions::default() };
        assert!(bad.check().unwrap_err().to_string().contains("nms_iou"));
        let nan = SegmentationOptions { confidence: f64::NAN, ..SegmentationOptions::default() };
        assert!(nan.check().is_err());
    }
}
