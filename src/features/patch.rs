//! Alignment of a small patch with a later image, under an affine warp and a change of brightness.
//!
//! Inverse compositional Lucas-Kanade (S. Baker, I. Matthews, *Lucas-Kanade 20 Years On*, IJCV 2004, section 3.2): the
//! patch keeps its gradients and normal equations from the frame of its first observation, so that a track is always
//! compared with its first appearance and does not drift from frame to frame. Gain and bias are removed by giving the
//! warped patch the template's mean and standard deviation in every iteration.

use nalgebra::{Matrix2, Matrix6, Point2, Vector2, Vector6};
use pulp::{Arch, Simd, WithSimd};

use crate::image::GrayImage;

/// A warp from patch coordinates (offsets from the patch's center) to image positions: `pixel = shape · offset +
/// center`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warp {
    /// Affine part.
    pub shape: Matrix2<f32>,
    /// Image position of the patch's center, pixels, first pixel center at (0.5, 0.5).
    pub center: Point2<f32>,
}

/// Square template with its precomputed gradients and normal equations.
///
/// Rows are padded with zeros to a whole number of `LANES`.
#[derive(Clone, Debug)]
pub struct Patch {
    radius: i32,
    /// Mean of the gray values.
    mean: f32,
    /// Gray values of zero mean and unit variance.
    normalized: Vec<f32>,
    /// Gradient of `normalized`, across and down.
    gradient: [Vec<f32>; 2],
    /// Sum over the pixels of the gradient times the warp's Jacobian, `J`: a00, a01, a10, a11, tx, ty.
    sum_jacobian: Vector6<f32>,
    /// Sum over the pixels of `J` times the normalized value.
    sum_template: Vector6<f32>,
    inverse_hessian: Matrix6<f32>,
}

/// Outcome of an alignment.
#[derive(Clone, Copy, Debug)]
pub struct Aligned {
    /// Aligned warp.
    pub warp: Warp,
    /// Normalized cross-correlation with the template, −1 to 1.
    pub correlation: f32,
    /// See [`Patch::covariance`].
    pub covariance: Matrix2<f32>,
}

impl Patch {
    /// Cuts a patch of `2 radius + 1` pixels a side around an image position.
    ///
    /// `None` if it crosses the image's border or has too little structure to determine a position.
    pub fn cut(image: &GrayImage, center: Point2<f32>, radius: i32) -> Option<Self> {
        // One more on each side, for central differences.
        let wide = square(image, center, radius + 1)?;
        let side = (2 * radius + 1) as usize;
        let at = |x: usize, y: usize| wide[y * (side + 2) + x];
        let values: Vec<f32> = (0..side * side).map(|i| at(i % side + 1, i / side + 1)).collect();
        let (mean, std) = mean_and_std(&values);
        if std < MIN_STD {
            return None;
        }
        let padded = padded(side);
        let [mut normalized, mut gradient_x, mut gradient_y] = std::array::from_fn(|_| vec![0.0; padded * side]);
        let (mut sum_jacobian, mut sum_template) = (Vector6::zeros(), Vector6::zeros());
        let mut hessian = Matrix6::zeros();
        for (i, value) in values.iter().enumerate() {
            let (column, row) = (i % side, i / side);
            let (x, y) = (column + 1, row + 1);
            let gx = (at(x + 1, y) - at(x - 1, y)) / (2.0 * std);
            let gy = (at(x, y + 1) - at(x, y - 1)) / (2.0 * std);
            let (dx, dy) = ((column as i32 - radius) as f32, (row as i32 - radius) as f32);
            let (template, place) = ((value - mean) / std, row * padded + column);
            (normalized[place], gradient_x[place], gradient_y[place]) = (template, gx, gy);
            let jacobian = Vector6::new(gx * dx, gx * dy, gy * dx, gy * dy, gx, gy);
            sum_jacobian += jacobian;
            sum_template += jacobian * template;
            hessian += jacobian * jacobian.transpose();
        }
        // A weak prior on the shape: on weak texture it would absorb noise and displace the center.
        let stiffness = SHAPE_STIFFNESS * (radius * radius) as f32 * (hessian[(4, 4)] + hessian[(5, 5)]);
        for k in 0..4 {
            hessian[(k, k)] += stiffness;
        }
        Some(Self {
            radius,
            mean,
            normalized,
            gradient: [gradient_x, gradient_y],
            sum_jacobian,
            sum_template,
            inverse_hessian: hessian.try_inverse()?,
        })
    }

