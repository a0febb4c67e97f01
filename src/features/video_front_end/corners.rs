//! The places of a picture that are worth following.

use nalgebra::Point2;

use crate::image::CornerStrength;

/// The strongest corners, the strongest first: pixels that no neighbour exceeds, at some distance from one another (J.
/// Shi, C. Tomasi, *Good Features to Track*, CVPR 1994). Pixels at the border of the picture are none.
///
/// * `is_free` – whether a pixel may be one.
/// * `wanted` – how many at the most.
/// * `quality` – smallest strength relative to the strongest pixel that may be one.
/// * `min_distance_px` – smallest distance of two.
///
/// Positions are centres of pixels, the first one at (0.5, 0.5).
pub fn strongest(
    strength: &CornerStrength,
    is_free: impl Fn(usize, usize) -> bool,
    wanted: usize,
    quality: f64,
    min_distance_px: f64,
) -> Vec<Point2<f32>> {
    let (cols, rows) = (strength.num_cols(), strength.num_rows());
    let (quality, mut strongest) = (quality as f32, 0.0f32);
    let mut peaks: Vec<(f32, u32, u32)> = Vec::new();
    for y in 0..rows {
        let here = strength.row(y);
        let inside = y > 0 && y + 1 < rows;
        for (x, value) in here.iter().enumerate() {
            if *value > quality * strongest && is_free(x, y) {
                strongest = strongest.max(*value);
                if inside && x > 0 && x + 1 < cols && is_peak(strength, x, y) {
                    peaks.push((*value, x as u32, y as u32));
                }
            }
        }
    }
    peaks.retain(|(value, ..)| *value > quality * strongest);
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

/// Returns true if none of the eight neighbors is stronger.
fn is_peak(strength: &CornerStrength, x: usize, y: usize) -> bool {
    let value = strength.row(y)[x];
    (y - 1..=y + 1).all(|v| strength.row(v)[x - 1..=x + 1].iter().all(|other| *other <= value))
}

/// Corners that keep a distance from one another.
struct Spread {
    corners: Vec<[u32; 2]>,
    min_distance_sq: f64,
    cell_px: u32,
    cols: usize,
    /// The last corner in every cell of a grid, each as large as the distance, by its index, or [`NONE`].
    last: Vec<u32>,
    /// Per corner the one before it in its cell, or [`NONE`].
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

    /// Adds a corner that is far enough from the others.
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
        let is_free = |x: usize, y: usize| free.as_raw()[y * width as usize + x] > 0;
        let (picture, mask) = (borrowed_gray(&image).unwrap(), borrowed_gray(&free).unwrap());
        for (wanted, distance) in [(400, 4.0), (60, 12.0), (500, 1.0)] {
            let mut expected = Vector::<Point2f>::new();
            let of_opencv = opencv::imgproc::good_features_to_track;
            of_opencv(&picture, &mut expected, wanted, 0.01, distance, &mask, 3, false, 0.04).unwrap();
            let found = strongest(&CornerStrength::of(&image), is_free, wanted as usize, 0.01, distance);
            let expected: Vec<_> = expected.iter().map(|p| Point2::new(p.x + 0.5, p.y + 0.5)).collect();
            // Those that are equally strong may come in another order, and one that is not the strongest by rounding.
            let common = found.iter().filter(|p| expected.contains(p)).count();
            assert!(
                found.len().abs_diff(expected.len()) <= 2 && common + 3 >= expected.len(),
                "{common} of {expected:?}"
            );
        }
    }

    #[test]
    fn nothing_is_free_and_nothing_is_found() {
        let plain = CornerStrength::of(&GrayImage::from_pixel(30, 20, ::image::Luma([80])));
        assert!(strongest(&plain, |_, _| true, 10, 0.01, 3.0).is_empty());
        let noise = CornerStrength::of(&GrayImage::from_fn(30, 20, |x, y| ::image::Luma([(x * y * 37 % 251) as u8])));
        assert!(strongest(&noise, |_, _| false, 10, 0.01, 3.0).is_empty());
        assert!(strongest(&CornerStrength::default(), |_, _| true, 10, 0.01, 3.0).is_empty());
    }
}
