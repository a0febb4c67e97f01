//! The scale ratio from all frames at once, and how well the motion determines it.
//!
//! With h_i and a_ij as in [`View`](super::View), constant distance reads h_i + r a_ij = d_j. For frame weights w_i the
//! unknown d_j are profiled out by taking the weighted mean over the frames away (tilde), and
//!
//! ```text
//! r = − Σ_i w_i h̃_i mean_j(ã_ij) / Σ_i w_i mean_j(ã_ij²),      e_ij = h̃_i + r ã_ij.
//! ```
//!
//! The weights come from a robust loss on the frame's residual e_i = sqrt(mean_j e_ij²): a wrong plane spoils all
//! points of its frame alike, so frames, not points, are the independent observations. Huber's loss first (convex, it finds
//! the valley), then Cauchy's, which lets go of frames that are plainly wrong.
//!
//! The standard deviation follows from the same formula: σ_r² = σ² / Σ_i w_i mean_j(ã_ij²), with σ² the weighted mean
//! of e_i² times n / (n − 2): n frames, less one for r and one for the mean distance. What it hangs on is the *excitation*
//! Σ ã²: the spread of the camera's height over the ground, in the object's own units. When camera and object move
//! parallel to the ground there is none, and nothing in these equations determines r.
//!
//! a_ij is linear in the point, a_ij = m_i · o_j + b_i, so that means over the points need only their second moments: the cost is that of
//! the frames, however many points there are.
//!
//! Derivation: docs/maths/scale.md.

use nalgebra::{Matrix4, Vector3, Vector4};
use serde::{Deserialize, Serialize};

use super::views::median;
use super::{ScaleError, Views};
use crate::math::RobustLoss;

/// How robust the fit is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct LeastSquaresOptions {
    /// Residual, in robust standard deviations, at which Huber's loss becomes linear: 1.345 keeps 95 % of the efficiency of
    /// plain least squares on Gaussian noise.
    pub huber_scale: f64,
    /// The constant of Cauchy's loss in robust standard deviations: 2.385, for the same reason.
    pub cauchy_scale: f64,
    /// Rounds of reweighting with each loss; it stops earlier when r no longer changes.
    pub max_rounds: usize,
}

impl Default for LeastSquaresOptions {
    fn default() -> Self {
        Self { huber_scale: 1.345, cauchy_scale: 2.385, max_rounds: 50 }
    }
}

/// The solution over all frames.
#[derive(Clone, Debug, PartialEq)]
pub struct LeastSquares {
    /// r; of either sign, and not finite where nothing determines it.
    pub ratio: f64,
    /// Its standard deviation, frames taken as independent.
    pub std: f64,
    /// Standard deviation σ of a frame's distances, units of the background.
    pub residual_std: f64,
    /// Weighted spread (standard deviation) of the camera's height over the ground in units of the object: the root of
    /// the mean over frames of mean_j ã_ij².
    pub excitation: f64,
    /// Weighted mean over frames of the camera's height over the object, in units of the object: what `excitation` is compared with.
    pub mean_height: f64,
    /// Weight of each view, 0 to 1, in the order of [`Views::views`].
    pub weights: Vec<f64>,
}

/// Robust least squares over all views.
///
/// # Errors
/// [`ScaleError`] for fewer than three views (two leave no residual to judge by) or no points.
pub fn least_squares(views: &Views, options: &LeastSquaresOptions) -> Result<LeastSquares, ScaleError> {
    views.require(3)?;
    let system = System::new(views);
    let mut weights = vec![1.0; views.views.len()];
    let mut fit = system.fit(&weights);
    let losses: [fn(f64) -> RobustLoss; 2] =
        [|scale| RobustLoss::Huber { scale }, |scale| RobustLoss::Cauchy { scale }];
    for (loss, scale) in losses.into_iter().zip([options.huber_scale, options.cauchy_scale]) {
        for _ in 0..options.max_rounds {
            // 1.4826 turns the median of absolute Gaussian residuals into their standard deviation.
            let sigma = 1.4826 * median(fit.residuals.clone()).unwrap_or(0.0);
            if sigma <= f64::EPSILON * fit.size || !fit.ratio.is_finite() {
                break;
            }
            let loss = loss(scale * sigma);
            weights = fit.residuals.iter().map(|e| loss.evaluate(e * e)[1]).collect();
            let last = std::mem::replace(&mut fit, system.fit(&weights)).ratio;
            if (fit.ratio - last).abs() <= 1e-12 * fit.ratio.abs() {
                break;
            }
        }
    }
    Ok(fit.summary(weights))
}

