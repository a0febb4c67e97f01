//! Zheng et al.: the shortest path.
//!
//! E. Zheng et al., program `trajectoryBased3DRecon`, which completes the code of Park et al. by a criterion on first
//! differences. Along the family of paths it is closed:
//!
//! ```text
//! Σ |Δc_i + r Δv_i|² → min,    r = −Σ Δc · Δv / Σ |Δv|².
//! ```
//!
//! **Assumption**: the vehicle hardly moves from frame to frame, compared with the camera. **Blind** where the camera
//! is stationary; a vehicle that moves along with the camera has r → 0.

use super::motion::{Motion, components};
use crate::trajectory::ScaleError;

/// r of the shortest path.
pub(super) fn ratio(motion: &Motion) -> Result<f64, ScaleError> {
    let term = |(a, b): (usize, usize)| {
        [motion.centers[b] - motion.centers[a], motion.offsets[b] - motion.offsets[a]].map(components)
    };
    motion.least_squares(&motion.pairs(1).map(term).collect::<Vec<_>>())
}
