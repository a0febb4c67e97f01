//! The YOLOX family of detectors (Ge et al., *YOLOX: Exceeding YOLO Series in 2021*).
//!
//! Input: one image [1, 3, h, w], blue, green, red between 0 and 255, in the upper left corner, grey beyond. Output:
//! [1, n, 5 + C], one row per cell of three grids with the strides s = 8, 16, 32, the finest first, each row by row.
//! The row x, y, w, h, o, p₁ ... of the cell in column i and row j encodes, in pixels of the input, an object with its
//! centre at (s (i + x), s (j + y)), of the size s eʷ × s eʰ, of class c with the score o · p_c.

use std::borrow::Cow;
use std::path::Path;

use ::image::RgbImage;

use super::classes::{Classes, class_names};
use super::letterbox::{Anchor, Letterbox, fitted};
use super::tiles::Tile;
use super::{DetectorOptions, MAX_OBJECTS};
use crate::ffi::onnx::{Model, Resources, Tensor};
use crate::image::resize_rgb_quickly;
use crate::networks::PerceptionError;
use crate::networks::description::{ChannelOrder, Preprocessing};
use crate::networks::tensor::{input_size, tensor_from_image};
use crate::scene::{BoxDetection, DetectionSource, Rect};

/// Sides of a cell in pixels of the input, in the order of the output's rows. Free sides of an input are multiples of
/// the largest.
const STRIDES: [usize; 3] = [8, 16, 32];
/// Number of columns of the output before those of the classes.
const NUM_BOX_COLUMNS: usize = 5;

/// Loads a box detector; its family is recognised from its inputs and outputs. `resources` is its resource limit, or a
/// number of threads; 0 is one per core.
///
/// # Errors
/// [`PerceptionError::Option`] for invalid options; [`PerceptionError::UnknownLayout`] lists the network's layout and
/// the supported ones; [`PerceptionError::NoClassNames`] and [`PerceptionError::NoWantedClass`] give the problem with
/// its classes; errors of the runtime name the remedy.
pub fn load_detector(
    path: &Path,
    options: &DetectorOptions,
    resources: impl Into<Resources>,
) -> Result<Yolox, PerceptionError> {
    options.check()?;
    let model = Model::load(path, resources)?;
    if recognise(&model) {
        return Yolox::new(model, options);
    }
    Err(PerceptionError::unknown_layout(
        &model,
        "detection",
        "the YOLOX family: one image [1, 3, h, w] in; [1, n, 5 + classes] out, one row per cell of the \
                    strides 8, 16 and 32, not decoded",
    ))
}

/// Returns true if a network's inputs and outputs are those of the family.
fn recognise(model: &Model) -> bool {
    let ([input], [output]) = (model.inputs(), model.outputs()) else { return false };
    let image = input.shape.len() == 4 && input.shape[1].is_none_or(|channels| channels == 3);
    let [_, rows, Some(columns)] = output.shape[..] else { return false };
    let cells = match (input.shape.get(2), input.shape.get(3)) {
        (Some(Some(height)), Some(Some(width))) => Some(num_cells(*width, *height)),
        _ => None,
    };
    let fits = match (rows, cells) {
        (Some(rows), Some(cells)) => rows == cells,
        (Some(_), None) => false,
        (None, _) => true,
    };
    image && columns > NUM_BOX_COLUMNS && fits
}

/// Cells of all grids over an input.
fn num_cells(width: usize, height: usize) -> usize {
    STRIDES.iter().map(|stride| (width / stride) * (height / stride)).sum()
}

/// A loaded network of the family.
pub struct Yolox {
    model: Model,
    options: DetectorOptions,
    /// Names of the classes that are reported, by class number.
    wanted: Vec<Option<String>>,
}

