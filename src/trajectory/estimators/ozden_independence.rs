//! Ozden et al.: independence of the motions of camera and object.
//!
//! K. E. Ozden, K. Cornelis, L. Van Eycken, L. Van Gool, *Reconstructing 3D trajectories of independently moving
//! objects using generic constraints*, Computer Vision and Image Understanding 96, 2004: the motions are least
//! correlated at the true scale. The source's abstract states the criterion; its cost function is not known here, and
//! this one is ours. With S the covariances over the frames,
//!
//! ```text
//! J(r) = ‖S_co(r)‖² / (tr S_cc · tr S_oo(r)).
//! ```
//!
//! **Assumption**: the paths are uncorrelated in the sample. **Blind** where the camera moves along with the vehicle,
//! as every following drone and every car behind a car does: J then falls to the end of the search range.

use nalgebra::{Matrix3, Vector3};

use super::motion::Motion;
use super::search::Grid;
use crate::trajectory::ScaleError;

/// r of least correlation of the positions.
pub(super) fn ratio(motion: &Motion, guess: f64) -> Result<f64, ScaleError> {
    let (centers, offsets) = (centered(&motion.centers), centered(&motion.offsets));
    let [cc, cv, vv] = [[&centers, &centers], [&centers, &offsets], [&offsets, &offsets]].map(|[a, b]| sum(a, b));
    let cost = |r: f64| {
        let co = cc + r * cv;
        let oo = cc.trace() + 2.0 * r * cv.trace() + r * r * vv.trace();
        co.norm_squared() / (cc.trace() * oo)
    };
    Grid::FINE.least(guess, cost)
}

/// Vectors minus their mean.
pub(super) fn centered(vectors: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mean = vectors.iter().sum::<Vector3<f64>>() / vectors.len() as f64;
    vectors.iter().map(|vector| vector - mean).collect()
}

/// Σ a bᵀ.
fn sum(a: &[Vector3<f64>], b: &[Vector3<f64>]) -> Matrix3<f64> {
    a.iter().zip(b).map(|(a, b)| a * b.transpose()).sum()
}
