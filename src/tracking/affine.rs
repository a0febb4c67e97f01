//! Affine motion of an object between two frames.

use nalgebra::{Matrix3, Vector3};

use super::region::Region;
use crate::math::upper_median;
use crate::scene::{BoundingBox, Flow, Rect};

/// Length of a displacement in pixels.
///
/// It can neither overflow nor underflow; `hypot`, which guards against both, takes ten times as long.
pub(super) fn length([x, y]: [f64; 2]) -> f64 {
    (x * x + y * y).sqrt()
}

/// x' = a + A (x − origin), in pixels.
#[derive(Clone, Debug)]
pub(super) struct Affine {
    pub(super) origin: [f64; 2],
    /// Per coordinate of the target: constant, factor of x, factor of y.
    pub(super) rows: [[f64; 3]; 2],
}

impl Affine {
    /// Minimum number of pixels of a fit; fewer give a displacement only.
    const MIN_PIXELS: usize = 100;
    /// Maximum change of a vehicle's area from frame to frame, as a factor.
    const MAX_GROWTH: f64 = 1.3;
    /// Number of fits, each to the inliers of the one before.
    const ROUNDS: usize = 3;
    /// Maximum residual of an inlier, in medians of all residuals.
    const MAX_RESIDUAL_MEDIANS: f64 = 2.5;
    /// Residual up to which a pixel is always an inlier, pixels.
    const MAX_RESIDUAL_PX: f64 = 0.5;

    pub(super) fn shift([dx, dy]: [f64; 2]) -> Self {
        Self { origin: [0.0; 2], rows: [[dx, 1.0, 0.0], [dy, 0.0, 1.0]] }
    }

    /// Fits the motion to flow by least squares with outlier rejection.
    ///
    /// `None` with too few pixels, a singular system, or an implausible change of area.
    pub(super) fn fit(pixels: &[(u32, u32)], flow: &Flow) -> Option<Self> {
        let pairs = pixels.iter().map(|&(x, y)| {
            let ([dx, dy], from) = (flow.at(x, y), [f64::from(x) + 0.5, f64::from(y) + 0.5]);
            (from, [from[0] + f64::from(dx), from[1] + f64::from(dy)])
        });
        let mut pairs: Vec<([f64; 2], [f64; 2])> = pairs.collect();
        let mut fitted = Self::least_squares(&pairs)?;
        for _ in 1..Self::ROUNDS {
            let residual = |(from, to): &([f64; 2], [f64; 2])| {
                let [x, y] = fitted.at(*from);
                length([x - to[0], y - to[1]])
            };
            let median = upper_median(pairs.iter().map(residual).collect())?;
            let limit = Self::MAX_RESIDUAL_PX.max(Self::MAX_RESIDUAL_MEDIANS * median);
            pairs = pairs.iter().filter(|pair| residual(pair) <= limit).copied().collect();
            fitted = Self::least_squares(&pairs)?;
        }
        let growth = fitted.determinant();
        (1.0 / Self::MAX_GROWTH..=Self::MAX_GROWTH).contains(&growth).then_some(fitted)
    }

    fn least_squares(pairs: &[([f64; 2], [f64; 2])]) -> Option<Self> {
        if pairs.len() < Self::MIN_PIXELS {
            return None;
        }
        let mean = |c: usize| pairs.iter().map(|(from, _)| from[c]).sum::<f64>() / pairs.len() as f64;
        let origin = [mean(0), mean(1)];
        let (mut normal, mut right) = (Matrix3::zeros(), [Vector3::zeros(); 2]);
        for (from, to) in pairs {
            let row = Vector3::new(1.0, from[0] - origin[0], from[1] - origin[1]);
            normal += row * row.transpose();
            right[0] += row * to[0];
            right[1] += row * to[1];
        }
        let cholesky = normal.cholesky()?;
        let rows = right.map(|right| cholesky.solve(&right).into());
        Some(Self { origin, rows })
    }

    pub(super) fn at(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (u, v) = (x - self.origin[0], y - self.origin[1]);
        self.rows.map(|[constant, a, b]| constant + a * u + b * v)
    }

    fn determinant(&self) -> f64 {
        let [[_, a, b], [_, c, d]] = self.rows;
        a * d - b * c
    }

    /// Composition: this motion followed by another.
    pub(super) fn then(&self, next: &Self) -> Self {
        let [[e, a, b], [f, c, d]] = self.rows;
        let constants = next.at([e, f]);
        let row = |k: usize| {
            let [_, p, q] = next.rows[k];
            [constants[k], p * a + q * c, p * b + q * d]
        };
        Self { origin: self.origin, rows: [row(0), row(1)] }
    }

    /// Warps a region by the motion; `None` if nothing remains in the frame.
    pub(super) fn apply(&self, region: &Region) -> Option<Region> {
        warped(region, |corner| self.at(corner), |center| self.source(center[0], center[1]))
    }

    /// Warps a region by the inverse motion; `None` if nothing remains in the frame.
    pub(super) fn apply_inverse(&self, region: &Region) -> Option<Region> {
        warped(region, |corner| self.source(corner[0], corner[1]), |center| self.at(center))
    }

    /// Inverse motion: source of a target position.
    pub(super) fn source(&self, x: f64, y: f64) -> [f64; 2] {
        let [[e, a, b], [f, c, d]] = self.rows;
        let (u, v) = (x - e, y - f);
        let determinant = self.determinant();
        [self.origin[0] + (d * u - b * v) / determinant, self.origin[1] + (a * v - c * u) / determinant]
    }
}

/// Warps a region: the pixels whose centers have their source in it; `None` if none is in the frame.
///
/// * `forward` – maps a position of the region to its target.
/// * `inverse` – maps a target to its source.
fn warped(
    region: &Region,
    forward: impl Fn([f64; 2]) -> [f64; 2],
    inverse: impl Fn([f64; 2]) -> [f64; 2],
) -> Option<Region> {
    let frame @ (width, height) = (region.mask().width(), region.mask().height());
    let Rect { x0, y0, x1, y1 } = region.rect();
    let corners = [[x0, y0], [x1, y0], [x0, y1], [x1, y1]].map(forward);
    let least = |c: usize| corners.iter().map(|p| p[c]).fold(f64::INFINITY, f64::min).floor().max(0.0) as u32;
    let most = |c: usize| corners.iter().map(|p| p[c]).fold(f64::NEG_INFINITY, f64::max).ceil().max(0.0) as u32;
    let bounds = BoundingBox { x0: least(0), y0: least(1), x1: most(0).min(width), y1: most(1).min(height) };
    if bounds.x0 >= bounds.x1 || bounds.y0 >= bounds.y1 {
        return None;
    }
    Region::in_window(frame, bounds, |x, y| {
        let [u, v] = inverse([f64::from(x) + 0.5, f64::from(y) + 0.5]);
        u >= 0.0 && v >= 0.0 && region.contains(u as u32, v as u32)
    })
}