    /// Aligns the patch with an image from a near start.
    ///
    /// `None` if it leaves the image, diverges from the start, or finds no structure there.
    pub fn align(&self, image: &GrayImage, start: &Warp) -> Option<Aligned> {
        Arch::new().dispatch(Alignment { patch: self, image, start })
    }

    /// Aligns the patch in the smallest search window that holds it and its possible displacement.
    #[inline(always)]
    fn align_here(&self, image: &GrayImage, start: &Warp) -> Option<Aligned> {
        let [x0, y0, x1, y1] = extent(start, self.radius);
        // Maximum displacement, and a few pixels more for the shape.
        let spread = (x1 - x0).max(y1 - y0) + self.radius as f32 + 4.0;
        if spread <= SMALL as f32 {
            self.align_within::<SMALL>(image, start)
        } else if spread <= LARGE as f32 {
            self.align_within::<LARGE>(image, start)
        } else {
            self.align_within::<LARGEST>(image, start)
        }
    }

    #[inline(always)]
    fn align_within<const SIDE: usize>(&self, image: &GrayImage, start: &Warp) -> Option<Aligned> {
        // A bound: a patch that has not converged by then is lost.
        const MAX_ITERATIONS: usize = 15;
        let mut warp = *start;
        let mut window = SearchWindow::<SIDE>::new(image, start, self.radius)?;
        let mut correlation = 0.0;
        for iteration in 0..=MAX_ITERATIONS {
            let compared = match window.sampler(&warp, self.radius) {
                Some(sampler) => self.compare(&sampler)?,
                None => {
                    window = SearchWindow::new(image, &warp, self.radius)?;
                    self.compare(&window.sampler(&warp, self.radius)?)?
                }
            };
            correlation = compared.correlation;
            if iteration == MAX_ITERATIONS {
                break;
            }
            let gradient = (compared.jacobian - self.sum_jacobian * compared.mean) / compared.std - self.sum_template;
            let step = self.inverse_hessian * gradient;
            warp = composed_with_inverse(&warp, &step)?;
            if (warp.center - start.center).norm() > self.radius as f32 * 0.5 {
                return None;
            }
            if step.fixed_rows::<2>(4).norm() < 0.005 {
                // Too short a step to compare again.
                break;
            }
        }
        // Mean squared difference of two patches of zero mean and unit variance.
        let difference = (2.0 - 2.0 * correlation).max(0.0);
        Some(Aligned { warp, correlation, covariance: self.covariance(&warp.shape, difference) })
    }

    /// Covariance of an aligned position, pixels², from the mean squared difference to the template, whose variance is
    /// 1.
    ///
    /// The difference is taken as noise that is independent from pixel to pixel. It is not, which makes all covariances
    /// too small by about the same factor.
    pub fn covariance(&self, shape: &Matrix2<f32>, difference: f32) -> Matrix2<f32> {
        let position = self.inverse_hessian.fixed_view::<2, 2>(4, 4) * difference;
        shape * position * shape.transpose()
    }