impl Yolox {
    /// Takes a network that [`recognise`] accepted.
    fn new(model: Model, options: &DetectorOptions) -> Result<Self, PerceptionError> {
        let columns = model.outputs()[0].shape[2].unwrap_or(0);
        let names = class_names(&model, columns.saturating_sub(NUM_BOX_COLUMNS))?;
        let Classes { names, wanted } = Classes::new(&model, names, &options.classes)?;
        let wanted = names.into_iter().zip(wanted).map(|(name, wanted)| wanted.then_some(name)).collect();
        Ok(Self { model, options: options.clone(), wanted })
    }

    /// Widths and heights of the inputs for a frame: the network's own, or for each scale the smallest that contains
    /// the frame scaled to the requested size.
    fn input_sizes(&self, frame: (u32, u32)) -> Vec<(u32, u32)> {
        let size = |&scale: &f64| {
            let ratio = scale * f64::from(self.options.input_size) / f64::from(frame.0.max(frame.1).max(1));
            let open =
                |length: u32| ((f64::from(length) * ratio).round() as u32).max(1).next_multiple_of(STRIDES[2] as u32);
            input_size(&self.model, (open(frame.0), open(frame.1)))
        };
        let mut sizes: Vec<(u32, u32)> = self.options.scales.iter().map(size).collect();
        sizes.sort_unstable();
        sizes.dedup();
        sizes
    }

    /// Detects objects in an image at one size of the network's input; boxes in pixels of the frame.
    fn detect_at(
        &mut self,
        picture: &RgbImage,
        frame: (u32, u32),
        input: (u32, u32),
    ) -> Result<Vec<BoxDetection>, PerceptionError> {
        let size = picture.dimensions();
        let (boxed, pixels) = Letterbox::place_at(picture, Tile::whole(size.0, size.1), input, Anchor::TopLeft)?;
        let output = self.run(&pixels)?;
        let found = decode(&output.values, input, &self.wanted, self.options.confidence);
        let in_picture = found.into_iter().filter_map(|detection| in_frame(detection, &boxed, size));
        let enlarged = [f64::from(frame.0) / f64::from(size.0), f64::from(frame.1) / f64::from(size.1)];
        Ok(in_picture.map(|found| BoxDetection { rect: found.rect.scaled(enlarged), ..found }).collect())
    }

    /// Runs the network; one row per cell.
    fn run(&mut self, pixels: &RgbImage) -> Result<Tensor, PerceptionError> {
        let bytes = Preprocessing { order: ChannelOrder::Bgr, scale: 1.0, ..Preprocessing::default() };
        let mut outputs = self.model.run(&[tensor_from_image(pixels, &bytes)])?;
        let rows = num_cells(pixels.width() as usize, pixels.height() as usize);
        let expected = [1, rows, NUM_BOX_COLUMNS + self.wanted.len()];
        let (found, expected) = match outputs.pop() {
            Some(output) if output.shape == expected && is_decoded(&output) => {
                let plain = "boxes that are not decoded; export without --decode_in_inference";
                (Some(output.shape), plain.to_owned())
            }
            Some(output) if outputs.is_empty() && output.shape == expected => return Ok(output),
            other => {
                let rows = format!("{expected:?}, one row per cell of the strides 8, 16 and 32");
                (other.map(|output| output.shape), rows)
            }
        };
        Err(PerceptionError::output(&self.model, found, expected))
    }
}

/// Returns true if the output has sides in pixels rather than their logarithms, some of which would be negative.
fn is_decoded(output: &Tensor) -> bool {
    output.values.chunks_exact(output.shape[2]).all(|row| row[2] >= 0.0 && row[3] >= 0.0)
}

impl Yolox {
    /// Detects the objects of `image`; highest confidence first.
    ///
    /// # Errors
    /// The network cannot be run or its output has a shape that its family does not allow.
    pub fn detect(&mut self, image: &RgbImage) -> Result<Vec<BoxDetection>, PerceptionError> {
        let frame = image.dimensions();
        if image.is_empty() {
            return Ok(Vec::new());
        }
        let mut found = Vec::new();
        let mut picture = Cow::Borrowed(image);
        // The largest first: halving its image takes a tenth of the time of shrinking the frame again.
        for input in self.input_sizes(frame).into_iter().rev() {
            let (width, height) = fitted(picture.dimensions(), input);
            if (width, height) != picture.dimensions() {
                picture = Cow::Owned(resize_rgb_quickly(&picture, width, height)?);
            }
            found.extend(self.detect_at(&picture, frame, input)?);
        }
        Ok(surest(found, self.options.nms_iou))
    }
}

