//! Mask R-CNN as torchvision exports it (He, Gkioxari, Dollár, Girshick, 2017).
//!
//! Input: one image [3, h, w] or [1, 3, h, w], RGB between 0 and 1; the network scales it itself, so inputs of free
//! size take the frame at its own. Outputs, in any order: boxes [n, 4] (corners in input pixels), labels [n] (0 is the
//! background), scores [n] and masks of probabilities. These are either [n, 1, m, m], each relative to its box, or
//! pasted into the input, [n, 1, h, w]. An object's mask is where the probability, interpolated at the frame's pixels,
//! exceeds one half.
//!
//! Outside its box a relative mask is 0, and it is interpolated towards that, as torchvision does
//! (`paste_masks_in_image`); torchvision's boxes are whole pixels there, which makes its masks larger by up to a pixel.

use ::image::RgbImage;

use super::classes::{Classes, class_names_after_background};
use super::letterbox::Letterbox;
use super::suppression::Candidate;
use super::tiles::mask_in;
use super::{SegmentationOptions, Segmenter, segment_views};
use crate::ffi::onnx::{Model, Tensor, TensorInfo};
use crate::networks::PerceptionError;
use crate::networks::description::{Preprocessing, sidecar_path};
use crate::networks::tensor::{Plane, input_size, tensor_from_image};
use crate::scene::{Detection, Mask};

/// Margin of a pasted mask beyond its box, as a share of the box's sides (one cell of 28), in addition to one pixel.
const PASTED_MARGIN: f32 = 1.0 / 28.0;

/// Indices of the outputs, if a network's inputs and outputs are those of the family.
pub(super) fn recognise(model: &Model) -> Option<OutputIndices> {
    let [input] = model.inputs() else { return None };
    let is_image = match input.shape[..] {
        [channels, _, _] => channels == Some(3),
        [batch, channels, _, _] => batch.is_none_or(|b| b == 1) && channels == Some(3),
        _ => false,
    };
    OutputIndices::find(model.outputs()).filter(|_| is_image)
}

/// Indices of the four outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct OutputIndices {
    boxes: usize,
    labels: usize,
    scores: usize,
    masks: usize,
}

impl OutputIndices {
    /// Finds the four outputs by their ranks and number types; `None` unless each occurs once.
    fn find(outputs: &[TensorInfo]) -> Option<Self> {
        let only = |fits: &dyn Fn(&TensorInfo) -> bool| {
            let mut places = (0..outputs.len()).filter(|&k| fits(&outputs[k]));
            places.next().filter(|_| places.next().is_none())
        };
        let is_float = |info: &TensorInfo| info.element == "f32";
        let or_open = |side: Option<usize>, length: usize| side.is_none_or(|s| s == length);
        Some(Self {
            boxes: only(&|o| is_float(o) && o.shape.len() == 2 && or_open(o.shape[1], 4))?,
            labels: only(&|o| o.element.starts_with(['i', 'u']) && o.shape.len() == 1)?,
            scores: only(&|o| is_float(o) && o.shape.len() == 1)?,
            masks: only(&|o| is_float(o) && o.shape.len() == 4 && or_open(o.shape[1], 1))?,
        })
    }
}

/// A loaded network of the family.
pub(super) struct MaskRcnn {
    model: Model,
    options: SegmentationOptions,
    places: OutputIndices,
    classes: Classes,
}

impl MaskRcnn {
    /// Takes a network that [`recognise`] accepted.
    pub(super) fn new(
        model: Model,
        places: OutputIndices,
        options: &SegmentationOptions,
    ) -> Result<Self, PerceptionError> {
        let classes = Classes::new(&model, class_names_after_background(&model)?, &options.classes)?;
        if classes.wanted.first() == Some(&true) {
            return Err(PerceptionError::Description {
                path: sidecar_path(model.path()),
                reason: format!(
                    "class 0 of a Mask R-CNN is the background, found {:?}; begin with \"background\"",
                    classes.names[0]
                ),
            });
        }
        Ok(Self { model, options: options.clone(), places, classes })
    }

