//! Odds that an object moves along the camera's path (eq. 14 to 16 of `docs/maths/motion.md`).
//!
//! An object that moves parallel to the camera, at a constant ratio of speeds, is seen exactly as a stationary one of
//! another size at another distance: no residual tells them apart. Only the ground does. A stationary object meets the
//! ground at its own depth; an oncoming one would float over it, one ahead would lie behind it. Both hypotheses are
//! compared by their likelihoods, so that a short baseline or a distant object leaves the question open.

use std::f64::consts::PI;

use super::classify::{GROUND_TOLERANCE, HORIZON};
use super::{GroundModel, StaticPoint, View};
use crate::math::{median, quantile};

/// Depth of the ground below a point of an object, relative to the depth of the static point that explains its track.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactDepth {
    /// Inverse depth of the static point over that of the ground where the object ends below it: 1 for a stationary
    /// object that is seen down to the ground, less behind the ground, more over it.
    pub ratio: f64,
    /// Standard deviation by the noise of the track.
    pub std: f64,
    /// Share by which the ground's inverse depth may be wrong.
    pub tolerance: f64,
    /// True if the object is truncated by the lower image border, so that any part of it may be hidden.
    pub is_cut: bool,
}

impl GroundModel {
    /// Foot of an object below one of its points.
    ///
    /// * `pixel` – where the object ends below the point, in the frame of `point`.
    ///
    /// `None` where the ray meets no ground within the distances at which a vehicle differs from the sky.
    pub fn foot(&self, view: &View, pixel: [f64; 2], is_cut: bool, point: &StaticPoint) -> Option<ContactDepth> {
        let ray = view.camera.normalized_from_pixel(pixel.into()).push(1.0);
        let ground = self.inverse_depth(&view.cam_from_world, ray)?;
        let heights = 1.0 / (ground * self.camera_height(&view.cam_from_world)?);
        let foot = ContactDepth {
            ratio: point.inverse_depth / ground,
            std: point.std / ground,
            tolerance: GROUND_TOLERANCE + heights / HORIZON,
            is_cut,
        };
        let is_usable = ground > 0.0 && heights < HORIZON && foot.ratio.is_finite() && foot.std.is_finite();
        is_usable.then_some(foot)
    }
}

/// Fewest points whose feet are compared: fewer may all lie on a roof.
const MIN_FEET: usize = 5;
/// Largest share of its height by which an object that is seen as a whole is hidden from below.
const MOST_HIDDEN: f64 = 0.5;
/// Shares of the height that are tried.
const NUM_SHARES: usize = 16;
/// A tolerance is a limit that is itself known to a quarter.
const SOFTNESS: f64 = 0.25;
/// Share of the points that are lower than what counts as the object's top.
const TOP: f64 = 0.9;

/// Common properties of the feet of an object, and the height of its top.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ContactEvidence {
    foot: ContactDepth,
    /// Height of the top over the ground if the object is stationary, in heights of the camera.
    top: f64,
}

impl ContactEvidence {
    /// The medians of all feet; `None` for fewer than five.
    ///
    /// * `heights` – of the points over the ground, in heights of the camera, where they are known.
    pub(super) fn of(feet: &[ContactDepth], mut heights: Vec<f64>) -> Option<Self> {
        if feet.len() < MIN_FEET {
            return None;
        }
        let middle = |of: fn(&ContactDepth) -> f64| median(feet.iter().map(of).collect());
        let num_cut = feet.iter().filter(|foot| foot.is_cut).count();
        let foot = ContactDepth {
            ratio: middle(|foot| foot.ratio)?,
            std: middle(|foot| foot.std)?,
            tolerance: middle(|foot| foot.tolerance)?,
            is_cut: 2 * num_cut > feet.len(),
        };
        // Without a known depth the top may be as high as the camera.
        let top = quantile(&mut heights, TOP).unwrap_or(1.0).max(0.0);
        let lowest = if foot.ratio > 1.0 { 1.0 - 1.0 / foot.ratio } else { 0.0 };
        Some(Self { foot, top: top.max(lowest) })
    }

    /// Returns true if the foot, if stationary, would be over the ground rather than behind it.
    pub(super) fn floats(&self) -> bool {
        self.foot.ratio > 1.0
    }

    /// Likelihood of the foot if the object moves along the camera's path over that if it is stationary.
    pub(super) fn odds_of_motion(&self) -> f64 {
        let mean =
            |likelihood: &dyn Fn(f64) -> f64| self.hidden_shares().map(likelihood).sum::<f64>() / NUM_SHARES as f64;
        let moving = mean(&|hidden| self.likelihood_moving(hidden));
        let stationary = mean(&|hidden| self.likelihood_stationary(hidden));
        moving / stationary.max(f64::MIN_POSITIVE)
    }

