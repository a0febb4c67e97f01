//! Scale ratio from all frames at once, with its determinacy by the motion.
//!
//! With h_i and a_ij as in [`View`](super::View), constant distance reads h_i + r a_i = d for the mean a_i of the a_ij
//! over the object's points. The residuals e_i = h_i + r a_i − d have two sources. The errors of ground planes are
//! independent in every frame (white noise). An object's reconstruction drifts, as every chain of frames does: its
//! depth changes slowly by a percent over a drive (random walk). Plain least squares takes the drift for information,
//! and r is wrong by up to fourteen of its standard deviations. Here
//!
//! ```text
//! e_i = white_i + walk_i,   var(white_i) = σ² / w_i,   var(walk_i − walk_(i−1)) = q σ² (t_i − t_(i−1))
//! ```
//!
//! with t the frame index. A Kalman filter with the state d + walk and a diffuse initial state turns the h_i and the
//! a_i into independent innovations y_i and x_i of variance σ² F_i, and generalized least squares is
//!
//! ```text
//! r = − Σ x_i y_i / F_i / Σ x_i² / F_i,      σ_r² = σ² / Σ x_i² / F_i.
//! ```
//!
//! The regression assumes exact a_i; noise in them shrinks r. If all noise is theirs, the ratio is
//! (1 + (n − 2) σ_r² / r²) r; the truth is between both (R. Frisch, *Statistical Confluence Analysis*, 1934).
//!
//! q maximizes the restricted likelihood. The weights w_i are Tukey's, of the distance of e_i from the median of its
//! neighbors in time: wrong planes differ from their neighbors and lose all weight, drift does not.
//!
//! r depends on the *excitation*, the spread of a_i: the variation of the camera's height over the ground in the
//! object's own units. When camera and object move parallel to the ground there is none, and r is undetermined.
//!
//! Derivation: docs/maths/scale.md.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Estimate, Options, ScaleError, Views};
use crate::math::{STD_PER_MAD, centroid, median};

/// Frames before and after a frame whose median it is compared with: they share slow drift, but not a wrong plane.
const NEIGHBORS: usize = 5;

/// Noise model of the fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LeastSquaresOptions {
    /// True if drift of the heights is estimated as a random walk; false for white noise only.
    pub drift: bool,
}

impl Default for LeastSquaresOptions {
    fn default() -> Self {
        Self { drift: true }
    }
}

/// Solution over all frames.
#[derive(Clone, Debug, PartialEq)]
pub struct LeastSquares {
    /// r; of either sign, and not finite where it is undetermined.
    pub ratio: f64,
    /// Its standard deviation.
    pub std: f64,
    /// r if all noise were in the heights of the object.
    pub ratio_by_object_noise: f64,
    /// Standard deviation of the distances d over all frames, drift included, units of the background.
    pub residual_std: f64,
    /// Weighted spread (standard deviation) of the camera's height over the ground in units of the object.
    pub excitation: f64,
    /// Weighted mean over frames of the camera's height over the object, in units of the object, for comparison with
    /// `excitation`.
    pub mean_height: f64,
}