    /// Runs the network on one view. Free sides of its input are those of the frame.
    fn infer(&mut self, pixels: &RgbImage) -> Result<CheckedOutputs, PerceptionError> {
        let mut input = tensor_from_image(pixels, &Preprocessing::default());
        if self.model.inputs()[0].shape.len() == 3 {
            input.shape.remove(0);
        }
        let outputs = self.model.run(&[input])?;
        let num_classes = self.classes.names.len();
        CheckedOutputs::new(outputs, self.places, pixels.dimensions(), num_classes)
            .map_err(|(found, expected)| PerceptionError::output(&self.model, Some(found), expected))
    }
}

impl Segmenter for MaskRcnn {
    fn segment(&mut self, image: &RgbImage) -> Result<Vec<Detection>, PerceptionError> {
        let (frame, options) = (image.dimensions(), self.options.clone());
        let input = input_size(&self.model, frame);
        let infer = |pixels: &RgbImage| {
            let answer = self.infer(pixels)?;
            Ok((answer.candidates(&self.classes.wanted, options.confidence as f32), answer))
        };
        let mask = |candidate: &Candidate<usize>, boxed: &_, answer: &CheckedOutputs| {
            answer.mask(candidate.mask, boxed, frame)
        };
        let found = segment_views(image, input, &options, infer, mask)?;
        Ok(self.classes.detections(found))
    }
}

/// Extent of a mask's values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Spread {
    /// The object's box.
    Box,
    /// The whole input.
    Input,
}

/// Outputs of the network for one view, with checked shapes.
#[derive(Debug)]
struct CheckedOutputs {
    /// [n, 4], corners in input pixels.
    boxes: Tensor,
    /// [n].
    labels: Vec<usize>,
    /// [n].
    scores: Vec<f32>,
    /// [n, 1, h, w].
    masks: Tensor,
    spread: Spread,
}

impl CheckedOutputs {
    /// Checks the shapes of a run's outputs; an error is the shape at fault and the expected one.
    fn new(
        mut outputs: Vec<Tensor>,
        places: OutputIndices,
        input: (u32, u32),
        num_classes: usize,
    ) -> Result<Self, (Vec<usize>, String)> {
        let none = || Tensor::zeros(&[0]);
        let mut take = |place: usize| outputs.get_mut(place).map_or_else(none, |t| std::mem::replace(t, none()));
        let [boxes, labels, scores, masks] = [places.boxes, places.labels, places.scores, places.masks].map(&mut take);
        let n = scores.values.len();
        if boxes.shape != [n, 4] || labels.shape != [n] {
            return Err((boxes.shape, format!("boxes [{n}, 4] and labels [{n}], for {n} scores")));
        }
        let [num_masks, 1, height, width] = masks.shape[..] else {
            return Err((masks.shape, "masks [n, 1, h, w]".to_owned()));
        };
        if num_masks != n || (n > 0 && (height == 0 || width == 0)) {
            return Err((masks.shape, format!("{n} masks, none of them empty")));
        }
        let labels: Vec<usize> = labels.values.iter().map(|&label| label as usize).collect();
        if let Some(label) = labels.iter().find(|&&label| label >= num_classes) {
            return Err((vec![*label], format!("labels below {num_classes}, the number of class names")));
        }
        let pasted = (width, height) == (input.0 as usize, input.1 as usize);
        let spread = if pasted { Spread::Input } else { Spread::Box };
        Ok(Self { boxes, labels, scores: scores.values, masks, spread })
    }

    /// Objects of wanted classes with sufficient score, with their rows.
    fn candidates(&self, wanted: &[bool], min_confidence: f32) -> Vec<Candidate<usize>> {
        let sure = |&row: &usize| {
            self.scores[row] >= min_confidence
                && wanted[self.labels[row]]
                && self.corners(row).iter().all(|v| v.is_finite())
        };
        let candidate = |row: usize| Candidate {
            corners: self.corners(row),
            class_idx: self.labels[row],
            confidence: self.scores[row],
            cut: false,
            view_idx: 0,
            mask: row,
        };
        (0..self.scores.len()).filter(sure).map(candidate).collect()
    }

