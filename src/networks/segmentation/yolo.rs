//! The YOLO-seg family: YOLOv8-seg, YOLO11-seg and networks with the same head.
//!
//! Input: one image [1, 3, h, w], RGB between 0 and 1, grey letterbox. Output: [1, 4 + C + K, N], per column a box
//! (centre x, centre y, width, height in input pixels), C class scores after the sigmoid and K mask coefficients; and K
//! prototype masks [1, K, h / 4, w / 4]. An object's mask is where sigmoid(coefficients · prototypes), interpolated at
//! the frame's pixels inside its box, exceeds one half.

use ::image::RgbImage;

use super::classes::{Classes, class_names};
use super::letterbox::Letterbox;
use super::suppression::Candidate;
use super::tiles::mask_in;
use super::{SegmentationOptions, Segmenter, segment_views};
use crate::ffi::onnx::{Model, Tensor};
use crate::networks::PerceptionError;
use crate::networks::description::Preprocessing;
use crate::networks::tensor::{Plane, input_size, size_in_steps, tensor_from_image};
use crate::scene::{Detection, Mask};

/// Returns true if a network's inputs and outputs are those of the family.
pub(super) fn recognise(model: &Model) -> bool {
    let [input] = model.inputs() else { return false };
    let [boxes, prototypes] = model.outputs() else { return false };
    let three_channels = input.shape.len() == 4 && input.shape[1].is_none_or(|c| c == 3);
    let room_for_coefficients = match (boxes.shape.get(1), prototypes.shape.get(1)) {
        (Some(Some(rows)), Some(Some(k))) => *rows > 4 + k,
        _ => true,
    };
    let columns_are_boxes = match (boxes.shape.get(1), boxes.shape.get(2)) {
        (Some(Some(rows)), Some(Some(columns))) => rows < columns,
        _ => true,
    };
    let ranks = boxes.shape.len() == 3 && prototypes.shape.len() == 4;
    three_channels && ranks && room_for_coefficients && columns_are_boxes
}

/// A loaded network of the family.
pub(super) struct YoloSeg {
    model: Model,
    options: SegmentationOptions,
    /// Class names with flags of the reported ones; set by the first run if the network's input size is free.
    classes: Option<Classes>,
}

impl YoloSeg {
    /// Takes a network that [`recognise`] accepted.
    pub(super) fn new(model: Model, options: &SegmentationOptions) -> Result<Self, PerceptionError> {
        let mut segmenter = Self { model, options: options.clone(), classes: None };
        let sides = segmenter.model.outputs();
        if let (Some(rows), Some(k)) = (sides[0].shape[1], sides[1].shape[1]) {
            segmenter.classes = Some(segmenter.find_classes(rows.saturating_sub(4 + k))?);
        }
        Ok(segmenter)
    }

    fn find_classes(&self, num_classes: usize) -> Result<Classes, PerceptionError> {
        Classes::new(&self.model, class_names(&self.model, num_classes)?, &self.options.classes)
    }

    /// Runs the network on one view; returns the raw outputs in the family's order.
    fn infer(&mut self, input: &RgbImage) -> Result<Raw, PerceptionError> {
        let input = tensor_from_image(input, &Preprocessing::default());
        let outputs = self.model.run(&[input])?;
        let raw = Raw::new(outputs)
            .map_err(|(found, expected)| PerceptionError::output(&self.model, Some(found), expected))?;
        let num_classes = raw.num_classes();
        if self.classes.as_ref().is_none_or(|c| c.names.len() != num_classes) {
            self.classes = Some(self.find_classes(num_classes)?);
        }
        Ok(raw)
    }
}

impl Segmenter for YoloSeg {
    fn segment(&mut self, image: &RgbImage) -> Result<Vec<Detection>, PerceptionError> {
        let (frame, options) = (image.dimensions(), self.options.clone());
        // 32 is the family's coarsest stride.
        let input = input_size(&self.model, size_in_steps(frame, options.input_size, 32));
        let infer = |pixels: &RgbImage| {
            let raw = self.infer(pixels)?;
            let found = |classes: &Classes| raw.candidates(&classes.wanted, options.confidence as f32);
            Ok((self.classes.as_ref().map(found).unwrap_or_default(), raw.prototypes))
        };
        let mask = |candidate: &_, boxed: &_, prototypes: &_| mask_of(candidate, boxed, input, prototypes, frame);
        let found = segment_views(image, input, &options, infer, mask)?;
        Ok(self.classes.as_ref().map(|classes| classes.detections(found)).unwrap_or_default())
    }
}

/// The two outputs of one run, their shapes checked.
struct Raw {
    /// [1, 4 + C + K, N].
    boxes: Tensor,
    /// [1, K, h, w].
    prototypes: Tensor,
}