    /// Compares an image with the template, in one pass over the patch; `None` where it has no structure.
    ///
    /// Gray values are relative to the template's mean, which keeps the sums small.
    #[inline(always)]
    fn compare<const SIDE: usize>(&self, sampler: &Sampler<'_, SIDE>) -> Option<WarpedPatch> {
        let side = (2 * self.radius + 1) as usize;
        let (padded, num_pixels) = (padded(side), (side * side) as f32);
        let [mut sum, mut sum_sq, mut products] = [[0.0f32; LANES]; 3];
        // Sums of gradient times value: alone, times the column, times the row; across and down.
        let [mut alone, mut by_column, mut by_row] = [[[0.0f32; LANES]; 2]; 3];
        for row in 0..side {
            let dy = (row as i32 - self.radius) as f32;
            for first in (0..padded).step_by(LANES) {
                let place = row * padded + first;
                let lanes = place..place + LANES;
                let template = &self.normalized[lanes.clone()];
                let gradient = [&self.gradient[0][lanes.clone()], &self.gradient[1][lanes]];
                let values = sampler.sample(dy, (first as i32 - self.radius) as f32);
                for k in 0..LANES {
                    let is_inside = if first + k < side { 1.0 } else { 0.0 };
                    let value = (values[k] - self.mean) * is_inside;
                    sum[k] += value;
                    sum_sq[k] += value * value;
                    products[k] += value * template[k];
                    let dx = ((first + k) as i32 - self.radius) as f32;
                    for axis in 0..2 {
                        let product = gradient[axis][k] * value;
                        alone[axis][k] += product;
                        by_column[axis][k] += product * dx;
                        by_row[axis][k] += product * dy;
                    }
                }
            }
        }
        let total = |lanes: &[f32; LANES]| lanes.iter().sum::<f32>();
        let mean = total(&sum) / num_pixels;
        let std = (total(&sum_sq) / num_pixels - mean * mean).max(0.0).sqrt();
        let [[x, y], [x_column, y_column], [x_row, y_row]] =
            [alone, by_column, by_row].map(|axes| axes.map(|lanes| total(&lanes)));
        (std >= MIN_STD).then(|| WarpedPatch {
            mean,
            std,
            jacobian: Vector6::new(x_column, x_row, y_column, y_row, x, y),
            correlation: total(&products) / (num_pixels * std),
        })
    }
}

/// Alignment with the vector instructions of the processor.
struct Alignment<'a> {
    patch: &'a Patch,
    image: &'a GrayImage,
    start: &'a Warp,
}

impl WithSimd for Alignment<'_> {
    type Output = Option<Aligned>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        self.patch.align_here(self.image, self.start)
    }
}

/// Statistics of an image under a warp.
struct WarpedPatch {
    /// Mean of the gray values minus that of the template.
    mean: f32,
    std: f32,
    /// Sum over the pixels of the template's gradient times the warp's Jacobian times the gray value minus the
    /// template's mean.
    jacobian: Vector6<f32>,
    /// Normalized cross-correlation with the template.
    correlation: f32,
}

/// Number of gray values processed at once by vector instructions.
const LANES: usize = 8;

/// Side of the smallest search window, pixels.
const SMALL: usize = 32;
/// Side of the medium search window, pixels.
const LARGE: usize = 64;
/// Side of the largest search window, pixels: a patch that needs more is lost.
const LARGEST: usize = 512;

/// Length of a padded row.
fn padded(side: usize) -> usize {
    side.div_ceil(LANES) * LANES
}

/// Part of an image in which a patch is searched, as floating-point numbers.
///
/// Converting pixels for every sample takes longer than all else. The compiler knows the length of the rows and omits
/// bounds checks.
struct SearchWindow<const SIDE: usize> {
    values: Vec<[f32; SIDE]>,
    /// Array indices of the first value in the image.
    corner: [usize; 2],
    /// Columns and rows that lie in the image.
    size: [usize; 2],
}

impl<const SIDE: usize> SearchWindow<SIDE> {
    /// `None` if the patch is not inside the image under the warp, or covers too many pixels.
    #[inline(always)]
    fn new(image: &GrayImage, warp: &Warp, radius: i32) -> Option<Self> {
        let sides = [image.width() as usize, image.height() as usize];
        let [x0, y0, x1, y1] = extent(warp, radius);
        let is_inside = x0 >= 0.0 && y0 >= 0.0 && x1 < sides[0] as f32 - 1.0 && y1 < sides[1] as f32 - 1.0;
        if !is_inside || (x1 - x0).max(y1 - y0) > (SIDE - 4) as f32 {
            return None;
        }
        let first = |from: f32, to: f32| (0.5 * (from + to - SIDE as f32)).max(0.0) as usize;
        let corner = [first(x0, x1), first(y0, y1)];
        let size = [0, 1].map(|axis| (sides[axis] - corner[axis]).min(SIDE));
        let mut values = vec![[0.0; SIDE]; SIDE];
        let rows = image.as_raw().chunks_exact(sides[0]).skip(corner[1]);
        for (values, row) in values.iter_mut().zip(rows) {
            let row = &row[corner[0]..corner[0] + size[0]];
            values.iter_mut().zip(row).for_each(|(value, gray)| *value = f32::from(*gray));
        }
        Some(Self { values, corner, size })
    }