    fn corners(&self, row: usize) -> [f32; 4] {
        std::array::from_fn(|k| self.boxes.values[4 * row + k])
    }

    /// Mask of an object: pixels in its box and a margin of one cell whose centres have a value above one half.
    fn mask(&self, row: usize, boxed: &Letterbox, frame: (u32, u32)) -> Mask {
        let (height, width) = (self.masks.shape[2], self.masks.shape[3]);
        let values = &self.masks.values[row * height * width..(row + 1) * height * width];
        let [x0, y0, x1, y1] = self.corners(row);
        let [box_width, box_height] = [x1 - x0, y1 - y0].map(|side| side.max(f32::EPSILON));
        match self.spread {
            Spread::Box => {
                let cell = [box_width / width as f32, box_height / height as f32];
                let (left, top) = (x0 - cell[0], y0 - cell[1]);
                let values = with_border(values, width, height);
                let plane = Plane { width: width + 2, height: height + 2, values: &values };
                let is_object = |u: f32, v: f32| plane.sample((u - left) / cell[0], (v - top) / cell[1]) > 0.5;
                pixels_of([left, top, x1 + cell[0], y1 + cell[1]], boxed, frame, is_object)
            }
            Spread::Input => {
                let plane = Plane { width, height, values };
                let margin = [box_width, box_height].map(|side| side * PASTED_MARGIN + 1.0);
                let corners = [x0 - margin[0], y0 - margin[1], x1 + margin[0], y1 + margin[1]];
                pixels_of(corners, boxed, frame, |u, v| plane.sample(u, v) > 0.5)
            }
        }
    }
}

/// Mask of the frame's pixels in a box of the input whose centres, as positions in the input, belong to the object.
fn pixels_of(
    [x0, y0, x1, y1]: [f32; 4],
    boxed: &Letterbox,
    frame: (u32, u32),
    is_object: impl Fn(f32, f32) -> bool,
) -> Mask {
    let ([left, top], [right, bottom]) = (boxed.frame_from_input(x0, y0), boxed.frame_from_input(x1, y1));
    mask_in([left, top, right, bottom], frame, |x, y| {
        let [u, v] = boxed.input_from_frame(x, y);
        is_object(u, v)
    })
}

