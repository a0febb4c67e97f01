//! The reprojection residual of one observation and its derivatives (eqs. 1–5).

use nalgebra::Point3;

use super::layout::POSE_DIM;
use super::state::View;
use crate::math::RobustLoss;

/// A weighted residual (eq. 5) and its Jacobian with respect to a view block of `D` freedoms, a shared camera's
/// intrinsics and the point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Residual<const D: usize> {
    pub value: [f64; 2],
    /// Two rows: pose, then fused intrinsics.
    pub d_view: [[f64; D]; 2],
    /// Two rows.
    pub d_point: [[f64; 3]; 2],
}

/// Where derivatives by intrinsics go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum IntrinsicsTarget {
    Nowhere,
    /// Columns 6.. of the view block.
    ViewBlock,
    /// The shared camera's own columns.
    Shared,
}

/// Position in the camera frame (eq. 1).
#[inline(always)]
pub(super) fn point_in_cam(view: &View, point: &[f64; 3]) -> [f64; 3] {
    let row = |i: usize| {
        let r = &view.rotation[i];
        r[0] * point[0] + r[1] * point[1] + r[2] * point[2] + view.translation[i]
    };
    [row(0), row(1), row(2)]
}

/// The residual alone, divided by its standard deviation but not weighted by the loss.
#[inline(always)]
pub(super) fn plain_residual(view: &View, point: &[f64; 3], pixel: &[f64; 2], inverse_sigma: f64) -> [f64; 2] {
    let [x, y, z] = point_in_cam(view, point);
    let inverse_z = 1.0 / z;
    let seen = view.camera.pixel_from_normalized(nalgebra::Vector2::new(x * inverse_z, y * inverse_z));
    [(seen.x - pixel[0]) * inverse_sigma, (seen.y - pixel[1]) * inverse_sigma]
}

/// ρ(‖r‖²) of a residual.
#[inline(always)]
pub(super) fn robust_cost(loss: &RobustLoss, residual: &[f64; 2]) -> f64 {
    let squared = residual[0] * residual[0] + residual[1] * residual[1];
    if *loss == RobustLoss::Squared { squared } else { loss.evaluate(squared)[0] }
}

/// Residual and derivatives, weighted by √ρ' (eq. 5). Derivatives by shared intrinsics go to `d_shared`; freedoms
/// that `mask` holds get zero columns. The returned cost is ρ.
#[inline(always)]
pub(super) fn linearize<const D: usize>(
    view: &View,
    point: &[f64; 3],
    pixel: &[f64; 2],
    inverse_sigma: f64,
    loss: &RobustLoss,
    target: IntrinsicsTarget,
    d_shared: Option<&mut [[f64; 6]; 2]>,
) -> (f64, Residual<D>) {
    let p = point_in_cam(view, point);
    let projection = view.camera.project(Point3::new(p[0], p[1], p[2]));
    let plain = [(projection.pixel.x - pixel[0]) * inverse_sigma, (projection.pixel.y - pixel[1]) * inverse_sigma];
    let squared = plain[0] * plain[0] + plain[1] * plain[1];
    let (cost, weight) = match loss {
        RobustLoss::Squared => (squared, inverse_sigma),
        _ => {
            let [rho, slope, _] = loss.evaluate(squared);
            (rho, slope.sqrt() * inverse_sigma)
        }
    };
    let scale = weight / inverse_sigma;
    let mut out =
        Residual { value: [plain[0] * scale, plain[1] * scale], d_view: [[0.0; D]; 2], d_point: [[0.0; 3]; 2] };
    for i in 0..2 {
        let d = [
            projection.d_point[(i, 0)] * weight,
            projection.d_point[(i, 1)] * weight,
            projection.d_point[(i, 2)] * weight,
        ];
        // Eq. 3: ∂p/∂ω = −[p]ₓ, so a row d becomes p × d; ∂p/∂v = I.
        let turn = [p[1] * d[2] - p[2] * d[1], p[2] * d[0] - p[0] * d[2], p[0] * d[1] - p[1] * d[0]];
        out.d_view[i][..3].copy_from_slice(&turn);
        out.d_view[i][3..POSE_DIM].copy_from_slice(&d);
        let r = &view.rotation;
        for k in 0..3 {
            out.d_point[i][k] = d[0] * r[0][k] + d[1] * r[1][k] + d[2] * r[2][k];
        }
    }
    let intrinsics_row = |i: usize, into: &mut [f64]| {
        let columns = &view.columns;
        for (k, cell) in into.iter_mut().enumerate().take(columns.len) {
            let source = columns.source[k];
            let mut value = projection.d_intrinsics[(i, source)];
            if source == 0 {
                value += columns.aspect * projection.d_intrinsics[(i, 1)];
            }
            *cell = value * weight;
        }
    };
    match (target, d_shared) {
        (IntrinsicsTarget::ViewBlock, _) => {
            for i in 0..2 {
                intrinsics_row(i, &mut out.d_view[i][POSE_DIM..]);
            }
        }
        (IntrinsicsTarget::Shared, Some(shared)) => {
            for (i, row) in shared.iter_mut().enumerate() {
                *row = [0.0; 6];
                intrinsics_row(i, row);
            }
        }
        _ => {}
    }
    (cost, out)
}
