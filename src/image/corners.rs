//! Corner strength of every pixel.

use pulp::{Arch, Simd, WithSimd};

use super::{GrayImage, mirrored};

/// The smaller eigenvalue of the structure tensor at every pixel (J. Shi, C. Tomasi, *Good Features to Track*, CVPR
/// 1994), row-major.
///
/// The tensor is summed over 3 × 3 pixels, with gradients by the 3 × 3 Sobel operator; borders are mirrored. Values are
/// scaled as those of OpenCV's `cornerMinEigenVal` (gray between 0 and 1, gradients over 12). All sums are integers
/// below 2²⁴, and thus exact.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CornerStrength {
    width: usize,
    values: Vec<f32>,
}

impl CornerStrength {
    /// Corner strength of an image.
    pub fn of(image: &GrayImage) -> Self {
        Arch::new().dispatch(Work(image))
    }

    /// Values of a row of the image.
    pub fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.width..(y + 1) * self.width]
    }

    /// Number of rows.
    pub fn num_rows(&self) -> usize {
        self.values.len().checked_div(self.width).unwrap_or(0)
    }

    /// Number of pixels in a row.
    pub fn num_cols(&self) -> usize {
        self.width
    }
}

/// Computation compiled for all vector instruction sets, dispatched at run time.
struct Work<'a>(&'a GrayImage);

impl WithSimd for Work<'_> {
    type Output = CornerStrength;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> CornerStrength {
        let (width, height) = (self.0.width() as usize, self.0.height() as usize);
        let mut values = vec![0.0; width * height];
        if values.is_empty() {
            return CornerStrength { width, values };
        }
        let row = |y: usize| &self.0.as_raw()[y * width..(y + 1) * width];
        let mut gradients = Gradients::new(width);
        let mut products: [Products; 3] = std::array::from_fn(|_| Products::new(width));
        let mut sums = Products::new(width);
        for (y, out) in values.chunks_exact_mut(width).enumerate() {
            // Rows y - 1, y and y + 1, at their indices modulo 3; the first and the last are mirrored at the border.
            for next in (if y == 0 { 0 } else { y + 1 })..(y + 2).min(height) {
                let around = [mirrored(next as i64 - 1, height), next, mirrored(next as i64 + 1, height)];
                gradients.fill(around.map(row));
                products[next % 3].fill(&gradients);
            }
            let around = [mirrored(y as i64 - 1, height), y, mirrored(y as i64 + 1, height)];
            sums.add_up(around.map(|y| &products[y % 3]));
            sums.write_smaller_eigenvalues(out);
        }
        CornerStrength { width, values }
    }
}

/// A row with one more value at each end.
fn mirror_ends<T: Copy>(row: &mut [T]) {
    let width = row.len() - 2;
    row[0] = row[1 + mirrored(-1, width)];
    row[width + 1] = row[1 + mirrored(width as i64, width)];
}

/// Gradients in the middle of three rows of an image: smoothed values and vertical differences, with one more value at
/// each end.
struct Gradients {
    smooth: Vec<i16>,
    down: Vec<i16>,
}

impl Gradients {
    fn new(width: usize) -> Self {
        Self { smooth: vec![0; width + 2], down: vec![0; width + 2] }
    }

    #[inline(always)]
    fn fill(&mut self, [above, here, below]: [&[u8]; 3]) {
        let out = self.smooth[1..].iter_mut().zip(&mut self.down[1..]);
        for ((smooth, down), ((a, b), c)) in out.zip(above.iter().zip(here).zip(below)) {
            let [a, b, c] = [*a, *b, *c].map(i16::from);
            (*smooth, *down) = (a + 2 * b + c, c - a);
        }
        mirror_ends(&mut self.smooth);
        mirror_ends(&mut self.down);
    }
}

/// Products of gradient components: xx, xy, yy, with one more value at each end.
struct Products([Vec<f32>; 3]);

