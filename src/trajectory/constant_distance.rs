//! Scale ratio from the best view pair, as in the paper.
//!
//! A point that moves with the object keeps its distance to the ground, so that for a pair of views (i, i′) every
//! point j gives an equation (eqs. determine_s1 to determine_s3; h, a as in [`View`])
//!
//! ```text
//! h_i + r a_ji = h_i′ + r a_ji′    ⇒    r_j = (h_i′ − h_i) / (a_ji − a_ji′).
//! ```
//!
//! Pairs are ranked twice: by the magnitude of the numerator, which all points share, largest first; and by the spread
//! of the r_j over the points, smallest first. The paper speaks of "the variance of the corresponding scale ratios" and
//! of "the scale ratio difference"; both order pairs by the spread of their r_j. Here the spread is the standard
//! deviation. The pair with the smallest sum of both ranks wins, and r is the least squares solution of its equations
//! (a_ji − a_ji′) r = h_i′ − h_i over all points.
//!
//! Cases that the paper does not specify:
//! * Equal sums: the larger numerator wins.
//! * A winner whose r is not positive: the next pair in the order is used, since a ratio of lengths is positive.
//! * Long clips: the number of pairs grows with the square of the frames. Beyond [`MAX_PAIRS`] only every n-th frame is
//!   used; beyond [`MAX_RATIOS`] the spread is computed over every k-th point only. The final least squares uses all
//!   points. Both limits are far above 60 frames.

use super::{Estimate, LeastSquares, Options, ScaleError, View, Views, least_squares};

/// Maximum number of ranked view pairs: all of 600 frames, a quarter of a second.
const MAX_PAIRS: usize = 200_000;
/// Maximum number of ratios r_j computed for the second ranking: 250 points in each of [`MAX_PAIRS`].
const MAX_RATIOS: usize = 50_000_000;

/// Result of the best view pair.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConstantDistance {
    /// r > 0.
    pub ratio: f64,
    /// Mean over the points of (a_ji − a_ji′)², in squared units of the object; it determines the pair's uncertainty.
    pub mean_denominator_sq: f64,
}

/// Scale ratio of the pair of views with the lowest sum of ranks.
///
/// # Errors
/// [`ScaleError`] for fewer than two views, no points, or no pair with a positive ratio.
pub fn constant_distance(views: &Views) -> Result<ConstantDistance, ScaleError> {
    constant_distance_within(views, MAX_PAIRS, MAX_RATIOS)
}

fn constant_distance_within(
    views: &Views,
    max_pairs: usize,
    max_ratios: usize,
) -> Result<ConstantDistance, ScaleError> {
    views.require(2)?;
    let pairs = pairs_by_numerator(&views.views, max_pairs);
    // At least a hundred points, or all, for a meaningful spread even in the longest clip.
    let per_pair = (max_ratios / pairs.len().max(1)).max(100);
    let stride = views.points.len().div_ceil(per_pair);
    let spreads: Vec<f64> = pairs.iter().map(|&(i, k)| spread(views, i, k, stride)).collect();
    let mut solved = combined_order(&spreads).into_iter().map(|idx| solve(views, pairs[idx]));
    let found = solved.find(|found| found.ratio.is_finite() && found.ratio > 0.0);
    found.ok_or(ScaleError::NoPositivePair { num_pairs: pairs.len() })
}

impl ConstantDistance {
    /// Standard deviation of the ratio, sqrt(2 σ² / mean_j D_j²), with σ from the residuals of the fit over all frames
    /// and the drift that grows with the distance, at `ratio`.
    fn std(&self, all_frames: &LeastSquares, views: &Views, ratio: f64) -> f64 {
        all_frames.residual_std.hypot(views.grazing_std(ratio)) * (2.0 / self.mean_denominator_sq).sqrt()
    }
}

/// Ratio of the best pair, with a standard deviation from the fit over all frames.
pub(super) fn estimate(views: &Views, options: &Options) -> Result<Estimate, ScaleError> {
    let found = constant_distance(views)?;
    let all_frames = least_squares(views, &options.least_squares).ok();
    Ok(Estimate::new(found.ratio, all_frames.map(|fit| found.std(&fit, views, found.ratio))))
}

fn numerator(first: &View, second: &View) -> f64 {
    second.camera_height - first.camera_height
}

/// Index pairs i < i′ by decreasing magnitude of the numerator, of all views or of every n-th: at most about
/// `max_pairs`.
fn pairs_by_numerator(views: &[View], max_pairs: usize) -> Vec<(usize, usize)> {
    let stride = (views.len() as f64 / (2.0 * max_pairs as f64).sqrt()).ceil().max(1.0) as usize;
    let kept: Vec<usize> = (0..views.len()).step_by(stride).collect();
    let later = |(k, &i): (usize, &usize)| kept[k + 1..].iter().map(move |&other| (i, other)).collect::<Vec<_>>();
    let mut pairs: Vec<(usize, usize)> = kept.iter().enumerate().flat_map(later).collect();
    let size = |&(i, k): &(usize, usize)| numerator(&views[i], &views[k]).abs();
    pairs.sort_by(|a, b| size(b).total_cmp(&size(a)).then(a.cmp(b)));
    pairs
}