    /// Sampler of the patch under a warp; `None` if it is not inside.
    #[inline(always)]
    fn sampler(&self, warp: &Warp, radius: i32) -> Option<Sampler<'_, SIDE>> {
        let [x0, y0, x1, y1] = extent(warp, radius);
        let ([left, top], [cols, rows]) = (self.corner.map(|at| at as f32), self.size.map(|side| side as f32));
        let holds = x0 >= left && y0 >= top && x1 < left + cols - 1.0 && y1 < top + rows - 1.0;
        let values = self.values.as_slice().try_into().ok().filter(|_| holds)?;
        Some(Sampler { values, origin: warp.center - Vector2::new(0.5 + left, 0.5 + top), shape: warp.shape })
    }
}

/// Bounding box of a warped square of `2 radius + 1` pixels a side, in array indices: the first pixel center is at 0.5.
#[inline(always)]
fn extent(warp: &Warp, radius: i32) -> [f32; 4] {
    let reach = |row: usize| radius as f32 * (warp.shape[(row, 0)].abs() + warp.shape[(row, 1)].abs());
    let ([x, y], [across, down]) = ([warp.center.x - 0.5, warp.center.y - 0.5], [reach(0), reach(1)]);
    [x - across, y - down, x + across, y + down]
}

/// Search window under a warp that is inside it.
struct Sampler<'a, const SIDE: usize> {
    values: &'a [[f32; SIDE]; SIDE],
    /// The patch's center, in array indices.
    origin: Point2<f32>,
    shape: Matrix2<f32>,
}

impl<const SIDE: usize> Sampler<'_, SIDE> {
    /// Bilinear samples along a row of the patch, from a column on; those beyond the patch are arbitrary.
    #[inline(always)]
    fn sample(&self, row: f32, column: f32) -> [f32; LANES] {
        let start = self.origin + self.shape * Vector2::new(column, row);
        // Fixed point: conversions of floating-point numbers to indices take longer than all else.
        let fixed = |value: f32| (value * ONE) as i32;
        let (first, step) = ([start.x, start.y].map(fixed), [self.shape[(0, 0)], self.shape[(1, 0)]].map(fixed));
        // The corners of the patch are inside; rounding, and row padding, may still cross the border.
        let last = (SIDE * SIDE - SIDE - 2) as u32;
        let (mut index, mut part) = ([0u32; LANES], [[0.0f32; LANES]; 2]);
        for k in 0..LANES {
            let place = |axis: usize| first[axis].wrapping_add(step[axis].wrapping_mul(k as i32));
            let (x, y) = (place(0), place(1));
            index[k] = ((y >> BITS).wrapping_mul(SIDE as i32).wrapping_add(x >> BITS) as u32).min(last);
            part[0][k] = (x & MASK) as f32 * (1.0 / ONE);
            part[1][k] = (y & MASK) as f32 * (1.0 / ONE);
        }
        let values = self.values.as_flattened();
        let mut near = [[0.0f32; LANES]; 4];
        for k in 0..LANES {
            let index = index[k] as usize;
            (near[0][k], near[1][k]) = (values[index], values[index + 1]);
            (near[2][k], near[3][k]) = (values[index + SIDE], values[index + SIDE + 1]);
        }
        std::array::from_fn(|k| {
            let top = near[0][k] + part[0][k] * (near[1][k] - near[0][k]);
            let bottom = near[2][k] + part[0][k] * (near[3][k] - near[2][k]);
            top + part[1][k] * (bottom - top)
        })
    }
}

/// Fractional bits of a position in fixed point; positions are within [`LARGEST`].
const BITS: u32 = 18;
/// One pixel in fixed point.
const ONE: f32 = (1 << BITS) as f32;
/// Mask of the fractional bits.
const MASK: i32 = (1 << BITS) - 1;

/// Minimum standard deviation of a patch's gray values, gray levels: below it they are noise, not structure.
const MIN_STD: f32 = 1.0;
/// Weight of the prior on the shape, relative to the information on the position.
const SHAPE_STIFFNESS: f32 = 0.01;

