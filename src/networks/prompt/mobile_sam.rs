//! Masks of boxes by MobileSAM (Zhang et al., *Faster Segment Anything*, 2023) or a network with the same interface.
//!
//! An encoder embeds a window of the frame, and a decoder predicts the mask of the object in a box.
//!
//! Encoder: image [1, 3, H, W], RGB, (v − mean) / std, H and W multiples of 16, zero where the window does not fill it;
//! output: embedding [1, c, H/16, W/16]. Decoder: the embedding; points [1, 2, 2], corners of the box in pixels of the
//! input, the center of the first pixel at 0; labels [1, 2], 2 and 3 (first and second corner); output: logits [1, m,
//! H/4, W/4] and the expected overlap of each mask, [1, m].
//!
//! **Window.** Objects that are small in the input are segmented badly, so the window is only a few times as large as
//! the box. Boxes inside a window that are not too small for it share it (`window`), since the encoder takes nearly all
//! of the time.
//!
//! **Selection of the mask.** The network predicts several masks, from a part of the object to everything that moves
//! with it, and its expected overlap often prefers the part. The box is the better criterion. The quality of a mask is
//! the product of its expected overlap, of its stability (the IoU of the masks at two thresholds of the logits, one
//! above and one below zero), and of the agreement of its bounding box with the box prompt. The mask of the highest
//! quality is selected. Masks of no object, such as a piece of road between two shadows, may have a high expected
//! overlap, but they are rarely stable.

use std::path::Path;

use ::image::RgbImage;

use super::local::LocalMask;
use super::options::{CONFIRMED_OVERLAP, MASK_MARGIN, PromptOptions};
use super::outline::largest_component;
use super::window::{Placement, SharedWindow, Window, shared_windows};
use super::{BoxMask, BoxSegmenter, agreement, fills, visible};
use crate::ffi::onnx::{Model, Resources, Tensor, TensorInfo};
use crate::networks::PerceptionError;
use crate::networks::description::Preprocessing;
use crate::networks::tensor::{Plane, tensor_from_image};
use crate::scene::{Mask, Rect};

/// Side of a cell of the logits, pixels of the input.
const LOGIT_STEP: f64 = 4.0;
/// Offset of the two thresholds of the logits between which the stability of a mask is measured.
const STABILITY_OFFSET: f32 = 1.0;
/// Minimum quality of a mask for a second prompt with its bounding box.
const LOOSE_QUALITY: f64 = 0.5;
/// Minimum share of the mask's area in the whole input that is within the margin of the box.
const MIN_INSIDE: f64 = 0.8;

/// Loads the encoder and the decoder.
///
/// * `resources` – resource limits of each part, or a number of threads; 0 is one per core.
///
/// # Errors
/// [`PerceptionError::Option`] for invalid options; [`PerceptionError::UnknownLayout`] for a part with other inputs or
/// outputs; errors of the runtime describe its installation.
pub fn load_box_segmenter(
    encoder: &Path,
    decoder: &Path,
    options: &PromptOptions,
    resources: impl Into<Resources>,
) -> Result<Box<dyn BoxSegmenter>, PerceptionError> {
    options.check()?;
    let resources = resources.into();
    let encoder = Model::load(encoder, resources)?;
    let decoder = Model::load(decoder, resources)?;
    refuse_unless(is_encoder(&encoder), &encoder, "an encoder: image [1, 3, H, W] in, embedding [1, c, h, w] out")?;
    refuse_unless(
        is_decoder(&decoder),
        &decoder,
        "a decoder: embedding [1, c, h, w], points [1, n, 2], labels [1, n] in; masks [1, m, h, w], scores [1, m] out",
    )?;
    Ok(Box::new(MobileSam { encoder, decoder, options: options.clone() }))
}

fn ranks(tensors: &[TensorInfo]) -> Vec<usize> {
    tensors.iter().map(|tensor| tensor.shape.len()).collect()
}

fn is_encoder(model: &Model) -> bool {
    ranks(model.inputs()) == [4] && ranks(model.outputs()) == [4] && model.inputs()[0].shape[1] == Some(3)
}

fn is_decoder(model: &Model) -> bool {
    ranks(model.inputs()) == [4, 3, 2] && ranks(model.outputs()) == [4, 2]
}

fn refuse_unless(fits: bool, model: &Model, supported: &'static str) -> Result<(), PerceptionError> {
    if fits {
        return Ok(());
    }
    Err(PerceptionError::unknown_layout(model, "box mask", supported))
}

