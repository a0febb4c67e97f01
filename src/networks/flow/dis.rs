//! Dense inverse search: OpenCV's implementation of Kroeger et al., *Fast Optical Flow using Dense Inverse Search*,
//! 2016, around every box at the scale of the object in it.

use ::image::{GrayImage, RgbImage};
use opencv::core::{Mat, MatTraitConst, MatTraitConstManual, Point2f, Ptr};
use opencv::prelude::*;
use opencv::video::{DISOpticalFlow, DISOpticalFlow_PRESET_FAST};

use super::parts::{Part, PartFlow, nothing};
use super::{Field, FlowEstimator, check_sizes, consistent};
use crate::image::{borrowed_gray, gray_from_rgb, resize_gray, scale_to_fit};
use crate::math::upper_median;
use crate::networks::PerceptionError;
use crate::scene::{BoundingBox, Flow, Rect};

/// Minimum side of the input, pixels: DIS divides its input by powers of two and fails below this.
const MIN_SIDE: u32 = 32;
/// Longer side of an object at the resolution of the estimate, pixels. Masks propagated through six frames of seven
/// rendered sequences (objects of 20 to 170 px) had an overlap of 0.81 with the truth with 48 px, 0.83 with 64 and 96,
/// and 0.82 with 128 and 192; in frames of 960 px, for any size of the object, 0.68 (Python prototype, same calls).
const OBJECT_PX: f64 = 64.0;
/// Maximum magnification: objects of less than 20 pixels have no further detail.
const MAX_ENLARGEMENT: f64 = 3.0;
/// Longer side of the frame, pixels, at which the common motion of an object and its surroundings is estimated: a
/// quarter of the cost of 512; not varied.
const FRAME_PX: u32 = 256;

/// OpenCV's DIS flow.
pub struct DisFlow {
    algorithm: Ptr<DISOpticalFlow>,
}

impl DisFlow {
    /// Creates the algorithm.
    ///
    /// # Errors
    /// [`PerceptionError::OpenCv`] if OpenCV cannot.
    pub fn new() -> Result<Self, PerceptionError> {
        let mut algorithm = DISOpticalFlow::create(DISOpticalFlow_PRESET_FAST)?;
        // Down to half of the resolution: the preset ends at a quarter.
        algorithm.set_finest_scale(1)?;
        // Refinement takes two thirds of the time, and masks are as good without it (docs/benchmarks/perception.md).
        algorithm.set_variational_refinement_iterations(0)?;
        Ok(Self { algorithm })
    }

    fn estimate(&mut self, from: &GrayImage, to: &GrayImage) -> Result<Field, PerceptionError> {
        let mut flow = Mat::default();
        self.algorithm.calc(&borrowed_gray(from)?, &borrowed_gray(to)?, &mut flow)?;
        let pairs = flow.data_typed::<Point2f>()?.iter().map(|p| [p.x, p.y]);
        Ok(Field::from_pairs(flow.cols() as usize, flow.rows() as usize, pairs))
    }

    /// Coarse flow of the whole frame.
    fn common(&mut self, from: &GrayImage, to: &GrayImage) -> Result<Field, PerceptionError> {
        let (width, height) = scale_to_fit(from.width(), from.height(), FRAME_PX);
        let small = |image| resize_gray(image, width.max(MIN_SIDE), height.max(MIN_SIDE));
        self.estimate(&small(from)?, &small(to)?)
    }

    /// Flow in and around a box.
    fn around(
        &mut self,
        rect: &Rect,
        common: &Field,
        from: &GrayImage,
        to: &GrayImage,
    ) -> Result<Option<PartFlow>, PerceptionError> {
        let Some(part) = Part::of(rect, shift(rect, common, from.dimensions()), from.dimensions()) else {
            return Ok(None);
        };
        let scale = (OBJECT_PX / rect.width().max(rect.height()).max(1.0)).min(MAX_ENLARGEMENT);
        let side = |length: u32| ((scale * f64::from(length)).round() as u32).max(MIN_SIDE);
        let (width, height) = (side(part.bounds.width()), side(part.bounds.height()));
        let from = resize_gray(&part.cut(from), width, height)?;
        let to = resize_gray(&part.cut_shifted(to), width, height)?;
        let forward = self.estimate(&from, &to)?;
        let backward = self.estimate(&to, &from)?;
        let consistent = consistent(&forward, &backward);
        Ok(Some(PartFlow { part, forward, consistent }))
    }
}

/// Median displacement of a box, whole pixels of the frame.
fn shift(rect: &Rect, common: &Field, (width, height): (u32, u32)) -> [i32; 2] {
    /// Samples along each side of a box.
    const GRID: u32 = 8;
    let rect = rect.clipped(width, height);
    let per = [common.width as f64 / f64::from(width), common.height as f64 / f64::from(height)];
    let at = |from: f64, length: f64, k: u32, per: f64| {
        (per * (from + length * (f64::from(k) + 0.5) / f64::from(GRID))) as f32
    };
    let samples: Vec<[f32; 2]> = (0..GRID * GRID)
        .map(|k| {
            common.sample(at(rect.x0, rect.width(), k % GRID, per[0]), at(rect.y0, rect.height(), k / GRID, per[1]))
        })
        .collect();
    let median = |c: usize| upper_median(samples.iter().map(|d| f64::from(d[c])).collect()).unwrap_or(0.0);
    [(median(0) / per[0]).round() as i32, (median(1) / per[1]).round() as i32]
}

