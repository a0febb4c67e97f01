//! Relative poses between pairs of images: what needs no similarity, and counts images that are missing.
//!
//! Of two images, the rotation and the direction of translation from one to the other are compared. The error of a pair
//! is the larger of both angles; the area under the curve of recall over error, up to a limit and divided by it, is 1
//! where everything is exact (Y. Jin et al., *Image Matching across Wide Baselines: From Paper to Practice*, IJCV
//! 2021). All pairs of the reference's images count: one with an image that the other lacks has failed.

use serde::{Deserialize, Serialize};

use crate::math::{Rigid3, median};

/// Limits of the areas, degrees.
pub const LIMITS_DEG: [f64; 5] = [0.5, 1.0, 3.0, 5.0, 10.0];

/// Pairs that are looked at; of more, an even selection is.
const MAX_PAIRS: usize = 500_000;

/// Baseline below which there is no direction of translation, over the extent of the reference's cameras.
const LEAST_BASELINE: f64 = 1e-6;

/// Errors of relative poses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RelativePoses {
    /// Pairs of the reference's images that were looked at.
    pub num_pairs: usize,
    /// Those of which the other lacks an image.
    pub num_failed: usize,
    /// Median angle between the rotations of pairs that both have, degrees.
    pub rotation_median_deg: f64,
    /// Median angle between their directions of translation, degrees; `None` where no camera moves.
    pub translation_median_deg: Option<f64>,
    /// Area under the curve of recall, 0 to 1, for each of [`LIMITS_DEG`].
    pub auc: [f64; LIMITS_DEG.len()],
}

struct PairError {
    rotation_deg: f64,
    translation_deg: Option<f64>,
}

/// * `pairs` – (other, reference) `cam_from_world` of common images.
/// * `num_reference` – images of the reference.
/// * `extent` – of the reference's cameras.
///
/// # Errors
/// The reason, in words, where there is no pair.
pub(super) fn relative_poses(
    pairs: &[(Rigid3, Rigid3)],
    num_reference: usize,
    extent: f64,
) -> Result<RelativePoses, String> {
    let n = pairs.len();
    if n < 2 {
        return Err("relative poses need two images that are registered in both".into());
    }
    let stride = (n * (n - 1) / 2).div_ceil(MAX_PAIRS);
    let all = (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j)));
    let errors: Vec<PairError> =
        all.step_by(stride).map(|(i, j)| pair_error(&pairs[i], &pairs[j], LEAST_BASELINE * extent)).collect();
    let worst = |e: &PairError| e.translation_deg.map_or(e.rotation_deg, |t| t.max(e.rotation_deg));
    let mut sorted: Vec<f64> = errors.iter().map(worst).collect();
    sorted.sort_by(f64::total_cmp);
    let (found, wanted) = ((n * (n - 1) / 2) as f64, (num_reference * (num_reference - 1) / 2) as f64);
    let num_pairs = (errors.len() as f64 * wanted / found).round() as usize;
    Ok(RelativePoses {
        num_pairs,
        num_failed: num_pairs.saturating_sub(errors.len()),
        rotation_median_deg: median(errors.iter().map(|e| e.rotation_deg).collect()).unwrap_or(0.0),
        translation_median_deg: median(errors.iter().filter_map(|e| e.translation_deg).collect()),
        auc: LIMITS_DEG.map(|limit| area(&sorted, num_pairs, limit)),
    })
}

fn pair_error(a: &(Rigid3, Rigid3), b: &(Rigid3, Rigid3), least: f64) -> PairError {
    let b_from_a = |from: &Rigid3, to: &Rigid3| *to * from.inverse();
    let (other, reference) = (b_from_a(&a.0, &b.0), b_from_a(&a.1, &b.1));
    let is_apart = reference.translation.norm() > least && other.translation.norm() > 0.0;
    PairError {
        rotation_deg: other.rotation.angle_to(&reference.rotation).to_degrees(),
        translation_deg: is_apart.then(|| other.translation.angle(&reference.translation).to_degrees()),
    }
}

/// ∫₀^limit recall(e) de / limit: an error e below the limit counts from e on.
fn area(sorted: &[f64], num_pairs: usize, limit: f64) -> f64 {
    let below = sorted.iter().take_while(|error| **error < limit);
    below.fold(0.0, |sum, error| sum + limit - error) / (limit * num_pairs as f64)
}
