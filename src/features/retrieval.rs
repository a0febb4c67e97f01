//! Image retrieval: pairs of views that probably show the same part of a scene.
//!
//! The global descriptor of a view is its VLAD (H. Jégou et al., *Aggregating Local Descriptors into a Compact Image
//! Representation*, CVPR 2010): per visual word, the sum of the residuals of its descriptors, normalized word by word
//! (R. Arandjelović, A. Zisserman, *All about VLAD*, CVPR 2013). The words are a k-means of descriptors of the set
//! itself. Positions of the views add the nearest ones in space.

use std::collections::BTreeSet;

use nalgebra::Point3;
use rand::seq::index::sample;
use rayon::prelude::*;

use super::rootsift::{DESCRIPTOR_LEN, DESCRIPTOR_NORM, Features};
use crate::math::seeded_rng;

/// Number of visual words: at the lower end of the usual vocabularies of VLAD (16 to 256), 32 KiB per image.
const NUM_WORDS: usize = 64;

/// Maximum number of features per view, the strongest: bounds the cost; a fifth of those of a photograph.
const NUM_STRONGEST: usize = 1000;

/// Number of descriptors for k-means: 500 per word.
const NUM_SAMPLED: usize = 500 * NUM_WORDS;

/// Number of iterations of k-means; later ones assign few descriptors to another word.
const NUM_ROUNDS: usize = 10;

/// Stream of random numbers of the vocabulary; pairs of views have those from 0 on.
const STREAM: u64 = u64::MAX;

type Descriptor = [f32; DESCRIPTOR_LEN];

/// Pairs of each view and the `count` views most similar to it, ascending.
pub(super) fn similar_pairs(features: &[Features], count: usize, seed: u64) -> BTreeSet<[usize; 2]> {
    let words = vocabulary(features, seed);
    let globals: Vec<Vec<f32>> = features.par_iter().map(|features| vlad(features, &words)).collect();
    best_pairs(globals.len(), count, |i, j| {
        // A view without features resembles none.
        Some(dot(&globals[i], &globals[j])).filter(|similarity| *similarity > 0.0)
    })
}

/// Pairs of each view and the `count` views nearest to it in space, ascending; views without a position have none.
pub(super) fn near_pairs(positions: &[Option<Point3<f64>>], count: usize) -> BTreeSet<[usize; 2]> {
    best_pairs(positions.len(), count, |i, j| Some(-(positions[i]? - positions[j]?).norm() as f32))
}

/// Pairs of each view and the `count` others of the highest score.
fn best_pairs(n: usize, count: usize, score: impl Fn(usize, usize) -> Option<f32> + Sync) -> BTreeSet<[usize; 2]> {
    let best_of = |i: usize| {
        let others = (0..n).filter(|&j| j != i);
        let mut scored: Vec<(f32, usize)> = others.filter_map(|j| Some((score(i, j)?, j))).collect();
        scored.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        scored.truncate(count);
        scored.into_iter().map(|(_, j)| [i.min(j), i.max(j)]).collect::<Vec<_>>()
    };
    (0..n).into_par_iter().flat_map_iter(best_of).collect::<Vec<_>>().into_iter().collect()
}

/// Descriptors of the strongest features of a view, of length 1.
fn descriptors(features: &Features) -> impl Iterator<Item = Descriptor> + '_ {
    let rows = features.descriptors.chunks_exact(DESCRIPTOR_LEN).take(NUM_STRONGEST);
    rows.map(|row| std::array::from_fn(|k| f32::from(row[k]) / DESCRIPTOR_NORM))
}

