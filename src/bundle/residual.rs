//! The reprojection residual of one observation and its derivatives (eqs. 1–5).

use nalgebra::{Point3, Vector2};

use super::layout::POSE_DIM;
use super::problem::Observation;
use super::simd::Fused;
use super::state::View;
use super::whitening::Whitening;
use crate::math::RobustLoss;

/// A weighted residual and its Jacobian (eq. 5) with respect to a view block of `D` degrees of freedom.
#[derive(Clone, Copy, Debug)]
pub(super) struct Residual<const D: usize> {
    pub value: [f64; 2],
    /// Two rows: derivatives by the pose, then by the intrinsics of the view block.
    pub d_view: [[f64; D]; 2],
    /// Q = Jₚ L⁻ᵀ, two rows (eq. 9); filled by the elimination of the point.
    pub eliminated: [[f64; 3]; 2],
}

/// Further derivatives of a linearization.
pub(super) struct Derivatives<'a> {
    /// Jₚ, two rows.
    pub d_point: &'a mut [[f64; 3]; 2],
    /// By the intrinsics of a shared camera, two rows.
    pub d_shared: Option<&'a mut [[f64; 6]; 2]>,
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

/// Residual without derivatives, whitened but not weighted by the loss.
#[inline(always)]
pub(super) fn plain_residual(view: &View, point: &[f64; 3], measured: &Observation) -> [f64; 2] {
    let [x, y, z] = point_in_cam(view, point);
    let inverse_z = 1.0 / z;
    let seen = view.camera.pixel_from_normalized(Vector2::new(x * inverse_z, y * inverse_z));
    measured.whitening.apply([seen.x - measured.pixel.x, seen.y - measured.pixel.y])
}

/// ρ(‖r‖²) of a residual.
#[inline(always)]
pub(super) fn robust_cost(loss: &RobustLoss, residual: &[f64; 2]) -> f64 {
    let squared = residual[0] * residual[0] + residual[1] * residual[1];
    if *loss == RobustLoss::Squared { squared } else { loss.evaluate(squared)[0] }
}

/// ρ(‖r‖²) of a residual, and √ρ'.
#[inline(always)]
pub(super) fn robust_cost_and_root(loss: &RobustLoss, residual: &[f64; 2]) -> (f64, f64) {
    let squared = residual[0] * residual[0] + residual[1] * residual[1];
    match loss {
        RobustLoss::Squared => (squared, 1.0),
        _ => {
            let [rho, slope, _] = loss.evaluate(squared);
            (rho, slope.sqrt())
        }
    }
}

/// Residual and derivatives, weighted by √ρ' (eq. 5), and ρ.
///
/// Derivatives by intrinsics are written to `d_shared` if present, otherwise to the view block if it includes them.
#[inline(always)]
pub(super) fn linearize<const D: usize, F: Fused>(
    view: &View,
    point: &[f64; 3],
    measured: &Observation,
    loss: &RobustLoss,
    mut derivatives: Derivatives,
) -> (f64, Residual<D>) {
    let p = point_in_cam(view, point);
    let projection = view.camera.project(Point3::new(p[0], p[1], p[2]));
    let (pixel, whitening) = (&measured.pixel, &measured.whitening);
    let plain = whitening.apply([projection.pixel.x - pixel.x, projection.pixel.y - pixel.y]);
    let (cost, root) = robust_cost_and_root(loss, &plain);
    let [xx, xy, yy] = whitening.0;
    let weight = Whitening([xx * root, xy * root, yy * root]);
    let mut out =
        Residual { value: [plain[0] * root, plain[1] * root], d_view: [[0.0; D]; 2], eliminated: [[0.0; 3]; 2] };
    let r = &view.rotation;
    let column = |k: usize| weight.apply([projection.d_point[(0, k)], projection.d_point[(1, k)]]);
    let whitened = [column(0), column(1), column(2)];
    for i in 0..2 {
        let d = [whitened[0][i], whitened[1][i], whitened[2][i]];
        // Eq. 3: ∂p/∂ω = −[p]ₓ, so a row d becomes p × d; ∂p/∂v = I.
        let row = &mut out.d_view[i];
        row[0] = F::mul_add(p[1], d[2], -(p[2] * d[1]));
        row[1] = F::mul_add(p[2], d[0], -(p[0] * d[2]));
        row[2] = F::mul_add(p[0], d[1], -(p[1] * d[0]));
        row[3..POSE_DIM].copy_from_slice(&d);
        for k in 0..3 {
            derivatives.d_point[i][k] = F::mul_add(d[0], r[0][k], F::mul_add(d[1], r[1][k], d[2] * r[2][k]));
        }
    }
    let columns = &view.columns;
    if columns.len > 0 {
        let room = if derivatives.d_shared.is_some() { 6 } else { D - POSE_DIM };
        for k in 0..columns.len.min(room) {
            let source = columns.source[k];
            let aspect = if source == 0 { columns.aspect } else { 0.0 };
            let by = |i: usize| projection.d_intrinsics[(i, source)] + aspect * projection.d_intrinsics[(i, 1)];
            let [first, second] = weight.apply([by(0), by(1)]);
            match &mut derivatives.d_shared {
                Some(shared) => (shared[0][k], shared[1][k]) = (first, second),
                None => (out.d_view[0][POSE_DIM + k], out.d_view[1][POSE_DIM + k]) = (first, second),
            }
        }
    }
    (cost, out)
}