impl Products {
    fn new(width: usize) -> Self {
        Self(std::array::from_fn(|_| vec![0.0; width + 2]))
    }

    #[inline(always)]
    fn fill(&mut self, gradients: &Gradients) {
        let width = gradients.smooth.len() - 2;
        let (smooth, down) = (&gradients.smooth[..width + 2], &gradients.down[..width + 2]);
        let [xx, xy, yy] = self.0.each_mut().map(|row| &mut row[1..=width]);
        for x in 0..width {
            let across = f32::from(smooth[x + 2] - smooth[x]);
            let down = f32::from(down[x] + 2 * down[x + 1] + down[x + 2]);
            (xx[x], xy[x], yy[x]) = (across * across, across * down, down * down);
        }
        self.0.iter_mut().for_each(|row| mirror_ends(row));
    }

    /// The sum of three rows.
    #[inline(always)]
    fn add_up(&mut self, rows: [&Self; 3]) {
        for (k, out) in self.0.iter_mut().enumerate() {
            let [a, b, c] = rows.map(|row| &row.0[k]);
            for ((out, a), (b, c)) in out.iter_mut().zip(a).zip(b.iter().zip(c)) {
                *out = a + b + c;
            }
        }
    }

    #[inline(always)]
    fn write_smaller_eigenvalues(&self, out: &mut [f32]) {
        /// Scale of products: Sobel weights of total 4 on either side, three rows, 255 gray values; squared.
        const SCALE: f32 = 1.0 / (4.0 * 3.0 * 255.0 * 4.0 * 3.0 * 255.0);
        let width = out.len();
        let [xx, xy, yy] = self.0.each_ref().map(|row| &row[..width + 2]);
        for x in 0..width {
            let sum = |row: &[f32]| row[x] + row[x + 1] + row[x + 2];
            let (a, b, c) = (0.5 * sum(xx), sum(xy), 0.5 * sum(yy));
            out[x] = SCALE * ((a + c) - ((a - c) * (a - c) + b * b).sqrt());
        }
    }
}

#[cfg(test)]
mod tests {
    use opencv::core::{BORDER_DEFAULT, Mat, MatTraitConstManual};
    use rand::Rng as _;

    use super::*;
    use crate::image::borrowed_gray;
    use crate::math::seeded_rng;

    #[test]
    fn corners_are_as_strong_as_opencv_says() {
        let mut rng = seeded_rng(4, 0);
        for (width, height) in [(3, 3), (64, 5), (37, 29), (200, 3)] {
            let image = GrayImage::from_fn(width, height, |x, y| {
                ::image::Luma([if x / 9 % 2 == y / 7 % 2 {
                    rng.random_range(0..60)
                } else {
                    rng.random_range(150..=255)
                }])
            });
            let mut expected = Mat::default();
            let picture = borrowed_gray(&image).unwrap();
            opencv::imgproc::corner_min_eigen_val(&picture, &mut expected, 3, 3, BORDER_DEFAULT).unwrap();
            let found = CornerStrength::of(&image);
            assert_eq!((found.num_cols(), found.num_rows()), (width as usize, height as usize));
            for y in 0..height {
                let expected = expected.at_row::<f32>(y as i32).unwrap();
                for (x, (a, b)) in found.row(y as usize).iter().zip(expected).enumerate() {
                    assert!((a - b).abs() < 2e-6, "{width} x {height}, {x}, {y}: {a} {b}");
                }
            }
        }
    }

    #[test]
    fn pictures_of_any_size_have_a_strength() {
        for (width, height) in [(0, 0), (0, 4), (1, 1), (1, 5), (2, 2), (6, 1)] {
            let found = CornerStrength::of(&GrayImage::from_pixel(width, height, ::image::Luma([9])));
            assert!(found.values.len() == (width * height) as usize && found.values.iter().all(|v| *v == 0.0));
        }
    }
}
