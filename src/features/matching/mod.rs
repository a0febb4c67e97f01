//! Matching of descriptors between two images.
//!
//! All similarities of two sets of descriptors are computed, in integers. A match is mutual, and better than the second
//! best in its row and its column by Lowe's ratio.

mod products;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::rootsift::{DESCRIPTOR_LEN, DESCRIPTOR_NORM, Features};
use crate::checks::{Checked, within};
use products::Best;

/// Options of descriptor matching.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MatchOptions {
    /// Maximum ratio of the distances to the best and the second best candidate.
    #[schemars(extend("unit" = "ratio"))]
    pub max_ratio: f32,
    /// Maximum distance of two descriptors of length 1: 0 for equal ones, 1.41 for those that have nothing in common.
    #[schemars(extend("unit" = "distance"))]
    pub max_distance: f32,
}

impl Default for MatchOptions {
    fn default() -> Self {
        Self { max_ratio: 0.75, max_distance: 0.7 }
    }
}

impl MatchOptions {
    /// Rejects options that are out of range.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("max_ratio", self.max_ratio, 0.0..=1.0)?;
        within("max_distance", self.max_distance, 0.0..=2.0)
    }
}

impl Best {
    fn is_distinct(&self, options: &MatchOptions) -> bool {
        // For vectors of length N, ‖a − b‖² / N² = 2 − 2 a·b / N².
        let distance =
            |product: i16| (2.0 - 2.0 * f32::from(product) / (DESCRIPTOR_NORM * DESCRIPTOR_NORM)).max(0.0).sqrt();
        let first = distance(self.first);
        let second = distance(self.second);
        // Two candidates at distance zero, up to rounding, are duplicates.
        first <= options.max_distance && first <= options.max_ratio * second && second > 0.02
    }
}

/// Matches the features of two images; pairs of indices, ascending in the first.
pub fn match_features(a: &Features, b: &Features, options: &MatchOptions) -> Vec<[u32; 2]> {
    match_strongest(a, b, usize::MAX, options)
}

/// Matches the first features of two images: the strongest, if they come from [`super::rootsift::extract`].
pub fn match_strongest(a: &Features, b: &Features, count: usize, options: &MatchOptions) -> Vec<[u32; 2]> {
    let part = |f: &'_ Features| f.len().min(count) * DESCRIPTOR_LEN;
    let (best_of_row, best_of_column) = products::best(&a.descriptors[..part(a)], &b.descriptors[..part(b)]);
    mutual_matches(&best_of_row, &best_of_column, options)
}

fn mutual_matches(best_of_row: &[Best], best_of_column: &[Best], options: &MatchOptions) -> Vec<[u32; 2]> {
    let mutual = |(i, best): (usize, &Best)| {
        let back = best_of_column.get(best.index as usize)?;
        let agreed = back.index == i as u32 && best.is_distinct(options) && back.is_distinct(options);
        agreed.then_some([i as u32, best.index])
    };
    best_of_row.iter().enumerate().filter_map(mutual).collect()
}

/// Matches only the pairs for which `may` is true, compared one by one: for pairs of which geometry leaves few.
pub fn match_where(
    a: &Features,
    b: &Features,
    may: impl Fn(usize, usize) -> bool,
    options: &MatchOptions,
) -> Vec<[u32; 2]> {
    const NONE: Best = Best { index: u32::MAX, first: 0, second: 0 };
    let (mut best_of_row, mut best_of_column) = (vec![NONE; a.len()], vec![NONE; b.len()]);
    let descriptor = |i: usize| i * DESCRIPTOR_LEN..(i + 1) * DESCRIPTOR_LEN;
    for (i, row) in best_of_row.iter_mut().enumerate() {
        for (j, column) in best_of_column.iter_mut().enumerate().filter(|(j, _)| may(i, *j)) {
            let (x, y) = (&a.descriptors[descriptor(i)], &b.descriptors[descriptor(j)]);
            let product: i32 = x.iter().zip(y).map(|(x, y)| i32::from(*x) * i32::from(*y)).sum();
            row.offer(product as i16, j as u32);
            column.offer(product as i16, i as u32);
        }
    }
    mutual_matches(&best_of_row, &best_of_column, options)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::seeded_rng;
    use nalgebra::Point2;
    use rand::Rng as _;

    fn features(n: usize, descriptor: impl Fn(usize) -> Vec<u8>) -> Features {
        Features {
            pixels: vec![Point2::origin(); n],
            rgb: vec![[0; 3]; n],
            shapes: Vec::new(),
            descriptors: (0..n).flat_map(descriptor).collect(),
        }
    }

    fn unit(seed: u64, noise: f32) -> Vec<u8> {
        let mut rng = seeded_rng(seed, 0);
        let mut jitter = seeded_rng(seed, 1);
        let sparse = |value: f32| if value > 0.8 { value } else { 0.0 };
        let raw: Vec<f32> =
            (0..DESCRIPTOR_LEN).map(|_| sparse(rng.random::<f32>()) + noise * jitter.random::<f32>()).collect();
        let norm = raw.iter().map(|v| v * v).sum::<f32>().sqrt();
        raw.into_iter().map(|v| (v / norm * DESCRIPTOR_NORM).round() as u8).collect()
    }

    #[test]
    fn noisy_copies_are_matched_in_any_order_and_duplicates_are_rejected() {
        let a = features(600, |i| unit(i as u64, 0.0));
        let b = features(500, |j| unit((499 - j) as u64, 0.05));
        let found = match_features(&a, &b, &MatchOptions::default());
        assert_eq!(found.len(), 500);
        assert!(found.iter().all(|[i, j]| i + j == 499));
        let duplicates = features(2, |_| unit(3, 0.0));
        assert!(match_features(&a, &duplicates, &MatchOptions::default()).is_empty());
        assert!(match_features(&a, &Features::default(), &MatchOptions::default()).is_empty());
        assert!(match_features(&Features::default(), &a, &MatchOptions::default()).is_empty());
    }
}
