//! Park et al. along the family of paths.
//!
//! Where the size of v_i is known up to r, the assumption of [`park`](super::park) needs no triangulation. With Θ the
//! first K cosines and P = I − Θ Θᵀ the projection onto all others,
//!
//! ```text
//! |P c + r P v|² → min,    r = −⟨P c, P v⟩ / |P v|².
//! ```
//!
//! **Assumption** and **blindness** as there. Noise of v remains whole in P v, while little of the camera's path does:
//! it pulls r towards 0 (errors in the variables).

use nalgebra::DMatrix;

use super::motion::Motion;
use super::park::cosines;
use crate::trajectory::ScaleError;

/// Basis vectors: four periods in a clip, or half of the frames. Cross-validation is not at hand, since fewer always
/// leave larger residuals.
const NUM_BASIS: usize = 8;

/// r of the least high frequencies.
pub(super) fn ratio(motion: &Motion) -> Result<f64, ScaleError> {
    // Orthonormal over frames that are missing, too.
    let basis = cosines(motion, NUM_BASIS.min(motion.len() / 2)).qr().q();
    let [centers, offsets] = [&motion.centers, &motion.offsets].map(|vectors| {
        let matrix = DMatrix::from_fn(motion.len(), 3, |row, column| vectors[row][column]);
        &matrix - &basis * (basis.transpose() * &matrix)
    });
    let row = |matrix: &DMatrix<f64>, k: usize| [matrix[(k, 0)], matrix[(k, 1)], matrix[(k, 2)]];
    let terms: Vec<_> = (0..motion.len()).map(|k| [row(&centers, k), row(&offsets, k)]).collect();
    motion.least_squares(&terms)
}
