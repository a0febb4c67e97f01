//! Coarse masks of boxes by GrabCut (Rother, Kolmogorov, Blake, 2004), where the mask network cannot run.
//!
//! GrabCut separates the colors inside the box from those around it by two Gaussian mixtures and a minimum cut. This is
//! OpenCV's implementation, on a downscaled crop of the frame around the box. Pixels outside the box are definite
//! background. Pixels in a central ellipse are definite foreground; without it the object is lost in every fifth box.
//! Shadows, windows and the ground between the wheels are assigned by their colors.

use ::image::{GrayImage, Luma, RgbImage};
use opencv::core::{self, Mat};
use opencv::imgproc;

use super::outline::largest_component;
use super::window::Window;
use super::{BoxMask, BoxSegmenter, PromptOptions, agreement, fills, visible};
use crate::image::{gray_from_mat, mat_from_gray, mat_from_rgb, resize_rgb};
use crate::networks::PerceptionError;
use crate::scene::{Mask, Rect};

/// Margin of background around the box in the crop, as a share of its longer side.
const BACKGROUND_MARGIN: f64 = 0.25;
/// Maximum longer side of the downscaled crop, pixels; crops are not enlarged.
const WORKING_SIDE: u32 = 160;
/// Axes of the ellipse of definite foreground, as a share of the box's sides.
const CORE: f64 = 0.7;
/// Minimum shorter side of a box, pixels: smaller boxes have too few pixels for two mixtures of five Gaussians.
const MIN_SIDE_PX: f64 = 4.0;
/// Expected overlap with the truth if the mask's bounding box equals the box prompt: 0.80 in rendered sequences with
/// boxes displaced by a tenth.
const TRUST: f64 = 0.8;

/// Segmenter without a network, as a fallback for the mask network.
pub struct GrabCut {
    options: PromptOptions,
}

impl GrabCut {
    /// Segmenter with the quality tests of the mask network; other options are ignored.
    pub fn new(options: &PromptOptions) -> Self {
        Self { options: options.clone() }
    }

    fn mask(&self, image: &RgbImage, rect: &Rect) -> Result<Option<BoxMask>, PerceptionError> {
        let frame = image.dimensions();
        let rect = visible(rect, frame);
        let too_small = !(rect.width() >= MIN_SIDE_PX && rect.height() >= MIN_SIDE_PX);
        let Some(window) = Window::of_pixels(&rect.grown(BACKGROUND_MARGIN), frame).filter(|_| !too_small) else {
            return Ok(None);
        };
        let inside = cut(image, window, &rect)?;
        let mask = Mask::from_fn(frame.0, frame.1, |x, y| {
            let (x, y) = (i64::from(x) - i64::from(window.x0), i64::from(y) - i64::from(window.y0));
            inside.get(x, y)
        });
        Ok(self.tested(mask, &rect))
    }

    /// Mask with its quality, if it passes the tests.
    fn tested(&self, mask: Mask, rect: &Rect) -> Option<BoxMask> {
        let quality = TRUST * agreement(&mask.bounding_box()?.into(), rect);
        let passes = fills(&mask, rect) && quality >= TRUST * self.options.min_quality;
        passes.then_some(BoxMask { mask, quality })
    }
}

impl BoxSegmenter for GrabCut {
    fn masks(&mut self, image: &RgbImage, boxes: &[Rect]) -> Result<Vec<Option<BoxMask>>, PerceptionError> {
        boxes.iter().map(|rect| self.mask(image, rect)).collect()
    }

    fn is_coarse(&self) -> bool {
        true
    }
}

/// Segments the object in a box; the mask has the window's size.
fn cut(image: &RgbImage, window: Window, rect: &Rect) -> Result<Mask, PerceptionError> {
    let (width, height) = crate::image::scale_to_fit(window.width, window.height, WORKING_SIDE);
    let pixels = mat_from_rgb(&resize_rgb(&window.crop(image), width, height)?)?;
    let scale = [f64::from(width) / f64::from(window.width), f64::from(height) / f64::from(window.height)];
    let origin = window.rect();
    let small = Rect {
        x0: (rect.x0 - origin.x0) * scale[0],
        y0: (rect.y0 - origin.y0) * scale[1],
        x1: (rect.x1 - origin.x0) * scale[0],
        y1: (rect.y1 - origin.y0) * scale[1],
    };
    let Some(mut labels) = initial_labels(&small, (width, height))? else {
        return Ok(Mask::empty(window.width, window.height));
    };
    let (mut background, mut object) = (Mat::default(), Mat::default());
    // OpenCV's generator, which initializes the mixtures, has the same seed for every box.
    core::set_rng_seed(1)?;
    let rect = core::Rect::default();
    let mode = imgproc::GC_INIT_WITH_MASK;
    // Number of iterations of fitting the mixtures and cutting.
    let num_rounds = 3;
    imgproc::grab_cut(&pixels, &mut labels, rect, &mut background, &mut object, num_rounds, mode)?;
    let labels = gray_from_mat(&labels)?;
    let object = Mask::from_fn(width, height, |x, y| {
        let label = i32::from(labels.get_pixel(x, y).0[0]);
        label == imgproc::GC_FGD || label == imgproc::GC_PR_FGD
    });
    let object = largest_component(&object);
    Ok(Mask::from_fn(window.width, window.height, |x, y| {
        object.contains((f64::from(x) + 0.5) * scale[0], (f64::from(y) + 0.5) * scale[1])
    }))
}