    /// Shares of its height by which an object may be hidden from below, all equally likely: most are hidden by little.
    fn hidden_shares(&self) -> impl Iterator<Item = f64> + use<> {
        let most = if self.foot.is_cut { 1.0 } else { MOST_HIDDEN };
        (0..NUM_SHARES).map(move |k| most * ((k as f64 + 0.5) / NUM_SHARES as f64).powi(3))
    }

    /// Density of the ratio of a stationary object: that of its lowest visible height, wrong by no more than the
    /// ground's tolerance, with the track's noise.
    fn likelihood_stationary(&self, hidden: f64) -> f64 {
        let lowest = hidden * self.top;
        if lowest >= 1.0 {
            return 0.0;
        }
        let expected = 1.0 / (1.0 - lowest);
        let width = self.foot.tolerance * expected;
        let std = self.foot.std.max(SOFTNESS * width);
        let below = |limit: f64| 1.0 / (1.0 + (-LOGISTIC * (self.foot.ratio - expected + limit) / std).exp());
        (below(width) - below(-width)) / (2.0 * width)
    }

    /// Density of the ratio of an object that moves along the camera's path. The ratio of two velocities that are
    /// normally distributed alike has Cauchy's distribution; noise makes it wider.
    fn likelihood_moving(&self, hidden: f64) -> f64 {
        let ContactDepth { ratio, std, tolerance, .. } = self.foot;
        let scale = 1.0 - hidden * ratio * (1.0 - self.top);
        // One minus the ratio of velocities, and its derivative by the ratio that is observed.
        let relative = (1.0 - hidden) * ratio / scale;
        let slope = (1.0 - hidden) / (scale * scale);
        let spread = 1.0 + slope * (std + tolerance * ratio.abs());
        slope / (PI * spread * (1.0 + ((1.0 - relative) / spread).powi(2)))
    }
}

/// Factor with which the logistic function is nearest to the normal distribution's.
const LOGISTIC: f64 = 1.702;

#[cfg(test)]
mod tests {
    use super::*;

    /// Odds of motion of a car 1.5 m high at a distance, with tracks good to 3 % of the inverse depth.
    ///
    /// * `camera_m` – height of the camera.
    /// * `speed` – its speed over the camera's; negative for an oncoming one.
    /// * `hidden_m` – height of its lowest visible part.
    fn odds(camera_m: f64, distance_m: f64, speed: f64, hidden_m: f64) -> f64 {
        let [lowest, top] = [hidden_m / camera_m, 1.5 / camera_m];
        // A static object that explains the tracks is 1 / (1 − speed) times as far away and as large.
        let ratio = (1.0 - speed) / (1.0 - lowest);
        let apparent_top = 1.0 - (1.0 - top) / (1.0 - speed);
        let tolerance = GROUND_TOLERANCE + distance_m / camera_m / HORIZON;
        let foot = ContactDepth { ratio, std: 0.03 * ratio, tolerance, is_cut: false };
        ContactEvidence::of(&[foot; MIN_FEET], vec![apparent_top; MIN_FEET]).unwrap().odds_of_motion()
    }

    #[test]
    fn near_cars_are_told_apart_by_their_feet_and_far_ones_are_not() {
        for camera_m in [1.2, 1.65] {
            for hidden_m in [0.0, 0.25] {
                let parked = odds(camera_m, 10.0, 0.0, hidden_m);
                assert!(parked < 0.5, "{camera_m} {hidden_m}: {parked}");
            }
            assert!(odds(camera_m, 10.0, 0.8, 0.0) > 5.0);
            assert!((0.1..5.0).contains(&odds(camera_m, 30.0, 0.3, 0.0)));
        }
    }

    /// Table of docs/maths/motion.md.
    #[test]
    #[ignore = "prints figures"]
    fn print_odds() {
        for (camera_m, distance_m) in [(1.2, 10.0), (1.65, 10.0), (1.2, 30.0), (1.65, 30.0), (20.0, 30.0)] {
            let of = |speed: f64, hidden_m: f64| format!("{:.2}", odds(camera_m, distance_m, speed, hidden_m));
            let speeds = [0.0, -1.0, -0.5, 0.25, 0.45, 0.8].map(|speed| of(speed, 0.0)).join(" | ");
            println!("| {camera_m} m, {distance_m} m | {} | {speeds} |", of(0.0, 0.25));
        }
    }
}
