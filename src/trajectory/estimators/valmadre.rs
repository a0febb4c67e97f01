//! Valmadre and Lucey: the least response to a high-pass filter.
//!
//! J. Valmadre, S. Lucey, *General Trajectory Prior for Non-Rigid Reconstruction*, CVPR 2012. With second differences
//! as the filter, along the family of paths it is closed:
//!
//! ```text
//! Σ |D²c_i + r D²v_i|² → min,    r = −Σ D²c · D²v / Σ |D²v|².
//! ```
//!
//! **Assumption**: the vehicle hardly accelerates, compared with the camera. **Blind** where the camera moves as evenly
//! as the vehicle. Noise of v grows fourfold in D²v and pulls r towards 0 (errors in the variables).

use super::motion::{Motion, components};
use crate::trajectory::ScaleError;

/// r of the least acceleration.
pub(super) fn ratio(motion: &Motion) -> Result<f64, ScaleError> {
    let term = |[a, b, c]: [usize; 3]| [&motion.centers, &motion.offsets].map(|x| components(x[a] - 2.0 * x[b] + x[c]));
    motion.least_squares(&motion.triples().map(term).collect::<Vec<_>>())
}