/// `warp ∘ (identity + step)⁻¹`.
fn composed_with_inverse(warp: &Warp, step: &Vector6<f32>) -> Option<Warp> {
    let change = Matrix2::new(1.0 + step[0], step[1], step[2], 1.0 + step[3]).try_inverse()?;
    let shape = warp.shape * change;
    let center = warp.center - shape * Vector2::new(step[4], step[5]);
    let sane = shape.iter().all(|v| v.is_finite()) && (0.1..10.0).contains(&shape.determinant());
    (sane && center.coords.iter().all(|v| v.is_finite())).then_some(Warp { shape, center })
}

fn mean_and_std(values: &[f32]) -> (f32, f32) {
    let n = values.len() as f32;
    let mean = values.iter().sum::<f32>() / n;
    (mean, (values.iter().map(|v| (v - mean) * (v - mean)).sum::<f32>() / n).sqrt())
}

/// Bilinear samples of a square of `2 radius + 1` pixels a side, row-major; `None` if any lies outside.
fn square(image: &GrayImage, center: Point2<f32>, radius: i32) -> Option<Vec<f32>> {
    let (width, side) = (image.width() as usize, (2 * radius + 1) as usize);
    let [x, y] = [center.x, center.y].map(|at| at - 0.5 - radius as f32);
    let reach = (side - 1) as f32;
    let is_inside = x >= 0.0 && y >= 0.0 && x + reach < width as f32 - 1.0 && y + reach < image.height() as f32 - 1.0;
    if !is_inside {
        return None;
    }
    let (first, [u, v]) = (y as usize * width + x as usize, [x.fract(), y.fract()]);
    let mut out = Vec::with_capacity(side * side);
    for row in 0..side {
        let top = &image.as_raw()[first + row * width..][..side + 1];
        let bottom = &image.as_raw()[first + (row + 1) * width..][..side + 1];
        out.extend(top.windows(2).zip(bottom.windows(2)).map(|(top, bottom)| {
            let [a, b, c, d] = [top[0], top[1], bottom[0], bottom[1]].map(f32::from);
            let (top, bottom) = (a + u * (b - a), c + u * (d - c));
            top + v * (bottom - top)
        }));
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth texture under an affine map and a change of brightness.
    fn picture(map: impl Fn(f32, f32) -> (f32, f32), gain: f32, bias: f32) -> GrayImage {
        GrayImage::from_fn(120, 100, |x, y| {
            let (u, v) = map(x as f32 + 0.5, y as f32 + 0.5);
            let value = 40.0 * ((u * 0.31).sin() + (v * 0.23 + 0.1 * u).cos() + (0.17 * (u + v)).sin());
            ::image::Luma([(gain * value + bias).clamp(0.0, 255.0) as u8])
        })
    }

    #[test]
    fn affine_motion_and_brightness_are_estimated_to_a_twentieth_of_a_pixel() {
        let first = picture(|x, y| (x, y), 0.7, 120.0);
        let shape = Matrix2::new(1.08, 0.05, -0.04, 0.94);
        let (c, moved) = (Point2::new(60.5, 50.5), Vector2::new(2.3, -1.6));
        let inverse = shape.try_inverse().unwrap();
        let second = picture(
            |x, y| {
                let p = c + inverse * (Point2::new(x, y) - c - moved);
                (p.x, p.y)
            },
            0.5,
            100.0,
        );
        let patch = Patch::cut(&first, c, 8).unwrap();
        let start = Warp { shape: Matrix2::identity(), center: c + Vector2::new(1.5, -1.0) };
        let found = patch.align(&second, &start).unwrap();
        assert!((found.warp.center - (c + moved)).norm() < 0.05, "{:?}", found.warp);
        assert!(found.correlation > 0.99);
    }

    #[test]
    fn flat_or_truncated_patches_are_rejected() {
        let flat = GrayImage::from_pixel(60, 60, ::image::Luma([90]));
        assert!(Patch::cut(&flat, Point2::new(30.0, 30.0), 7).is_none());
        let image = picture(|x, y| (x, y), 0.7, 120.0);
        assert!(Patch::cut(&image, Point2::new(3.0, 30.0), 7).is_none());
        let patch = Patch::cut(&image, Point2::new(30.0, 30.0), 7).unwrap();
        let outside = Warp { shape: Matrix2::identity(), center: Point2::new(118.0, 30.0) };
        assert!(patch.align(&image, &outside).is_none());
    }
}
