//! Masks of boxes by the program's own small network (`models/box_masks.md`): one crop per box, one run per crop.
//!
//! Input: crop [1, 4, 128, 128]: RGB, (v − 128) / 64, and a box channel: 1 in the box, 0 around it, −1 beyond the
//! border of the frame. Output: logits [1, 1, 128, 128] and the expected overlap with the truth, [1, 1]. The box is in
//! the center of its crop, whose sides are [`MARGIN`] times as long; `models/make/box_masks/crops.py` has the same
//! geometry.

use std::path::Path;

use ::image::{Rgb, RgbImage};

use super::local::LocalMask;
use super::options::{CONFIRMED_OVERLAP, MASK_MARGIN, PromptOptions};
use super::outline::largest_component;
use super::window::Window;
use super::{BoxMask, BoxSegmenter, agreement, fills, visible};
use crate::ffi::onnx::{Model, Resources, Tensor};
use crate::image::resize_rgb;
use crate::networks::PerceptionError;
use crate::networks::tensor::{PAD, Plane};
use crate::scene::{Mask, Rect};

/// Side of the input and of the logits, pixels.
const SIDE: usize = 128;
/// Ratio of the sides of a crop to those of its box.
const MARGIN: f64 = 1.5;
/// Maximum aspect ratio of a crop: its shorter side is at least the longer one over this.
const MAX_STRETCH: f64 = 2.0;
/// Pixel value that is zero in the input, (v − `MEAN`) / `SCALE`.
const MEAN: f32 = 128.0;
/// Difference of pixel values that is one unit of the input.
const SCALE: f32 = 64.0;

/// Loads the network.
///
/// * `resources` – resource limits, or a number of threads; 0 is one per core.
///
/// # Errors
/// [`PerceptionError::Option`] for invalid options; [`PerceptionError::UnknownLayout`] for other inputs or outputs;
/// errors of the runtime describe its installation.
pub fn load_small_box_segmenter(
    path: &Path,
    options: &PromptOptions,
    resources: impl Into<Resources>,
) -> Result<Box<dyn BoxSegmenter>, PerceptionError> {
    options.check()?;
    let model = Model::load(path, resources)?;
    let shape_of_input = model.inputs().iter().map(|input| input.shape.as_slice()).collect::<Vec<_>>();
    let is_crop = matches!(shape_of_input[..], [[_, Some(4), Some(SIDE), Some(SIDE)]]);
    let ranks: Vec<usize> = model.outputs().iter().map(|output| output.shape.len()).collect();
    if is_crop && ranks == [4, 2] {
        return Ok(Box::new(BoxNet { model, options: options.clone() }));
    }
    Err(PerceptionError::unknown_layout(
        &model,
        "box mask",
        "a crop [n, 4, 128, 128] in; logits [n, 1, 128, 128] and quality [n, 1] out",
    ))
}

/// Loaded network with its options.
struct BoxNet {
    model: Model,
    options: PromptOptions,
}

impl BoxSegmenter for BoxNet {
    fn masks(&mut self, image: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError> {
        boxes.iter().map(|rect| self.segment(image, &visible(rect, image.dimensions()))).collect()
    }

    fn is_coarse(&self) -> bool {
        false
    }
}

impl BoxNet {
    /// Segments the object in a box.
    ///
    /// If the mask has a high quality but the box is loose, as boxes of motion are, a second run is prompted with the
    /// bounding box of the mask.
    fn segment(&mut self, image: &RgbImage, rect: &Rect) -> Result<Option<BoxMask>, PerceptionError> {
        let frame = image.dimensions();
        let Some(first) = self.predict(image, rect)? else { return Ok(None) };
        let (fits, min_quality) = (agreement(&first.rect, rect), self.options.min_quality);
        if first.quality * fits >= min_quality {
            return Ok(fills(&first.local.mask, rect).then(|| first.box_mask(fits, frame)));
        }
        if first.quality < min_quality {
            return Ok(None);
        }
        let tight = first.rect;
        let Some(second) = self.predict(image, &tight)? else { return Ok(None) };
        let fits = agreement(&second.rect, &tight) * fits.sqrt();
        let first = first.box_mask(1.0, frame).mask;
        let passes = fills(&second.local.mask, &tight) && second.quality * fits >= min_quality;
        let found = second.box_mask(fits, frame);
        Ok(Some(found).filter(|found| passes && found.mask.iou(&first) >= CONFIRMED_OVERLAP))
    }