/// Loaded encoder and decoder with their options.
struct MobileSam {
    encoder: Model,
    decoder: Model,
    options: PromptOptions,
}

impl BoxSegmenter for MobileSam {
    fn masks(&mut self, image: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError> {
        let frame = image.dimensions();
        let boxes: Vec<Rect> = boxes.iter().map(|rect| visible(rect, frame)).collect();
        let mut found = vec![None; boxes.len()];
        for SharedWindow { window, boxes: inside } in shared_windows(&boxes, frame, &self.options) {
            let (embedding, placement) = self.encode(image, window)?;
            for b in inside {
                found[b] = self.segment(&embedding, &placement, &boxes[b], frame)?;
            }
        }
        Ok(found)
    }

    fn is_coarse(&self) -> bool {
        false
    }
}

impl MobileSam {
    /// Encodes a window of the frame.
    fn encode(&mut self, image: &RgbImage, window: Window) -> Result<(Tensor, Placement), PerceptionError> {
        let placement = Placement::new(window, self.options.input_size);
        let pixels = tensor_from_image(&placement.pixels(image, window)?, &imagenet());
        let mut outputs = self.encoder.run(&[padded(&pixels, placement.input)])?;
        match outputs.pop() {
            Some(embedding) if outputs.is_empty() && embedding.shape.len() == 4 => Ok((embedding, placement)),
            other => Err(wrong_output(&self.encoder, other, "one embedding [1, c, h, w]")),
        }
    }

    /// Segments the object in a box.
    ///
    /// If the box is too large for a clear mask in it, as boxes of motion are, a second run is prompted with the
    /// bounding box of the mask.
    fn segment(
        &mut self,
        embedding: &Tensor,
        placement: &Placement,
        rect: &Rect,
        frame: (u32, u32),
    ) -> Result<Option<BoxMask>, PerceptionError> {
        let outputs = self.decode(embedding, placement, rect)?;
        if let Some(found) = best(&outputs, placement, rect, frame, &self.options) {
            return Ok(Some(found));
        }
        let loose = PromptOptions { min_quality: LOOSE_QUALITY.min(self.options.min_quality), ..self.options.clone() };
        let Some(first) = best(&outputs, placement, rect, frame, &loose) else { return Ok(None) };
        let Some(tight) = first.mask.bounding_box().map(Rect::from) else { return Ok(None) };
        let outputs = self.decode(embedding, placement, &tight)?;
        let second = best(&outputs, placement, &tight, frame, &self.options);
        let lost = agreement(&tight, rect).sqrt();
        let confirmed = second.filter(|second| second.mask.iou(&first.mask) >= CONFIRMED_OVERLAP);
        let judged = confirmed.map(|second| BoxMask { quality: second.quality * lost, ..second });
        Ok(judged.filter(|found| found.quality >= self.options.min_quality))
    }

