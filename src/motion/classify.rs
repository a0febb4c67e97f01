//! Which tracks move (eq. 5 to 9 of `docs/maths/motion.md`).

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::fit::{StaticFit, fit_static};
use super::noise::{Circumstances, Noise};
use super::{PointTrack, Surroundings};

/// Evidence that a point moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Evidence {
    /// No standing point could be seen so: it leaves its epipolar lines.
    OffItsLine,
    /// The standing point that could be seen so lies behind the ground: a vehicle ahead, on the way of the camera.
    BehindGround,
}

/// Verdict on a track.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// It moves.
    Moving(Evidence),
    /// The standing point that could be seen so floats over the ground: something tall, or a vehicle that comes nearer.
    Floating,
    /// It stands on the ground.
    Stationary,
    /// It keeps its place in the picture, whatever the camera does: a bonnet, a mark, a letter.
    Fixed,
    /// Too short, too noisy, or the camera moves too little to say.
    Undetermined,
}

/// Verdict on a track, with its strength.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrackLabel {
    /// Verdict.
    pub verdict: Verdict,
    /// By how many times the noise it departs from what a point standing on the ground would show (without a ground:
    /// any standing point).
    pub strength: f64,
    /// By how many pixels it does so, at the most.
    pub deviation_px: f64,
    /// Height of the standing point over the ground, relative to that of the camera; `None` without a ground, or where
    /// none is known.
    pub relative_height: Option<f64>,
    /// The standing point; `None` for a track that leaves its epipolar lines or is fixed to the camera.
    pub static_point: Option<StaticPoint>,
}

/// Depth of the static point that explains a track.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StaticPoint {
    /// Frame in whose camera the depth is given.
    pub frame: u32,
    /// Inverse depth, per unit of the background; zero or negative for a point that keeps pace with the camera.
    pub inverse_depth: f64,
    /// Its standard deviation.
    pub std: f64,
}

impl TrackLabel {
    const UNDETERMINED: Self = Self {
        verdict: Verdict::Undetermined,
        strength: 0.0,
        deviation_px: 0.0,
        relative_height: None,
        static_point: None,
    };

    /// Returns true if the point moves.
    pub fn is_moving(&self) -> bool {
        matches!(self.verdict, Verdict::Moving(_))
    }
}

/// Minimum residual of a moving point, in times the noise of the image's own points.
const MIN_STRENGTH: f64 = 4.0;
/// Smallest deviation from what a static point would show, pixels.
pub(super) const MIN_DEVIATION_PX: f64 = 1.5;
/// Tolerance of the ground: share of the distance at which a ray meets it.
pub const GROUND_TOLERANCE: f64 = 0.15;

/// Says of every track whether it moves; one label per track.
///
/// Tracks that less than four frames with cameras see are undetermined. Where no frame has a camera, so are all.
pub fn classify(tracks: &[PointTrack], surroundings: &Surroundings) -> Vec<TrackLabel> {
    let measured: Vec<Option<Measured>> = tracks.par_iter().map(|track| measure(track, surroundings)).collect();
    let samples: Vec<(Circumstances, f64)> =
        measured.iter().flatten().filter(|m| !m.is_fixed).map(|m| (m.circumstances, m.fit.rms_px)).collect();
    let noise = Noise::measure(&samples);
    let label = |m: &Option<Measured>| m.as_ref().map_or(TrackLabel::UNDETERMINED, |m| m.label(&noise));
    measured.iter().map(label).collect()
}

/// A track held against a standing point.
struct Measured {
    fit: StaticFit,
    circumstances: Circumstances,
    is_fixed: bool,
    /// Inverse depth at which the ray meets the ground; zero or negative for the sky.
    ground: Option<f64>,
    /// Inverse of the camera's height over the ground.
    per_height: Option<f64>,
}

/// No standing point is nearer to the camera than this part of the camera's height over the ground.
const LEAST_DISTANCE: f64 = 0.05;
/// Distances from which on the sky begins, in heights of the camera.
pub(super) const HORIZON: f64 = 40.0;

/// Strength of a static point, at most, as a share of the minimum strength of a moving one.
const QUIET: f64 = 0.75;

