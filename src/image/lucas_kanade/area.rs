//! Region of an image as floating-point numbers.

use ::image::GrayImage;
use pulp::Simd;

use super::LANES;
use super::window::Window;
use crate::image::mirrored;

/// Pixels of a region at an integer position, with mirrored image borders.
#[derive(Default)]
pub(super) struct Area {
    values: Vec<f32>,
    cols: usize,
    rows: usize,
    /// Position of the first value, pixels; the center of the image's first pixel is (0, 0).
    corner: [i64; 2],
}

/// Start of a window in an area: index of a value, and fraction of a pixel.
pub(super) struct SubpixelPosition {
    start: usize,
    pub fraction: [f32; 2],
}

impl Area {
    /// Cuts the window that begins at `first` with at least this margin on all sides.
    #[inline(always)]
    pub fn cut_around(&mut self, picture: &GrayImage, first: [f32; 2], window: Window, margin: usize) {
        self.corner = first.map(|value| whole_below(value) - margin as i64);
        // One more for interpolation between pixels, rounded up to whole vectors.
        self.cols = (window.width + 2 * margin + 1).next_multiple_of(LANES);
        self.rows = window.height + 2 * margin + 1;
        self.values.resize(self.cols * self.rows, 0.0);
        let (width, height) = (picture.width() as usize, picture.height() as usize);
        if self.is_inside(picture) {
            let start = self.corner[1] as usize * width + self.corner[0] as usize;
            let pixels = &picture.as_raw()[start..];
            // Row lengths known at compile time.
            match self.cols {
                16 => convert::<16>(&mut self.values, pixels, width),
                24 => convert::<24>(&mut self.values, pixels, width),
                _ => self.values.chunks_exact_mut(self.cols).zip(pixels.chunks(width)).for_each(|(out, row)| {
                    out.iter_mut().zip(row).for_each(|(out, value)| *out = f32::from(*value));
                }),
            }
        } else {
            for (k, out) in self.values.chunks_exact_mut(self.cols).enumerate() {
                let y = mirrored(self.corner[1] + k as i64, height);
                let row = &picture.as_raw()[y * width..][..width];
                let at = |x: usize| f32::from(row[mirrored(self.corner[0] + x as i64, width)]);
                out.iter_mut().enumerate().for_each(|(x, out)| *out = at(x));
            }
        }
    }

    /// Returns true if the whole area is in the image.
    #[inline(always)]
    pub fn is_inside(&self, picture: &GrayImage) -> bool {
        let fits = |first: i64, length: usize, all: u32| first >= 0 && first + length as i64 <= i64::from(all);
        fits(self.corner[0], self.cols, picture.width()) && fits(self.corner[1], self.rows, picture.height())
    }

    /// Start of the window with its first pixel at a position; `None` if the area does not contain all of it.
    #[inline(always)]
    pub fn place(&self, first: [f32; 2], window: Window) -> Option<SubpixelPosition> {
        let whole = first.map(whole_below);
        let fraction = [first[0] - whole[0] as f32, first[1] - whole[1] as f32];
        let start = [whole[0] - self.corner[0], whole[1] - self.corner[1]];
        let fits = |start: i64, length: usize, all: usize| start >= 0 && start as usize + length < all;
        let is_here = fits(start[0], window.width, self.cols) && fits(start[1], window.height, self.rows);
        is_here.then(|| SubpixelPosition { start: start[1] as usize * self.cols + start[0] as usize, fraction })
    }

    /// Vectors of a row interpolated between columns, starting at a column and at each of the two after it.
    #[inline(always)]
    pub fn three_columns<S: Simd>(&self, simd: S, fraction: S::f32s, column: usize, row: usize) -> [S::f32s; 3] {
        let values = self.values.get(row * self.cols + column..).unwrap_or_default();
        let [a, b, c, d] = [0, 1, 2, 3].map(|x| load(simd, values, x));
        let between = |a, b| simd.mul_add_f32s(fraction, simd.sub_f32s(b, a), a);
        [between(a, b), between(b, c), between(c, d)]
    }

    /// Vector of a window's row, interpolated between columns.
    #[inline(always)]
    pub fn between_columns<S: Simd>(&self, simd: S, place: &SubpixelPosition, column: usize, row: usize) -> S::f32s {
        let start = place.start + row * self.cols + column;
        let (left, right) = (load(simd, &self.values, start), load(simd, &self.values, start + 1));
        simd.mul_add_f32s(simd.splat_f32s(place.fraction[0]), simd.sub_f32s(right, left), left)
    }
}

/// Converts the first pixels of consecutive image rows, `stride` apart, to rows of values.
#[inline(always)]
fn convert<const COLS: usize>(values: &mut [f32], pixels: &[u8], stride: usize) {
    for (out, row) in values.as_chunks_mut::<COLS>().0.iter_mut().zip(pixels.chunks(stride)) {
        let row: &[u8; COLS] = row.first_chunk().unwrap_or(&[0; COLS]);
        *out = row.map(f32::from);
    }
}

/// Vector of the values from an index on, padded by zeros.
#[inline(always)]
pub(super) fn load<S: Simd>(simd: S, values: &[f32], start: usize) -> S::f32s {
    let values = values.get(start..start + S::F32_LANES).unwrap_or_default();
    S::as_simd_f32s(values).0.first().copied().unwrap_or(simd.splat_f32s(0.0))
}

/// Largest integer not above a value. (`floor` is a function call on the oldest processors.)
#[inline(always)]
pub(super) fn whole_below(value: f32) -> i64 {
    let towards_zero = value as i32;
    i64::from(towards_zero) - i64::from(towards_zero as f32 > value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_goes_on_as_its_mirror_image() {
        let picture = GrayImage::from_fn(4, 3, |x, y| ::image::Luma([(10 * y + x) as u8]));
        let window = Window { width: 8, height: 3 };
        let mut area = Area::default();
        area.cut_around(&picture, [-1.5, -0.5], window, 1);
        assert_eq!((area.corner, area.cols, area.rows), ([-3, -2], 16, 6));
        assert_eq!(area.values[16..25], [13.0, 12.0, 11.0, 10.0, 11.0, 12.0, 13.0, 12.0, 11.0]);
        assert!(!area.is_inside(&picture));
        assert!(area.place([-2.25, -1.0], window).is_some_and(|at| at.fraction == [0.75, 0.0]));
        assert!(area.place([-3.5, -1.0], window).is_none() && area.place([-2.0, 2.0], window).is_none());
    }

    #[test]
    fn whole_numbers_below() {
        assert_eq!([2.7, 2.0, -0.2, -3.0, 0.0].map(whole_below), [2, 2, -1, -3, 0]);
    }
}