/// Decodes the rows of an output; boxes in pixels of the input (width, height). `wanted` has one entry per class.
fn decode(values: &[f32], input: (u32, u32), wanted: &[Option<String>], min_confidence: f64) -> Vec<BoxDetection> {
    let mut found = Vec::new();
    let mut rows = values.chunks_exact(NUM_BOX_COLUMNS + wanted.len());
    for stride in STRIDES {
        let columns = (input.0 as usize / stride).max(1);
        let cells = columns * (input.1 as usize / stride);
        for (cell, row) in rows.by_ref().take(cells).enumerate() {
            let Some((class, confidence)) = best_class(row, wanted) else { continue };
            if confidence >= min_confidence {
                let rect = cell_box(row, [cell % columns, cell / columns], stride as f64);
                found.push(BoxDetection {
                    class: class.to_owned(),
                    confidence,
                    rect,
                    finder: DetectionSource::Detector,
                });
            }
        }
    }
    found
}

/// Best class of a row and its score; `None` where the class is not wanted.
fn best_class<'a>(row: &[f32], wanted: &'a [Option<String>]) -> Option<(&'a str, f64)> {
    let (objectness, scores) = (row[NUM_BOX_COLUMNS - 1], &row[NUM_BOX_COLUMNS..]);
    let (class, best) = scores.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1).then(b.0.cmp(&a.0)))?;
    let name = wanted.get(class)?.as_deref()?;
    Some((name, f64::from(objectness * best)))
}

/// Decodes the box of a row, for the cell in a column and row of its grid; pixels of the input.
fn cell_box(row: &[f32], [column, line]: [usize; 2], stride: f64) -> Rect {
    let [x, y, w, h] = [0, 1, 2, 3].map(|k| f64::from(row[k]));
    let (x, y) = (stride * (column as f64 + x), stride * (line as f64 + y));
    let (half_w, half_h) = (stride * w.exp() / 2.0, stride * h.exp() / 2.0);
    Rect { x0: x - half_w, y0: y - half_h, x1: x + half_w, y1: y + half_h }
}

/// Clips a box to the frame, in its pixels; `None` where it is outside.
fn in_frame(detection: BoxDetection, boxed: &Letterbox, frame: (u32, u32)) -> Option<BoxDetection> {
    let Rect { x0, y0, x1, y1 } = detection.rect;
    let [x0, y0] = boxed.frame_from_input(x0 as f32, y0 as f32).map(f64::from);
    let [x1, y1] = boxed.frame_from_input(x1 as f32, y1 as f32).map(f64::from);
    // A side that is not a number would be clipped to the frame's.
    let finite = [x0, y0, x1, y1].iter().all(|side| side.is_finite());
    let rect = Rect { x0, y0, x1, y1 }.clipped(frame.0, frame.1);
    (finite && rect.area_px2() > 0.0).then_some(BoxDetection { rect, ..detection })
}

