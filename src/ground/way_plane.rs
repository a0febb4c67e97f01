//! A plane along the way of a camera, in the camera's own frame (eq. 15 and 16 of `docs/maths/ground.md`).

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use rand::Rng as _;

use super::Options;
use super::sighting::Sighting;
use crate::math::Rng;
use crate::scene::FrameId;

/// Cameras in vehicles are mounted upright by hand: standard deviation of the roll, radians. It tells the road from the
/// slope beside it where the slope has more points.
const ROLL_STD: f64 = 0.087;
/// The way is parallel to the road: standard deviation of the angle between them, radians.
const PITCH_STD: f64 = 0.005;
/// Noise of an image position, pixels.
const NOISE_PX: f64 = 1.0;

/// Right-angled axes in the camera's frame: along its way, up, and to the right.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Axes {
    pub way: Vector3<f64>,
    pub up: Vector3<f64>,
    pub right: Vector3<f64>,
}

impl Axes {
    /// "Up" is up in the picture as far as that is across the way; a camera that looks along "up" has none.
    pub(super) fn new(way: Vector3<f64>) -> Self {
        let in_picture = -Vector3::y();
        let across = in_picture - way * way.dot(&in_picture);
        let up = across.try_normalize(1e-3).unwrap_or_else(|| way.cross(&Vector3::x()).normalize());
        Self { way, up, right: way.cross(&up) }
    }
}

/// A plane along the way: n ∝ up + roll · right + pitch · way, and the camera's height over it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Fit {
    pub height: f64,
    pub roll: f64,
    pub pitch: f64,
    /// Of height, roll and pitch.
    pub covariance: Matrix3<f64>,
}

impl Fit {
    /// How far a place lies over the plane.
    pub(super) fn over(&self, place: &Vector3<f64>) -> f64 {
        self.slope(place) + self.height
    }

    /// How far a place lies along the normal, as the camera sees it.
    pub(super) fn slope(&self, place: &Vector3<f64>) -> f64 {
        let along = place.x + self.roll * place.y + self.pitch * place.z;
        along / (1.0 + self.roll * self.roll + self.pitch * self.pitch).sqrt()
    }

    /// Standard deviations of height, roll and pitch.
    pub(super) fn stds(&self) -> Vector3<f64> {
        self.covariance.diagonal().map(|variance| variance.max(0.0).sqrt())
    }
}

/// One point, as the frames see it that are nearest to it.
pub(super) struct Track {
    /// Coordinates up, right and along the way of the camera, and the frame.
    pub places: Vec<(Vector3<f64>, FrameId)>,
    /// Up to this distance it lies on a plane (eq. 1), and the standard deviation of its height.
    tolerances: Vec<(f64, f64)>,
}

impl Track {
    pub(super) fn new(sighting: &Sighting, axes: &Axes, options: &Options) -> Option<Self> {
        let up_down = |x: &Vector3<f64>| Vector3::new(axes.up.dot(x), axes.right.dot(x), axes.way.dot(x));
        let seen: Vec<_> = sighting.views.iter().filter(|view| axes.up.dot(&view.in_cam.coords) < 0.0).collect();
        let places = seen.iter().map(|view| (up_down(&view.in_cam.coords), view.frame)).collect();
        let tolerances = seen.iter().map(|view| {
            let pixel = view.in_cam.z / view.focal;
            let own_var = sighting.variance_along(view, &axes.up) * NOISE_PX * NOISE_PX;
            (options.max_error_px * pixel, (own_var + pixel * pixel * NOISE_PX * NOISE_PX).sqrt())
        });
        let tolerances: Vec<_> = tolerances.collect();
        let is_usable = !seen.is_empty() && tolerances.iter().all(|(a, b)| a.is_finite() && b.is_finite());
        is_usable.then_some(Self { places, tolerances })
    }

