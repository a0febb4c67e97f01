//! Generic RANSAC loop for all models of the program.
//!
//! LO-RANSAC (Chum, Matas, Kittler, *Locally Optimized RANSAC*, DAGM 2003) with the truncated quadratic score of MSAC
//! (Torr, Zisserman, *MLESAC*, CVIU 2000): a model costs `Σ min(e², t²)`. Whenever a sample beats the best model so
//! far, the model is refined on its inliers, which provides most of the accuracy. The number of samples adapts to the
//! inlier ratio. Samples are drawn from a seeded generator: the same data and seed give the same result.

use rand::Rng as _;

use crate::math::Rng;

/// Problem to be solved by RANSAC.
pub trait Estimator {
    /// Estimated model.
    type Model: Clone;
    /// Size of a minimal sample.
    const SAMPLE_SIZE: usize;

    /// Number of data.
    fn num_data(&self) -> usize;
    /// All models that a minimal sample of distinct data allows: none for a degenerate one.
    fn fit(&self, sample: &[usize], models: &mut Vec<Self::Model>);
    /// Squared residual of one datum; `f64::INFINITY` where the datum contradicts the model (behind the camera).
    fn error_sq(&self, model: &Self::Model, datum: usize) -> f64;
    /// A better model from its inliers, by least squares; `None` where that fails.
    fn refine(&self, model: &Self::Model, inliers: &[usize]) -> Option<Self::Model>;
}

/// Effort of the search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Residual up to which a datum is an inlier, in the unit of the estimator's residual.
    pub max_error: f64,
    /// Required probability of having drawn an all-inlier sample.
    pub confidence: f64,
    /// Minimum number of samples.
    pub min_iterations: usize,
    /// Maximum number of samples.
    pub max_iterations: usize,
    /// Minimum useful number of inliers: it bounds the number of samples drawn.
    pub least_inliers: usize,
}

impl Options {
    /// The usual effort at a given threshold.
    pub fn with_max_error(max_error: f64) -> Self {
        Self { max_error, confidence: 0.9999, min_iterations: 30, max_iterations: 5000, least_inliers: 0 }
    }
}

/// The best model found.
#[derive(Clone, Debug)]
pub struct Consensus<M> {
    /// The model, refined.
    pub model: M,
    /// Data within the threshold, ascending.
    pub inliers: Vec<usize>,
    /// Truncated quadratic score over all data; smaller is better.
    pub score: f64,
}

/// Runs LO-RANSAC. `None` when there are too few data or no sample gave a model with more inliers than its own sample.
pub fn ransac<E: Estimator>(estimator: &E, options: &Options, rng: &mut Rng) -> Option<Consensus<E::Model>> {
    let num_data = estimator.num_data();
    if num_data < E::SAMPLE_SIZE {
        return None;
    }
    let max_sq = options.max_error * options.max_error;
    let mut best: Option<Consensus<E::Model>> = None;
    let mut models = Vec::new();
    let mut sample = vec![0; E::SAMPLE_SIZE];
    let mut needed = needed_iterations(options.least_inliers, num_data, E::SAMPLE_SIZE, options);
    let mut iteration = 0;
    while iteration < needed.max(options.min_iterations).min(options.max_iterations) {
        iteration += 1;
        draw_sample(&mut sample, num_data, rng);
        models.clear();
        estimator.fit(&sample, &mut models);
        for model in &models {
            let limit = best.as_ref().map_or(f64::INFINITY, |b| b.score);
            let Some(score) = score_below(estimator, model, max_sq, limit) else { continue };
            let candidate = Consensus { model: model.clone(), inliers: inliers_of(estimator, model, max_sq), score };
            let candidate = locally_optimized(estimator, candidate, max_sq);
            let found = candidate.inliers.len().max(options.least_inliers);
            needed = needed_iterations(found, num_data, E::SAMPLE_SIZE, options);
            best = Some(candidate);
        }
    }
    best.filter(|b| b.inliers.len() > E::SAMPLE_SIZE)
}

/// Data within the threshold, ascending.
pub fn inliers_of<E: Estimator>(estimator: &E, model: &E::Model, max_error_sq: f64) -> Vec<usize> {
    (0..estimator.num_data()).filter(|&datum| estimator.error_sq(model, datum) <= max_error_sq).collect()
}

/// The truncated score, or `None` as soon as it reaches `limit`.
fn score_below<E: Estimator>(estimator: &E, model: &E::Model, max_sq: f64, limit: f64) -> Option<f64> {
    let mut score = 0.0;
    for datum in 0..estimator.num_data() {
        score += estimator.error_sq(model, datum).min(max_sq);
        if score >= limit {
            return None;
        }
    }
    Some(score)
}

/// Refines on the inliers, as long as that improves the score.
fn locally_optimized<E: Estimator>(
    estimator: &E,
    mut current: Consensus<E::Model>,
    max_sq: f64,
) -> Consensus<E::Model> {
    // A bound; the loop ends when the score does not improve.
    for _ in 0..4 {
        if current.inliers.len() <= E::SAMPLE_SIZE {
            break;
        }
        let Some(model) = estimator.refine(&current.model, &current.inliers) else { break };
        let Some(score) = score_below(estimator, &model, max_sq, current.score) else { break };
        let inliers = inliers_of(estimator, &model, max_sq);
        current = Consensus { model, inliers, score };
    }
    current
}