/// Robust generalized least squares over all views.
///
/// # Errors
/// [`ScaleError`] for fewer than three views (two have no residual) or no points.
pub fn least_squares(views: &Views, options: &LeastSquaresOptions) -> Result<LeastSquares, ScaleError> {
    views.require(3)?;
    let series = Series::new(views);
    let mut weights = vec![1.0; series.heights.len()];
    let mut fit = series.fit(&weights, 0.0);
    let next =
        |weights: &[f64]| if options.drift { series.max_likelihood_fit(weights) } else { series.fit(weights, 0.0) };
    // Ends earlier when r has converged.
    for _ in 0..50 {
        let local_residuals = series.local_residuals(fit.ratio);
        let sigma = STD_PER_MAD * median(local_residuals.iter().map(|e| e.abs()).collect()).unwrap_or(0.0);
        if sigma <= f64::EPSILON * series.size() || !fit.ratio.is_finite() {
            break;
        }
        // Tukey's biweight. A constant of 4.685 would have 95 % efficiency on Gaussian noise, but keep some planes with
        // errors of half a meter.
        let weight = |e: &f64| (1.0 - (e / (3.0 * sigma)).powi(2)).max(0.0).powi(2);
        weights = local_residuals.iter().map(weight).collect();
        let last = std::mem::replace(&mut fit, next(&weights)).ratio;
        if (fit.ratio - last).abs() <= 1e-12 * fit.ratio.abs() {
            break;
        }
    }
    let found = series.summary(&fit, &weights);
    // Height errors of this size from the first to the last frame change the spread of the a_i by as much.
    let systematic = views.grazing_std(found.ratio).hypot(views.plane_std) / found.excitation;
    let std = if systematic.is_finite() { found.std.hypot(systematic) } else { found.std };
    Ok(LeastSquares { std, ..found })
}

/// Ratio of the fit, if it is positive.
pub(super) fn estimate(views: &Views, options: &Options) -> Result<Estimate, ScaleError> {
    let LeastSquares { ratio, std, .. } = least_squares(views, &options.least_squares)?;
    if !(ratio.is_finite() && ratio > 0.0) {
        return Err(ScaleError::NotPositive { num_views: views.views.len(), ratio });
    }
    Ok(Estimate::new(ratio, Some(std)))
}

/// Data of the fit, by view.
struct Series {
    /// t_i.
    frames: Vec<f64>,
    /// h_i.
    heights: Vec<f64>,
    /// a_i.
    offsets: Vec<f64>,
}

#[derive(Clone, Copy)]
struct Fit {
    ratio: f64,
    std: f64,
    /// −2 log of the restricted likelihood, up to a constant.
    deviance: f64,
}

impl Fit {
    const UNDETERMINED: Self = Self { ratio: f64::NAN, std: f64::INFINITY, deviance: f64::INFINITY };
}

impl Series {
    fn new(views: &Views) -> Self {
        // a_ij is linear in the point: the mean over the points is that of the mean point.
        let center = centroid(&views.points);
        Self {
            frames: views.views.iter().map(|v| f64::from(v.frame.0)).collect(),
            heights: views.views.iter().map(|v| v.camera_height).collect(),
            offsets: views.views.iter().map(|v| v.offset(&center)).collect(),
        }
    }

    /// Reference length for "zero up to rounding" of residuals.
    fn size(&self) -> f64 {
        self.heights.iter().fold(0.0, |m: f64, h| m.max(h.abs()))
    }

    /// e_i minus the median of its neighbors in time, itself included.
    fn local_residuals(&self, ratio: f64) -> Vec<f64> {
        let residuals: Vec<f64> = self.heights.iter().zip(&self.offsets).map(|(h, a)| h + ratio * a).collect();
        let near = |i: usize| &residuals[i.saturating_sub(NEIGHBORS)..residuals.len().min(i + NEIGHBORS + 1)];
        residuals.iter().enumerate().map(|(i, e)| e - median(near(i).to_vec()).unwrap_or(*e)).collect()
    }

    /// Fit with the drift of maximum likelihood.
    fn max_likelihood_fit(&self, weights: &[f64]) -> Fit {
        // From no drift to no white noise, four to a decade.
        let drifts = std::iter::once(0.0).chain((-16..=12).map(|k| 10f64.powf(f64::from(k) / 4.0)));
        let fits = drifts.map(|drift| self.fit(weights, drift));
        fits.min_by(|a, b| a.deviance.total_cmp(&b.deviance)).unwrap_or_else(|| self.fit(weights, 0.0))
    }

