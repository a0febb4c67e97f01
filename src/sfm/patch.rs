//! Alignment of a small patch with a later image, under an affine warp and a change of brightness.
//!
//! Inverse compositional Lucas-Kanade (S. Baker, I. Matthews, *Lucas-Kanade 20 Years On*, IJCV 2004, section 3.2): the
//! patch keeps its gradients and normal equations from the frame in which it was born, so that a track always compares
//! with its first sight and does not drift from frame to frame. Gain and bias are taken out by giving the warped patch
//! the template's mean and standard deviation in every iteration.

use nalgebra::{Matrix2, Matrix6, Point2, Vector2, Vector6};
use pulp::{Arch, Simd, WithSimd};

use crate::image::GrayImage;

/// A warp from patch coordinates (offsets from the patch's centre) to image positions: `pixel = shape · offset +
/// center`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Warp {
    /// Affine part.
    pub shape: Matrix2<f32>,
    /// Image position of the patch's centre, pixels, first pixel centre at (0.5, 0.5).
    pub center: Point2<f32>,
}

/// A square template with what alignment needs of it. Rows are filled up with zeros to a whole number of `LANES`.
#[derive(Clone, Debug)]
pub struct Patch {
    radius: i32,
    /// Mean of the grey values.
    mean: f32,
    /// Grey values of zero mean and unit variance.
    normalized: Vec<f32>,
    /// Gradient of `normalized`, across and down.
    gradient: [Vec<f32>; 2],
    /// Sum over the pixels of the gradient times the warp's Jacobian, `J`: a00, a01, a10, a11, tx, ty.
    sum_jacobian: Vector6<f32>,
    /// The same of `J` times the normalised value.
    sum_template: Vector6<f32>,
    inverse_hessian: Matrix6<f32>,
}

/// Outcome of an alignment.
#[derive(Clone, Copy, Debug)]
pub struct Aligned {
    /// Where the patch is now.
    pub warp: Warp,
    /// Normalised cross-correlation with the template, −1 to 1.
    pub correlation: f32,
    /// See [`Patch::covariance`].
    pub covariance: Matrix2<f32>,
}

