//! Motion of a vehicle relative to the camera, regressed on the camera's own: motion state and scale ratio of a
//! stationary vehicle.
//!
//! With the camera centers cᵢ and the vehicle's positions pᵢ at the estimated scale ratio r̂, both in the background's
//! frame,
//!
//! ```text
//! pᵢ − cᵢ = a − s cᵢ + eᵢ,    s = (1 − v) r̂ / r
//! ```
//!
//! for a vehicle that moves at v times the camera's velocity, r the true ratio. A stationary vehicle has s = r̂ / r: 1
//! within the error of r̂ and that of s, and its ratio is r̂ / s. For a moving vehicle v has Cauchy's distribution,
//! that of the ratio of two equal normal velocities. The ratio of both likelihoods decides. Derivation and figures:
//! docs/maths/motion.md, section *Moving or stationary trajectory*.

use std::f64::consts::PI;

use nalgebra::Vector3;

use super::smoother::DRIFT;
use crate::math::student_4;
use crate::scene::{CameraPathRatio, ImageId, ObjectPose, Reconstruction, ScaleEstimate, ScaleShares};

/// Fewest positions that show a motion, as for the smoother.
const MIN_POSITIONS: usize = 4;
/// Unknowns of the regression: s and a.
const UNKNOWNS: f64 = 4.0;
/// Relative standard deviation of s beyond which it says nothing about the ratio, as for the methods of the verdict.
const MAX_RELATIVE_STD: f64 = 0.5;

/// Slope s of the vehicle's displacement relative to the camera over the camera's own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RelativeMotion {
    /// The slope s.
    pub slope: f64,
    /// Its standard deviation: residuals are errors of the model that persist, so that they count as a single one, and
    /// drift that no residual shows is added.
    pub std: f64,
    /// RMS of the residuals, as a share of the distance to the camera.
    pub residual: f64,
}

impl RelativeMotion {
    /// Regression over the positions of a vehicle; `None` for fewer than four, or a camera that does not move.
    pub fn of(poses: &[ObjectPose], background: &Reconstruction) -> Option<Self> {
        let sight = |pose: &ObjectPose| {
            let center = background.images.get(&ImageId::from(pose.frame))?.cam_from_world.center().coords;
            let relative = Vector3::from(pose.position) - center;
            let weight = relative.norm_squared().recip();
            (weight.is_finite() && center.norm_squared().is_finite()).then_some((weight, center, relative))
        };
        let sights: Vec<(f64, Vector3<f64>, Vector3<f64>)> = poses.iter().filter_map(sight).collect();
        (sights.len() >= MIN_POSITIONS).then(|| regression(&sights))?
    }

    /// Likelihood of a moving vehicle over that of a stationary one.
    ///
    /// * `ratio_std` – relative standard deviation of the scale ratio. It comes from a jackknife over five groups, so
    ///   that the error has Student's distribution with four degrees of freedom.
    pub fn odds_of_motion(&self, ratio_std: f64) -> f64 {
        let std = ratio_std.hypot(self.std);
        let off = 1.0 - self.slope;
        let stationary = student_4(off / std) / std;
        let spread = 1.0 + std;
        let moving = (PI * spread * (1.0 + (off / spread).powi(2))).recip();
        moving / stationary.max(f64::MIN_POSITIVE)
    }

    /// The scale estimate of a vehicle that is known to be stationary: mean of its ratio and that by the camera path,
    /// by inverse variances of the logarithms. `None` where the camera path does not determine the ratio.
    ///
    /// * `accepted` – largest relative standard deviation of a determined ratio.
    pub fn constrained(&self, scale: &ScaleEstimate, accepted: f64) -> Option<ScaleEstimate> {
        let own = self.std / self.slope;
        if !(self.slope > 0.0 && own < MAX_RELATIVE_STD) {
            return None;
        }
        let other = scale.std.map(|std| std / scale.ratio).filter(|std| std.is_finite());
        let weight = other.map_or(1.0, |other| other * other / (other * other + own * own));
        let ratio = scale.ratio * (-weight * self.slope.ln()).exp();
        let shares = scaled(&scale.shares.unwrap_or_default(), 1.0 - weight);
        let shares = ScaleShares { frames: shares.frames.hypot(weight * own), ..shares };
        let by_path = scale.ratio / self.slope;
        let camera_path = CameraPathRatio {
            ratio: by_path,
            std: own * by_path,
            residual: self.residual,
            ratio_without: scale.ratio,
            std_without: scale.std,
            degenerate_without: scale.degenerate,
        };
        let degenerate = scale.degenerate && !(shares.total() <= accepted);
        Some(ScaleEstimate {
            ratio,
            std: Some(shares.total() * ratio),
            degenerate,
            reason: scale.reason.clone().filter(|_| degenerate),
            shares: Some(shares),
            camera_path: Some(camera_path),
            ..scale.clone()
        })
    }
}

