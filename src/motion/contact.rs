//! Odds that an object moves along the camera's path (eq. 14 to 16 of `docs/maths/motion.md`).
//!
//! An object that moves parallel to the camera, at a constant ratio of speeds, has the same images as a stationary
//! object of another size at another distance: residuals do not distinguish them, only the ground does. A stationary
//! object is in contact with the ground at its own depth. The static points of an oncoming object are above the ground,
//! those of one ahead behind it. Both hypotheses are compared by their likelihoods, so a short baseline or a distant
//! object gives no decision.

use std::f64::consts::PI;

use super::classify::{GROUND_TOLERANCE, HORIZON};
use super::{GroundModel, StaticPoint, View};
use crate::math::{median, quantile};

/// Depth of the ground at an object's lower edge, relative to that of the static point above it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContactDepth {
    /// Inverse depth of the static point over that of the ground at the lower edge of the object below it.
    ///
    /// It is 1 for a stationary object that is visible down to the ground, smaller behind the ground, larger above it.
    pub ratio: f64,
    /// Standard deviation of the ratio by the noise of the track.
    pub std: f64,
    /// Maximum relative error of the ground's inverse depth.
    pub tolerance: f64,
    /// True if the lower image border truncates the object, so any part of it may be hidden.
    pub is_truncated: bool,
}

impl GroundModel {
    /// Contact depth of an object below one of its points.
    ///
    /// * `pixel` – lower edge of the object below the point, in the frame of `point`.
    ///
    /// `None` where the ray does not intersect the ground, or beyond the distance at which points differ from the sky.
    pub fn contact_depth(
        &self,
        view: &View,
        pixel: [f64; 2],
        is_truncated: bool,
        point: &StaticPoint,
    ) -> Option<ContactDepth> {
        let ray = view.camera.normalized_from_pixel(pixel.into()).push(1.0);
        let ground = self.inverse_depth(&view.cam_from_world, ray)?;
        let heights = 1.0 / (ground * self.camera_height(&view.cam_from_world)?);
        let contact = ContactDepth {
            ratio: point.inverse_depth / ground,
            std: point.std / ground,
            tolerance: GROUND_TOLERANCE + heights / HORIZON,
            is_truncated,
        };
        let is_usable = ground > 0.0 && heights < HORIZON && contact.ratio.is_finite() && contact.std.is_finite();
        is_usable.then_some(contact)
    }
}

/// Minimum number of points with a contact depth: fewer may all be on the roof.
const MIN_CONTACTS: usize = 5;
/// Maximum occluded share of its height, from below, of an object that the image border does not truncate.
const MAX_OCCLUDED: f64 = 0.5;
/// Number of occluded shares over which the likelihoods are averaged.
const NUM_OCCLUDED_SHARES: usize = 16;
/// Softness of the ends of the uniform density, as a share of its half-width: a tolerance is itself known to a quarter.
const SOFTNESS: f64 = 0.25;
/// Quantile of the heights of the points that is the top of the object.
const TOP: f64 = 0.9;

/// Medians of the contact depths of an object, and the height of its top.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct ContactEvidence {
    contact: ContactDepth,
    /// Height of the top over the ground if the object is stationary, in heights of the camera.
    top: f64,
}

impl ContactEvidence {
    /// Medians of all contact depths; `None` for fewer than five.
    ///
    /// * `heights` – known heights of the points over the ground, in heights of the camera.
    pub(super) fn of(contacts: &[ContactDepth], mut heights: Vec<f64>) -> Option<Self> {
        if contacts.len() < MIN_CONTACTS {
            return None;
        }
        let median_of = |of: fn(&ContactDepth) -> f64| median(contacts.iter().map(of).collect());
        let num_truncated = contacts.iter().filter(|contact| contact.is_truncated).count();
        let contact = ContactDepth {
            ratio: median_of(|contact| contact.ratio)?,
            std: median_of(|contact| contact.std)?,
            tolerance: median_of(|contact| contact.tolerance)?,
            is_truncated: 2 * num_truncated > contacts.len(),
        };
        // Without a known depth the top may be as high as the camera.
        let top = quantile(&mut heights, TOP).unwrap_or(1.0).max(0.0);
        let lowest = if contact.ratio > 1.0 { 1.0 - 1.0 / contact.ratio } else { 0.0 };
        Some(Self { contact, top: top.max(lowest) })
    }

