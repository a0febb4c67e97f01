//! Corners of an image that are worth tracking.

use nalgebra::Point2;
use pulp::{Arch, Simd, WithSimd};

use crate::image::CornerStrength;

/// The strongest corners, the strongest first.
///
/// They are pixels that no neighbor exceeds, at a minimum distance from one another (J. Shi, C. Tomasi, *Good Features
/// to Track*, CVPR 1994). Pixels at the border of the image are excluded.
///
/// * `free` – pixels that may be one, row-major.
/// * `wanted` – maximum number of corners.
/// * `quality` – minimum strength relative to the strongest pixel that may be one.
/// * `min_distance_px` – minimum distance between two.
///
/// Positions are centers of pixels, the first one at (0.5, 0.5).
pub fn strongest(
    strength: &CornerStrength,
    free: &[bool],
    wanted: usize,
    quality: f64,
    min_distance_px: f64,
) -> Vec<Point2<f32>> {
    let (cols, rows) = (strength.num_cols(), strength.num_rows());
    let mut peaks = Arch::new().dispatch(Peaks { strength, free, quality: quality as f32 });
    peaks.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then((a.2, a.1).cmp(&(b.2, b.1))));
    let mut kept = Spread::new(cols, rows, min_distance_px);
    for (_, x, y) in peaks {
        if kept.corners.len() >= wanted {
            break;
        }
        kept.push([x, y]);
    }
    kept.corners.into_iter().map(|[x, y]| Point2::new(x as f32 + 0.5, y as f32 + 0.5)).collect()
}

/// Search for the free pixels that none of their eight neighbors exceeds.
///
/// It uses the vector instructions of the processor and returns strength, column and row.
struct Peaks<'a> {
    strength: &'a CornerStrength,
    free: &'a [bool],
    quality: f32,
}

impl WithSimd for Peaks<'_> {
    type Output = Vec<(f32, u32, u32)>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let (cols, rows) = (self.strength.num_cols(), self.strength.num_rows());
        let mut peaks = Vec::new();
        if cols < 3 || rows < 3 {
            return peaks;
        }
        let row = |y: usize| (self.strength.row(y), &self.free[y * cols..(y + 1) * cols]);
        let threshold = self.quality * (0..rows).map(row).map(strongest_free).fold(0.0, f32::max);
        let (mut highest, mut is_peak) = (vec![0.0f32; cols], vec![false; cols - 2]);
        for y in 1..rows - 1 {
            let ((above, _), (here, free), (below, _)) = (row(y - 1), row(y), row(y + 1));
            for (((highest, a), b), c) in highest.iter_mut().zip(above).zip(here).zip(below) {
                *highest = a.max(*b).max(*c);
            }
            let inner = here[1..].iter().zip(&free[1..]);
            for ((is_peak, (value, is_free)), around) in is_peak.iter_mut().zip(inner).zip(highest.windows(3)) {
                let exceeds = (*value >= around[0]) & (*value >= around[1]) & (*value >= around[2]);
                *is_peak = *is_free & (*value > threshold) & exceeds;
            }
            let found = (1..).zip(&is_peak).filter(|(_, is_peak)| **is_peak);
            peaks.extend(found.map(|(x, _)| (here[x], x as u32, y as u32)));
        }
        peaks
    }
}

/// Maximum strength of the free pixels of a row.
#[inline(always)]
fn strongest_free((values, free): (&[f32], &[bool])) -> f32 {
    /// Number of values that are compared at a time.
    const LANES: usize = 16;
    let larger = |most: f32, (value, is_free): (&f32, &bool)| {
        let value = if *is_free { *value } else { 0.0 };
        if value > most { value } else { most }
    };
    let (values, last) = values.as_chunks::<LANES>();
    let (free, last_free) = free.as_chunks::<LANES>();
    let mut most = [0.0f32; LANES];
    for (values, free) in values.iter().zip(free) {
        for (most, one) in most.iter_mut().zip(values.iter().zip(free)) {
            *most = larger(*most, one);
        }
    }
    let of_rest = last.iter().zip(last_free).fold(0.0, larger);
    most.into_iter().fold(of_rest, f32::max)
}

/// Corners that keep a distance from one another.
struct Spread {
    corners: Vec<[u32; 2]>,
    min_distance_sq: f64,
    cell_px: u32,
    cols: usize,
    /// Index of the last corner in every cell of a grid, each as large as the distance, or [`NONE`].
    last: Vec<u32>,
    /// Index of the previous corner in its cell, by corner, or [`NONE`].
    before: Vec<u32>,
}