/// Weighted regression of the relative displacement on the camera's.
///
/// * `sights` – weight, camera center, and vehicle relative to it. Weights are inverse squares of distances, since
///   errors of positions are proportional to them.
fn regression(sights: &[(f64, Vector3<f64>, Vector3<f64>)]) -> Option<RelativeMotion> {
    let total: f64 = sights.iter().map(|(weight, ..)| weight).sum();
    let center = sights.iter().map(|(weight, c, _)| *weight * c).sum::<Vector3<f64>>() / total;
    let relative = sights.iter().map(|(weight, _, u)| *weight * u).sum::<Vector3<f64>>() / total;
    let sum = |of: &dyn Fn(Vector3<f64>, Vector3<f64>) -> f64| {
        sights.iter().map(|(weight, c, u)| weight * of(c - center, u - relative)).sum::<f64>() / total
    };
    let spread = sum(&|c, _| c.norm_squared());
    let slope = -sum(&|c, u| c.dot(&u)) / spread;
    let num = sights.len() as f64;
    let freedom = 3.0 * num / (3.0 * num - UNKNOWNS);
    let squares = freedom * sum(&|c, u| (u + slope * c).norm_squared());
    // Weights are inverse squares of distances, so that num / total is the weighted mean of those squares.
    let distance_squared = num / total;
    let std = ((squares + DRIFT * DRIFT * distance_squared) / spread).sqrt();
    let residual = (squares / distance_squared).sqrt();
    let is_finite = slope.is_finite() && std.is_finite() && residual.is_finite();
    is_finite.then_some(RelativeMotion { slope, std, residual })
}

fn scaled(shares: &ScaleShares, factor: f64) -> ScaleShares {
    let ScaleShares { frames, plane, contact, focal, disagreement } = *shares;
    let [frames, plane, contact, focal, disagreement] =
        [frames, plane, contact, focal, disagreement].map(|share| factor * share);
    ScaleShares { frames, plane, contact, focal, disagreement }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{FrameId, ScaleMethod};
    use crate::synthetic::drive::{self, Drive, drive};
    use crate::trajectory::assemble::poses;

    /// Relative motion in a drive, with a ratio that is off by a factor.
    fn found(speed_m_s: f64, factor: f64) -> RelativeMotion {
        let Drive { background, object, frames, ratio, .. } =
            drive(&drive::Options { speed_m_s, ..drive::Options::default() }, 3);
        RelativeMotion::of(&poses(&background, &object, factor * ratio, &frames), &background).unwrap()
    }

    #[test]
    fn a_stationary_vehicle_has_its_ratio_from_the_camera_path() {
        for factor in [1.0, 1.3, 0.6] {
            let motion = found(0.0, factor);
            assert!((motion.slope - factor).abs() < 1e-9 && motion.residual < 1e-9, "{motion:?}");
            let scale = ScaleEstimate { std: Some(factor * 0.1), ..ScaleEstimate::new(factor, ScaleMethod::Joint) };
            let constrained = motion.constrained(&scale, 0.1).unwrap();
            let std = constrained.std.unwrap();
            assert!((constrained.ratio - 1.0).abs() < std && std < 0.02, "{constrained:?}");
            assert!((constrained.shares.unwrap().total() / (std / constrained.ratio) - 1.0).abs() < 1e-12);
            let path = constrained.camera_path.unwrap();
            assert!((path.ratio - 1.0).abs() < 1e-9 && path.ratio_without == factor, "{path:?}");
        }
    }

    #[test]
    fn odds_tell_moving_from_stationary_vehicles_as_far_as_the_ratio_allows() {
        assert!(found(0.0, 1.05).odds_of_motion(0.05) < 0.2);
        // More than three standard deviations off, as a parked car before a dashcam was: the ratio may be wrong.
        assert!((0.2..5.0).contains(&found(0.0, 0.83).odds_of_motion(0.05)));
        for slope in [-0.5, 0.1, 2.0] {
            let motion = RelativeMotion { slope, std: 0.05, residual: 0.01 };
            assert!(motion.odds_of_motion(0.1) > 5.0, "{slope}");
            let odds = motion.odds_of_motion(5.0);
            assert!((0.2..5.0).contains(&odds), "{odds}");
        }
    }

    #[test]
    fn a_hovering_camera_and_few_positions_show_nothing() {
        let Drive { background, object, frames, ratio, .. } = drive(&drive::Options::default(), 3);
        let all = poses(&background, &object, ratio, &frames);
        assert_eq!(RelativeMotion::of(&all[..3], &background), None);
        let same: Vec<ObjectPose> = all.iter().map(|pose| ObjectPose { frame: FrameId(0), ..pose.clone() }).collect();
        assert!(RelativeMotion::of(&same, &background).is_none_or(|motion| motion.std > 1e3));
    }
}
