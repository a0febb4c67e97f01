//! Median background, and the regions in which a frame differs from it.

use opencv::core::{BORDER_CONSTANT, CV_32S, Mat, MatTraitConst, MatTraitConstManual, Point, Size};
use opencv::imgproc;
use rayon::prelude::*;

use super::{ComparedFrame, homography};
use crate::image::{GrayImage, ImageError, RgbImage, borrowed_gray, borrowed_rgb, rgb_from_mat, warp_rgb};
use crate::math::{STD_PER_MAD, upper_median};
use crate::motion::View;
use crate::scene::{BoundingBox, Rect};

/// Minimum of the largest difference in a region, gray levels of the channel that differs most: static parts of renders
/// and clear videos differ by less than 10.
const MIN_DIFFERENCE: f64 = 20.0;
/// The same minimum in standard deviations of the frame's noise.
const SIGMAS: f64 = 6.0;
/// Share of the minimum that suffices for the other pixels of a region: without it a green car in the shadow is split.
const WEAK: f64 = 0.6;
/// Side of the square of the morphological closing that connects parts of one vehicle, such as windows and roof,
/// pixels.
const CLOSING_PX: i32 = 5;
/// Minimum area of a region, square pixels: a car of 10 × 4 pixels has more.
const MIN_AREA_PX2: usize = 30;
/// Minimum share of a region without shadow for its box to exclude the shadow.
const MIN_LIT: f64 = 0.25;
/// Interval between the pixels from which the noise is measured, pixels.
const STRIDE: usize = 29;

/// Median background around a time in one view; black where too few frames cover it.
pub(super) struct SceneMedian {
    pub(super) time_s: f64,
    view: View,
    image: RgbImage,
}

impl SceneMedian {
    /// Median of sample frames, warped to a view.
    pub(super) fn new(view: View, time_s: f64, samples: &[&ComparedFrame]) -> Result<Self, ImageError> {
        let warped: Vec<RgbImage> = samples
            .par_iter()
            .map(|sample| warp_rgb(&sample.image, &homography(&view, &sample.view)))
            .collect::<Result<_, _>>()?;
        let mut image = RgbImage::new(view.camera.width, view.camera.height);
        image.par_chunks_exact_mut(3).enumerate().for_each(|(at, pixel)| {
            for (channel, value) in pixel.iter_mut().enumerate() {
                let mut values = [0u8; super::NUM_SAMPLES];
                let mut count = 0;
                for value in warped.iter().map(|image| image.as_raw()[3 * at + channel]).filter(|value| *value > 0) {
                    values[count] = value;
                    count += 1;
                }
                values[..count].sort_unstable();
                *value = if 2 * count > warped.len() { values[count / 2] } else { 0 };
            }
        });
        Ok(Self { time_s, view, image })
    }

    /// Regions in which a frame differs, pixels of the working size. Edges displaced by a pixel are tolerated.
    pub(super) fn differences(&self, frame: &ComparedFrame) -> Result<Vec<Rect>, ImageError> {
        let expected = warp_rgb(&self.image, &homography(&frame.view, &self.view))?;
        let (least, most) = (neighborhood(&expected, imgproc::erode)?, neighborhood(&expected, imgproc::dilate)?);
        let [offsets, stds] = brightness(&frame.image, &expected);
        let limits = [0, 1, 2].map(|channel| MIN_DIFFERENCE.max(SIGMAS * stds[channel]));
        let kind = |[pixel, expected, least, most]: [&[u8]; 4]| {
            let value = |channel: usize| f64::from(pixel[channel]) - offsets[channel];
            let strength = |channel: usize| {
                let value = value(channel);
                (value - f64::from(most[channel])).max(f64::from(least[channel]) - value) / limits[channel]
            };
            let strength = strength(0).max(strength(1)).max(strength(2));
            if strength <= WEAK || least.contains(&0) {
                return 0;
            }
            let is_lit = !is_shadow([0, 1, 2].map(|channel| value(channel) / f64::from(expected[channel])));
            DIFFERS | if strength > 1.0 { STRONG } else { 0 } | if is_lit { LIT } else { 0 }
        };
        let (width, height) = frame.image.dimensions();
        let mut kinds = GrayImage::new(width, height);
        let pixels = triples(&frame.image).zip(triples(&expected)).zip(triples(&least)).zip(triples(&most));
        kinds.par_iter_mut().zip(pixels).for_each(|(value, (((p, e), l), m))| *value = kind([p, e, l, m]));
        connected(&kinds)
    }
}

/// Flag of a pixel that differs.
const DIFFERS: u8 = 1;
/// Flag of a pixel that differs strongly.
const STRONG: u8 = 2;
/// Flag of a pixel that differs and is no shadow.
const LIT: u8 = 4;

fn triples(image: &RgbImage) -> impl IndexedParallelIterator<Item = &[u8]> {
    image.as_raw().par_chunks_exact(3)
}

