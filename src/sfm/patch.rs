//! Alignment of a small patch with a later image, under an affine warp and a change of brightness.
//!
//! Inverse compositional Lucas-Kanade (S. Baker, I. Matthews, *Lucas-Kanade 20 Years On*, IJCV 2004, section 3.2): the
//! patch keeps its gradients and normal equations from the frame in which it was born, so that a track always compares
//! with its first sight and does not drift from frame to frame. Gain and bias are taken out by giving the warped patch
//! the template's mean and standard deviation in every iteration.

use nalgebra::{Matrix2, Matrix6, Point2, Vector2, Vector6};

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

/// A square template with what alignment needs of it.
#[derive(Clone, Debug)]
pub struct Patch {
    radius: i32,
    /// Zero mean, unit variance.
    normalized: Vec<f32>,
    /// Gradient times the warp's Jacobian, six per pixel: a00, a01, a10, a11, tx, ty.
    steepest: Vec<Vector6<f32>>,
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
        let steepest: Vec<Vector6<f32>> = (0..side * side)
            .map(|i| {
                let (x, y) = (i % side + 1, i / side + 1);
                let gx = (at(x + 1, y) - at(x - 1, y)) / (2.0 * deviation);
                let gy = (at(x, y + 1) - at(x, y - 1)) / (2.0 * deviation);
                let (dx, dy) = ((x as i32 - 1 - radius) as f32, (y as i32 - 1 - radius) as f32);
                Vector6::new(gx * dx, gx * dy, gy * dx, gy * dy, gx, gy)
            })
            .collect();
        let mut hessian = steepest.iter().fold(Matrix6::zeros(), |sum, j| sum + j * j.transpose());
        // The shape is held a little: on weak texture it would take up noise and carry the centre along.
        let stiffness = SHAPE_STIFFNESS * (radius * radius) as f32 * (hessian[(4, 4)] + hessian[(5, 5)]);
        for k in 0..4 {
            hessian[(k, k)] += stiffness;
        }
        Some(Self {
            radius,
            normalized: values.iter().map(|v| (v - mean) / deviation).collect(),
            steepest,
            inverse_hessian: hessian.try_inverse()?,
        })
    }

    /// Aligns the patch with an image from a near start. `None` when it leaves the image, runs away from the start, or
    /// finds nothing with structure there.
    pub fn align(&self, image: &GrayImage, start: &Warp) -> Option<Aligned> {
        const MAX_ITERATIONS: usize = 15;
        const CONVERGED_PX: f32 = 0.005;
        let mut warp = *start;
        for _ in 0..MAX_ITERATIONS {
            let seen = self.normalized_sample(image, &warp)?;
            let gradient = self
                .steepest
                .iter()
                .zip(seen.iter().zip(&self.normalized))
                .fold(Vector6::zeros(), |sum, (j, (s, t))| sum + j * (s - t));
            let step = self.inverse_hessian * gradient;
            warp = composed_with_inverse(&warp, &step)?;
            if (warp.center - start.center).norm() > self.radius as f32 * 0.5 {
                return None;
            }
            if step.fixed_rows::<2>(4).norm() < CONVERGED_PX {
                break;
            }
        }
        let seen = self.normalized_sample(image, &warp)?;
        let products = seen.iter().zip(&self.normalized).map(|(s, t)| s * t).sum::<f32>();
        let correlation = products / seen.len() as f32;
        let difference =
            seen.iter().zip(&self.normalized).map(|(s, t)| (s - t).powi(2)).sum::<f32>() / seen.len() as f32;
        Some(Aligned { warp, correlation, covariance: self.covariance(&warp.shape, difference) })
    }

    /// Covariance of the position that an alignment finds, pixels², if the mean squared difference from the template,
    /// whose variance is 1, is noise that is independent from pixel to pixel; it is not, which makes all covariances
    /// too small by about the same factor.
    pub fn covariance(&self, shape: &Matrix2<f32>, difference: f32) -> Matrix2<f32> {
        let position = self.inverse_hessian.fixed_view::<2, 2>(4, 4) * difference;
        shape * position * shape.transpose()
    }

    fn normalized_sample(&self, image: &GrayImage, warp: &Warp) -> Option<Vec<f32>> {
        let mut seen = sample(image, warp, self.radius)?;
        let (mean, deviation) = mean_and_deviation(&seen);
        if deviation < MIN_DEVIATION {
            return None;
        }
        seen.iter_mut().for_each(|v| *v = (*v - mean) / deviation);
        Some(seen)
    }
}

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
    let (width, height) = (image.width() as usize, image.height() as usize);
    let pixels = image.as_raw();
    // To array indices: the first pixel centre is at 0.5.
    let origin = warp.center - Vector2::new(0.5, 0.5);
    let reach = radius as f32;
    let inside = |sx: f32, sy: f32| {
        let p = origin + warp.shape * Vector2::new(sx * reach, sy * reach);
        p.x >= 0.0 && p.y >= 0.0 && p.x < width as f32 - 1.0 && p.y < height as f32 - 1.0
    };
    if !(inside(-1.0, -1.0) && inside(1.0, -1.0) && inside(-1.0, 1.0) && inside(1.0, 1.0)) {
        return None;
    }
    let side = (2 * radius + 1) as usize;
    let mut out = Vec::with_capacity(side * side);
    let (step_x, step_y) = (warp.shape.column(0), warp.shape.column(1));
    for dy in -radius..=radius {
        let mut p = origin + step_y * dy as f32 - step_x * reach;
        for _ in 0..side {
            let (x, y) = (p.x as usize, p.y as usize);
            let (fx, fy) = (p.x - x as f32, p.y - y as f32);
            // The corners lie inside; rounding along the row may still step on the last column or row.
            let i = y.min(height - 2) * width + x.min(width - 2);
            let (a, b) = (f32::from(pixels[i]), f32::from(pixels[i + 1]));
            let (c, d) = (f32::from(pixels[i + width]), f32::from(pixels[i + width + 1]));
            let (top, bottom) = (a + fx * (b - a), c + fx * (d - c));
            out.push(top + fy * (bottom - top));
            p.x += step_x.x;
            p.y += step_x.y;
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