impl Raw {
    /// Checks the shapes; an error is the shape at fault and the expected one.
    fn new(outputs: Vec<Tensor>) -> Result<Self, (Vec<usize>, String)> {
        let mut outputs = outputs.into_iter();
        let (Some(boxes), Some(prototypes)) = (outputs.next(), outputs.next()) else {
            return Err((Vec::new(), "two outputs".into()));
        };
        let [1, k, height, width] = prototypes.shape[..] else {
            return Err((prototypes.shape, "prototypes [1, k, h, w]".into()));
        };
        let [1, rows, _] = boxes.shape[..] else {
            return Err((boxes.shape, "boxes [1, 4 + classes + k, n]".into()));
        };
        if rows <= 4 + k || height == 0 || width == 0 {
            return Err((boxes.shape, format!("boxes with more than 4 + {k} rows, and prototypes that are not empty")));
        }
        Ok(Self { boxes, prototypes })
    }

    fn num_classes(&self) -> usize {
        self.boxes.shape[1] - 4 - self.prototypes.shape[1]
    }

    /// Candidates of wanted classes with sufficient score; corners in input pixels.
    fn candidates(&self, wanted: &[bool], min_confidence: f32) -> Vec<Candidate<Vec<f32>>> {
        let (n, num_classes) = (self.boxes.shape[2], self.num_classes());
        let row = |r: usize| &self.boxes.values[r * n..(r + 1) * n];
        let mut best: Vec<(f32, usize)> = vec![(0.0, 0); n];
        for class_idx in 0..num_classes {
            for (best, &score) in best.iter_mut().zip(row(4 + class_idx)) {
                if score > best.0 {
                    *best = (score, class_idx);
                }
            }
        }
        let rows = self.boxes.shape[1];
        let column = |i: usize, (confidence, class_idx): (f32, usize)| {
            let (x, y, w, h) = (row(0)[i], row(1)[i], row(2)[i], row(3)[i]);
            let corners = [x - w / 2.0, y - h / 2.0, x + w / 2.0, y + h / 2.0];
            let mask = (4 + num_classes..rows).map(|r| row(r)[i]).collect();
            Candidate { corners, class_idx, confidence, cut: false, view_idx: 0, mask }
        };
        let sure = |&(_, (score, class)): &(usize, (f32, usize))| {
            score >= min_confidence && wanted.get(class).copied().unwrap_or(false)
        };
        let found = best.into_iter().enumerate().filter(sure).map(|(i, best)| column(i, best));
        found.filter(|c| c.corners.iter().all(|v| v.is_finite())).collect()
    }
}

/// Mask of an object: pixels of its box whose centres have a mask value above one half.
fn mask_of(
    candidate: &Candidate<Vec<f32>>,
    boxed: &Letterbox,
    input: (u32, u32),
    prototypes: &Tensor,
    frame: (u32, u32),
) -> Mask {
    let (height, width) = (prototypes.shape[2], prototypes.shape[3]);
    let (per_x, per_y) = (width as f32 / input.0 as f32, height as f32 / input.1 as f32);
    let cell = |x: f32, y: f32| {
        let [u, v] = boxed.input_from_frame(x, y);
        [u * per_x, v * per_y]
    };
    let [x0, y0, x1, y1] = candidate.corners;
    let ([u0, v0], [u1, v1]) = (cell(x0, y0), cell(x1, y1));
    let columns = around(u0, u1, width);
    let rows = around(v0, v1, height);
    let values = combine(candidate, prototypes, columns.clone(), rows.clone());
    let plane = Plane { width: columns.len(), height: rows.len(), values: &values };
    mask_in(candidate.corners, frame, |x, y| {
        let [u, v] = cell(x, y);
        plane.sample(u - columns.start as f32, v - rows.start as f32) > 0.5
    })
}

/// Cells needed to interpolate positions between `first` and `last`; never empty.
fn around(first: f32, last: f32, len: usize) -> std::ops::Range<usize> {
    let start = ((first - 1.0).floor().max(0.0) as usize).min(len - 1);
    start..((last + 1.0).ceil().max(0.0) as usize).clamp(start + 1, len)
}

/// sigmoid(coefficients · prototypes) over a block of cells.
fn combine(
    candidate: &Candidate<Vec<f32>>,
    prototypes: &Tensor,
    columns: std::ops::Range<usize>,
    rows: std::ops::Range<usize>,
) -> Vec<f32> {
    let (height, width) = (prototypes.shape[2], prototypes.shape[3]);
    let mut values = vec![0.0; columns.len() * rows.len()];
    let planes = prototypes.values.chunks_exact(height * width);
    for (&coefficient, plane) in candidate.mask.iter().zip(planes) {
        for (out, y) in values.chunks_exact_mut(columns.len()).zip(rows.clone()) {
            let source = &plane[y * width + columns.start..y * width + columns.end];
            for (value, &prototype) in out.iter_mut().zip(source) {
                *value += coefficient * prototype;
            }
        }
    }
    for value in &mut values {
        *value = 1.0 / (1.0 + (-*value).exp());
    }
    values
}