/// Number of samples after which an all-inlier one was drawn with the required confidence.
fn needed_iterations(num_inliers: usize, num_data: usize, sample_size: usize, options: &Options) -> usize {
    let all_inliers = (num_inliers as f64 / num_data as f64).powi(sample_size as i32);
    if all_inliers >= 1.0 {
        return options.min_iterations;
    }
    let needed = (1.0 - options.confidence).ln() / (1.0 - all_inliers).ln();
    if needed.is_finite() { (needed.ceil() as usize).min(options.max_iterations) } else { options.max_iterations }
}

/// Distinct indices below `num_data`, uniformly.
fn draw_sample(sample: &mut [usize], num_data: usize, rng: &mut Rng) {
    for k in 0..sample.len() {
        sample[k] = loop {
            let drawn = rng.random_range(0..num_data);
            if !sample[..k].contains(&drawn) {
                break drawn;
            }
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::seeded_rng;

    /// A line y = a x + b through two-dimensional points.
    struct Line(Vec<[f64; 2]>);

    impl Estimator for Line {
        type Model = [f64; 2];
        const SAMPLE_SIZE: usize = 2;

        fn num_data(&self) -> usize {
            self.0.len()
        }

        fn fit(&self, sample: &[usize], models: &mut Vec<[f64; 2]>) {
            let ([x0, y0], [x1, y1]) = (self.0[sample[0]], self.0[sample[1]]);
            if x0 != x1 {
                let a = (y1 - y0) / (x1 - x0);
                models.push([a, y0 - a * x0]);
            }
        }

        fn error_sq(&self, [a, b]: &[f64; 2], datum: usize) -> f64 {
            let [x, y] = self.0[datum];
            (a * x + b - y).powi(2)
        }

        fn refine(&self, _: &[f64; 2], inliers: &[usize]) -> Option<[f64; 2]> {
            let n = inliers.len() as f64;
            let (mut sx, mut sy, mut sxx, mut sxy) = (0.0, 0.0, 0.0, 0.0);
            for &i in inliers {
                let [x, y] = self.0[i];
                (sx, sy, sxx, sxy) = (sx + x, sy + y, sxx + x * x, sxy + x * y);
            }
            let a = (n * sxy - sx * sy) / (n * sxx - sx * sx);
            Some([a, (sy - a * sx) / n])
        }
    }

    fn noisy_line(num_outliers: usize) -> Line {
        let mut rng = seeded_rng(1, 2);
        let on_line = (0..60).map(|i| {
            let x = f64::from(i) / 10.0;
            [x, 2.0 * x - 1.0 + 0.01 * (x * 37.0).sin()]
        });
        let mut points: Vec<_> = on_line.collect();
        points.extend((0..num_outliers).map(|_| [rng.random_range(0.0..6.0), rng.random_range(-50.0..50.0)]));
        Line(points)
    }

    #[test]
    fn finds_the_line_among_outliers_and_repeats() {
        let line = noisy_line(120);
        let run = || ransac(&line, &Options::with_max_error(0.05), &mut seeded_rng(3, 0)).unwrap();
        let found = run();
        assert!((found.model[0] - 2.0).abs() < 0.01 && (found.model[1] + 1.0).abs() < 0.01);
        assert!(found.inliers.len() >= 60);
        assert_eq!(found.inliers, run().inliers);
        assert_eq!(found.model, run().model);
    }

    #[test]
    fn what_is_of_no_use_is_not_looked_for() {
        struct Counted(Line, std::cell::Cell<usize>);
        impl Estimator for Counted {
            type Model = [f64; 2];
            const SAMPLE_SIZE: usize = 2;
            fn num_data(&self) -> usize {
                self.0.num_data()
            }
            fn fit(&self, sample: &[usize], models: &mut Vec<[f64; 2]>) {
                self.1.set(self.1.get() + 1);
                self.0.fit(sample, models);
            }
            fn error_sq(&self, model: &[f64; 2], datum: usize) -> f64 {
                self.0.error_sq(model, datum)
            }
            fn refine(&self, model: &[f64; 2], inliers: &[usize]) -> Option<[f64; 2]> {
                self.0.refine(model, inliers)
            }
        }
        // A sixth of the data lies on the line.
        let samples = |least_inliers: usize| {
            let counted = Counted(noisy_line(300), Default::default());
            let options = Options { least_inliers, ..Options::with_max_error(0.05) };
            let found = ransac(&counted, &options, &mut seeded_rng(3, 0)).map_or(0, |found| found.inliers.len());
            (counted.1.get(), found)
        };
        let ((all, found), (few, _)) = (samples(0), samples(180));
        assert!(found >= 60 && all > 200 && few < 40, "{found} {all} {few}");
        assert_eq!(samples(60).1, found);
    }

    #[test]
    fn too_few_data_or_no_structure_is_no_answer() {
        let options = Options::with_max_error(1e-9);
        assert!(ransac(&Line(vec![[0.0, 0.0]]), &options, &mut seeded_rng(0, 0)).is_none());
        let scattered = Line(vec![[0.0, 0.0], [1.0, 5.0], [2.0, -3.0], [3.0, 11.0]]);
        assert!(ransac(&scattered, &options, &mut seeded_rng(0, 0)).is_none());
        let same = Line(vec![[1.0, 2.0]; 5]);
        assert!(ransac(&same, &options, &mut seeded_rng(0, 0)).is_none());
    }
}