fn measure(track: &PointTrack, surroundings: &Surroundings) -> Option<Measured> {
    let pose = |frame: u32| surroundings.view(frame).map(|view| view.cam_from_world);
    let heights =
        |frame: u32| surroundings.ground.zip(pose(frame)).and_then(|(ground, pose)| ground.camera_height(&pose));
    let height = (track.first..track.end()).find_map(heights);
    let limit = height.map_or(f64::INFINITY, |height| 1.0 / (LEAST_DISTANCE * height));
    let fit = fit_static(track, surroundings, limit)?;
    let at_reference = pose(fit.reference)?;
    let ground = surroundings.ground.and_then(|ground| ground.inverse_depth(&at_reference, fit.ray));
    Some(Measured {
        circumstances: circumstances(track, surroundings, fit.reference)?,
        is_fixed: is_fixed(track, surroundings),
        ground,
        per_height: height.map(|height| 1.0 / height),
        fit,
    })
}

fn circumstances(track: &PointTrack, surroundings: &Surroundings, reference: u32) -> Option<Circumstances> {
    let [x, y] = track.at(reference)?;
    let (width, height) = surroundings.size;
    Some(Circumstances {
        time_s: *surroundings.times_s.get(reference as usize)?,
        num_frames: track.pixels.len(),
        place: [x / f64::from(width.max(1)), y / f64::from(height.max(1))],
    })
}

/// Returns true if a point that is visible for a second and a half stays within a pixel.
fn is_fixed(track: &PointTrack, surroundings: &Surroundings) -> bool {
    let time = |frame: u32| surroundings.times_s.get(frame as usize).copied().unwrap_or(0.0);
    let spread = |k: usize| {
        let values = || track.pixels.iter().map(|pixel| pixel[k]);
        values().fold(f32::MIN, f32::max) - values().fold(f32::MAX, f32::min)
    };
    // In less time a far point of the world stays within a pixel, too.
    time(track.end().saturating_sub(1)) - time(track.first) >= 1.5 && spread(0).max(spread(1)) <= 1.2
}

impl Measured {
    fn label(&self, noise: &Noise) -> TrackLabel {
        let noise_px = noise.of(&self.circumstances);
        let off_line = self.fit.rms_px / noise_px;
        let (along, along_px) = self.along_ray(noise_px);
        let is_clear = |strength: f64, px: f64| strength >= MIN_STRENGTH && px >= MIN_DEVIATION_PX;
        let is_quiet = off_line < QUIET * MIN_STRENGTH;
        let verdict = if self.is_fixed {
            Verdict::Fixed
        } else if is_clear(off_line, self.fit.max_px) {
            Verdict::Moving(Evidence::OffItsLine)
        } else if is_clear(-along, -along_px) {
            Verdict::Moving(Evidence::BehindGround)
        } else if is_clear(along, along_px) {
            Verdict::Floating
        } else if is_quiet && self.is_depth_known(noise_px) {
            Verdict::Stationary
        } else {
            Verdict::Undetermined
        };
        let relative_height =
            self.ground.filter(|_| self.is_depth_known(noise_px)).map(|g| 1.0 - g / self.fit.inverse_depth);
        let deviation_px = self.fit.max_px.hypot(along_px);
        let static_point = StaticPoint {
            frame: self.fit.reference,
            inverse_depth: self.fit.inverse_depth,
            std: self.fit.inverse_depth_per_px * noise_px,
        };
        TrackLabel {
            verdict,
            strength: off_line.max(along.abs()),
            deviation_px,
            relative_height,
            static_point: Some(static_point).filter(|_| is_quiet && !self.is_fixed),
        }
    }

    /// Distance of the static point from the ground along its ray, beyond the ground's tolerance: in times the noise
    /// and in pixels; positive in front of the ground, negative behind it; zeros without a ground.
    fn along_ray(&self, noise_px: f64) -> (f64, f64) {
        let (Some(ground), Some(per_height)) = (self.ground, self.per_height) else { return (0.0, 0.0) };
        let ground = ground.max(0.0);
        let slack = GROUND_TOLERANCE * ground + per_height / HORIZON;
        let gap = self.fit.inverse_depth - ground;
        let beyond = gap.signum() * (gap.abs() - slack).max(0.0);
        (beyond / (self.fit.inverse_depth_per_px * noise_px).max(1e-12), beyond * self.fit.shift_px)
    }

    /// Returns true if the depth is known, and not so large that a vehicle ahead would look the same.
    fn is_depth_known(&self, noise_px: f64) -> bool {
        let sigma = self.fit.inverse_depth_per_px * noise_px;
        let farthest = self.per_height.map_or(0.0, |per_height| per_height / HORIZON);
        self.fit.inverse_depth > farthest.max(MIN_STRENGTH * sigma)
    }
}