    /// Returns true if the static points are above the ground rather than behind it.
    pub(super) fn floats(&self) -> bool {
        self.contact.ratio > 1.0
    }

    /// Likelihood ratio of motion along the camera's path over a stationary object.
    pub(super) fn odds_of_motion(&self) -> f64 {
        let mean = |likelihood: &dyn Fn(f64) -> f64| {
            self.occluded_shares().map(likelihood).sum::<f64>() / NUM_OCCLUDED_SHARES as f64
        };
        let moving = mean(&|occluded| self.likelihood_moving(occluded));
        let stationary = mean(&|occluded| self.likelihood_stationary(occluded));
        moving / stationary.max(f64::MIN_POSITIVE)
    }

    /// Equally likely occluded shares of the object's height, from below; most are small.
    fn occluded_shares(&self) -> impl Iterator<Item = f64> + use<> {
        let most = if self.contact.is_truncated { 1.0 } else { MAX_OCCLUDED };
        (0..NUM_OCCLUDED_SHARES).map(move |k| most * ((k as f64 + 0.5) / NUM_OCCLUDED_SHARES as f64).powi(3))
    }

    /// Density of the ratio for a stationary object.
    ///
    /// It is uniform within the ground's tolerance around the ratio of the lowest visible height, softened by the
    /// noise.
    fn likelihood_stationary(&self, occluded: f64) -> f64 {
        let lowest = occluded * self.top;
        if lowest >= 1.0 {
            return 0.0;
        }
        let expected = 1.0 / (1.0 - lowest);
        let width = self.contact.tolerance * expected;
        let std = self.contact.std.max(SOFTNESS * width);
        let below = |limit: f64| 1.0 / (1.0 + (-LOGISTIC * (self.contact.ratio - expected + limit) / std).exp());
        (below(width) - below(-width)) / (2.0 * width)
    }

    /// Density of the ratio for an object that moves along the camera's path.
    ///
    /// The ratio of two velocities with equal normal distributions has the Cauchy distribution; noise widens it.
    fn likelihood_moving(&self, occluded: f64) -> f64 {
        let ContactDepth { ratio, std, tolerance, .. } = self.contact;
        let scale = 1.0 - occluded * ratio * (1.0 - self.top);
        // One minus the ratio of velocities, and its derivative by the observed ratio.
        let relative = (1.0 - occluded) * ratio / scale;
        let slope = (1.0 - occluded) / (scale * scale);
        let spread = 1.0 + slope * (std + tolerance * ratio.abs());
        slope / (PI * spread * (1.0 + ((1.0 - relative) / spread).powi(2)))
    }
}

/// Scale at which the logistic function is closest to the normal distribution function.
const LOGISTIC: f64 = 1.702;

#[cfg(test)]
mod tests {
    use super::*;

    /// Odds of motion of a car 1.5 m high, with tracks whose inverse depth has a relative σ of 3 %.
    ///
    /// * `camera_m` – height of the camera.
    /// * `speed` – speed of the car over that of the camera; negative for an oncoming car.
    /// * `hidden_m` – height of the lowest visible part.
    fn odds(camera_m: f64, distance_m: f64, speed: f64, hidden_m: f64) -> f64 {
        let [lowest, top] = [hidden_m / camera_m, 1.5 / camera_m];
        // A static object that explains the tracks is 1 / (1 − speed) times as far away and as large.
        let ratio = (1.0 - speed) / (1.0 - lowest);
        let apparent_top = 1.0 - (1.0 - top) / (1.0 - speed);
        let tolerance = GROUND_TOLERANCE + distance_m / camera_m / HORIZON;
        let contact = ContactDepth { ratio, std: 0.03 * ratio, tolerance, is_truncated: false };
        ContactEvidence::of(&[contact; MIN_CONTACTS], vec![apparent_top; MIN_CONTACTS]).unwrap().odds_of_motion()
    }

    #[test]
    fn near_cars_are_distinguished_by_their_contact_and_far_ones_are_not() {
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
