//! Extrema of differences of Gaussians.

use nalgebra::{Matrix3, Vector3};

use super::scale_space::{Octave, Plane};
use super::{Keypoint, LAYERS, SIGMA, ScaleSpacePosition};

/// Width of the border without search, samples.
const BORDER: usize = 5;
/// Maximum ratio of the principal curvatures: above it a keypoint can slide along an edge.
const MAX_EDGE_RATIO: f32 = 10.0;

/// Calls `found` for every extremum of an octave.
pub(super) fn find(octave: &Octave, index: usize, min_contrast: f32, mut found: impl FnMut(Keypoint)) {
    let (width, height) = (octave.layers[0].width, octave.layers[0].height);
    if width.min(height) <= 2 * BORDER {
        return;
    }
    // The fit may raise the contrast, so the first threshold is half of it.
    let threshold = 0.5 * min_contrast;
    let mut rows = DifferenceRows::new(octave);
    for y in BORDER..height - BORDER {
        rows.advance_to(y);
        for layer in 1..=LAYERS {
            let values = rows.around(layer);
            for x in BORDER..width - BORDER {
                let value = values[1][1][x];
                if value.abs() > threshold
                    && is_extremum(value, &values, x)
                    && let Some(position) = refined(octave, [layer, y, x], index, min_contrast)
                {
                    found(position);
                }
            }
        }
    }
}

/// The differences of all layers at three neighboring rows.
struct DifferenceRows<'a> {
    octave: &'a Octave,
    /// By layer, then row modulo three.
    rows: Vec<[Vec<f32>; 3]>,
    middle: usize,
}

impl<'a> DifferenceRows<'a> {
    fn new(octave: &'a Octave) -> Self {
        let width = octave.layers[0].width;
        let rows = (0..LAYERS + 2).map(|_| std::array::from_fn(|_| vec![0.0; width])).collect();
        let mut new = Self { octave, rows, middle: BORDER - 1 };
        new.fill(BORDER - 1);
        new.fill(BORDER);
        new
    }

    fn fill(&mut self, y: usize) {
        for (pair, rows) in self.octave.layers.windows(2).zip(&mut self.rows) {
            for ((out, a), b) in rows[y % 3].iter_mut().zip(pair[0].row(y)).zip(pair[1].row(y)) {
                *out = b - a;
            }
        }
    }

    fn advance_to(&mut self, y: usize) {
        self.middle = y;
        self.fill(y + 1);
    }

    /// Of the layer below, the layer itself and the one above: the row above, the row itself and the one below.
    fn around(&self, layer: usize) -> [[&[f32]; 3]; 3] {
        std::array::from_fn(|l| std::array::from_fn(|k| self.rows[layer + l - 1][(self.middle + k + 2) % 3].as_slice()))
    }
}

#[inline]
fn is_extremum(value: f32, values: &[[&[f32]; 3]; 3], x: usize) -> bool {
    // Along the row first: most candidates end there.
    let row = values[1][1];
    let sign = if value > 0.0 { 1.0 } else { -1.0 };
    let value = value * sign;
    if row[x - 1] * sign >= value || row[x + 1] * sign > value {
        return false;
    }
    let beats = |rows: &[&[f32]; 3]| rows.iter().all(|row| (x - 1..=x + 1).all(|x| row[x] * sign <= value));
    beats(&values[1]) && beats(&values[0]) && beats(&values[2])
}

/// Fits a quadratic around an extremum, and again at another sample if its peak is nearer to that.
///
/// `None` if that leaves the octave, or the contrast is small, or it is an edge.
fn refined(
    octave: &Octave,
    [mut layer, mut y, mut x]: [usize; 3],
    index: usize,
    min_contrast: f32,
) -> Option<Keypoint> {
    let (width, height) = (octave.layers[0].width, octave.layers[0].height);
    // As often as in OpenCV's and VLFeat's implementations.
    for _ in 0..5 {
        let cube = Cube::at(&octave.layers, layer, y, x);
        let offset = -cube.hessian.lu().solve(&cube.gradient)?;
        if !offset.iter().all(|o| o.abs() < 3.0) {
            return None;
        }
        if offset.iter().all(|o| o.abs() <= 0.5) {
            let contrast = (cube.value + 0.5 * cube.gradient.dot(&offset)).abs();
            if contrast < min_contrast || cube.is_edge() {
                return None;
            }
            let position = ScaleSpacePosition {
                octave: index,
                layer,
                x: x as f32 + offset.x,
                y: y as f32 + offset.y,
                sigma: SIGMA * ((layer as f32 + offset.z) / LAYERS as f32).exp2(),
            };
            let pixel = |at: f32| at * octave.step + 0.5;
            let (x, y) = (pixel(position.x), pixel(position.y));
            return Some(Keypoint { x, y, scale: position.sigma * octave.step, angle: 0.0, contrast, position });
        }
        let moved = |at: usize, by: f32| at.checked_add_signed(by.round() as isize);
        (x, y, layer) = (moved(x, offset.x)?, moved(y, offset.y)?, moved(layer, offset.z)?);
        let inside = |at: usize, side: usize| (BORDER..side - BORDER).contains(&at);
        if !inside(x, width) || !inside(y, height) || !(1..=LAYERS).contains(&layer) {
            return None;
        }
    }
    None
}

/// Value and derivatives at a sample, by central differences.
struct Cube {
    value: f32,
    gradient: Vector3<f32>,
    hessian: Matrix3<f32>,
}

impl Cube {
    fn at(layers: &[Plane], layer: usize, y: usize, x: usize) -> Self {
        let d = |l: isize, dy: isize, dx: isize| {
            let (layer, i) = ((layer as isize + l) as usize, (y as isize + dy) as usize);
            let j = (x as isize + dx) as usize;
            layers[layer + 1].at(j, i) - layers[layer].at(j, i)
        };
        let value = d(0, 0, 0);
        let gradient = Vector3::new(
            0.5 * (d(0, 0, 1) - d(0, 0, -1)),
            0.5 * (d(0, 1, 0) - d(0, -1, 0)),
            0.5 * (d(1, 0, 0) - d(-1, 0, 0)),
        );
        let twice = 2.0 * value;
        let [xx, yy, zz] =
            [d(0, 0, 1) + d(0, 0, -1) - twice, d(0, 1, 0) + d(0, -1, 0) - twice, d(1, 0, 0) + d(-1, 0, 0) - twice];
        let xy = 0.25 * (d(0, 1, 1) - d(0, 1, -1) - d(0, -1, 1) + d(0, -1, -1));
        let xz = 0.25 * (d(1, 0, 1) - d(1, 0, -1) - d(-1, 0, 1) + d(-1, 0, -1));
        let yz = 0.25 * (d(1, 1, 0) - d(1, -1, 0) - d(-1, 1, 0) + d(-1, -1, 0));
        Self { value, gradient, hessian: Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) }
    }

    fn is_edge(&self) -> bool {
        let [xx, yy, xy] = [self.hessian.m11, self.hessian.m22, self.hessian.m12];
        let (trace, determinant) = (xx + yy, xx * yy - xy * xy);
        let limit = (MAX_EDGE_RATIO + 1.0).powi(2) / MAX_EDGE_RATIO;
        determinant <= 0.0 || trace * trace >= limit * determinant
    }
}