    /// Runs the network on the crop of a box; `None` for an empty box or an empty mask.
    fn predict(&mut self, image: &RgbImage, rect: &Rect) -> Result<Option<Prediction>, PerceptionError> {
        let Some(crop) = Crop::of(rect) else { return Ok(None) };
        let Some(window) = Window::of_pixels(&rect.grown(MASK_MARGIN), image.dimensions()) else {
            return Ok(None);
        };
        let mut outputs = self.model.run(&[crop.tensor(image, rect)?])?.into_iter();
        let (logits, quality) = match (outputs.next(), outputs.next()) {
            (Some(logits), Some(quality)) if logits.shape == [1, 1, SIDE, SIDE] && quality.values.len() == 1 => {
                (logits.values, f64::from(quality.values[0]))
            }
            (found, _) => {
                let expected = "logits [1, 1, 128, 128] and one quality";
                return Err(PerceptionError::output(&self.model, found.map(|tensor| tensor.shape), expected));
            }
        };
        let mask = largest_component(&crop.mask_in(&logits, window));
        let local = LocalMask { window, mask };
        let quality = if quality.is_finite() { quality.clamp(0.0, 1.0) } else { 0.0 };
        Ok(local.rect().map(|rect| Prediction { local, rect, quality }))
    }
}

/// Output of the network for one box.
struct Prediction {
    local: LocalMask,
    /// Bounding box of the mask in the frame.
    rect: Rect,
    /// Expected overlap with the truth.
    quality: f64,
}

impl Prediction {
    fn box_mask(&self, fits: f64, frame: (u32, u32)) -> BoxMask {
        BoxMask { mask: self.local.in_frame(frame), quality: self.quality * fits }
    }
}

/// Input region of the network in whole pixels of the frame; it may extend beyond the border.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Crop {
    x0: i64,
    y0: i64,
    width: u32,
    height: u32,
}

impl Crop {
    /// Crop around a box; `None` for a box without area.
    fn of(rect: &Rect) -> Option<Self> {
        let (width, height) = (rect.width(), rect.height());
        if !(width > 0.0 && height > 0.0) {
            return None;
        }
        let along = |first: f64, last: f64, other: f64| {
            let half = 0.5 * MARGIN * (last - first).max(other / MAX_STRETCH);
            let middle = 0.5 * (first + last);
            let start = (middle - half).floor();
            (start as i64, ((middle + half).ceil() - start).max(1.0) as u32)
        };
        let (x0, width) = along(rect.x0, rect.x1, height);
        let (y0, height) = along(rect.y0, rect.y1, rect.width());
        Some(Self { x0, y0, width, height })
    }

    /// Converts a position in the frame to the input.
    fn input_from_frame(&self, x: f64, y: f64) -> [f64; 2] {
        let along = |at: f64, first: i64, length: u32| (at - first as f64) * SIDE as f64 / f64::from(length);
        [along(x, self.x0, self.width), along(y, self.y0, self.height)]
    }

    /// Input tensor of a box.
    fn tensor(&self, image: &RgbImage, rect: &Rect) -> Result<Tensor, PerceptionError> {
        let mut part = RgbImage::from_pixel(self.width, self.height, Rgb([PAD; 3]));
        ::image::imageops::replace(&mut part, image, -self.x0, -self.y0);
        let pixels = resize_rgb(&part, SIDE as u32, SIDE as u32)?;
        let mut tensor = Tensor::zeros(&[1, 4, SIDE, SIDE]);
        for (k, pixel) in pixels.pixels().enumerate() {
            for c in 0..3 {
                tensor.values[c * SIDE * SIDE + k] = (f32::from(pixel.0[c]) - MEAN) / SCALE;
            }
        }
        let (low, high) = (self.input_from_frame(rect.x0, rect.y0), self.input_from_frame(rect.x1, rect.y1));
        let [width, height] = [image.width(), image.height()].map(f64::from);
        let (first, last) = (self.input_from_frame(0.0, 0.0), self.input_from_frame(width, height));
        let channel = &mut tensor.values[3 * SIDE * SIDE..];
        for (y, row) in channel.chunks_exact_mut(SIDE).enumerate() {
            for (x, value) in row.iter_mut().enumerate() {
                let at = [x as f64, y as f64];
                let is_beyond = (0..2).any(|k| at[k] + 0.5 < first[k] || at[k] + 0.5 >= last[k]);
                let share = |k: usize| (high[k].min(at[k] + 1.0) - low[k].max(at[k])).clamp(0.0, 1.0);
                *value = if is_beyond { -1.0 } else { (share(0) * share(1)) as f32 };
            }
        }
        Ok(tensor)
    }

