//! Plane parallel to a camera's motion, in the camera's own frame (eq. 15 and 16 of `docs/maths/ground.md`).

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use rand::Rng as _;

use super::Options;
use super::observations::{PointObservations, PointView};
use crate::math::Rng;
use crate::scene::FrameId;

/// Standard deviation of the roll of cameras in vehicles, which are mounted upright by hand, radians. This prior
/// distinguishes the road from a bank next to it with more points.
const ROLL_STD: f64 = 0.087;
/// Standard deviation of the angle between the direction of motion and the road, radians.
const PITCH_STD: f64 = 0.005;

/// Orthogonal axes in the camera's frame: direction of motion, up, and right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Axes {
    pub forward: Vector3<f64>,
    pub up: Vector3<f64>,
    pub right: Vector3<f64>,
}

impl Axes {
    /// Axes for a direction of motion; up is the image's up direction, orthogonalized.
    ///
    /// If the camera moves along the image's up direction, up is an arbitrary orthogonal direction.
    pub(super) fn new(forward: Vector3<f64>) -> Self {
        let image_up = -Vector3::y();
        let across = image_up - forward * forward.dot(&image_up);
        let up = across.try_normalize(1e-3).unwrap_or_else(|| forward.cross(&Vector3::x()).normalize());
        Self { forward, up, right: forward.cross(&up) }
    }
}

/// Plane along the motion: n ∝ up + roll · right + pitch · forward, and the camera's height over it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    pub height: f64,
    pub roll: f64,
    pub pitch: f64,
    /// Covariance of height, roll and pitch.
    pub covariance: Matrix3<f64>,
}

impl Fit {
    /// Signed distance of a position from the plane, positive above it.
    pub(super) fn signed_distance(&self, position: &Vector3<f64>) -> f64 {
        self.along_normal()(position) + self.height
    }

    /// Returns the function that maps a position to its coordinate along the normal, from the camera.
    pub(super) fn along_normal(&self) -> impl Fn(&Vector3<f64>) -> f64 + use<> {
        let (roll, pitch) = (self.roll, self.pitch);
        let shrink = 1.0 / (1.0 + roll * roll + pitch * pitch).sqrt();
        move |position| (position.x + roll * position.y + pitch * position.z) * shrink
    }

    /// Standard deviations of height, roll and pitch.
    pub(super) fn stds(&self) -> Vector3<f64> {
        self.covariance.diagonal().map(|variance| variance.max(0.0).sqrt())
    }
}

/// Observations of one point in the frames nearest to it.
pub(super) struct Track {
    pub observations: Vec<TrackObservation>,
}

/// Position of a point in the frame of one camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TrackObservation {
    /// Coordinates along the axes up, right and forward.
    pub at: Vector3<f64>,
    pub frame: FrameId,
    /// Maximum distance of an inlier from a plane (eq. 1).
    pub tolerance: f64,
    /// Standard deviation of its height.
    pub std: f64,
    /// Weight of its distance from a plane by its standard deviation: 1 for an exact position.
    pub certainty: f64,
}

impl Track {
    pub(super) fn new(point: &PointObservations, axes: &Axes, options: &Options) -> Option<Self> {
        let observation = |view: &PointView| {
            let (x, pixel) = (&view.in_cam.coords, view.in_cam.z / view.focal);
            // Adds the noise of the image observation, one pixel.
            let std = (point.variance_along(view, &axes.up) + pixel * pixel).sqrt();
            let tolerance = options.max_error_px * pixel;
            let certainty = 1.0 / (1.0 + (std / tolerance).powi(2));
            let at = Vector3::new(axes.up.dot(x), axes.right.dot(x), axes.forward.dot(x));
            TrackObservation { at, frame: view.frame, tolerance, std, certainty }
        };
        let observations: Vec<TrackObservation> =
            point.views.iter().map(observation).filter(|observation| observation.at.x < 0.0).collect();
        let is_finite =
            |observation: &TrackObservation| observation.tolerance.is_finite() && observation.std.is_finite();
        (!observations.is_empty() && observations.iter().all(is_finite)).then_some(Self { observations })
    }

    /// Mean MSAC score (eq. 5) on a plane, and the share of observations clearly below it.
    ///
    /// * `height` – height of the camera over the plane by frame.
    pub(super) fn score(
        &self,
        along_normal: &impl Fn(&Vector3<f64>) -> f64,
        height: impl Fn(FrameId) -> f64,
    ) -> (f64, f64) {
        let each = self.observations.iter().map(|observation| {
            let distance = (along_normal(&observation.at) + height(observation.frame)) / observation.tolerance;
            (observation.certainty * (1.0 - distance * distance).max(0.0), f64::from(distance < -3.0))
        });
        let (support, below) = each.fold((0.0, 0.0), |sum, (a, b)| (sum.0 + a, sum.1 + b));
        let count = self.observations.len() as f64;
        (support / count, below / count)
    }