    /// Runs the decoder with a box prompt.
    fn decode(
        &mut self,
        embedding: &Tensor,
        placement: &Placement,
        rect: &Rect,
    ) -> Result<DecoderOutputs, PerceptionError> {
        let corners = [[rect.x0, rect.y0], [rect.x1, rect.y1]];
        let values = corners.map(|[x, y]| placement.input_from_frame(x, y).map(|v| (v - 0.5) as f32)).concat();
        let points = Tensor { shape: vec![1, 2, 2], values };
        // Labels of the first and second corner of a box.
        let labels = Tensor { shape: vec![1, 2], values: vec![2.0, 3.0] };
        let mut outputs = self.decoder.run(&[embedding.clone(), points, labels])?.into_iter();
        let (Some(masks), Some(scores)) = (outputs.next(), outputs.next()) else {
            return Err(wrong_output(&self.decoder, None, "masks and scores"));
        };
        let [1, num, height, width] = masks.shape[..] else {
            return Err(wrong_output(&self.decoder, Some(masks), "masks [1, m, h, w]"));
        };
        if scores.shape != [1, num] || width == 0 || height == 0 {
            return Err(wrong_output(&self.decoder, Some(scores), "one score for each mask, [1, m]"));
        }
        Ok(DecoderOutputs { width, height, logits: masks.values, scores: scores.values })
    }
}

/// RGB with the mean and standard deviation of ImageNet.
fn imagenet() -> Preprocessing {
    Preprocessing {
        mean: [123.675, 116.28, 103.53],
        std: [58.395, 57.12, 57.375],
        scale: 1.0,
        ..Preprocessing::default()
    }
}

/// A tensor [1, 3, h, w] with zeros to the right and below, up to an input's width and height.
fn padded(pixels: &Tensor, (width, height): (u32, u32)) -> Tensor {
    let (from_height, from_width) = (pixels.shape[2], pixels.shape[3]);
    let (height, width) = (height as usize, width as usize);
    let mut out = Tensor::zeros(&[1, 3, height, width]);
    for (row_idx, row) in pixels.values.chunks_exact(from_width).enumerate() {
        let (channel, y) = (row_idx / from_height, row_idx % from_height);
        let start = (channel * height + y) * width;
        out.values[start..start + from_width].copy_from_slice(row);
    }
    out
}

fn wrong_output(model: &Model, found: Option<Tensor>, expected: &str) -> PerceptionError {
    PerceptionError::output(model, found.map(|tensor| tensor.shape), expected)
}

/// Outputs of the decoder for one box.
struct DecoderOutputs {
    /// Width of a mask's logits, cells.
    width: usize,
    /// Height of a mask's logits, cells.
    height: usize,
    /// Logits of all masks, one mask after the other.
    logits: Vec<f32>,
    /// Expected overlap of each mask.
    scores: Vec<f32>,
}

/// Mask of the highest quality that passes all tests.
fn best(
    outputs: &DecoderOutputs,
    placement: &Placement,
    rect: &Rect,
    frame: (u32, u32),
    options: &PromptOptions,
) -> Option<BoxMask> {
    let mut best: Option<Candidate> = None;
    let planes = outputs.logits.chunks_exact(outputs.width * outputs.height);
    for (values, &score) in planes.zip(&outputs.scores) {
        let plane = Plane { width: outputs.width, height: outputs.height, values };
        let quality = f64::from(score).clamp(0.0, 1.0) * stability(&plane);
        // An upper bound: the agreement with the box only lowers it, and takes most of the time to compute.
        let is_worse = best.as_ref().is_some_and(|best| quality <= best.quality);
        if quality >= options.min_quality && !is_worse {
            let next = candidate(&plane, quality, placement, rect, frame, options);
            best = match (best, next) {
                (Some(best), Some(next)) if next.quality <= best.quality => Some(best),
                (best, next) => next.or(best),
            };
        }
    }
    best.map(|best| BoxMask { mask: best.mask.in_frame(frame), quality: best.quality })
}

/// Candidate mask of the object.
struct Candidate {
    mask: LocalMask,
    quality: f64,
}

/// Mask of a plane of logits, if it passes the tests.
///
/// Enough of its area must be within the margin of the box, its area relative to the box must be in range, and its
/// quality must suffice.
///
/// * `quality` – quality without the agreement with the box.
fn candidate(
    plane: &Plane<'_>,
    quality: f64,
    placement: &Placement,
    rect: &Rect,
    frame: (u32, u32),
    options: &PromptOptions,
) -> Option<Candidate> {
    let window = Window::of_pixels(&rect.grown(MASK_MARGIN), frame)?;
    let in_window = mask_in(plane, placement, window);
    let inside_px2 = in_window.area_px2() as f64;
    let local = LocalMask { window, mask: largest_component(&in_window) };
    let quality = quality * agreement(&local.rect()?, rect);
    let passes = inside_px2 >= MIN_INSIDE * everywhere_px2(plane, placement)
        && fills(&local.mask, rect)
        && quality >= options.min_quality;
    passes.then_some(Candidate { mask: local, quality })
}

/// Mask of the pixels of a window at whose centers the logits are positive.
fn mask_in(plane: &Plane<'_>, placement: &Placement, window: Window) -> Mask {
    Mask::from_fn(window.width, window.height, |x, y| {
        let [u, v] = placement.input_from_frame(f64::from(window.x0 + x) + 0.5, f64::from(window.y0 + y) + 0.5);
        plane.sample((u / LOGIT_STEP) as f32, (v / LOGIT_STEP) as f32) > 0.0
    })
}

/// IoU of the masks at a threshold above and one below zero, 0 to 1.
fn stability(plane: &Plane<'_>) -> f64 {
    let above = |threshold: f32| plane.values.iter().filter(|&&logit| logit > threshold).count() as f64;
    above(STABILITY_OFFSET) / above(-STABILITY_OFFSET).max(1.0)
}

/// Area of the mask in the whole input, in pixels of the frame.
fn everywhere_px2(plane: &Plane<'_>, placement: &Placement) -> f64 {
    let cells = plane.values.iter().filter(|&&logit| logit > 0.0).count();
    cells as f64 * LOGIT_STEP * LOGIT_STEP / placement.area_scale()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: (u32, u32) = (400, 300);
    const BOX: Rect = Rect { x0: 180.0, y0: 140.0, x1: 220.0, y1: 160.0 };

    /// Placement of the window: four pixels of the input per pixel of the frame, so a cell is a pixel.
    fn placement() -> Placement {
        Placement::new(Window { x0: 144, y0: 94, width: 112, height: 112 }, 448)
    }

    /// Outputs with one logit per pixel of the frame.
    fn output(logit: impl Fn(f64, f64) -> f32, score: f32) -> DecoderOutputs {
        let at = |cell: usize| logit(144.5 + (cell % 112) as f64, 94.5 + (cell / 112) as f64);
        DecoderOutputs { width: 112, height: 112, logits: (0..112 * 112).map(at).collect(), scores: vec![score] }
    }

    fn inside(rect: Rect) -> impl Fn(f64, f64) -> f32 {
        move |x, y| if rect.contains(x, y) { 5.0 } else { -5.0 }
    }

    fn judged(outputs: &DecoderOutputs) -> Option<BoxMask> {
        best(outputs, &placement(), &BOX, FRAME, &PromptOptions::default())
    }

    #[test]
    fn a_mask_that_fits_its_box_has_its_position_in_the_frame() {
        let found = judged(&output(inside(BOX), 0.9)).unwrap();
        let truth = Mask::from_fn(FRAME.0, FRAME.1, |x, y| BOX.contains(f64::from(x) + 0.5, f64::from(y) + 0.5));
        assert_eq!(found.mask, truth);
        assert!((found.quality - 0.9).abs() < 1e-6, "{}", found.quality);
    }

    #[test]
    fn edges_between_cells_are_interpolated() {
        // The logit decreases through zero at x = 200.25, between the centers of two cells.
        let found = output(|x, y| if BOX.contains(x, y) { (200.25 - x) as f32 } else { -5.0 }, 1.0);
        let plane = Plane { width: 112, height: 112, values: &found.logits };
        let window = Window::of_pixels(&BOX, FRAME).unwrap();
        let in_window = mask_in(&plane, &placement(), window);
        assert_eq!(in_window.bounding_box().unwrap().x1 + window.x0, 200);
        assert!(plane.sample(200.25 - 144.0, 150.0 - 94.0).abs() < 1e-4);
    }

    #[test]
    fn masks_of_no_object_fail_the_tests() {
        let grown = |share: f64| BOX.grown(share);
        assert_eq!(judged(&output(inside(BOX), 0.5)), None, "the network expects little");
        assert_eq!(judged(&output(inside(grown(1.0)), 1.0)), None, "it leaves the box on all sides");
        assert_eq!(judged(&output(inside(grown(-0.2)), 1.0)), None, "it fills too little of the box");
        assert_eq!(judged(&output(|_, _| -5.0, 1.0)), None, "there is nothing");
        assert_eq!(judged(&output(|_, _| f32::NAN, f32::NAN)), None, "there are no numbers");
        let unstable = |x: f64, y: f64| if BOX.contains(x, y) { 0.5 } else { -5.0 };
        assert_eq!(judged(&output(unstable, 1.0)), None, "it is not stable");
    }

    #[test]
    fn the_mask_that_fits_the_box_is_preferred_to_a_part_with_a_higher_expected_overlap() {
        let part = Rect { x1: 200.0, ..BOX };
        let (whole, part) = (output(inside(BOX), 0.85), output(inside(part), 1.0));
        let both = DecoderOutputs { logits: [part.logits, whole.logits].concat(), scores: vec![1.0, 0.85], ..whole };
        assert!((judged(&both).unwrap().quality - 0.85).abs() < 1e-6);
    }

    #[test]
    fn the_input_beyond_the_window_is_zero() {
        let pixels = Tensor { shape: vec![1, 3, 1, 2], values: vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0] };
        let input = padded(&pixels, (3, 2));
        assert_eq!(input.shape, [1, 3, 2, 3]);
        let expected = [1.0, 2.0, 0.0, 0.0, 0.0, 0.0, 3.0, 4.0, 0.0, 0.0, 0.0, 0.0, 5.0, 6.0, 0.0, 0.0, 0.0, 0.0];
        assert_eq!(input.values, expected);
    }
}