/// Pads the values with a cell of zeros on every side.
fn with_border(values: &[f32], width: usize, height: usize) -> Vec<f32> {
    let mut padded = vec![0.0; (width + 2) * (height + 2)];
    for (target, row) in padded.chunks_exact_mut(width + 2).skip(1).zip(values.chunks_exact(width)) {
        target[1..=width].copy_from_slice(row);
    }
    padded
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::networks::segmentation::tiles::Tile;

    const PLACES: OutputIndices = OutputIndices { boxes: 0, labels: 1, scores: 2, masks: 3 };

    fn info(name: &str, element: &str, shape: &[Option<usize>]) -> TensorInfo {
        TensorInfo { name: name.into(), shape: shape.to_vec(), element: element.into() }
    }

    fn tensor(shape: &[usize], values: &[f32]) -> Tensor {
        Tensor { shape: shape.to_vec(), values: values.to_vec() }
    }

    /// One object at (8, 4)-(24, 12), of label 3, whose mask's left half is set.
    fn answer(mask: Tensor) -> Result<CheckedOutputs, (Vec<usize>, String)> {
        let outputs = vec![tensor(&[1, 4], &[8.0, 4.0, 24.0, 12.0]), tensor(&[1], &[3.0]), tensor(&[1], &[0.9]), mask];
        CheckedOutputs::new(outputs, PLACES, (32, 16), 4)
    }

    fn letterbox() -> Letterbox {
        Letterbox::place(&RgbImage::new(64, 32), Tile::whole(64, 32), (32, 16)).unwrap().0
    }

    #[test]
    fn outputs_are_known_by_rank_and_type_in_any_order() {
        let n = None;
        let mut outputs = vec![
            info("17", "f32", &[n, Some(1), n, n]),
            info("a", "i64", &[n]),
            info("b", "f32", &[n]),
            info("c", "f32", &[n, Some(4)]),
        ];
        assert_eq!(OutputIndices::find(&outputs), Some(OutputIndices { boxes: 3, labels: 1, scores: 2, masks: 0 }));
        outputs.push(info("d", "f32", &[n]));
        assert_eq!(OutputIndices::find(&outputs), None, "two that could be the scores");
        assert_eq!(OutputIndices::find(&outputs[..3]), None);
    }

    #[test]
    fn a_mask_spread_over_its_box_lies_there_in_the_frame() {
        let mask = answer(tensor(&[1, 1, 2, 4], &[1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0])).unwrap();
        assert_eq!(mask.spread, Spread::Box);
        let found = mask.mask(0, &letterbox(), (64, 32));
        // The frame is twice the input: the left half is (16, 8)-(32, 24), and beyond it the value is one half at the
        // border between the cells.
        let bounds = found.bounding_box().unwrap();
        assert_eq!((bounds.x0, bounds.y0, bounds.x1, bounds.y1), (16, 8, 32, 24));
        // Interpolated towards zero on two sides, a corner is rounded.
        assert_eq!(found.area_px2(), 232);
        assert!(!found.get(16, 8) && found.get(16, 12) && found.get(20, 8));
    }

    #[test]
    fn a_pasted_mask_lies_where_its_pixels_are() {
        let mut pasted = Tensor::zeros(&[1, 1, 16, 32]);
        for y in 4..12 {
            pasted.values[y * 32 + 8..y * 32 + 16].fill(1.0);
        }
        let mask = answer(pasted).unwrap();
        assert_eq!(mask.spread, Spread::Input);
        let found = mask.mask(0, &letterbox(), (64, 32));
        let bounds = found.bounding_box().unwrap();
        assert_eq!((bounds.x0, bounds.y0, bounds.x1, bounds.y1), (16, 8, 32, 24));
    }

    #[test]
    fn only_wanted_objects_with_sufficient_score_count() {
        let found = answer(Tensor::zeros(&[1, 1, 2, 2])).unwrap();
        assert_eq!(found.candidates(&[false, false, false, true], 0.5).len(), 1);
        assert_eq!(found.candidates(&[false, false, false, true], 0.95).len(), 0);
        assert_eq!(found.candidates(&[false, true, true, false], 0.5).len(), 0);
    }

    #[test]
    fn shapes_and_labels_that_do_not_fit_are_named() {
        assert!(answer(Tensor::zeros(&[1, 2, 4, 4])).unwrap_err().1.contains("[n, 1, h, w]"));
        assert!(answer(Tensor::zeros(&[2, 1, 4, 4])).unwrap_err().1.contains("1 masks"));
        assert!(answer(Tensor::zeros(&[1, 1, 0, 4])).unwrap_err().1.contains("none of them empty"));
        let outputs = |label: f32| {
            vec![Tensor::zeros(&[1, 4]), tensor(&[1], &[label]), tensor(&[1], &[0.5]), Tensor::zeros(&[1, 1, 2, 2])]
        };
        assert!(CheckedOutputs::new(outputs(4.0), PLACES, (32, 16), 4).unwrap_err().1.contains("below 4"));
        assert!(CheckedOutputs::new(outputs(3.0), PLACES, (32, 16), 4).is_ok());
        let nothing =
            vec![Tensor::zeros(&[0, 4]), Tensor::zeros(&[0]), Tensor::zeros(&[0]), Tensor::zeros(&[0, 1, 0, 0])];
        assert!(CheckedOutputs::new(nothing, PLACES, (32, 16), 4).unwrap().candidates(&[true; 4], 0.0).is_empty());
    }
}