    /// Maximum of [`Self::score`].
    fn max_score(&self) -> f64 {
        self.observations.iter().map(|observation| observation.certainty).sum::<f64>() / self.observations.len() as f64
    }

    /// Tukey weight of the point, from the mean of its distances in tolerances.
    pub(super) fn tukey_weight(&self, fit: &Fit) -> f64 {
        let distances =
            self.observations.iter().map(|observation| fit.signed_distance(&observation.at) / observation.tolerance);
        let mean = distances.sum::<f64>() / self.observations.len() as f64;
        (1.0 - mean * mean).max(0.0).powi(2)
    }
}

/// Plane through two random points, parallel to the motion, with the maximum score (eq. 15).
pub(super) fn best_sample(tracks: &[Track], max_samples: usize, rng: &mut Rng) -> Option<Fit> {
    if tracks.len() < 2 {
        return None;
    }
    // Upper bounds of the score of each point and those after it.
    let mut remaining: Vec<f64> = tracks.iter().map(Track::max_score).collect();
    (1..remaining.len()).rev().for_each(|k| remaining[k - 1] += remaining[k]);
    let mut best: Option<(f64, Fit)> = None;
    for _ in 0..max_samples {
        let mut draw = || tracks[rng.random_range(0..tracks.len())].observations[0].at;
        let Some(fit) = through_two(draw(), draw()) else { continue };
        let least = best.map_or(0.0, |(value, _)| value);
        if let Some(value) = score_above(tracks, &remaining, &fit, least) {
            best = Some((value, fit));
        }
    }
    best.map(|(_, fit)| fit)
}

/// Score of a plane (eq. 15); `None` as soon as it cannot exceed `least`.
///
/// * `remaining` – by point, upper bound of the score of it and those after it.
fn score_above(tracks: &[Track], remaining: &[f64], fit: &Fit, least: f64) -> Option<f64> {
    let prior = (-0.5 * (fit.roll / ROLL_STD).powi(2)).exp();
    let along_normal = fit.along_normal();
    let (mut support, mut below) = (0.0, 0.0);
    // The bound is checked once for many points, so its cost is negligible.
    for (tracks, remaining) in tracks.chunks(64).zip(remaining.chunks(64)) {
        if prior * (support - 0.5 * below + remaining[0]) <= least {
            return None;
        }
        for track in tracks {
            let (on, under) = track.score(&along_normal, |_| fit.height);
            support += on;
            below += under;
        }
    }
    Some(prior * (support - 0.5 * below)).filter(|value| *value > least)
}

/// Plane up + roll · right + height = 0 through two points.
fn through_two(a: Vector3<f64>, b: Vector3<f64>) -> Option<Fit> {
    let solution = Matrix2::new(a.y, 1.0, b.y, 1.0).try_inverse()? * Vector2::new(-a.x, -b.x);
    let (roll, slant) = (solution.x, solution.y);
    let height = slant / (1.0 + roll * roll).sqrt();
    let is_usable = height > 0.0 && height.is_finite() && roll.abs() < 1.0;
    is_usable.then(|| Fit { height, roll, pitch: 0.0, covariance: Matrix3::zeros() })
}

/// Weighted least squares on height, roll and pitch, with priors on the two angles (eq. 16).
pub(super) fn refined(tracks: &[Track], start: Fit) -> Option<Fit> {
    let mut fit = start;
    for _ in 0..20 {
        let (mut information, mut right_side, mut squares, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0.0, 0.0);
        for track in tracks {
            let of_track = track.tukey_weight(&fit);
            let weight = of_track / track.observations.len() as f64;
            for TrackObservation { at, std, .. } in &track.observations {
                let row = Vector3::new(1.0, at.y, at.z);
                let of_place = weight / (std * std);
                information += row * row.transpose() * of_place;
                right_side -= row * (at.x * of_place);
                squares += weight * (fit.signed_distance(at) / std).powi(2);
            }
            count += of_track;
        }
        // Residuals exceed the noise, since roads are not planar.
        let excess = (squares / (count - 3.0).max(1.0)).max(1.0);
        let prior = Vector3::new(0.0, ROLL_STD.powi(-2), PITCH_STD.powi(-2));
        let covariance = (information / excess + Matrix3::from_diagonal(&prior)).try_inverse()?;
        let solution = covariance * (right_side / excess);
        let next = Fit { height: solution.x, roll: solution.y, pitch: solution.z, covariance };
        let has_converged = (next.height - fit.height).abs() < 1e-9 * fit.height.abs();
        fit = next;
        if has_converged {
            break;
        }
    }
    let numbers = [fit.height, fit.roll, fit.pitch, fit.covariance.sum()];
    (fit.height > 0.0 && numbers.iter().all(|x| x.is_finite())).then_some(fit)
}
