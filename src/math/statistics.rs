//! Medians and other quantiles; the jackknife. The two medians are not interchangeable: the choice affects the last
//! digits of results.

use std::ops::Range;

/// Standard deviation of a normal distribution over its median absolute deviation.
pub const STD_PER_MAD: f64 = 1.4826;

/// Median length of a two-dimensional normal error over the standard deviation of a coordinate (Rayleigh).
pub const RAYLEIGH_MEDIAN: f64 = 1.177_41;

/// The median; for an even count the mean of the middle two. `None` if empty. Values must be finite.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let upper = *values.get(values.len() / 2)?;
    Some(if values.len() % 2 == 1 { upper } else { 0.5 * (values[values.len() / 2 - 1] + upper) })
}

/// The upper median: always one of the values, for an even count the larger of the middle two. `None` if empty.
pub fn upper_median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Quantile by the nearest rank: always one of the values, whose order changes. `None` if empty.
pub fn quantile(values: &mut [f64], share: f64) -> Option<f64> {
    let rank = (share * values.len().checked_sub(1)? as f64).round() as usize;
    Some(*values.select_nth_unstable_by(rank, f64::total_cmp).1)
}

/// Range of the values without a fraction at each end, by the nearest ranks; their order changes. `None` if empty.
pub fn quantile_range(values: &mut [f64], tail: f64) -> Option<[f64; 2]> {
    Some([quantile(values, tail)?, quantile(values, 1.0 - tail)?])
}

/// Quantile by the rank rounded down. `None` if empty.
pub fn lower_quantile(values: &mut [f64], share: f64) -> Option<f64> {
    let rank = (share * values.len().checked_sub(1)? as f64) as usize;
    Some(*values.select_nth_unstable_by(rank, f64::total_cmp).1)
}

/// Index of the bin of a value among `count` equal bins from 0 to 1; clamped to the first or last bin.
pub fn bin(value: f64, count: usize) -> usize {
    ((value * count as f64) as usize).min(count - 1)
}

/// Density of Student's distribution with four degrees of freedom: that of an error over a standard deviation which is
/// itself known from five groups.
pub fn student_4(x: f64) -> f64 {
    0.375 * (1.0 + 0.25 * x * x).powf(-2.5)
}

/// Number of jackknife groups, each omitted once.
pub const JACKKNIFE_GROUPS: usize = 5;

/// Ranges of the groups of a jackknife among `len` values in order.
pub fn jackknife_groups(len: usize) -> impl Iterator<Item = Range<usize>> {
    (0..JACKKNIFE_GROUPS).map(move |k| k * len / JACKKNIFE_GROUPS..(k + 1) * len / JACKKNIFE_GROUPS)
}

/// Standard deviation of an estimate, from its K values without each of K groups: σ² = (K − 1) / K · Σ (θ_k − θ̄)².
///
/// Delete-a-group jackknife; J. Shao and C. F. J. Wu, *A general theory for jackknife variance estimation*, Annals of
/// Statistics 1989. `None` for fewer than three values.
pub fn jackknife_std(values: &[f64]) -> Option<f64> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
    (values.len() >= 3).then(|| ((count - 1.0) / count * squares).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_agree_on_odd_counts_and_differ_on_even_ones() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(upper_median(vec![3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), Some(2.5));
        assert_eq!(upper_median(vec![4.0, 1.0, 2.0, 3.0]), Some(3.0));
        assert_eq!((median(vec![7.0]), upper_median(vec![7.0])), (Some(7.0), Some(7.0)));
        assert_eq!((median(Vec::new()), upper_median(Vec::new())), (None, None));
    }

    #[test]
    fn a_quantile_is_one_of_the_values() {
        let mut values = [5.0, 1.0, 4.0, 2.0, 3.0];
        assert_eq!([0.0, 0.3, 0.5, 1.0].map(|share| quantile(&mut values, share)), [1.0, 2.0, 3.0, 5.0].map(Some));
        assert_eq!(
            [0.0, 0.4, 0.5, 1.0].map(|share| lower_quantile(&mut values, share)),
            [1.0, 2.0, 3.0, 5.0].map(Some)
        );
        assert_eq!((quantile(&mut [], 0.5), lower_quantile(&mut [], 0.5)), (None, None));
    }

    #[test]
    fn the_jackknife_of_a_mean_is_its_standard_error() {
        // Five groups of one number each: leaving one out in turn gives s² / n exactly.
        let numbers = [0.3, -1.2, 0.7, 2.0, -0.4];
        let mean = numbers.iter().sum::<f64>() / 5.0;
        let of_mean = (numbers.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / 4.0 / 5.0).sqrt();
        let found = jackknife_std(&numbers.map(|x| (5.0 * mean - x) / 4.0));
        assert!((found.unwrap() - of_mean).abs() < 1e-12);
        assert_eq!(jackknife_std(&[0.1, 0.2]), None);
    }
}