/// Standard deviation of r_j over every `stride`-th point; infinite if it cannot be computed.
fn spread(views: &Views, i: usize, k: usize, stride: usize) -> f64 {
    let (first, second) = (&views.views[i], &views.views[k]);
    let numerator = numerator(first, second);
    let (mut shift, mut sum, mut sum_sq, mut count) = (None, 0.0, 0.0, 0.0);
    for point in views.points.iter().step_by(stride) {
        let ratio = numerator / (first.offset(point) - second.offset(point));
        // Measured from the first value: the plain sum of squares would cancel for nearly equal ratios.
        let delta = ratio - *shift.get_or_insert(ratio);
        (sum, sum_sq, count) = (sum + delta, sum_sq + delta * delta, count + 1.0);
    }
    let variance = (sum_sq - sum * sum / count) / count;
    if variance.is_finite() { variance.max(0.0).sqrt() } else { f64::INFINITY }
}

/// Pair indices by the sum of both ranks. The list itself is in the order of the first ranking.
fn combined_order(spreads: &[f64]) -> Vec<usize> {
    let mut by_spread: Vec<usize> = (0..spreads.len()).collect();
    by_spread.sort_by(|&a, &b| spreads[a].total_cmp(&spreads[b]));
    let mut rank_sum: Vec<usize> = (0..spreads.len()).collect();
    for (rank, &idx) in by_spread.iter().enumerate() {
        rank_sum[idx] += rank;
    }
    let mut order: Vec<usize> = (0..spreads.len()).collect();
    order.sort_by_key(|&idx| (rank_sum[idx], idx));
    order
}

/// Least squares over all points of the pair: r = N Σ D_j / Σ D_j², and the mean of D_j².
fn solve(views: &Views, (i, k): (usize, usize)) -> ConstantDistance {
    let (first, second) = (&views.views[i], &views.views[k]);
    let (mut sum, mut sum_sq) = (0.0, 0.0);
    for point in &views.points {
        let denominator = first.offset(point) - second.offset(point);
        (sum, sum_sq) = (sum + denominator, sum_sq + denominator * denominator);
    }
    let ratio = numerator(first, second) * sum / sum_sq;
    ConstantDistance { ratio, mean_denominator_sq: sum_sq / views.points.len() as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{Noise, Options, Route, Terrain, drive};

    fn error(options: &Options, seed: u64) -> f64 {
        let world = drive(options, seed);
        let views = Views::new(&world.background, &world.object, &world.planes, &crate::trajectory::Options::default());
        let found = constant_distance(&views).unwrap();
        (found.ratio / world.ratio - 1.0).abs()
    }

    #[test]
    fn exact_worlds_give_the_exact_ratio() {
        for terrain in [
            Terrain::Flat,
            Terrain::Slope { gradient: [0.1, -0.05] },
            Terrain::Hills { amplitude_m: 1.0, wavelength_m: 60.0 },
        ] {
            for route in [Route::Straight, Route::Curve { radius_m: 30.0 }] {
                let options = Options { terrain, route, ..Options::default() };
                assert!(error(&options, 3) < 1e-9, "{terrain:?} {route:?}: {}", error(&options, 3));
            }
        }
    }

    /// Two thirds of all seeds stay below 1 % at half a pixel, half a degree and 3 cm; three times that is the bound.
    #[test]
    fn noise_moves_the_ratio_by_little() {
        let noise = Noise { pixel_px: 0.5, plane_height_m: 0.03, plane_tilt_deg: 0.5, bad_planes: 0.1 };
        for seed in 0..6 {
            let found = error(&Options { noise, ..Options::default() }, seed);
            assert!(found < 0.03, "seed {seed}: {found}");
        }
    }

    #[test]
    fn limits_reduce_the_frames() {
        // Over hills no two numerators are equal.
        let terrain = Terrain::Hills { amplitude_m: 1.0, wavelength_m: 60.0 };
        let world = drive(&Options { num_frames: 20, terrain, ..Options::default() }, 1);
        let views = Views::new(&world.background, &world.object, &world.planes, &crate::trajectory::Options::default());
        assert_eq!(pairs_by_numerator(&views.views, 1000).len(), 190);
        let limited = pairs_by_numerator(&views.views, 40);
        assert!(limited.len() == 21 && limited.iter().all(|(i, k)| i % 3 == 0 && k % 3 == 0), "{limited:?}");
        let limited = constant_distance_within(&views, 40, 1000);
        assert!((limited.unwrap().ratio / world.ratio - 1.0).abs() < 1e-9);
    }

    #[test]
    fn equal_heights_and_missing_views_are_errors() {
        let world = drive(&Options { camera_climb_m: 0.0, ..Options::default() }, 1);
        let mut views =
            Views::new(&world.background, &world.object, &world.planes, &crate::trajectory::Options::default());
        for view in &mut views.views {
            view.camera_height = 1.0;
        }
        let limited = |views: &Views| constant_distance_within(views, 10, 1000);
        assert_eq!(limited(&views), Err(ScaleError::NoPositivePair { num_pairs: 10 }));
        views.views.truncate(1);
        assert!(matches!(limited(&views), Err(ScaleError::TooFewViews { usable: 1, .. })));
        views.points.clear();
        assert_eq!(limited(&views), Err(ScaleError::NoPoints));
    }
}