/// Returns true if a pixel is darker than expected by the same ratio in all channels, like shadows and gray cars.
fn is_shadow(ratios: [f64; 3]) -> bool {
    let (least, most) = (ratios.into_iter().fold(f64::MAX, f64::min), ratios.into_iter().fold(0.0, f64::max));
    // The limits are the ratio of sky light to full sunlight, penumbrae, and the color of the sky.
    least >= 0.35 && most <= 0.95 && most - least <= 0.12
}

/// Minimum or maximum of each channel among a pixel and its neighbors.
fn neighborhood(
    image: &RgbImage,
    operation: fn(&Mat, &mut Mat, &Mat, Point, i32, i32, opencv::core::Scalar) -> opencv::Result<()>,
) -> Result<RgbImage, ImageError> {
    let kernel = square(3)?;
    let (mut out, border) = (Mat::default(), imgproc::morphology_default_border_value()?);
    operation(&borrowed_rgb(image)?.try_clone()?, &mut out, &kernel, Point::new(-1, -1), 1, BORDER_CONSTANT, border)?;
    rgb_from_mat(&out)
}

fn square(side: i32) -> Result<Mat, ImageError> {
    Ok(imgproc::get_structuring_element_def(imgproc::MORPH_RECT, Size::new(side, side))?)
}

/// Difference in brightness between two images (exposure, clouds) and standard deviation of the noise, by channel.
fn brightness(image: &RgbImage, expected: &RgbImage) -> [[f64; 3]; 2] {
    let differences: [Vec<f64>; 3] = [0, 1, 2].map(|channel| {
        let values = image.as_raw().iter().zip(expected.as_raw()).skip(channel).step_by(3 * STRIDE);
        values.filter(|(_, e)| **e > 0).map(|(v, e)| f64::from(*v) - f64::from(*e)).collect()
    });
    let offsets = differences.each_ref().map(|all| upper_median(all.clone()).unwrap_or(0.0));
    let stds = [0, 1, 2].map(|channel| {
        let deviations = differences[channel].iter().map(|d| (d - offsets[channel]).abs()).collect();
        STD_PER_MAD * upper_median(deviations).unwrap_or(0.0)
    });
    [offsets, stds]
}

/// Boxes of connected regions of pixels that differ, at least one of them strongly, without their shadows.
fn connected(kinds: &GrayImage) -> Result<Vec<Rect>, ImageError> {
    let (mut closed, kernel, border) =
        (Mat::default(), square(CLOSING_PX)?, imgproc::morphology_default_border_value()?);
    let (source, anchor, close) = (borrowed_gray(kinds)?, Point::new(-1, -1), imgproc::MORPH_CLOSE);
    imgproc::morphology_ex(&source, &mut closed, close, &kernel, anchor, 1, BORDER_CONSTANT, border)?;
    let mut labels = Mat::default();
    let count = imgproc::connected_components(&closed, &mut labels, 8, CV_32S)?;
    let mut regions = vec![Region::default(); count.max(0) as usize];
    let width = kinds.width() as usize;
    let labeled = labels.data_typed::<i32>()?.iter().zip(kinds.iter()).enumerate();
    for (at, (label, kind)) in labeled.filter(|(_, (label, _))| **label > 0) {
        regions[*label as usize].add((at % width) as u32, (at / width) as u32, *kind);
    }
    Ok(regions.into_iter().filter_map(Region::rect).collect())
}

/// Connected region.
#[derive(Clone, Default)]
struct Region {
    is_strong: bool,
    /// All pixels.
    all: Extent,
    /// Pixels without shadow.
    lit: Extent,
}

#[derive(Clone, Default)]
struct Extent {
    num_pixels: usize,
    bounds: Option<BoundingBox>,
}

impl Extent {
    fn add(&mut self, x: u32, y: u32) {
        self.num_pixels += 1;
        let bounds = self.bounds.get_or_insert(BoundingBox { x0: x, y0: y, x1: x + 1, y1: y + 1 });
        (bounds.x0, bounds.x1) = (bounds.x0.min(x), bounds.x1.max(x + 1));
        (bounds.y0, bounds.y1) = (bounds.y0.min(y), bounds.y1.max(y + 1));
    }
}

impl Region {
    fn add(&mut self, x: u32, y: u32, kind: u8) {
        self.is_strong |= kind & STRONG > 0;
        self.all.add(x, y);
        if kind & LIT > 0 {
            self.lit.add(x, y);
        }
    }

    /// Box of the region; `None` if it is too small or too weak.
    fn rect(self) -> Option<Rect> {
        // A gray car whose pixels, except for the lamps, are darker than the road looks like a shadow.
        let is_lit = self.lit.num_pixels as f64 >= MIN_LIT * self.all.num_pixels as f64;
        let bounds = if is_lit { self.lit.bounds } else { self.all.bounds };
        bounds.filter(|_| self.is_strong && self.all.num_pixels >= MIN_AREA_PX2).map(Rect::from)
    }
}
