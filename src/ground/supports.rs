//! Numbers of points on planes of one inclination, for many heights at once (eq. 5 of `docs/maths/ground.md`).
//!
//! What a place adds is a parabola in the height between two heights, and nothing beyond. A sum of parabolas is one, so
//! that one pass through the places serves all heights: each adds its coefficients at the first height that it
//! supports, and takes them back behind the last.

use super::trajectory_plane::{Fit, Track};
use crate::scene::FrameId;

/// One sight of a point, as a plane of a given inclination asks for it.
struct SupportObservation {
    frame: FrameId,
    /// The height of the camera over a plane through it.
    height: f64,
    /// Maximum distance from the plane.
    tolerance: f64,
    /// Weight where it lies on the plane.
    weight: f64,
}

/// The places of many points.
pub(super) struct Supports(Vec<SupportObservation>);

impl Supports {
    pub(super) fn new<'a>(tracks: impl IntoIterator<Item = &'a Track>, fit: &Fit) -> Self {
        let slope = fit.slope();
        let of_track = |track: &'a Track| {
            let slope = &slope;
            let share = 1.0 / track.places.len() as f64;
            track.places.iter().map(move |place| SupportObservation {
                frame: place.frame,
                height: -slope(&place.at),
                tolerance: place.tolerance,
                weight: share * place.sureness,
            })
        };
        Self(tracks.into_iter().flat_map(of_track).collect())
    }

    /// The support of each of some ascending heights, where the camera's height is `course` times as much: a positive
    /// factor by frame.
    pub(super) fn supports(&self, heights: &[f64], course: impl Fn(FrameId) -> f64) -> Vec<f64> {
        let Some(&middle) = heights.get(heights.len() / 2) else { return Vec::new() };
        let mut changes = vec![[0.0; 3]; heights.len() + 1];
        for place in &self.0 {
            let factor = course(place.frame);
            let (at, reach) = (place.height / factor, place.tolerance / factor);
            let first = heights.partition_point(|height| *height <= at - reach);
            let end = first + heights[first..].partition_point(|height| *height < at + reach);
            if first < end {
                // In heights over the middle one, so that little is lost where parabolas are taken back.
                let (at, curvature) = (at - middle, place.weight / (reach * reach));
                let terms = [place.weight - curvature * at * at, 2.0 * curvature * at, -curvature];
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
    use crate::ground::trajectory_plane::Place;
    use crate::math::seeded_rng;
    use nalgebra::{Matrix3, Vector3};
    use rand::Rng as _;

    #[test]
    fn all_heights_at_once_are_supported_as_each_by_itself() {
        let mut rng = seeded_rng(4, 0);
        let fit = Fit { height: 1.5, roll: 0.02, pitch: -0.01, covariance: Matrix3::zeros() };
        let mut track = |k: u32| {
            let mut place = |frame: u32, tolerance: f64| {
                let at = Vector3::new(rng.random_range(-2.5..-0.5), rng.random_range(-4.0..4.0), 9.0);
                Place { at, frame: FrameId(frame), tolerance, std: 0.02, sureness: 0.5 + tolerance }
            };
            Track { places: vec![place(k, 0.3), place(k + 1, 0.05)] }
        };
        let tracks: Vec<Track> = (0..200).map(&mut track).collect();
        let heights: Vec<f64> = (0..40).map(|k| 0.75 + 0.05 * f64::from(k)).collect();
        let course = |frame: FrameId| 1.0 + 0.002 * f64::from(frame.0);
        let found = Supports::new(&tracks, &fit).supports(&heights, course);
        for (height, found) in heights.iter().zip(&found) {
            let slope = fit.slope();
            let one = |track: &Track| track.score(&slope, |frame| height * course(frame)).0;
            let expected: f64 = tracks.iter().map(one).sum();
            assert!((found - expected).abs() < 1e-9, "{height}: {found} {expected}");
        }
        assert!(found.iter().any(|support| *support > 3.0));
        assert!(Supports::new(&tracks, &fit).supports(&[], course).is_empty());
    }
}
