//! Octaves of Gaussian blurs.

use pulp::Arch;

use super::{LAYERS, SIGMA};

/// Image of floating-point values, row by row.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Plane {
    /// Number of columns.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// One value per pixel.
    pub values: Vec<f32>,
}

impl Plane {
    /// A row.
    pub(super) fn row(&self, y: usize) -> &[f32] {
        &self.values[y * self.width..(y + 1) * self.width]
    }

    /// A value.
    #[inline]
    pub(super) fn at(&self, x: usize, y: usize) -> f32 {
        self.values[y * self.width + x]
    }

    /// Doubles the size: sample 2 k is sample k, odd ones are the means of their neighbors.
    fn doubled(&self) -> Self {
        let (width, height) = (2 * self.width, 2 * self.height);
        let mut values = vec![0.0; width * height];
        for (y, out) in values.chunks_exact_mut(width.max(1)).enumerate() {
            let (above, below) = (self.row(y / 2), self.row((y.div_ceil(2)).min(self.height - 1)));
            for (x, value) in out.iter_mut().enumerate() {
                let (left, right) = (x / 2, x.div_ceil(2).min(self.width - 1));
                *value = 0.25 * (above[left] + above[right] + below[left] + below[right]);
            }
        }
        Self { width, height, values }
    }

    /// Every second sample of every second row.
    fn halved(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let rows = (0..height).flat_map(|y| self.row(2 * y).iter().step_by(2).copied());
        Self { width, height, values: rows.collect() }
    }
}

/// Gaussian blurs of the image at one size, with σ · 2^(k / [`LAYERS`]).
pub(super) struct Octave {
    /// `LAYERS + 3` of them.
    pub(super) layers: Vec<Plane>,
    /// Pixels of the image from one sample to the next.
    pub(super) step: f32,
}

/// Minimum side of an image for extrema, pixels.
const MIN_SIDE: usize = 16;

impl Octave {
    /// First octave: of the image or of the doubled image.
    pub(super) fn first(picture: &Plane, doubled: bool) -> Self {
        // Assumed blur of images, in their own pixels.
        const CAMERA_SIGMA: f32 = 0.5;
        let (base, step, sigma) = match doubled {
            true => (&picture.doubled(), 0.5, 2.0 * CAMERA_SIGMA),
            false => (picture, 1.0, CAMERA_SIGMA),
        };
        Self::from_base(blurred(base, (SIGMA * SIGMA - sigma * sigma).sqrt()), step)
    }

    fn from_base(base: Plane, step: f32) -> Self {
        let mut layers = vec![base];
        let sigma = |layer: usize| SIGMA * (layer as f32 / LAYERS as f32).exp2();
        for layer in 1..LAYERS + 3 {
            let more = (sigma(layer).powi(2) - sigma(layer - 1).powi(2)).sqrt();
            layers.push(blurred(&layers[layer - 1], more));
        }
        Self { layers, step }
    }

    /// Next octave, at half the size; `None` if that is too small for extrema.
    pub(super) fn next(&self) -> Option<Self> {
        let base = self.layers[LAYERS].halved();
        (base.width.min(base.height) >= MIN_SIDE).then(|| Self::from_base(base, 2.0 * self.step))
    }
}

/// Convolution with a Gaussian, borders repeated.
fn blurred(source: &Plane, sigma: f32) -> Plane {
    let mut out = Plane { width: source.width, height: source.height, values: vec![0.0; source.values.len()] };
    let kernel = half_kernel(sigma);
    Arch::new().dispatch(|| convolve(source, &kernel, &mut out.values));
    out
}

/// The middle and one side of a Gaussian of unit sum.
fn half_kernel(sigma: f32) -> Vec<f32> {
    let radius = (3.5 * sigma).ceil() as usize;
    let side: Vec<f32> = (0..=radius).map(|k| (-0.5 * (k as f32 / sigma).powi(2)).exp()).collect();
    let sum = side[0] + 2.0 * side[1..].iter().sum::<f32>();
    side.into_iter().map(|v| v / sum).collect()
}

