//! Mean, median and largest value of a quantity over sequences of which some may have failed.

use serde::{Deserialize, Serialize};

use crate::math::median;

/// Statistics of one quantity over sequences of which some may have failed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Sequences with a value; `mean`, `median` and `max` go over these.
    pub num: usize,
    /// Sequences that failed.
    pub num_failed: usize,
    /// Mean; `None` without values.
    pub mean: Option<f64>,
    /// Median; `None` without values.
    pub median: Option<f64>,
    /// Median over all sequences with the failed ones ranked behind the rest; `None` where that is a failed one.
    pub median_failed_last: Option<f64>,
    /// The largest value.
    pub max: Option<f64>,
}

impl Statistics {
    /// Of values, `None` standing for a failed sequence. Values that are not finite count as failed.
    pub fn new(values: impl IntoIterator<Item = Option<f64>>) -> Self {
        let (mut found, mut num_failed) = (Vec::new(), 0);
        for value in values {
            match value.filter(|v| v.is_finite()) {
                Some(value) => found.push(value),
                None => num_failed += 1,
            }
        }
        let num = found.len();
        let mut ranked = found.clone();
        ranked.extend(std::iter::repeat_n(f64::INFINITY, num_failed));
        Self {
            num,
            num_failed,
            mean: (num > 0).then(|| found.iter().sum::<f64>() / num as f64),
            max: found.iter().copied().max_by(f64::total_cmp),
            median: median(found),
            median_failed_last: median(ranked).filter(|m| m.is_finite()),
        }
    }

    /// Sequences in all.
    pub fn num_all(&self) -> usize {
        self.num + self.num_failed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn failed_sequences_are_counted_and_ranked_last() {
        let s = Statistics::new([Some(3.0), None, Some(1.0), Some(8.0)]);
        assert_eq!((s.num, s.num_failed, s.num_all()), (3, 1, 4));
        assert_eq!((s.mean, s.median, s.max), (Some(4.0), Some(3.0), Some(8.0)));
        // The four in order: 1, 3, 8, failed.
        assert_eq!(s.median_failed_last, Some(5.5));
    }

    #[test]
    fn where_half_failed_the_median_over_all_is_a_failure() {
        assert_eq!(Statistics::new([Some(1.0), None]).median_failed_last, None);
        assert_eq!(Statistics::new([Some(1.0), Some(2.0), None]).median_failed_last, Some(2.0));
        let nothing = Statistics::new([]);
        assert_eq!(nothing, Statistics::default());
        let nan = Statistics::new([Some(f64::NAN)]);
        assert_eq!((nan.num, nan.num_failed, nan.mean), (0, 1, None));
    }
}
