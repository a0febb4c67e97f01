//! Matching of descriptors between two images.
//!
//! All similarities of two sets of unit descriptors are one matrix product, taken in blocks (`faer`). A match is mutual,
//! and better than the second best in its row and its column by Lowe's ratio.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
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
    const BLOCK: usize = 256;
    let (rows, columns) = (a.len(), b.len());
    let mut best_of_row = vec![Best::NONE; rows];
    let mut best_of_column = vec![Best::NONE; columns];
    let all_b = MatRef::from_row_major_slice(&b.descriptors, columns, DESCRIPTOR_LEN);
    let mut similarities = vec![0.0f32; BLOCK * columns];
    for start in (0..rows).step_by(BLOCK) {
        let n = BLOCK.min(rows - start);
        let part = &a.descriptors[start * DESCRIPTOR_LEN..(start + n) * DESCRIPTOR_LEN];
        let block = MatRef::from_row_major_slice(part, n, DESCRIPTOR_LEN);
        let out = MatMut::from_column_major_slice_mut(&mut similarities[..n * columns], columns, n);
        matmul(out, Accum::Replace, all_b, block.transpose(), 1.0f32, Par::Seq);
        for (i, row) in similarities[..n * columns].chunks_exact(columns.max(1)).enumerate() {
            let best = &mut best_of_row[start + i];
            for (j, &similarity) in row.iter().enumerate() {
                best.offer(j as u32, similarity);
                best_of_column[j].offer((start + i) as u32, similarity);
            }
        }
    }
    let mutual = |(i, best): (usize, &Best)| {
        let back = best_of_column.get(best.index as usize)?;
        let agreed = back.index == i as u32 && best.is_distinct(options) && back.is_distinct(options);
        agreed.then_some([i as u32, best.index])
    };
    best_of_row.iter().enumerate().filter_map(mutual).collect()
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