    /// Mask of the pixels of a window at whose centers the logits are positive.
    fn mask_in(&self, logits: &[f32], window: Window) -> Mask {
        let plane = Plane { width: SIDE, height: SIDE, values: logits };
        Mask::from_fn(window.width, window.height, |x, y| {
            let [u, v] = self.input_from_frame(f64::from(window.x0 + x) + 0.5, f64::from(window.y0 + y) + 0.5);
            let is_inside = [u, v].into_iter().all(|at| (0.0..SIDE as f64).contains(&at));
            is_inside && plane.sample(u as f32, v as f32) > 0.0
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RECT: Rect = Rect { x0: 40.0, y0: 30.0, x1: 72.0, y1: 46.0 };

    #[test]
    fn a_box_is_in_the_center_of_its_crop() {
        let crop = Crop::of(&RECT).unwrap();
        assert_eq!(crop, Crop { x0: 32, y0: 26, width: 48, height: 24 });
        let [x, y] = crop.input_from_frame(56.0, 38.0);
        assert!((x - 64.0).abs() < 1e-9 && (y - 64.0).abs() < 1e-9, "{x}, {y}");
        // The aspect ratio of a crop is limited to two.
        let long = Crop::of(&Rect { x1: 136.0, ..RECT }).unwrap();
        assert_eq!((long.width, long.height), (144, 72));
        assert_eq!(Crop::of(&Rect { x1: 40.0, ..RECT }), None);
    }

    #[test]
    fn the_box_channel_encodes_the_box_its_surroundings_and_the_region_beyond_the_image() {
        let image = RgbImage::from_pixel(68, 100, Rgb([192, 128, 64]));
        let rect = Rect { x1: 68.0, ..RECT };
        let crop = Crop::of(&rect).unwrap();
        let tensor = crop.tensor(&image, &rect).unwrap();
        let at = |c: usize, x: usize, y: usize| tensor.values[(c * SIDE + y) * SIDE + x];
        assert_eq!([0, 1, 2, 3].map(|c| at(c, 64, 64)), [1.0, 0.0, -1.0, 1.0], "in the box");
        assert_eq!(at(3, 64, 4), 0.0, "above the box");
        assert_eq!([at(0, 126, 64), at(3, 126, 64)], [(114.0 - 128.0) / 64.0, -1.0], "beyond the border");
        let area: f32 = tensor.values[3 * SIDE * SIDE..].iter().filter(|&&v| v > 0.0).sum();
        let expected = rect.area_px2() * (SIDE * SIDE) as f64 / f64::from(crop.width * crop.height);
        assert!((f64::from(area) / expected - 1.0).abs() < 0.01, "{area} for {expected}");
    }

    #[test]
    fn logits_are_read_at_the_centers_of_the_pixels() {
        let crop = Crop::of(&RECT).unwrap();
        let logits: Vec<f32> = (0..SIDE * SIDE)
            .map(|k| {
                let (x, y) = (k % SIDE, k / SIDE);
                let [x, y] = [x as f64 * 48.0 / 128.0 + 32.2, y as f64 * 24.0 / 128.0 + 26.1];
                if RECT.contains(x, y) { 5.0 } else { -5.0 }
            })
            .collect();
        let window = Window::of_pixels(&RECT.grown(0.3), (200, 200)).unwrap();
        let local = LocalMask { window, mask: crop.mask_in(&logits, window) };
        assert_eq!(local.rect(), Some(RECT));
    }
}
