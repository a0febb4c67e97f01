//! Ozden et al.: motion in any plane.
//!
//! K. E. Ozden, K. Cornelis, L. Van Eycken, L. Van Gool, *Reconstructing 3D independent motions using
//! non-accidentalness*, CVPR 2004: a wrong scale destroys the planarity of a path. The cost function is ours: with σ₁ ≥
//! σ₂ ≥ σ₃ the singular values of the centered path o_i(r),
//!
//! ```text
//! J(r) = σ₃ / σ₂.
//! ```
//!
//! **Assumption**: the vehicle stays in one plane. **Blind** where the camera moves in a plane, for which r → 0 is a
//! perfect solution, and where the vehicle moves on a straight line, which is in many planes.

use nalgebra::DMatrix;

use super::Estimate;
use super::motion::{Motion, centered, positive};
use crate::trajectory::{ScaleError, Views};

/// Ratio of the flattest path.
pub(super) fn estimate(views: &Views) -> Result<Estimate, ScaleError> {
    let motion = Motion::new(views)?;
    let guess = motion.contact()?;
    motion.jackknifed(|motion| ratio(motion, guess))
}

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
        // The decomposition does not terminate on numbers whose squares are not finite.
        if !(path.amax() < 1e100) {
            return f64::INFINITY;
        }
        let mut values: Vec<f64> = path.singular_values().iter().copied().collect();
        values.sort_by(|a, b| b.total_cmp(a));
        values[2] / values[1]
    };
    least(guess, cost)
}

/// Ratio of minimum cost, by golden section search between the neighbors of the best one of a logarithmic grid.
///
/// # Errors
/// [`ScaleError::Undetermined`] if the cost is smallest at an end of the range, which is not a minimum.
fn least(guess: f64, cost: impl Fn(f64) -> f64) -> Result<f64, ScaleError> {
    // Search range, as factors of the initial ratio. That of contact of the lowest points has an error of a third at
    // most (the paper's own worst case), far below a factor of five.
    const FACTORS: [f64; 2] = [0.2, 5.0];
    // Number of ratios of the grid: steps of one percent resolve every minimum of a criterion.
    const NUM: usize = 321;
    let [first, last] = FACTORS.map(f64::ln);
    let ratio = |k: usize| guess * (first + (last - first) * k as f64 / (NUM - 1) as f64).exp();
    let costs = (0..NUM).map(|k| (k, cost(ratio(k)))).filter(|(_, cost)| cost.is_finite());
    let best = costs.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(k, _)| k);
    let Some(best) = best.filter(|k| (1..NUM - 1).contains(k)) else {
        return Err(ScaleError::Undetermined("the cost is least at the end of the search range"));
    };
    let (mut low, mut high) = (ratio(best - 1), ratio(best + 1));
    // Forty iterations narrow the interval by 10⁻⁸.
    for _ in 0..40 {
        let (a, b) = (low + 0.382 * (high - low), low + 0.618 * (high - low));
        if cost(a) < cost(b) { high = b } else { low = a }
    }
    positive(0.5 * (low + high))
}