/// Initial labels: background outside the box, foreground in its core, probable foreground between.
///
/// `None` without background or without foreground.
fn initial_labels(rect: &Rect, (width, height): (u32, u32)) -> Result<Option<Mat>, PerceptionError> {
    let label = |x: u32, y: u32| {
        let (x, y) = (f64::from(x) + 0.5, f64::from(y) + 0.5);
        match (rect.contains(x, y), in_core(rect, x, y)) {
            (_, true) => imgproc::GC_FGD,
            (true, false) => imgproc::GC_PR_FGD,
            (false, false) => imgproc::GC_BGD,
        }
    };
    let labels = GrayImage::from_fn(width, height, |x, y| Luma([label(x, y) as u8]));
    let has = |wanted: i32| labels.iter().any(|&label| i32::from(label) == wanted);
    if !has(imgproc::GC_BGD) || !has(imgproc::GC_FGD) {
        return Ok(None);
    }
    Ok(Some(mat_from_gray(&labels)?))
}

/// Returns true if a point is in the central ellipse of a box.
fn in_core(rect: &Rect, x: f64, y: f64) -> bool {
    let from_middle = |at: f64, first: f64, last: f64| (2.0 * at - first - last) / (CORE * (last - first));
    let (u, v) = (from_middle(x, rect.x0, rect.x1), from_middle(y, rect.y0, rect.y1));
    u * u + v * v < 1.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Red block with little noise on a road of gray noise.
    fn street() -> RgbImage {
        RgbImage::from_fn(200, 120, |x, y| {
            let noise = ((x * 31 + y * 17 + x * y) % 13) as u8;
            let block = (60..130).contains(&x) && (40..80).contains(&y);
            ::image::Rgb(if block { [190 + noise, 30, 40 + noise] } else { [100 + noise, 100 + noise, 96 + noise] })
        })
    }

    #[test]
    fn a_block_on_a_road_is_segmented_and_repeatable() {
        let mut segmenter = GrabCut::new(&PromptOptions::default());
        let boxes = [Rect { x0: 57.0, y0: 38.0, x1: 132.0, y1: 83.0 }, Rect { x0: 150.0, y0: 5.0, x1: 190.0, y1: 9.5 }];
        let found = segmenter.masks(&street(), &boxes).unwrap();
        let truth = Mask::from_fn(200, 120, |x, y| (60..130).contains(&x) && (40..80).contains(&y));
        let block = found[0].clone().unwrap();
        assert!(block.mask.iou(&truth) > 0.9, "{}", block.mask.iou(&truth));
        assert!(segmenter.is_coarse());
        // Other uses of OpenCV's generator in between have no effect.
        core::set_rng_seed(77).unwrap();
        assert_eq!(segmenter.masks(&street(), &boxes).unwrap(), found);
    }

    #[test]
    fn boxes_without_pixels_or_surroundings_have_no_mask() {
        let mut segmenter = GrabCut::new(&PromptOptions::default());
        let nowhere = Rect { x0: 300.0, y0: 10.0, x1: 340.0, y1: 60.0 };
        let all = Rect { x0: 0.0, y0: 0.0, x1: 200.0, y1: 120.0 };
        let thin = Rect { x0: 10.0, y0: 10.0, x1: 12.0, y1: 60.0 };
        let wrong = Rect { x0: f64::NAN, y0: 10.0, x1: 12.0, y1: f64::INFINITY };
        let found = segmenter.masks(&street(), &[nowhere, thin, wrong]).unwrap();
        assert_eq!(found, [None, None, None]);
        assert!(segmenter.masks(&street(), &[all]).is_ok());
        assert_eq!(segmenter.masks(&RgbImage::new(0, 0), &[all]).unwrap(), [None]);
    }
}
