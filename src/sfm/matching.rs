//! Matching of descriptors between two images.
//!
//! All similarities of two sets of unit descriptors are one matrix product, taken in blocks. A match is mutual, and better
//! than the second best in its row and its column by Lowe's ratio.

use ndarray::linalg::general_mat_mul;
use ndarray::{ArrayView2, ArrayViewMut2};
use serde::{Deserialize, Serialize};

use super::features::{DESCRIPTOR_LEN, Features};

/// When two features match.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MatchOptions {
    /// Largest ratio of the distances to the best and the second best candidate.
    pub max_ratio: f32,
    /// Largest distance of two unit descriptors.
    pub max_distance: f32,
}

impl Default for MatchOptions {
    fn default() -> Self {
        Self { max_ratio: 0.8, max_distance: 0.7 }
    }
}

/// The best and second best similarity seen so far, and where the best was.
#[derive(Clone, Copy)]
struct Best {
    index: u32,
    first: f32,
    second: f32,
}

impl Best {
    const NONE: Self = Self { index: u32::MAX, first: -1.0, second: -1.0 };

    fn offer(&mut self, index: u32, similarity: f32) {
        if similarity > self.first {
            *self = Self { index, first: similarity, second: self.first };
        } else if similarity > self.second {
            self.second = similarity;
        }
    }

    fn is_distinct(&self, options: &MatchOptions) -> bool {
        // For unit vectors ‖a − b‖² = 2 − 2 a·b.
        let distance = |similarity: f32| (2.0 - 2.0 * similarity).max(0.0).sqrt();
        let first = distance(self.first);
        // Two candidates at distance nought are twins, whatever their rounding says.
        const TWIN: f32 = 1e-3;
        first <= options.max_distance && first + TWIN <= options.max_ratio * distance(self.second)
    }
}

/// Pairs of feature indices, ascending in the first.
pub fn match_features(a: &Features, b: &Features, options: &MatchOptions) -> Vec<[u32; 2]> {
    let mut best_of_row = vec![Best::NONE; a.len()];
    let mut best_of_column = vec![Best::NONE; b.len()];
    for_each_similarity(a, b, |i, j, similarity| {
        best_of_row[i].offer(j as u32, similarity);
        best_of_column[j].offer(i as u32, similarity);
    });
    let mutual = |(i, best): (usize, &Best)| {
        let back = best_of_column.get(best.index as usize)?;
        let agreed = back.index == i as u32 && best.is_distinct(options) && back.is_distinct(options);
        agreed.then_some([i as u32, best.index])
    };
    best_of_row.iter().enumerate().filter_map(mutual).collect()
}

/// Calls `seen(i, j, a_i · b_j)` for all pairs, in blocks of rows that keep the products in cache.
fn for_each_similarity(a: &Features, b: &Features, mut seen: impl FnMut(usize, usize, f32)) {
    const BLOCK: usize = 64;
    let columns = b.len();
    let Ok(all_b) = ArrayView2::from_shape((columns, DESCRIPTOR_LEN), &b.descriptors) else { return };
    if columns == 0 {
        return;
    }
    let mut similarities = vec![0.0f32; BLOCK * columns];
    for (block, part) in a.descriptors.chunks(BLOCK * DESCRIPTOR_LEN).enumerate() {
        let rows = part.len() / DESCRIPTOR_LEN;
        let out = &mut similarities[..rows * columns];
        let (Ok(part), Ok(mut product)) = (
            ArrayView2::from_shape((rows, DESCRIPTOR_LEN), part),
            ArrayViewMut2::from_shape((rows, columns), &mut *out),
        ) else {
            return;
        };
        general_mat_mul(1.0, &part, &all_b.t(), 0.0, &mut product);
        for (i, row) in out.chunks_exact(columns).enumerate() {
            for (j, &similarity) in row.iter().enumerate() {
                seen(block * BLOCK + i, j, similarity);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::seeded_rng;
    use nalgebra::Point2;
    use rand::Rng as _;

    fn features(n: usize, descriptor: impl Fn(usize) -> Vec<f32>) -> Features {
        Features {
            pixels: vec![Point2::origin(); n],
            rgb: vec![[0; 3]; n],
            descriptors: (0..n).flat_map(descriptor).collect(),
        }
    }

    fn unit(seed: u64, noise: f32) -> Vec<f32> {
        let mut rng = seeded_rng(seed, 0);
        let mut jitter = seeded_rng(seed, 1);
        let sparse = |value: f32| if value > 0.8 { value } else { 0.0 };
        let raw: Vec<f32> =
            (0..DESCRIPTOR_LEN).map(|_| sparse(rng.random::<f32>()) + noise * jitter.random::<f32>()).collect();
        let norm = raw.iter().map(|v| v * v).sum::<f32>().sqrt();
        raw.into_iter().map(|v| v / norm).collect()
    }

    #[test]
    fn noisy_copies_are_found_in_any_order_and_twins_are_refused() {
        let a = features(600, |i| unit(i as u64, 0.0));
        let b = features(500, |j| unit((499 - j) as u64, 0.05));
        let found = match_features(&a, &b, &MatchOptions::default());
        assert_eq!(found.len(), 500);
        assert!(found.iter().all(|[i, j]| i + j == 499));
        let twins = features(2, |_| unit(3, 0.0));
        assert!(match_features(&a, &twins, &MatchOptions::default()).is_empty());
        assert!(match_features(&a, &Features::default(), &MatchOptions::default()).is_empty());
        assert!(match_features(&Features::default(), &a, &MatchOptions::default()).is_empty());
    }
}