/// Visual words of the views; fewer where they have fewer descriptors.
fn vocabulary(features: &[Features], seed: u64) -> Vec<Descriptor> {
    let mut rng = seeded_rng(seed, STREAM);
    let per_view = NUM_SAMPLED.div_ceil(features.len().max(1));
    let mut sampled: Vec<Descriptor> = Vec::new();
    for view in features {
        let all: Vec<Descriptor> = descriptors(view).collect();
        sampled.extend(sample(&mut rng, all.len(), per_view.min(all.len())).iter().map(|k| all[k]));
    }
    let firsts = sample(&mut rng, sampled.len(), NUM_WORDS.min(sampled.len()));
    let mut words: Vec<Descriptor> = firsts.iter().map(|k| sampled[k]).collect();
    for _ in 0..NUM_ROUNDS {
        let nearest: Vec<usize> = sampled.par_iter().filter_map(|descriptor| nearest(descriptor, &words)).collect();
        let mut sums = vec![([0.0; DESCRIPTOR_LEN], 0u32); words.len()];
        for (descriptor, word) in sampled.iter().zip(nearest) {
            let (sum, number) = &mut sums[word];
            sum.iter_mut().zip(descriptor).for_each(|(sum, value): (&mut f32, _)| *sum += value);
            *number += 1;
        }
        for (word, (sum, number)) in words.iter_mut().zip(sums).filter(|(_, (_, number))| *number > 0) {
            *word = sum.map(|sum| sum / number as f32);
        }
    }
    words
}

/// Index of the word nearest to a descriptor.
fn nearest(descriptor: &Descriptor, words: &[Descriptor]) -> Option<usize> {
    let distances = words.iter().map(|word| dot(word, word) - 2.0 * dot(word, descriptor));
    distances.enumerate().min_by(|a, b| a.1.total_cmp(&b.1)).map(|(word, _)| word)
}

/// Global descriptor of length 1; zeros without features.
fn vlad(features: &Features, words: &[Descriptor]) -> Vec<f32> {
    let mut global = vec![0.0; words.len() * DESCRIPTOR_LEN];
    for descriptor in descriptors(features) {
        let Some(word) = nearest(&descriptor, words) else { continue };
        let part = &mut global[word * DESCRIPTOR_LEN..][..DESCRIPTOR_LEN];
        part.iter_mut()
            .zip(descriptor.iter().zip(&words[word]))
            .for_each(|(sum, (value, center))| *sum += value - center);
    }
    global.chunks_exact_mut(DESCRIPTOR_LEN).for_each(normalize);
    normalize(&mut global);
    global
}

fn normalize(vector: &mut [f32]) {
    let norm = dot(vector, vector).sqrt();
    if norm > 0.0 {
        vector.iter_mut().for_each(|value| *value /= norm);
    }
}

/// Scalar product in eight sums, which the compiler computes at once; lengths are multiples of eight.
fn dot(a: &[f32], b: &[f32]) -> f32 {
    let mut sums = [0.0f32; 8];
    for (a, b) in a.chunks_exact(8).zip(b.chunks_exact(8)) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, (a, b))| *sum += a * b);
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::Rng as _;

    /// A view of a scene: noisy copies of the scene's descriptors.
    fn view(scene: u64, noise: u64) -> Features {
        let (mut points, mut jitter) = (seeded_rng(scene, 0), seeded_rng(noise, 1));
        let mut descriptors = Vec::new();
        for _ in 0..80 * DESCRIPTOR_LEN {
            let value: f32 = if points.random::<f32>() > 0.8 { points.random() } else { 0.0 };
            descriptors.push((60.0 * value + 8.0 * jitter.random::<f32>()) as u8);
        }
        Features { pixels: vec![nalgebra::Point2::origin(); 80], descriptors, ..Features::default() }
    }

    #[test]
    fn views_of_one_scene_are_paired_with_one_another() {
        let features: Vec<Features> = (0..40).map(|k| view(k % 8, k)).chain([Features::default()]).collect();
        let pairs = similar_pairs(&features, 4, 1);
        assert_eq!(pairs.len(), 8 * 10, "{pairs:?}");
        assert!(pairs.iter().all(|[i, j]| i % 8 == j % 8));
        assert_eq!(similar_pairs(&features, 4, 1), pairs);
        assert!(similar_pairs(&[], 4, 1).is_empty() && similar_pairs(&[Features::default()], 4, 1).is_empty());
    }

    #[test]
    fn near_views_are_paired_and_those_without_a_position_are_not() {
        let at = |x: f64| Some(Point3::new(x, 0.0, 0.0));
        let pairs = near_pairs(&[at(0.0), None, at(10.0), at(1.0), at(12.0)], 1);
        assert_eq!(pairs.into_iter().collect::<Vec<_>>(), [[0, 3], [2, 4]]);
    }
}