/// Marks an absent corner.
const NONE: u32 = u32::MAX;

impl Spread {
    fn new(width: usize, height: usize, min_distance_px: f64) -> Self {
        let cell_px = (min_distance_px.ceil() as u32).max(1);
        let (cols, rows) = (width / cell_px as usize + 1, height / cell_px as usize + 1);
        let min_distance_sq = min_distance_px * min_distance_px;
        let (corners, last, before) = (Vec::new(), vec![NONE; cols * rows], Vec::new());
        Self { corners, min_distance_sq, cell_px, cols, last, before }
    }

    /// Adds a corner if it is far enough from the others.
    fn push(&mut self, corner: [u32; 2]) {
        let [col, row] = corner.map(|at| (at / self.cell_px) as usize);
        let last_row = (row + 1).min(self.last.len() / self.cols - 1);
        let mut cells = (row.saturating_sub(1)..=last_row).flat_map(|row| {
            let first = row * self.cols;
            &self.last[first + col.saturating_sub(1)..first + (col + 2).min(self.cols)]
        });
        let is_far = |index: u32| {
            let other = self.corners[index as usize];
            let [dx, dy] = [0, 1].map(|k| f64::from(corner[k]) - f64::from(other[k]));
            dx * dx + dy * dy >= self.min_distance_sq
        };
        let of_cell = |last: u32| {
            let before = |index: &u32| Some(self.before[*index as usize]).filter(|before| *before != NONE);
            std::iter::successors(Some(last).filter(|last| *last != NONE), before)
        };
        if cells.all(|last| of_cell(*last).all(is_far)) {
            let index = self.corners.len() as u32;
            self.before.push(std::mem::replace(&mut self.last[row * self.cols + col], index));
            self.corners.push(corner);
        }
    }
}

#[cfg(test)]
mod tests {
    use opencv::core::{Point2f, Vector};
    use rand::Rng as _;

    use super::*;
    use crate::image::{GrayImage, borrowed_gray};
    use crate::math::seeded_rng;

    #[test]
    fn the_corners_are_those_of_opencv() {
        let mut rng = seeded_rng(9, 0);
        let (width, height) = (220, 150);
        let cells = GrayImage::from_fn(44, 30, |_, _| ::image::Luma([rng.random_range(0..255)]));
        let image = ::image::imageops::resize(&cells, width, height, ::image::imageops::FilterType::Triangle);
        let free = GrayImage::from_fn(width, height, |x, y| ::image::Luma([u8::from(x + y > 90) * 255]));
        let is_free: Vec<bool> = free.as_raw().iter().map(|value| *value > 0).collect();
        let (picture, mask) = (borrowed_gray(&image).unwrap(), borrowed_gray(&free).unwrap());
        for (wanted, distance) in [(400, 4.0), (60, 12.0), (500, 1.0)] {
            let mut expected = Vector::<Point2f>::new();
            let of_opencv = opencv::imgproc::good_features_to_track;
            of_opencv(&picture, &mut expected, wanted, 0.01, distance, &mask, 3, false, 0.04).unwrap();
            let found = strongest(&CornerStrength::of(&image), &is_free, wanted as usize, 0.01, distance);
            let expected: Vec<_> = expected.iter().map(|p| Point2::new(p.x + 0.5, p.y + 0.5)).collect();
            // Equally strong corners may be in another order, and rounding may change which one is the strongest.
            let common = found.iter().filter(|p| expected.contains(p)).count();
            assert!(
                found.len().abs_diff(expected.len()) <= 2 && common + 3 >= expected.len(),
                "{common} of {expected:?}"
            );
        }
    }

    #[test]
    fn no_corner_is_found_without_texture_or_free_pixels() {
        let plain = CornerStrength::of(&GrayImage::from_pixel(30, 20, ::image::Luma([80])));
        assert!(strongest(&plain, &[true; 600], 10, 0.01, 3.0).is_empty());
        let noise = CornerStrength::of(&GrayImage::from_fn(30, 20, |x, y| ::image::Luma([(x * y * 37 % 251) as u8])));
        assert!(strongest(&noise, &[false; 600], 10, 0.01, 3.0).is_empty());
        assert!(strongest(&CornerStrength::default(), &[], 10, 0.01, 3.0).is_empty());
    }
}
