//! Ozden et al.: motion in a plane, whichever.
//!
//! K. E. Ozden, K. Cornelis, L. Van Eycken, L. Van Gool, *Reconstructing 3D independent motions using
//! non-accidentalness*, CVPR 2004: a wrong scale destroys the planarity of a path. The cost function is ours: with σ₁ ≥
//! σ₂ ≥ σ₃ the singular values of the centered path o_i(r),
//!
//! ```text
//! J(r) = σ₃ / σ₂.
//! ```
//!
//! **Assumption**: the vehicle stays in one plane. **Blind** where the camera moves in a plane: r → 0 is then a perfect
//! answer; and where the vehicle moves on a straight line, which lies in many planes.

use nalgebra::DMatrix;

use super::motion::Motion;
use super::ozden_independence::centered;
use super::search::Grid;
use crate::trajectory::ScaleError;

/// r of the flattest path.
pub(super) fn ratio(motion: &Motion, guess: f64) -> Result<f64, ScaleError> {
    let (centers, offsets) = (centered(&motion.centers), centered(&motion.offsets));
    let entry = |row: usize, column: usize| match column {
        0..3 => centers[row][column],
        _ => offsets[row][column - 3],
    };
    let both = DMatrix::from_fn(motion.len(), 6, entry);
    let size = both.amax();
    if !(size.is_finite() && size > 0.0) {
        return Err(ScaleError::Undetermined("the motion leaves nothing to compare"));
    }
    // The path is Q (R_c + r R_v) with the triangular factor of both: its singular values are those of six rows.
    let triangle = (both / size).qr().r();
    let (of_centers, of_offsets) = (triangle.columns(0, 3).into_owned(), triangle.columns(3, 3).into_owned());
    let cost = |r: f64| {
        let path = &of_centers + r * &of_offsets;
        // The decomposition does not end on numbers whose squares are not finite.
        if !(path.amax() < 1e100) {
            return f64::INFINITY;
        }
        let mut values: Vec<f64> = path.singular_values().iter().copied().collect();
        values.sort_by(|a, b| b.total_cmp(a));
        values[2] / values[1]
    };
    Grid::FINE.least(guess, cost)
}