impl FlowEstimator for DisFlow {
    fn flow(&mut self, from: &RgbImage, to: &RgbImage, boxes: &[Rect]) -> Result<Flow, PerceptionError> {
        check_sizes(from, to)?;
        let mut flow = nothing(from.dimensions());
        if boxes.is_empty() || from.is_empty() {
            return Ok(flow);
        }
        let (from, to) = (gray_from_rgb(from)?, gray_from_rgb(to)?);
        let common = self.common(&from, &to)?;
        // Where boxes overlap, the flow of the smaller one is at the more suitable scale.
        let mut boxes = boxes.to_vec();
        boxes.sort_by(|a, b| b.area_px2().total_cmp(&a.area_px2()));
        let mut found = Vec::new();
        for rect in &boxes {
            found.extend(self.around(rect, &common, &from, &to)?.map(|part| (rect, part)));
        }
        // The margin of one box may overlap another box.
        for (_, part) in &found {
            part.put(&mut flow, &part.part.bounds);
        }
        for (rect, part) in &found {
            part.put(&mut flow, &covering(rect));
        }
        Ok(flow)
    }
}

/// Smallest pixel rectangle that covers a box.
fn covering(rect: &Rect) -> BoundingBox {
    let [x0, y0] = [rect.x0, rect.y0].map(|at| at.floor().max(0.0) as u32);
    let [x1, y1] = [rect.x1, rect.y1].map(|at| at.ceil().max(0.0) as u32);
    BoundingBox { x0, y0, x1, y1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Random patches of 24 and 7 pixels, moved by (dx, dy).
    fn texture(width: u32, height: u32, dx: f32, dy: f32) -> RgbImage {
        let random = |x: f32, y: f32| ((x * 12.99 + y * 78.23).sin() * 43_758.547).rem_euclid(1.0);
        let patches = |u: f32, v: f32, side: f32| {
            let (x, y) = (u / side, v / side);
            let (i, j, p, q) = (x.floor(), y.floor(), x.rem_euclid(1.0), y.rem_euclid(1.0));
            let row = |j: f32| random(i, j) * (1.0 - p) + random(i + 1.0, j) * p;
            row(j) * (1.0 - q) + row(j + 1.0) * q
        };
        RgbImage::from_fn(width, height, |x, y| {
            let (u, v) = (x as f32 - dx, y as f32 - dy);
            ::image::Rgb([(140.0 * patches(u, v, 24.0) + 110.0 * patches(u, v, 7.0)) as u8; 3])
        })
    }

    fn rect(x0: f64, y0: f64, width: f64, height: f64) -> Rect {
        Rect { x0, y0, x1: x0 + width, y1: y0 + height }
    }

    fn dis() -> DisFlow {
        DisFlow::new().unwrap()
    }

    #[test]
    fn flow_is_estimated_near_boxes_only() {
        let (from, to) = (texture(400, 300, 0.0, 0.0), texture(400, 300, 3.0, -2.0));
        let flow = dis().flow(&from, &to, &[rect(60.0, 60.0, 60.0, 50.0), rect(20.0, 200.0, 15.0, 12.0)]).unwrap();
        for (x, y) in [(90, 85), (27, 205)] {
            let [dx, dy] = flow.at(x, y);
            assert!((dx - 3.0).abs() < 0.3 && (dy + 2.0).abs() < 0.3 && flow.is_consistent(x, y), "{dx} {dy}");
        }
        assert!(!flow.is_consistent(300, 200) && flow.consistent.len() == 400 * 300);
        assert!(!dis().flow(&from, &to, &[]).unwrap().consistent.contains(&true));
    }

    #[test]
    fn a_small_object_moves_otherwise_than_its_surroundings() {
        // An object of 16 × 12 px on a camera's motion of 40 px.
        let object = |x: u32, y: u32, x0: u32| (x0..x0 + 16).contains(&x) && (100..112).contains(&y);
        let frame = |shift: f32, x0: u32| {
            let (background, own) = (texture(480, 270, shift, 0.0), texture(480, 270, x0 as f32 + 7.0, 31.0));
            RgbImage::from_fn(480, 270, |x, y| *if object(x, y, x0) { &own } else { &background }.get_pixel(x, y))
        };
        let (from, to) = (frame(0.0, 200), frame(40.0, 243));
        let near = rect(200.0, 100.0, 16.0, 12.0);
        let flow = dis().flow(&from, &to, &[near]).unwrap();
        let [dx, dy] = flow.at(208, 106);
        assert!((dx - 43.0).abs() < 0.7 && dy.abs() < 0.7, "{dx} {dy}");
    }

    #[test]
    fn any_size_works_and_different_sizes_are_an_error() {
        for (width, height) in [(0, 0), (1, 1), (7, 200), (33, 31)] {
            let image = texture(width, height, 0.0, 0.0);
            let whole = rect(0.0, 0.0, f64::from(width), f64::from(height));
            let flow = dis().flow(&image, &image, &[whole]).unwrap();
            assert_eq!(flow.displacement.len(), (width * height) as usize);
        }
        let error = dis().flow(&texture(8, 8, 0.0, 0.0), &texture(9, 8, 0.0, 0.0), &[]).unwrap_err();
        assert!(matches!(error, PerceptionError::SizeMismatch { .. }));
    }
}
