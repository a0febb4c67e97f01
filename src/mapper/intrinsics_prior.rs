//! Prior of the intrinsics, and which intrinsics are plausible.

use super::Noise;
use super::map::Map;
use crate::bundle::IntrinsicsPrior;
use crate::camera::Camera;

/// Factor on the residuals' noise for errors common to all observations: those of the model of the lens or of the
/// shutter, and points that slide with the view. Such errors do not average out.
pub(super) const COMMON_ERROR_FACTOR: f64 = 5.0;

/// A pull towards the guess, in units of observations with common errors ([`COMMON_ERROR_FACTOR`]): it counts where
/// these leave a parameter open.
///
/// The focal length is held log-normally to the guess, ln f ~ N(ln f₀, s²), which near the present f is a normal
/// distribution of f about f (1 − ln(f / f₀)) with deviation s f; the two values fx and fy share it.
///
/// The principal point is held to the middle as lenses are built, within a hundredth of the picture. Where views turn
/// and spread it moves freely; on a single flight looking straight down, where it could take up common errors, it
/// stays.
pub(super) fn prior(camera_idx: usize, map: &Map<'_>, noise: Noise) -> IntrinsicsPrior {
    // Manufacturing tolerance of ordinary lenses, a share of the longer side.
    const SIGMA_PRINCIPAL: f64 = 0.01;
    const SIGMA_RADIAL: f64 = 0.2;
    let camera = &map.cameras[camera_idx];
    // Observations count with a standard deviation of one pixel, so that those of the prior are in units of their true
    // one.
    let unit_px = match noise {
        Noise::Measured { sigma_px } if sigma_px > 0.0 => COMMON_ERROR_FACTOR * sigma_px,
        _ => 1.0,
    };
    let off = off_guess(map, camera_idx);
    let [width, height] = [camera.width, camera.height].map(f64::from);
    let mut values = [0.0, 0.0, 0.5 * width, 0.5 * height, 0.0, 0.0];
    let mut sigma = [
        0.0,
        0.0,
        SIGMA_PRINCIPAL * width.max(height),
        SIGMA_PRINCIPAL * width.max(height),
        SIGMA_RADIAL,
        SIGMA_RADIAL,
    ];
    for (k, focal) in camera.focal.into_iter().enumerate() {
        values[k] = focal * (1.0 - off);
        sigma[k] = std::f64::consts::SQRT_2 * map.known.of(camera_idx).guess_deviation() * focal;
    }
    IntrinsicsPrior { camera: camera_idx, values, sigma: sigma.map(|s| s / unit_px) }
}

/// ln of the focal length over that of the guess.
pub(super) fn off_guess(map: &Map<'_>, camera_idx: usize) -> f64 {
    (map.cameras[camera_idx].mean_focal() / map.guess[camera_idx].mean_focal()).ln()
}

/// Returns true if such a lens is plausible: a field of view between 9 and 157 degrees over the longer side, and
/// distortion that is monotonic from the center to the corner.
pub(super) fn is_plausible(camera: &Camera) -> bool {
    let side = f64::from(camera.width.max(camera.height));
    let focal_ok = (0.1 * side..=6.0 * side).contains(&camera.mean_focal());
    let corner = 0.5 * f64::from(camera.width).hypot(f64::from(camera.height)) / camera.mean_focal();
    let [k1, k2] = camera.radial;
    let r2 = corner * corner;
    let monotonic = 1.0 + 3.0 * k1 * r2 + 5.0 * k2 * r2 * r2 > 0.0 && 1.0 + k1 * r2 + k2 * r2 * r2 < 2.0;
    focal_ok && monotonic
}
