//! A plane along the way of a camera, in the camera's own frame (eq. 15 and 16 of `docs/maths/ground.md`).

use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};
use rand::Rng as _;

use super::Options;
use super::observations::{PointObservations, PointView};
use crate::math::Rng;
use crate::scene::FrameId;

/// Cameras in vehicles are mounted upright by hand: standard deviation of the roll, radians. It tells the road from the
/// slope next to it where the slope has more points.
const ROLL_STD: f64 = 0.087;
/// The way is parallel to the road: standard deviation of the angle between them, radians.
const PITCH_STD: f64 = 0.005;

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
    /// Height of a position over the plane.
    pub(super) fn over(&self, place: &Vector3<f64>) -> f64 {
        self.slope()(place) + self.height
    }

    /// Position along the normal, as the camera sees it.
    pub(super) fn slope(&self) -> impl Fn(&Vector3<f64>) -> f64 + use<> {
        let (roll, pitch) = (self.roll, self.pitch);
        let shrink = 1.0 / (1.0 + roll * roll + pitch * pitch).sqrt();
        move |place| (place.x + roll * place.y + pitch * place.z) * shrink
    }

    /// Standard deviations of height, roll and pitch.
    pub(super) fn stds(&self) -> Vector3<f64> {
        self.covariance.diagonal().map(|variance| variance.max(0.0).sqrt())
    }
}

/// One point, as the frames see it that are nearest to it.
pub(super) struct Track {
    pub places: Vec<Place>,
}

/// Position of a point as one frame sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Place {
    /// Coordinates up, right and along the way of the camera.
    pub at: Vector3<f64>,
    pub frame: FrameId,
    /// Up to this distance it lies on a plane (eq. 1).
    pub tolerance: f64,
    /// Standard deviation of its height.
    pub std: f64,
    /// Information of its distance from a plane: 1 for an exact one.
    pub sureness: f64,
}

impl Track {
    pub(super) fn new(sighting: &PointObservations, axes: &Axes, options: &Options) -> Option<Self> {
        let place = |view: &PointView| {
            let (x, pixel) = (&view.in_cam.coords, view.in_cam.z / view.focal);
            // The noise of an image position is a pixel.
            let std = (sighting.variance_along(view, &axes.up) + pixel * pixel).sqrt();
            let tolerance = options.max_error_px * pixel;
            let sureness = 1.0 / (1.0 + (std / tolerance).powi(2));
            let at = Vector3::new(axes.up.dot(x), axes.right.dot(x), axes.way.dot(x));
            Place { at, frame: view.frame, tolerance, std, sureness }
        };
        let places: Vec<Place> = sighting.views.iter().map(place).filter(|place| place.at.x < 0.0).collect();
        let is_finite = |place: &Place| place.tolerance.is_finite() && place.std.is_finite();
        (!places.is_empty() && places.iter().all(is_finite)).then_some(Self { places })
    }

    /// Mean of the scores of MSAC (eq. 5), and the share of places plainly below, of a plane whose height may differ
    /// from frame to frame.
    pub(super) fn score(&self, slope: &impl Fn(&Vector3<f64>) -> f64, height: impl Fn(FrameId) -> f64) -> (f64, f64) {
        let each = self.places.iter().map(|place| {
            let off = (slope(&place.at) + height(place.frame)) / place.tolerance;
            (place.sureness * (1.0 - off * off).max(0.0), f64::from(off < -3.0))
        });
        let (support, below) = each.fold((0.0, 0.0), |sum, (a, b)| (sum.0 + a, sum.1 + b));
        let count = self.places.len() as f64;
        (support / count, below / count)
    }

    /// The most that [`Self::score`] gives.
    fn largest_score(&self) -> f64 {
        self.places.iter().map(|place| place.sureness).sum::<f64>() / self.places.len() as f64
    }

    /// Tukey's weight of the point, from the mean of its distances in tolerances.
    pub(super) fn weight_on(&self, fit: &Fit) -> f64 {
        let off = self.places.iter().map(|place| fit.over(&place.at) / place.tolerance);
        let mean = off.sum::<f64>() / self.places.len() as f64;
        (1.0 - mean * mean).max(0.0).powi(2)
    }
}

/// The plane through two points, parallel to the way, that the most points lie on and the fewest below (eq. 15).
pub(super) fn best_sample(tracks: &[Track], max_samples: usize, rng: &mut Rng) -> Option<Fit> {
    if tracks.len() < 2 {
        return None;
    }
    // What all points from each on can add.
    let mut rest: Vec<f64> = tracks.iter().map(Track::largest_score).collect();
    (1..rest.len()).rev().for_each(|k| rest[k - 1] += rest[k]);
    let mut best: Option<(f64, Fit)> = None;
    for _ in 0..max_samples {
        let mut draw = || tracks[rng.random_range(0..tracks.len())].places[0].at;
        let Some(fit) = through_two(draw(), draw()) else { continue };
        let least = best.map_or(0.0, |(value, _)| value);
        if let Some(value) = value_above(tracks, &rest, &fit, least) {
            best = Some((value, fit));
        }
    }
    best.map(|(_, fit)| fit)
}

/// Score of a plane (eq. 15); `None` as soon as it cannot exceed `least`.
///
/// * `rest` – by point, what it and those behind it can add at most.
fn value_above(tracks: &[Track], rest: &[f64], fit: &Fit, least: f64) -> Option<f64> {
    let prior = (-0.5 * (fit.roll / ROLL_STD).powi(2)).exp();
    let slope = fit.slope();
    let (mut support, mut below) = (0.0, 0.0);
    // The bound is checked once for many points, which costs hardly anything.
    for (tracks, rest) in tracks.chunks(64).zip(rest.chunks(64)) {
        if prior * (support - 0.5 * below + rest[0]) <= least {
            return None;
        }
        for track in tracks {
            let (on, under) = track.score(&slope, |_| fit.height);
            support += on;
            below += under;
        }
    }
    Some(prior * (support - 0.5 * below)).filter(|value| *value > least)
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
            let of_track = track.weight_on(&fit);
            let weight = of_track / track.places.len() as f64;
            for Place { at, std, .. } in &track.places {
                let row = Vector3::new(1.0, at.y, at.z);
                let of_place = weight / (std * std);
                information += row * row.transpose() * of_place;
                right_side -= row * (at.x * of_place);
                squares += weight * (fit.over(at) / std).powi(2);
            }
            count += of_track;
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