/// Non-maximum suppression of boxes that overlap by more than `max_iou`; highest score first.
fn surest(mut found: Vec<BoxDetection>, max_iou: f64) -> Vec<BoxDetection> {
    found.sort_by(|a, b| b.confidence.total_cmp(&a.confidence));
    let mut kept: Vec<BoxDetection> = Vec::new();
    for candidate in found {
        if kept.len() < MAX_OBJECTS && kept.iter().all(|k| k.rect.iou(&candidate.rect) <= max_iou) {
            kept.push(candidate);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of an input of 64 × 32 with two classes, of which only the second is wanted; all scores zero.
    fn quiet() -> (Vec<f32>, [Option<String>; 2]) {
        (vec![0.0; num_cells(64, 32) * 7], [None, Some("car".to_owned())])
    }

    fn set(values: &mut [f32], row: usize, content: [f32; 7]) {
        values[row * 7..(row + 1) * 7].copy_from_slice(&content);
    }

    #[test]
    fn boxes_are_decoded_by_the_grid_of_their_row() {
        let (mut values, wanted) = quiet();
        assert_eq!(num_cells(64, 32), 8 * 4 + 4 * 2 + 2);
        // Column 3, row 2 of the grid of stride 8; column 1, row 1 of that of 16; column 1 of that of 32.
        set(&mut values, 2 * 8 + 3, [0.5, 0.25, 0.0, 2.0_f32.ln(), 0.5, 0.0, 0.5]);
        set(&mut values, 32 + 4 + 1, [0.0, 0.0, 0.0, 0.0, 1.0, 0.25, 0.5]);
        set(&mut values, 32 + 8 + 1, [0.5, 0.5, -0.5, -0.5, 1.0, 0.9, 0.5]);
        let found = decode(&values, (64, 32), &wanted, 0.25);
        assert_eq!(found.len(), 2, "the third is surer of a class that is not wanted: {found:?}");
        assert_eq!(found[0].confidence, 0.25);
        let near =
            |a: Rect, b: [f64; 4]| [a.x0 - b[0], a.y0 - b[1], a.x1 - b[2], a.y1 - b[3]].iter().all(|d| d.abs() < 1e-5);
        assert!(near(found[0].rect, [24.0, 10.0, 32.0, 26.0]), "{found:?}");
        assert!(near(found[1].rect, [8.0, 8.0, 24.0, 24.0]), "{found:?}");
        assert_eq!(decode(&values, (64, 32), &wanted, 0.3).len(), 1);
    }

    #[test]
    fn boxes_that_are_decoded_already_are_known_by_their_sides() {
        let output = |side: f32| Tensor { shape: vec![1, 2, 6], values: [[1.0, 1.0, 9.0, side, 0.5, 0.5]; 2].concat() };
        assert!(is_decoded(&output(16.0)));
        assert!(!is_decoded(&output(-0.3)));
    }

    #[test]
    fn boxes_end_at_the_frame_and_nonsense_is_dropped() {
        let frame = RgbImage::new(128, 50);
        let (boxed, _) = Letterbox::place_at(&frame, Tile::whole(128, 50), (64, 32), Anchor::TopLeft).unwrap();
        let found = |rect: Rect| {
            let class = "car".to_owned();
            in_frame(
                BoxDetection { class, confidence: 0.5, rect, finder: DetectionSource::Detector },
                &boxed,
                (128, 50),
            )
        };
        let half = found(Rect { x0: 10.0, y0: -3.0, x1: 20.0, y1: 40.0 }).unwrap();
        assert_eq!(half.rect, Rect { x0: 20.0, y0: 0.0, x1: 40.0, y1: 50.0 });
        assert_eq!(found(Rect { x0: 0.0, y0: 26.0, x1: 9.0, y1: 31.0 }), None, "in the grey below the frame");
        assert_eq!(found(Rect { x0: f64::NAN, y0: 0.0, x1: f64::INFINITY, y1: 9.0 }), None);
    }

    #[test]
    fn the_best_of_overlapping_boxes_is_kept_for_any_class() {
        let detection = |class: &str, confidence: f64, x0: f64| BoxDetection {
            class: class.to_owned(),
            confidence,
            rect: Rect { x0, y0: 0.0, x1: x0 + 10.0, y1: 10.0 },
            finder: DetectionSource::Detector,
        };
        let all = vec![detection("car", 0.4, 0.0), detection("truck", 0.6, 1.0), detection("car", 0.3, 6.0)];
        let kept = surest(all, 0.6);
        assert_eq!(kept.iter().map(|d| d.confidence).collect::<Vec<_>>(), [0.6, 0.3]);
    }
}
