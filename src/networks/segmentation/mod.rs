//! Instance segmentation: the objects of one frame, each with its own mask.

mod classes;
mod detector_options;
mod letterbox;
mod mask_rcnn;
mod suppression;
mod tiles;
mod yolo;
mod yolox;

use std::path::Path;

use ::image::RgbImage;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use self::detector_options::DetectorOptions;
use self::letterbox::Letterbox;
use self::mask_rcnn::MaskRcnn;
use self::suppression::{Candidate, suppress};
use self::tiles::views;
use self::yolo::YoloSeg;
pub use self::yolox::{Yolox, load_detector};
use super::{INPUT_SIZES, PerceptionError};
use crate::checks::{Checked, some_of, within};
use crate::ffi::onnx::{Model, Resources};
use crate::scene::{Detection, Mask};

/// Maximum number of objects per frame, by score: bounds memory for networks with many false detections.
const MAX_OBJECTS: usize = 300;

/// Instance segmentation of the movable objects of a frame.
pub trait Segmenter {
    /// Segments the objects of `image`, each with a mask of the image's size; highest confidence first.
    ///
    /// # Errors
    /// The network cannot be run or its output has a shape that its family does not allow.
    fn segment(&mut self, image: &RgbImage) -> Result<Vec<Detection>, PerceptionError>;
}

/// Treatment of frames that are larger than the network's input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SegmentationOptions {
    /// Minimum score of an object.
    #[schemars(extend("unit" = "score, 0 to 1"))]
    pub confidence: f64,
    /// Maximum overlap (intersection over union) of two objects of a class; of others the one with the higher score is
    /// kept.
    #[schemars(extend("unit" = "share"))]
    pub nms_iou: f64,
    /// Classes that are segmented; all of them are kept out of the background.
    pub classes: Vec<String>,
    /// Division of large frames into tiles, to find small objects.
    pub tiling: Tiling,
    /// Overlap of neighboring tiles; larger than the objects to be found.
    #[schemars(extend("unit" = "share of a tile's side"))]
    pub tile_overlap: f64,
    /// Longer side of the network's input, for networks with a free input size.
    #[schemars(extend("unit" = "pixels"))]
    pub input_size: u32,
}

/// Class names of movable objects in COCO, Cityscapes and the common drone data sets.
fn movable() -> Vec<String> {
    let names = "car truck bus van motorcycle motor motorbike bicycle person pedestrian people rider train tram \
                 tricycle awning-tricycle trailer caravan vehicle boat airplane dog horse cow sheep";
    names.split(' ').map(str::to_owned).collect()
}

impl Default for SegmentationOptions {
    fn default() -> Self {
        Self {
            confidence: 0.25,
            nms_iou: 0.6,
            classes: movable(),
            tiling: Tiling::Off,
            tile_overlap: 0.2,
            input_size: 640,
        }
    }
}

impl SegmentationOptions {
    /// Rejects invalid values.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("confidence", self.confidence, 0.0..=1.0)?;
        within("nms_iou", self.nms_iou, 0.0..=1.0)?;
        some_of("classes", &self.classes)?;
        within("tile_overlap", self.tile_overlap, 0.0..=0.8)?;
        within("input_size", self.input_size, INPUT_SIZES)
    }
}

/// Runs a network on all views of a frame; returns the objects with their masks, highest confidence first.
///
/// * `input` – width and height of the network's input.
/// * `infer` – runs the network on the pixels of a view; returns candidates with their corners in pixels of the input,
///   and the data of their masks.
/// * `mask` – makes the mask of a candidate in the frame.
fn segment_views<M, A>(
    image: &RgbImage,
    input: (u32, u32),
    options: &SegmentationOptions,
    mut infer: impl FnMut(&RgbImage) -> Result<(Vec<Candidate<M>>, A), PerceptionError>,
    mask: impl Fn(&Candidate<M>, &Letterbox, &A) -> Mask,
) -> Result<Vec<(Candidate<M>, Mask)>, PerceptionError> {
    if image.is_empty() {
        return Ok(Vec::new());
    }
    let frame = image.dimensions();
    let (mut candidates, mut seen) = (Vec::new(), Vec::new());
    for (view_idx, view) in views(frame, input, options).into_iter().enumerate() {
        let (boxed, pixels) = Letterbox::place(image, view, input)?;
        let (found, answer) = infer(&pixels)?;
        candidates.extend(found.into_iter().map(|c| c.in_frame(&boxed, view, view_idx, frame)));
        seen.push((boxed, answer));
    }
    let mut kept = suppress(candidates, options.nms_iou as f32);
    kept.truncate(MAX_OBJECTS);
    let with_mask = |candidate: Candidate<M>| {
        let (boxed, answer) = &seen[candidate.view_idx];
        let mask = mask(&candidate, boxed, answer);
        (mask.area_px2() > 0).then_some((candidate, mask))
    };
    Ok(kept.into_iter().filter_map(with_mask).collect())
}

/// Loads a network for instance segmentation; its family is recognised from its inputs and outputs. `resources` is its
/// resource limit, or a number of threads; 0 is one per core.
///
/// # Errors
/// [`PerceptionError::UnknownLayout`] lists the network's layout and the supported ones;
/// [`PerceptionError::NoClassNames`] and [`PerceptionError::NoWantedClass`] give the problem with its classes; errors
/// of the runtime name the remedy.
pub fn load_segmenter(
    path: &Path,
    options: &SegmentationOptions,
    resources: impl Into<Resources>,
) -> Result<Box<dyn Segmenter>, PerceptionError> {
    options.check()?;
    let model = Model::load(path, resources)?;
    if yolo::recognise(&model) {
        return Ok(Box::new(YoloSeg::new(model, options)?));
    }
    if let Some(places) = mask_rcnn::recognise(&model) {
        return Ok(Box::new(MaskRcnn::new(model, places, options)?));
    }
    Err(PerceptionError::unknown_layout(
        &model,
        "instance segmentation",
        "the YOLO-seg family (YOLOv8-seg, YOLO11-seg): one image [1, 3, h, w] in; \
                    [1, 4 + classes + k, n] and prototypes [1, k, h, w] out; torchvision's Mask R-CNN: one image \
                    [3, h, w] in; boxes [n, 4], labels [n], scores [n], masks [n, 1, h, w] out; see docs/perception.md",
    ))
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