impl Patch {
    /// Cuts a patch of `2 radius + 1` pixels a side round an image position.
    ///
    /// `None` when it reaches over the image's border or has too little structure to fix a position.
    pub fn cut(image: &GrayImage, center: Point2<f32>, radius: i32) -> Option<Self> {
        let identity = Warp { shape: Matrix2::identity(), center };
        // One more on each side, for central differences.
        let wide = sample(image, &identity, radius + 1)?;
        let side = (2 * radius + 1) as usize;
        let at = |x: usize, y: usize| wide[y * (side + 2) + x];
        let values: Vec<f32> = (0..side * side).map(|i| at(i % side + 1, i / side + 1)).collect();
        let (mean, deviation) = mean_and_deviation(&values);
        if deviation < MIN_DEVIATION {
            return None;
        }
        let padded = padded(side);
        let [mut normalized, mut gradient_x, mut gradient_y] = std::array::from_fn(|_| vec![0.0; padded * side]);
        let (mut sum_jacobian, mut sum_template) = (Vector6::zeros(), Vector6::zeros());
        let mut hessian = Matrix6::zeros();
        for (i, value) in values.iter().enumerate() {
            let (column, row) = (i % side, i / side);
            let (x, y) = (column + 1, row + 1);
            let gx = (at(x + 1, y) - at(x - 1, y)) / (2.0 * deviation);
            let gy = (at(x, y + 1) - at(x, y - 1)) / (2.0 * deviation);
            let (dx, dy) = ((column as i32 - radius) as f32, (row as i32 - radius) as f32);
            let (template, place) = ((value - mean) / deviation, row * padded + column);
            (normalized[place], gradient_x[place], gradient_y[place]) = (template, gx, gy);
            let jacobian = Vector6::new(gx * dx, gx * dy, gy * dx, gy * dy, gx, gy);
            sum_jacobian += jacobian;
            sum_template += jacobian * template;
            hessian += jacobian * jacobian.transpose();
        }
        // The shape is held a little: on weak texture it would take up noise and carry the centre along.
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

    /// Aligns the patch with an image from a near start. `None` when it leaves the image, runs away from the start, or
    /// finds nothing with structure there.
    pub fn align(&self, image: &GrayImage, start: &Warp) -> Option<Aligned> {
        Arch::new().dispatch(Alignment { patch: self, image, start })
    }

    #[inline(always)]
    fn align_here(&self, image: &GrayImage, start: &Warp) -> Option<Aligned> {
        const MAX_ITERATIONS: usize = 15;
        const CONVERGED_PX: f32 = 0.005;
        let mut warp = *start;
        for _ in 0..MAX_ITERATIONS {
            let seen = self.compare(image, &warp)?;
            let gradient = (seen.jacobian - self.sum_jacobian * seen.mean) / seen.deviation - self.sum_template;
            let step = self.inverse_hessian * gradient;
            warp = composed_with_inverse(&warp, &step)?;
            if (warp.center - start.center).norm() > self.radius as f32 * 0.5 {
                return None;
            }
            if step.fixed_rows::<2>(4).norm() < CONVERGED_PX {
                break;
            }
        }
        let correlation = self.compare(image, &warp)?.correlation;
        // Of two patches of zero mean and unit variance.
        let difference = (2.0 - 2.0 * correlation).max(0.0);
        Some(Aligned { warp, correlation, covariance: self.covariance(&warp.shape, difference) })
    }

    /// Covariance of the position that an alignment finds, pixels², if the mean squared difference from the template,
    /// whose variance is 1, is noise that is independent from pixel to pixel; it is not, which makes all covariances
    /// too small by about the same factor.
    pub fn covariance(&self, shape: &Matrix2<f32>, difference: f32) -> Matrix2<f32> {
        let position = self.inverse_hessian.fixed_view::<2, 2>(4, 4) * difference;
        shape * position * shape.transpose()
    }

    /// What the image shows under a warp, in one pass over the patch; `None` where it reaches over the border, or
    /// shows no structure. Grey values count from the template's mean, which keeps the sums small.
    #[inline(always)]
    fn compare(&self, image: &GrayImage, warp: &Warp) -> Option<Seen> {
        let picture = Picture::new(image, warp, self.radius)?;
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
                let values = picture.sample(dy, (first as i32 - self.radius) as f32);
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
        let deviation = (total(&sum_sq) / num_pixels - mean * mean).max(0.0).sqrt();
        let [[x, y], [x_column, y_column], [x_row, y_row]] =
            [alone, by_column, by_row].map(|axes| axes.map(|lanes| total(&lanes)));
        (deviation >= MIN_DEVIATION).then(|| Seen {
            mean,
            deviation,
            jacobian: Vector6::new(x_column, x_row, y_column, y_row, x, y),
            correlation: total(&products) / (num_pixels * deviation),
        })
    }
}

/// An alignment, for whatever vector instructions the processor has.
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

/// What an image shows under a warp.
struct Seen {
    /// Of the grey values, less the template's.
    mean: f32,
    deviation: f32,
    /// Sum over the pixels of the template's gradient times the warp's Jacobian times the grey value less the
    /// template's mean.
    jacobian: Vector6<f32>,
    /// Normalised cross-correlation with the template.
    correlation: f32,
}

/// Values that are worked on at once.
const LANES: usize = 8;

/// Length of a row with what fills it up.
fn padded(side: usize) -> usize {
    side.div_ceil(LANES) * LANES
}

/// An image under a warp that it holds whole.
struct Picture<'a> {
    pixels: &'a [u8],
    width: usize,
    height: usize,
    /// The patch's centre, in array indices.
    origin: Point2<f32>,
    shape: Matrix2<f32>,
}

impl<'a> Picture<'a> {
    /// `None` if a square of `2 radius + 1` pixels a side does not lie inside.
    #[inline(always)]
    fn new(image: &'a GrayImage, warp: &Warp, radius: i32) -> Option<Self> {
        let (width, height) = (image.width() as usize, image.height() as usize);
        // The first pixel centre is at 0.5.
        let origin = warp.center - Vector2::new(0.5, 0.5);
        let reach = radius as f32;
        let inside = |sx: f32, sy: f32| {
            let p = origin + warp.shape * Vector2::new(sx * reach, sy * reach);
            p.x >= 0.0 && p.y >= 0.0 && p.x < width as f32 - 1.0 && p.y < height as f32 - 1.0
        };
        let holds = inside(-1.0, -1.0) && inside(1.0, -1.0) && inside(-1.0, 1.0) && inside(1.0, 1.0);
        holds.then(|| Self { pixels: image.as_raw(), width, height, origin, shape: warp.shape })
    }

