//! Direction and descriptor of a keypoint, from the gradients around it.

use std::f32::consts::{PI, TAU};

use super::ScaleSpacePosition;
use super::scale_space::Plane;

/// Number of cells of a descriptor along each axis.
const CELLS: usize = 4;
/// Number of directions of a cell's histogram.
const DIRECTIONS: usize = 8;
/// Length of a descriptor.
pub const DESCRIPTOR_LEN: usize = CELLS * CELLS * DIRECTIONS;
/// Side of a cell, in σ of the keypoint.
const CELL_SIGMAS: f32 = 3.0;

/// The dominant direction, radians, and the descriptor turned by it.
pub(super) fn describe(layer: &Plane, position: &ScaleSpacePosition) -> (f32, [f32; DESCRIPTOR_LEN]) {
    let angle = dominant_direction(layer, position);
    let (sin, cos) = angle.sin_cos();
    let cell = CELL_SIGMAS * position.sigma;
    let reach = cell * std::f32::consts::SQRT_2 * 0.5 * (CELLS as f32 + 1.0);
    // A margin of one cell and direction receives the interpolation beyond the border.
    let mut wide = [[[0.0f32; DIRECTIONS + 1]; CELLS + 2]; CELLS + 2];
    for_each_gradient(layer, position, reach, |dx, dy, gx, gy| {
        let (u, v) = ((cos * dx + sin * dy) / cell, (cos * dy - sin * dx) / cell);
        let (column, row) = (u + 0.5 * CELLS as f32 + 0.5, v + 0.5 * CELLS as f32 + 0.5);
        let limit = CELLS as f32 + 1.0;
        if !(column > 0.0 && column < limit && row > 0.0 && row < limit) {
            return;
        }
        let weight = window((u * u + v * v) / (0.5 * (CELLS * CELLS) as f32)) * (gx * gx + gy * gy).sqrt();
        let mut direction = (direction_of(gx, gy) - angle) * (DIRECTIONS as f32 / TAU);
        while direction < 0.0 {
            direction += DIRECTIONS as f32;
        }
        while direction >= DIRECTIONS as f32 {
            direction -= DIRECTIONS as f32;
        }
        let (i, j, k) = (row as usize, column as usize, direction as usize);
        let (a, b, c) = (row - i as f32, column - j as f32, direction - k as f32);
        let (k0, k1) = (k.min(DIRECTIONS - 1), k.min(DIRECTIONS - 1) + 1);
        for (i, share) in [(i, weight * (1.0 - a)), (i + 1, weight * a)] {
            if i > CELLS + 1 {
                continue;
            }
            for (j, share) in [(j, share * (1.0 - b)), (j + 1, share * b)] {
                if j > CELLS + 1 {
                    continue;
                }
                wide[i][j][k0] += share * (1.0 - c);
                wide[i][j][k1] += share * c;
            }
        }
    });
    let mut out = [0.0; DESCRIPTOR_LEN];
    for (index, value) in out.iter_mut().enumerate() {
        let (i, j, k) = (index / (CELLS * DIRECTIONS), index / DIRECTIONS % CELLS, index % DIRECTIONS);
        let cell = &wide[i + 1][j + 1];
        *value = if k == 0 { cell[0] + cell[DIRECTIONS] } else { cell[k] };
    }
    normalize_and_clip(&mut out);
    (angle, out)
}

/// Normalizes to unit length with no entry above a fifth: single strong gradients (lights, edges of shadows) do not
/// dominate.
fn normalize_and_clip(values: &mut [f32; DESCRIPTOR_LEN]) {
    // Lowe, Distinctive image features from scale-invariant keypoints, 2004, section 6.1.
    let norm = values.iter().map(|v| v * v).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
    values.iter_mut().for_each(|v| *v = (*v / norm).min(0.2));
}

/// The most frequent gradient direction around a keypoint, radians.
fn dominant_direction(layer: &Plane, position: &ScaleSpacePosition) -> f32 {
    // Bins of ten degrees (Lowe 2004, section 5).
    const BINS: usize = 36;
    let sigma = 1.5 * position.sigma;
    let mut histogram = [0.0f32; BINS];
    for_each_gradient(layer, position, 3.0 * sigma, |dx, dy, gx, gy| {
        let distance_sq = (dx * dx + dy * dy) / (2.0 * sigma * sigma);
        if distance_sq < 4.5 {
            let bin = direction_of(gx, gy) * (BINS as f32 / TAU);
            let bin = (bin + BINS as f32 + 0.5) as usize % BINS;
            histogram[bin] += window(distance_sq) * (gx * gx + gy * gy).sqrt();
        }
    });
    for _ in 0..2 {
        let before = histogram;
        for k in 0..BINS {
            let at = |offset: usize| before[(k + BINS + offset - 2) % BINS];
            histogram[k] = (at(0) + at(4)) / 16.0 + (at(1) + at(3)) / 4.0 + at(2) * 3.0 / 8.0;
        }
    }
    let mut top = 0;
    for k in 1..BINS {
        if histogram[k] > histogram[top] {
            top = k;
        }
    }
    let (left, middle, right) = (histogram[(top + BINS - 1) % BINS], histogram[top], histogram[(top + 1) % BINS]);
    let curvature = left - 2.0 * middle + right;
    let offset = if curvature < 0.0 { 0.5 * (left - right) / curvature } else { 0.0 };
    (top as f32 + offset) * (TAU / BINS as f32)
}

/// Calls `seen(dx, dy, gx, gy)` for the samples of a square around a keypoint: offset from it, and gradient.
#[inline(always)]
fn for_each_gradient(
    layer: &Plane,
    position: &ScaleSpacePosition,
    reach: f32,
    mut seen: impl FnMut(f32, f32, f32, f32),
) {
    let range = |at: f32, side: usize| {
        let first = ((at - reach).ceil().max(1.0)) as usize;
        let last = ((at + reach).floor().min(side as f32 - 2.0)).max(0.0) as usize;
        first..last + 1
    };
    let columns = range(position.x, layer.width);
    for y in range(position.y, layer.height) {
        let (above, row, below) = (layer.row(y - 1), layer.row(y), layer.row(y + 1));
        let dy = y as f32 - position.y;
        for x in columns.clone() {
            seen(x as f32 - position.x, dy, row[x + 1] - row[x - 1], below[x] - above[x]);
        }
    }
}

/// A window like exp(−x) for x ≥ 0, without a call of exp.
#[inline]
fn window(x: f32) -> f32 {
    // (1 − x/16)¹⁶
    let base = (1.0 - x * (1.0 / 16.0)).max(0.0);
    let square = base * base;
    let fourth = square * square;
    let eighth = fourth * fourth;
    eighth * eighth
}

/// The angle of a gradient, −π to π, to 0.0003 radians.
#[inline]
fn direction_of(x: f32, y: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let ratio = ax.min(ay) / ax.max(ay).max(f32::MIN_POSITIVE);
    let square = ratio * ratio;
    let angle = ((-0.046_496_47 * square + 0.159_314_22) * square - 0.327_622_76) * square * ratio + ratio;
    let angle = if ay > ax { 0.5 * PI - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    if y < 0.0 { -angle } else { angle }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_those_of_the_arctangent() {
        for k in -180..180 {
            let angle = (k as f32).to_radians();
            let (y, x) = angle.sin_cos();
            let off = (direction_of(3.0 * x, 3.0 * y) - y.atan2(x)).abs();
            assert!(off < 4e-4 || (off - TAU).abs() < 4e-4, "{k}: {off}");
        }
        assert_eq!(direction_of(0.0, 0.0), 0.0);
    }
}
