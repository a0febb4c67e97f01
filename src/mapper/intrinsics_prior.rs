//! Prior of the intrinsics, and their plausibility.

use super::map::Map;
use super::{Intrinsics, Noise};
use crate::bundle::{COMMON_ERROR_FACTOR, IntrinsicsPrior};
use crate::camera::Camera;

/// Prior of a map's camera about its initial values; see [`about`].
pub(super) fn prior(camera_idx: usize, map: &Map<'_>, noise: Noise) -> IntrinsicsPrior {
    // The problem weights observations with a standard deviation of one pixel; this converts the prior to units of the
    // true one.
    let unit_px = noise.filter(|sigma_px| *sigma_px > 0.0).map_or(1.0, |sigma_px| COMMON_ERROR_FACTOR * sigma_px);
    let prior = about(&map.guess[camera_idx], map.known.of(camera_idx), &map.cameras[camera_idx], unit_px);
    IntrinsicsPrior { camera: camera_idx, ..prior }
}

/// Prior of the first camera of a problem about initial values, in units of observations with common errors.
///
/// With these ([`COMMON_ERROR_FACTOR`]) it matters where the observations leave a parameter undetermined.
///
/// The focal length is log-normal about the initial one, ln f ~ N(ln f₀, s²), which near the present f is a normal
/// distribution of f about f (1 − ln(f / f₀)) with standard deviation s f; the two values fx and fy share it.
pub(super) fn about(initial: &Camera, known: Intrinsics, here: &Camera, unit_px: f64) -> IntrinsicsPrior {
    let off = off_initial(here, initial);
    let [fx, fy] = here.focal;
    let [.., cx, cy, k1, k2] = initial.intrinsics();
    let mut sigma = known.std_of(here);
    sigma[..2].iter_mut().for_each(|std| *std *= std::f64::consts::SQRT_2);
    // A fixed parameter has no prior.
    let sigma = sigma.map(|std| if std > 0.0 { std / unit_px } else { f64::INFINITY });
    IntrinsicsPrior { camera: 0, values: [fx * (1.0 - off), fy * (1.0 - off), cx, cy, k1, k2], sigma }
}

/// ln of the focal length over the initial one.
pub(super) fn off_initial(here: &Camera, initial: &Camera) -> f64 {
    (here.mean_focal() / initial.mean_focal()).ln()
}

/// Returns true if the intrinsics are plausible.
///
/// They have a field of view between 9 and 157 degrees over the longer side, and distortion that is monotonic from the
/// center to the corner.
pub(super) fn is_plausible(camera: &Camera) -> bool {
    let side = f64::from(camera.width.max(camera.height));
    let focal_ok = (0.1 * side..=6.0 * side).contains(&camera.mean_focal());
    let corner = 0.5 * f64::from(camera.width).hypot(f64::from(camera.height)) / camera.mean_focal();
    let [k1, k2] = camera.radial;
    let r2 = corner * corner;
    let monotonic = 1.0 + 3.0 * k1 * r2 + 5.0 * k2 * r2 * r2 > 0.0 && 1.0 + k1 * r2 + k2 * r2 * r2 < 2.0;
    focal_ok && monotonic
}
