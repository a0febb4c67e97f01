//! Ozden et al.: motion in a plane perpendicular to the axis about which the vehicle turns.
//!
//! The planarity of `ozden-plane` with a known normal: a vehicle in a plane turns about the normal. K. E. Ozden, K.
//! Cornelis, L. Van Eycken, L. Van Gool, CVPR 2004, have the criterion; this form is ours. With the turns ΔR_i of the
//! object since the first frame, in axes of the background, the axis m is the eigenvector of the least eigenvalue of
//! Σ (ΔR_i − I)ᵀ (ΔR_i − I), and with means subtracted
//!
//! ```text
//! m · (c_i + r v_i) = 0,    r = −Σ (m · c)(m · v) / Σ (m · v)².
//! ```
//!
//! **Assumption**: the vehicle turns, and stays in one plane. **Blind** where the camera keeps its distance from that
//! plane, or the vehicle does not turn.

use nalgebra::{Matrix3, Rotation3, Vector3};

use super::motion::{Motion, centered};
use crate::math::symmetric_eigen;
use crate::trajectory::ScaleError;

/// r of a path perpendicular to the axis.
pub(super) fn ratio(motion: &Motion) -> Result<f64, ScaleError> {
    let axis = axis(motion).ok_or(ScaleError::Undetermined("the vehicle does not turn"))?;
    let [centers, offsets] = [&motion.centers, &motion.offsets].map(|all| centered(all));
    let term = |(c, v): (&Vector3<f64>, &Vector3<f64>)| [[axis.dot(c)], [axis.dot(v)]];
    motion.least_squares(&centers.iter().zip(&offsets).map(term).collect::<Vec<_>>())
}

/// Axis of the turns since the first frame; `None` if they are too small.
fn axis(motion: &Motion) -> Option<Vector3<f64>> {
    let first = motion.rotations.first()?.transpose();
    let turns = || motion.rotations.iter().map(|rotation| rotation * first);
    let largest = turns().map(|turn| Rotation3::from_matrix_unchecked(turn).angle()).fold(0.0, f64::max);
    let scatter: Matrix3<f64> = turns().map(|turn| turn - Matrix3::identity()).map(|d| d.transpose() * d).sum();
    // An attitude error of 0.3° gives the axis of a turn of 10° an error of 2°, and the plane one of 3 % of the path.
    let found = symmetric_eigen(scatter).filter(|_| largest >= 0.175)?;
    Some(found.eigenvectors.column(found.eigenvalues.imin()).into_owned())
}