/// Number of values that stay in registers during a convolution.
const CHUNK: usize = 32;

/// Convolves down the columns first, then along the rows.
#[inline(always)]
fn convolve(source: &Plane, kernel: &[f32], out: &mut [f32]) {
    let (width, height, radius) = (source.width, source.height, kernel.len() - 1);
    if width == 0 || height == 0 {
        return;
    }
    let mut padded = vec![0.0f32; width + 2 * radius];
    let mut rows: Vec<(&[f32], &[f32])> = Vec::with_capacity(radius + 1);
    for (y, out) in out.chunks_exact_mut(width).enumerate() {
        rows.clear();
        rows.extend((0..=radius).map(|k| (source.row(y.saturating_sub(k)), source.row((y + k).min(height - 1)))));
        weighted(&mut padded[radius..radius + width], kernel, |k, x| (&rows[k].0[x..], &rows[k].1[x..]));
        let (first, last) = (padded[radius], padded[radius + width - 1]);
        padded[..radius].fill(first);
        padded[radius + width..].fill(last);
        weighted(out, kernel, |k, x| (&padded[radius + x - k..], &padded[radius + x + k..]));
    }
}

/// `out[x] = kernel[0] · c[x] + Σ kernel[k] · (a[x] + b[x])`, where `sides(k, x)` gives a and b from x on.
#[inline(always)]
fn weighted<'a>(out: &mut [f32], kernel: &[f32], sides: impl Fn(usize, usize) -> (&'a [f32], &'a [f32])) {
    let (chunks, rest) = out.as_chunks_mut::<CHUNK>();
    let first_of_rest = chunks.len() * CHUNK;
    for (index, chunk) in chunks.iter_mut().enumerate() {
        *chunk = weighted_at(index * CHUNK, kernel, &sides);
    }
    for (x, value) in (first_of_rest..).zip(rest) {
        [*value] = weighted_at(x, kernel, &sides);
    }
}

/// Weighted sums of N values from x on.
#[inline(always)]
fn weighted_at<'a, const N: usize>(
    x: usize,
    kernel: &[f32],
    sides: &impl Fn(usize, usize) -> (&'a [f32], &'a [f32]),
) -> [f32; N] {
    let mut sum = [0.0f32; N];
    for (k, weight) in kernel.iter().enumerate() {
        let (a, b) = sides(k, x);
        let weight = if k == 0 { 0.5 * weight } else { *weight };
        let (Some(a), Some(b)) = (a.first_chunk::<N>(), b.first_chunk::<N>()) else { return sum };
        for j in 0..N {
            sum[j] += weight * (a[j] + b[j]);
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blur_of_a_point_is_the_gaussian_and_keeps_the_sum() {
        let (width, height) = (101, 67);
        let mut point = Plane { width, height, values: vec![0.0; width * height] };
        point.values[33 * width + 50] = 1.0;
        let blur = blurred(&point, 2.0);
        assert!((blur.values.iter().sum::<f32>() - 1.0).abs() < 1e-4);
        for (dx, dy) in [(0i32, 0i32), (3, -1), (-5, 4)] {
            let exact = (-((dx * dx + dy * dy) as f32) / 8.0).exp() / (8.0 * std::f32::consts::PI);
            let found = blur.at((50 + dx) as usize, (33 + dy) as usize);
            assert!((found - exact).abs() < 1e-4, "{found} {exact}");
        }
    }

    #[test]
    fn doubling_keeps_samples_and_halving_takes_them_back() {
        let plane = Plane { width: 3, height: 2, values: vec![1.0, 2.0, 4.0, 3.0, 5.0, 9.0] };
        let doubled = plane.doubled();
        assert_eq!((doubled.width, doubled.height), (6, 4));
        assert_eq!((doubled.at(2, 0), doubled.at(1, 0), doubled.at(0, 1)), (2.0, 1.5, 2.0));
        assert_eq!(doubled.halved(), plane);
    }
}