    fn fit(&self, weights: &[f64], drift: f64) -> Fit {
        let mut frames = (0..self.heights.len()).filter(|&i| weights[i] > 0.0);
        let Some(mut last) = frames.next() else { return Fit::UNDETERMINED };
        // The first frame initializes the state; each further one gives an innovation. Variances are in units of σ².
        let (mut height, mut offset, mut variance) = (self.heights[last], self.offsets[last], 1.0 / weights[last]);
        let (mut xx, mut xy, mut yy, mut log_variance, mut n) = (0.0, 0.0, 0.0, 0.0, 1.0);
        for i in frames {
            variance += drift * (self.frames[i] - self.frames[last]).abs();
            let innovation_variance = variance + 1.0 / weights[i];
            let (x, y) = (self.offsets[i] - offset, self.heights[i] - height);
            xx += x * x / innovation_variance;
            xy += x * y / innovation_variance;
            yy += y * y / innovation_variance;
            log_variance += innovation_variance.ln();
            n += 1.0;
            let gain = variance / innovation_variance;
            offset += gain * x;
            height += gain * y;
            variance *= 1.0 - gain;
            last = i;
        }
        let freedom: f64 = n - 2.0;
        if freedom <= 0.0 {
            return Fit::UNDETERMINED;
        }
        let variance = ((yy - xy * xy / xx).max(0.0) / freedom).max(f64::MIN_POSITIVE);
        Fit { ratio: -xy / xx, std: (variance / xx).sqrt(), deviance: freedom * variance.ln() + log_variance + xx.ln() }
    }