/// Frames as vectors u_i = (m_i, b_i) with a_ij = u_i · (q_j, 1), and the moments of the points q_j.
struct System {
    slopes: Vec<Vector4<f64>>,
    heights: Vec<f64>,
    /// mean_j (q_j, 1)(q_j, 1)ᵀ; its last column is the mean.
    moments: Matrix4<f64>,
}

struct Fit {
    ratio: f64,
    /// Σ w, Σ w e², Σ w mean_j ã².
    sums: [f64; 3],
    mean_height: f64,
    /// e_i.
    residuals: Vec<f64>,
    /// A length to hold residuals against, for "zero up to rounding".
    size: f64,
}

impl System {
    fn new(views: &Views) -> Self {
        let count = views.points.len() as f64;
        // Measured from their centre: the second moments would else cancel for an object far from its origin.
        let center = views.points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / count;
        let moments = views.points.iter().map(|p| (p.coords - center).push(1.0)).map(|q| q * q.transpose() / count);
        let slopes = views.views.iter().map(|v| v.normal_in_object.push(v.offset(&center.into())));
        Self {
            moments: moments.sum(),
            slopes: slopes.collect(),
            heights: views.views.iter().map(|v| v.camera_height).collect(),
        }
    }

    fn fit(&self, weights: &[f64]) -> Fit {
        let total: f64 = weights.iter().sum();
        let mean_slope = self.slopes.iter().zip(weights).map(|(u, w)| u * *w).sum::<Vector4<f64>>() / total;
        let mean_height = self.heights.iter().zip(weights).map(|(h, w)| h * w).sum::<f64>() / total;
        // Per frame: h̃, mean_j ã, mean_j ã².
        let centered: Vec<[f64; 3]> = self
            .slopes
            .iter()
            .zip(&self.heights)
            .map(|(u, h)| {
                let u = u - mean_slope;
                let moved = self.moments * u;
                [h - mean_height, moved[3], u.dot(&moved).max(0.0)]
            })
            .collect();
        let sum = |term: fn(&[f64; 3]) -> f64| centered.iter().zip(weights).map(|(c, w)| w * term(c)).sum::<f64>();
        let excitation_sum = sum(|[_, _, square]| *square);
        let ratio = -sum(|[h, mean, _]| h * mean) / excitation_sum;
        let residual =
            |[h, mean, square]: &[f64; 3]| (h * h + 2.0 * ratio * h * mean + ratio * ratio * square).max(0.0).sqrt();
        let residuals: Vec<f64> = centered.iter().map(residual).collect();
        let residual_sum = residuals.iter().zip(weights).map(|(e, w)| w * e * e).sum();
        Fit {
            ratio,
            sums: [total, residual_sum, excitation_sum],
            mean_height: -(self.moments * mean_slope)[3],
            residuals,
            size: mean_height.abs(),
        }
    }
}

impl Fit {
    fn summary(&self, weights: Vec<f64>) -> LeastSquares {
        let [total, residual_sum, excitation_sum] = self.sums;
        let n = weights.len() as f64;
        let variance = residual_sum / total * n / (n - 2.0);
        LeastSquares {
            ratio: self.ratio,
            std: (variance / excitation_sum).sqrt(),
            residual_std: variance.sqrt(),
            excitation: (excitation_sum / total).sqrt(),
            mean_height: self.mean_height,
            weights,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{Drive, Noise, Options, Terrain, drive};

    fn solve(world: &Drive) -> LeastSquares {
        let views = Views::new(&world.background, &world.object, &world.planes);
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
            assert!(found.std < 1e-6 * found.ratio);
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
            assert!(found.weights.iter().any(|w| *w < 0.3) && found.weights.iter().all(|w| *w <= 1.0));
        }
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
}