    /// Bilinear samples along a row of the patch, from a column on. What lies beyond the patch may be anything.
    #[inline(always)]
    fn sample(&self, row: f32, column: f32) -> [f32; LANES] {
        let start = self.origin + self.shape * Vector2::new(column, row);
        // Fixed point: conversions of floating-point numbers to indices take longer than all else.
        let fixed = |value: f32| (value * ONE) as i64;
        let (step_x, step_y) = (fixed(self.shape[(0, 0)]), fixed(self.shape[(1, 0)]));
        let (mut x, mut y) = (fixed(start.x), fixed(start.y));
        let mut values = [0.0; LANES];
        for value in &mut values {
            // The patch's corners lie inside; rounding may still step over the border.
            let index = |place: i64, last: usize| ((place >> BITS).max(0) as usize).min(last);
            let (u, v) = (index(x, self.width - 2), index(y, self.height - 2));
            let part = |place: i64| (place & ((1 << BITS) - 1)) as i32 as f32 * (1.0 / ONE);
            let first = v * self.width + u;
            let near = &self.pixels[first..first + self.width + 2];
            let [a, b, c, d] = [near[0], near[1], near[self.width], near[self.width + 1]].map(f32::from);
            let (top, bottom) = (a + part(x) * (b - a), c + part(x) * (d - c));
            *value = top + part(y) * (bottom - top);
            (x, y) = (x + step_x, y + step_y);
        }
        values
    }
}

/// Bits behind the point of a position in fixed point.
const BITS: u32 = 20;
const ONE: f32 = (1 << BITS) as f32;

/// Grey values of standard deviation below this are noise, not structure.
const MIN_DEVIATION: f32 = 1.0;
/// Weight that holds the shape, relative to the information on the position.
const SHAPE_STIFFNESS: f32 = 0.01;

/// `warp ∘ (identity + step)⁻¹`.
fn composed_with_inverse(warp: &Warp, step: &Vector6<f32>) -> Option<Warp> {
    let change = Matrix2::new(1.0 + step[0], step[1], step[2], 1.0 + step[3]).try_inverse()?;
    let shape = warp.shape * change;
    let center = warp.center - shape * Vector2::new(step[4], step[5]);
    let sane = shape.iter().all(|v| v.is_finite()) && (0.1..10.0).contains(&shape.determinant());
    (sane && center.coords.iter().all(|v| v.is_finite())).then_some(Warp { shape, center })
}

fn mean_and_deviation(values: &[f32]) -> (f32, f32) {
    let n = values.len() as f32;
    let mean = values.iter().sum::<f32>() / n;
    (mean, (values.iter().map(|v| (v - mean) * (v - mean)).sum::<f32>() / n).sqrt())
}

/// Bilinear samples of a warped square, row-major; `None` if any lies outside.
fn sample(image: &GrayImage, warp: &Warp, radius: i32) -> Option<Vec<f32>> {
    let picture = Picture::new(image, warp, radius)?;
    let side = (2 * radius + 1) as usize;
    let mut out = Vec::with_capacity(side * side);
    for row in -radius..=radius {
        for first in (0..side).step_by(LANES) {
            let values = picture.sample(row as f32, (first as i32 - radius) as f32);
            out.extend(&values[..LANES.min(side - first)]);
        }
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
    fn affine_motion_and_brightness_are_followed_to_a_twentieth_of_a_pixel() {
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
    fn flat_or_cut_patches_are_refused() {
        let flat = GrayImage::from_pixel(60, 60, ::image::Luma([90]));
        assert!(Patch::cut(&flat, Point2::new(30.0, 30.0), 7).is_none());
        let image = picture(|x, y| (x, y), 0.7, 120.0);
        assert!(Patch::cut(&image, Point2::new(3.0, 30.0), 7).is_none());
        let patch = Patch::cut(&image, Point2::new(30.0, 30.0), 7).unwrap();
        let outside = Warp { shape: Matrix2::identity(), center: Point2::new(118.0, 30.0) };
        assert!(patch.align(&image, &outside).is_none());
    }
}