    fn summary(&self, fit: &Fit, weights: &[f64]) -> LeastSquares {
        let total: f64 = weights.iter().sum();
        let mean = |values: &[f64]| values.iter().zip(weights).map(|(v, w)| v * w).sum::<f64>() / total;
        let spread = |values: &[f64]| {
            let center = mean(values);
            mean(&values.iter().map(|v| (v - center).powi(2)).collect::<Vec<_>>()).sqrt()
        };
        let distances: Vec<f64> = self.heights.iter().zip(&self.offsets).map(|(h, a)| h + fit.ratio * a).collect();
        let n = weights.iter().filter(|w| **w > 0.0).count() as f64;
        LeastSquares {
            ratio: fit.ratio,
            std: fit.std,
            ratio_by_object_noise: fit.ratio + (n - 2.0).max(0.0) * fit.std.powi(2) / fit.ratio,
            residual_std: spread(&distances) * (n / (n - 2.0).max(1.0)).sqrt(),
            excitation: spread(&self.offsets),
            mean_height: -mean(&self.offsets),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{Drive, Noise, Options, Terrain, drive};

    fn solve(world: &Drive) -> LeastSquares {
        let views = Views::new(&world.background, &world.object, &world.planes, &crate::trajectory::Options::default());
        least_squares(&views, &LeastSquaresOptions::default()).unwrap()
    }

    #[test]
    fn exact_worlds_give_the_exact_ratio() {
        for (terrain, camera_climb_m) in [
            (Terrain::Flat, 2.0),
            (Terrain::Slope { gradient: [0.1, -0.05] }, 5.0),
            (Terrain::Hills { amplitude_m: 1.0, wavelength_m: 60.0 }, 0.0),
        ] {
            let world = drive(&Options { terrain, camera_climb_m, ..Options::default() }, 2);
            let found = solve(&world);
            assert!((found.ratio / world.ratio - 1.0).abs() < 1e-9, "{terrain:?}: {found:?}");
            assert!(found.residual_std < 1e-6 * found.mean_height.abs(), "{terrain:?}: {found:?}");
        }
    }

    #[test]
    fn wrong_planes_lose_their_weight() {
        let noise = Noise { pixel_px: 0.5, plane_height_m: 0.03, plane_tilt_deg: 0.5, bad_planes: 0.1 };
        for seed in 0..6 {
            let world = drive(&Options { noise, ..Options::default() }, seed);
            let found = solve(&world);
            let error = (found.ratio / world.ratio - 1.0).abs();
            assert!(error < 0.015, "seed {seed}: {error}");
        }
    }

    /// An object with depth drift: the error of the ratio agrees with its standard deviation, which plain least squares
    /// underestimates by far.
    #[test]
    fn drift_does_not_count_as_information() {
        use rand::Rng as _;
        let mut squared_errors = [0.0, 0.0];
        for seed in 0..20 {
            let world = drive(&Options::default(), seed);
            let mut views =
                Views::new(&world.background, &world.object, &world.planes, &crate::trajectory::Options::default());
            let mut rng = crate::math::seeded_rng(seed, 7);
            let mut walk = 0.0;
            for view in &mut views.views {
                walk += 0.01 * rng.sample::<f64, _>(rand_distr::StandardNormal);
                view.camera_height += walk + 0.002 * rng.sample::<f64, _>(rand_distr::StandardNormal);
            }
            let found = least_squares(&views, &LeastSquaresOptions::default()).unwrap();
            let plain = Series::new(&views).fit(&vec![1.0; views.views.len()], 0.0);
            for (sum, (ratio, std)) in
                squared_errors.iter_mut().zip([(found.ratio, found.std), (plain.ratio, plain.std)])
            {
                *sum += ((ratio - world.ratio) / std).powi(2) / 20.0;
            }
        }
        let [with, without] = squared_errors;
        assert!((0.3..2.5).contains(&with) && without > 5.0, "{with} {without}");
    }

    /// A camera that hardly climbs, and an object whose heights have noise of half the excitation.
    #[test]
    fn the_truth_is_the_ratio_by_object_noise_where_all_noise_is_the_objects() {
        use rand::Rng as _;
        const NUM_SEEDS: u64 = 20;
        let [mut least, mut most] = [0.0, 0.0];
        for seed in 0..NUM_SEEDS {
            let world = drive(&Options { camera_climb_m: 0.3, ..Options::default() }, seed);
            let mut views =
                Views::new(&world.background, &world.object, &world.planes, &crate::trajectory::Options::default());
            let (mut rng, noise) = (crate::math::seeded_rng(seed, 3), 0.5 * solve(&world).excitation);
            for view in &mut views.views {
                let up = noise * rng.sample::<f64, _>(rand_distr::StandardNormal);
                view.center_in_object += up * view.normal_in_object;
            }
            let options = LeastSquaresOptions { drift: false };
            let found = least_squares(&views, &options).unwrap();
            least += found.ratio / world.ratio / NUM_SEEDS as f64;
            most += found.ratio_by_object_noise / world.ratio / NUM_SEEDS as f64;
        }
        assert!((0.7..0.9).contains(&least) && (0.95..1.05).contains(&most), "{least} {most}");
    }

    #[test]
    fn parallel_motion_shows_as_missing_excitation() {
        let world = drive(&Options { camera_climb_m: 0.0, ..Options::default() }, 5);
        let found = solve(&world);
        assert!(found.excitation < 1e-9 * found.mean_height, "{found:?}");
        let climbing = solve(&drive(&Options::default(), 5));
        // 8 m of even climb spread by 8 / sqrt(12) m; the object's unit is 1.7 m.
        assert!((climbing.excitation * 1.7 - 8.0 / 12.0_f64.sqrt()).abs() < 0.1);
    }

    #[test]
    fn a_vehicle_far_ahead_of_a_low_camera_is_not_known_from_a_small_climb() {
        let noise = Noise { plane_height_m: 0.001, ..Noise::default() };
        let relative_std = |camera_height_m: f64, camera_climb_m: f64| {
            let found = solve(&drive(&Options { camera_height_m, camera_climb_m, noise, ..Options::default() }, 5));
            found.std / found.ratio.abs()
        };
        let [low, high] = [relative_std(1.4, 0.1), relative_std(20.0, 1.5)];
        assert!(low > 0.5 && high < 0.1, "{low} {high}");
    }
}