    /// Mean of the scores of MSAC (eq. 5), and the share of places plainly below, of a plane whose height may differ
    /// from frame to frame.
    pub(super) fn score(&self, fit: &Fit, height: impl Fn(FrameId) -> f64) -> (f64, f64) {
        let each = self.places.iter().zip(&self.tolerances).map(|((place, frame), (tolerance, std))| {
            let off = (fit.over(place) - fit.height + height(*frame)) / tolerance;
            let sureness = 1.0 / (1.0 + (std / tolerance).powi(2));
            (sureness * (1.0 - off * off).max(0.0), f64::from(off < -3.0))
        });
        let (support, below) = each.fold((0.0, 0.0), |sum, (a, b)| (sum.0 + a, sum.1 + b));
        let count = self.places.len() as f64;
        (support / count, below / count)
    }

    /// Tukey's weight of the point, from the mean of its distances in tolerances.
    pub(super) fn weight_on(&self, fit: &Fit) -> f64 {
        let off =
            self.places.iter().zip(&self.tolerances).map(|((place, _), (tolerance, _))| fit.over(place) / tolerance);
        let mean = off.sum::<f64>() / self.places.len() as f64;
        (1.0 - mean * mean).max(0.0).powi(2)
    }
}

/// The plane through two points, parallel to the way, that the most points lie on and the fewest below (eq. 15).
pub(super) fn best_sample(tracks: &[Track], max_samples: usize, rng: &mut Rng) -> Option<Fit> {
    if tracks.len() < 2 {
        return None;
    }
    let mut best: Option<(f64, Fit)> = None;
    for _ in 0..max_samples {
        let mut draw = || tracks[rng.random_range(0..tracks.len())].places[0].0;
        let Some(fit) = through_two(draw(), draw()) else { continue };
        let sums = tracks
            .iter()
            .map(|track| track.score(&fit, |_| fit.height))
            .fold((0.0, 0.0), |s, t| (s.0 + t.0, s.1 + t.1));
        let prior = (-0.5 * (fit.roll / ROLL_STD).powi(2)).exp();
        let value = prior * (sums.0 - 0.5 * sums.1);
        if value > best.map_or(0.0, |(value, _)| value) {
            best = Some((value, fit));
        }
    }
    best.map(|(_, fit)| fit)
}

/// up + roll · right + height = 0 at both.
fn through_two(a: Vector3<f64>, b: Vector3<f64>) -> Option<Fit> {
    let solved = Matrix2::new(a.y, 1.0, b.y, 1.0).try_inverse()? * Vector2::new(-a.x, -b.x);
    let (roll, slant) = (solved.x, solved.y);
    let height = slant / (1.0 + roll * roll).sqrt();
    let is_usable = height > 0.0 && height.is_finite() && roll.abs() < 1.0;
    is_usable.then(|| Fit { height, roll, pitch: 0.0, covariance: Matrix3::zeros() })
}

/// Weighted least squares on height, roll and pitch, with what is known beforehand of the two angles (eq. 16).
pub(super) fn refined(tracks: &[Track], start: Fit) -> Option<Fit> {
    let mut fit = start;
    for _ in 0..20 {
        let (mut information, mut right_side, mut squares, mut count) = (Matrix3::zeros(), Vector3::zeros(), 0.0, 0.0);
        for track in tracks {
            let weight = track.weight_on(&fit) / track.places.len() as f64;
            for ((place, _), (_, std)) in track.places.iter().zip(&track.tolerances) {
                let row = Vector3::new(1.0, place.y, place.z);
                let of_place = weight / (std * std);
                information += row * row.transpose() * of_place;
                right_side -= row * (place.x * of_place);
                squares += weight * (fit.over(place) / std).powi(2);
            }
            count += track.weight_on(&fit);
        }
        // Points are off by more than their noise, as roads are not plane.
        let excess = (squares / (count - 3.0).max(1.0)).max(1.0);
        let prior = Vector3::new(0.0, ROLL_STD.powi(-2), PITCH_STD.powi(-2));
        let covariance = (information / excess + Matrix3::from_diagonal(&prior)).try_inverse()?;
        let solved = covariance * (right_side / excess);
        let next = Fit { height: solved.x, roll: solved.y, pitch: solved.z, covariance };
        let has_settled = (next.height - fit.height).abs() < 1e-9 * fit.height.abs();
        fit = next;
        if has_settled {
            break;
        }
    }
    let numbers = [fit.height, fit.roll, fit.pitch, fit.covariance.sum()];
    (fit.height > 0.0 && numbers.iter().all(|x| x.is_finite())).then_some(fit)
}
