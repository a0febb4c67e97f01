//! Support of parallel planes by points, for many heights at once (eq. 5 of `docs/maths/ground.md`).
//!
//! The score of an observation is a parabola in the height between two limits, and 0 beyond. A sum of parabolas is a
//! parabola, so one pass over the observations serves all heights: each adds its coefficients at the first height that
//! it supports, and subtracts them after the last.

use super::trajectory_plane::{Fit, Track};
use crate::scene::FrameId;

/// Observation of a point in relation to planes of one inclination.
struct SupportObservation {
    frame: FrameId,
    /// Height of the camera over the plane through the point.
    height: f64,
    /// Maximum distance of an inlier from the plane.
    tolerance: f64,
    /// Score at zero distance.
    weight: f64,
}

/// Observations of many points.
pub(super) struct Supports(Vec<SupportObservation>);

impl Supports {
    pub(super) fn new<'a>(tracks: impl IntoIterator<Item = &'a Track>, fit: &Fit) -> Self {
        let along_normal = fit.along_normal();
        let of_track = |track: &'a Track| {
            let along_normal = &along_normal;
            let share = 1.0 / track.observations.len() as f64;
            track.observations.iter().map(move |observation| SupportObservation {
                frame: observation.frame,
                height: -along_normal(&observation.at),
                tolerance: observation.tolerance,
                weight: share * observation.certainty,
            })
        };
        Self(tracks.into_iter().flat_map(of_track).collect())
    }

    /// Returns the support at each of the heights, which must ascend.
    ///
    /// * `profile` – positive factor on the camera's height by frame.
    pub(super) fn at_heights(&self, heights: &[f64], profile: impl Fn(FrameId) -> f64) -> Vec<f64> {
        let Some(&middle) = heights.get(heights.len() / 2) else { return Vec::new() };
        let mut changes = vec![[0.0; 3]; heights.len() + 1];
        for observation in &self.0 {
            let factor = profile(observation.frame);
            let (at, reach) = (observation.height / factor, observation.tolerance / factor);
            let first = heights.partition_point(|height| *height <= at - reach);
            let end = first + heights[first..].partition_point(|height| *height < at + reach);
            if first < end {
                // Relative to the middle height, which limits the cancellation where coefficients are subtracted.
                let (at, curvature) = (at - middle, observation.weight / (reach * reach));
                let terms = [observation.weight - curvature * at * at, 2.0 * curvature * at, -curvature];
                (0..3).for_each(|k| changes[first][k] += terms[k]);
                (0..3).for_each(|k| changes[end][k] -= terms[k]);
            }
        }
        let mut sum = [0.0; 3];
        let values = heights.iter().zip(&changes).map(|(height, change)| {
            (0..3).for_each(|k| sum[k] += change[k]);
            let x = height - middle;
            sum[0] + x * (sum[1] + x * sum[2])
        });
        values.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ground::trajectory_plane::TrackObservation;
    use crate::math::seeded_rng;
    use nalgebra::{Matrix3, Vector3};
    use rand::Rng as _;

    #[test]
    fn support_of_all_heights_equals_that_of_each_height() {
        let mut rng = seeded_rng(4, 0);
        let fit = Fit { height: 1.5, roll: 0.02, pitch: -0.01, covariance: Matrix3::zeros() };
        let mut track = |k: u32| {
            let mut observation = |frame: u32, tolerance: f64| {
                let at = Vector3::new(rng.random_range(-2.5..-0.5), rng.random_range(-4.0..4.0), 9.0);
                TrackObservation { at, frame: FrameId(frame), tolerance, std: 0.02, certainty: 0.5 + tolerance }
            };
            Track { observations: vec![observation(k, 0.3), observation(k + 1, 0.05)] }
        };
        let tracks: Vec<Track> = (0..200).map(&mut track).collect();
        let heights: Vec<f64> = (0..40).map(|k| 0.75 + 0.05 * f64::from(k)).collect();
        let profile = |frame: FrameId| 1.0 + 0.002 * f64::from(frame.0);
        let found = Supports::new(&tracks, &fit).at_heights(&heights, profile);
        for (height, found) in heights.iter().zip(&found) {
            let along_normal = fit.along_normal();
            let one = |track: &Track| track.score(&along_normal, |frame| height * profile(frame)).0;
            let expected: f64 = tracks.iter().map(one).sum();
            assert!((found - expected).abs() < 1e-9, "{height}: {found} {expected}");
        }
        assert!(found.iter().any(|support| *support > 3.0));
        assert!(Supports::new(&tracks, &fit).at_heights(&[], profile).is_empty());
    }
}
