//! Window around a point in the first image, and its difference from another image.
//!
//! All functions are inlined into one function per vector instruction set. Windows are split into strips as wide as a
//! vector, stored row by row.

use ::image::GrayImage;
use pulp::Simd;

use super::LANES;
use super::area::{Area, SubpixelPosition, load, whole_below};
use super::window::Window;

/// Gray values and gradients of a window, and the sums needed for a step.
#[derive(Default)]
pub(super) struct Template {
    values: Vec<f32>,
    across: Vec<f32>,
    down: Vec<f32>,
    /// Sums of products of gradient components: xx, xy, yy.
    pub products: [f32; 3],
}

/// Difference of an image from a template.
pub(super) struct Difference {
    /// Sum over the window of the difference times the gradient, x and y.
    pub along_gradient: [f32; 2],
    /// Mean of its absolute value, gray values.
    pub mean: f32,
}

impl Template {
    /// Sets the template to the window with its first pixel at `first`.
    ///
    /// Scharr gradients are computed of the interpolated pixels; they are zero outside the image.
    #[inline(always)]
    pub fn fill<S: Simd>(&mut self, simd: S, area: &mut Area, picture: &GrayImage, first: [f32; 2], window: Window) {
        area.cut_around(picture, first, window, 1);
        for values in [&mut self.values, &mut self.across, &mut self.down] {
            values.resize(window.num_pixels(), 0.0);
        }
        let is_whole = area.is_inside(picture);
        let mut sums = [simd.splat_f32s(0.0); 3];
        let [values, across, down] =
            [&mut self.values, &mut self.across, &mut self.down].map(|values| S::as_mut_simd_f32s(values).0);
        let [three, ten] = [3.0, 10.0].map(|weight| simd.splat_f32s(weight / 32.0));
        let fraction = first.map(|value| value - whole_below(value) as f32).map(|part| simd.splat_f32s(part));
        let mut k = 0;
        for strip in 0..window.width / S::F32_LANES {
            let column = strip * S::F32_LANES;
            let mut rows = Rows::new(simd, area, fraction, column);
            let mut above = rows.next(simd, 0);
            let mut here = rows.next(simd, 1);
            for row in 0..window.height {
                let below = rows.next(simd, row + 2);
                let mut gx = simd.mul_f32s(three, simd.add_f32s(above.step, below.step));
                gx = simd.mul_add_f32s(ten, here.step, gx);
                let mut gy = simd.sub_f32s(below.smooth, above.smooth);
                if !is_whole {
                    let place = [first[0] + column as f32, first[1] + row as f32];
                    zero_gradients_outside(simd, [&mut gx, &mut gy], place, picture);
                }
                sums[0] = simd.mul_add_f32s(gx, gx, sums[0]);
                sums[1] = simd.mul_add_f32s(gx, gy, sums[1]);
                sums[2] = simd.mul_add_f32s(gy, gy, sums[2]);
                (values[k], across[k], down[k]) = (here.value, gx, gy);
                (above, here) = (here, below);
                k += 1;
            }
        }
        self.products = sums.map(|sum| simd.reduce_sum_f32s(sum));
    }

    /// Difference of the window that begins at a position of another image.
    #[inline(always)]
    pub fn difference<S: Simd>(&self, simd: S, area: &Area, place: &SubpixelPosition, window: Window) -> Difference {
        let [mut across, mut down, mut size] = [simd.splat_f32s(0.0); 3];
        let fraction = simd.splat_f32s(place.fraction[1]);
        let rows = [&self.values, &self.across, &self.down].map(|values| S::as_simd_f32s(values).0);
        let [values, gx, gy] = rows.map(|rows| rows.chunks_exact(window.height));
        for (strip, ((values, gx), gy)) in values.zip(gx).zip(gy).enumerate() {
            let column = strip * S::F32_LANES;
            let mut above = area.between_columns(simd, place, column, 0);
            for (row, ((values, gx), gy)) in values.iter().zip(gx).zip(gy).enumerate() {
                let below = area.between_columns(simd, place, column, row + 1);
                let seen = simd.mul_add_f32s(fraction, simd.sub_f32s(below, above), above);
                let difference = simd.sub_f32s(seen, *values);
                across = simd.mul_add_f32s(difference, *gx, across);
                down = simd.mul_add_f32s(difference, *gy, down);
                size = simd.add_f32s(size, simd.abs_f32s(difference));
                above = below;
            }
        }
        let along_gradient = [simd.reduce_sum_f32s(across), simd.reduce_sum_f32s(down)];
        Difference { along_gradient, mean: simd.reduce_sum_f32s(size) / window.num_pixels() as f32 }
    }
}

/// Successive rows of a strip, interpolated between pixels.
struct Rows<'a, S: Simd> {
    area: &'a Area,
    column: usize,
    fraction: [S::f32s; 2],
    /// Previous image row, at the column before, the column itself and the one after it.
    last: [S::f32s; 3],
}

/// A row of a strip.
struct Row<S: Simd> {
    value: S::f32s,
    /// Difference of the column after and the one before.
    step: S::f32s,
    /// Horizontal Scharr smoothing.
    smooth: S::f32s,
}

impl<'a, S: Simd> Rows<'a, S> {
    #[inline(always)]
    fn new(simd: S, area: &'a Area, fraction: [S::f32s; 2], column: usize) -> Self {
        let last = area.three_columns(simd, fraction[0], column, 0);
        Self { area, column, fraction, last }
    }

    #[inline(always)]
    fn next(&mut self, simd: S, row: usize) -> Row<S> {
        let below = self.area.three_columns(simd, self.fraction[0], self.column, row + 1);
        let between =
            |k: usize| simd.mul_add_f32s(self.fraction[1], simd.sub_f32s(below[k], self.last[k]), self.last[k]);
        let [left, value, right] = [between(0), between(1), between(2)];
        self.last = below;
        let [three, ten] = [3.0, 10.0].map(|weight| simd.splat_f32s(weight / 32.0));
        let smooth = simd.mul_add_f32s(ten, value, simd.mul_f32s(three, simd.add_f32s(left, right)));
        Row { value, step: simd.sub_f32s(right, left), smooth }
    }
}

/// Zeroes the gradients of pixels outside the image; `place` is the position of the first pixel.
#[inline(always)]
fn zero_gradients_outside<S: Simd>(simd: S, gradients: [&mut S::f32s; 2], place: [f32; 2], picture: &GrayImage) {
    let is_within = |value: f32, side: u32| value >= 0.0 && value <= side as f32 - 1.0;
    let is_row_within = is_within(place[1], picture.height());
    let counts = |x: usize| is_row_within && is_within(place[0] + x as f32, picture.width());
    let counts: [f32; LANES] = std::array::from_fn(|x| f32::from(u8::from(counts(x))));
    let counts = load(simd, &counts, 0);
    for gradient in gradients {
        *gradient = simd.mul_f32s(*gradient, counts);
    }
}
