//! Classification of point tracks as moving or static (eq. 5 to 9 of `docs/maths/motion.md`).

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::fit::{StaticFit, fit_static};
use super::noise::{Noise, TrackContext};
use super::{PointTrack, Surroundings};

/// Evidence that a point moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Evidence {
    /// No static point explains the track: it leaves its epipolar lines.
    OffItsLine,
    /// The static point that explains the track is behind the ground: a vehicle ahead, on the path of the camera.
    BehindGround,
}

/// Verdict on a track.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// It moves.
    Moving(Evidence),
    /// The static point that explains the track is above the ground: a tall object, or an approaching vehicle.
    Floating,
    /// It is a static point on the ground.
    Stationary,
    /// It keeps its image position under any motion of the camera: the hood, a watermark, text.
    Fixed,
    /// The track is too short or too noisy, or the camera moves too little.
    Undetermined,
}

/// Verdict on a track, with its strength.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrackLabel {
    /// Verdict.
    pub verdict: Verdict,
    /// Residual against a static point on the ground, in times the noise (without a ground: any static point).
    pub strength: f64,
    /// Maximum of this residual, pixels.
    pub deviation_px: f64,
    /// Height of the static point over the ground, relative to that of the camera; `None` without a ground, or where
    /// the depth is unknown.
    pub relative_height: Option<f64>,
    /// Static point; `None` for a track that leaves its epipolar lines or is fixed to the camera.
    pub static_point: Option<StaticPoint>,
}

/// Depth of the static point that explains a track.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StaticPoint {
    /// Frame in whose camera the depth is given.
    pub frame: u32,
    /// Inverse depth, per unit of the background; zero or negative for a point with the velocity of the camera.
    pub inverse_depth: f64,
    /// Standard deviation of the inverse depth.
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

/// Minimum residual of a moving point, in times the noise of the image's own tracks.
const MIN_STRENGTH: f64 = 4.0;
/// Minimum residual of a moving point against the static point, pixels.
pub(super) const MIN_DEVIATION_PX: f64 = 1.5;
/// Tolerance of the ground, as a share of the inverse depth at which a ray intersects it.
pub const GROUND_TOLERANCE: f64 = 0.15;

/// Classifies every track; one label per track.
///
/// Tracks with fewer than four frames with cameras are undetermined. If no frame has a camera, all tracks are.
pub fn classify(tracks: &[PointTrack], surroundings: &Surroundings) -> Vec<TrackLabel> {
    let fitted: Vec<Option<FittedTrack>> = tracks.par_iter().map(|track| fit_track(track, surroundings)).collect();
    let samples: Vec<(TrackContext, f64)> =
        fitted.iter().flatten().filter(|m| !m.is_fixed).map(|m| (m.context, m.fit.rms_px)).collect();
    let noise = Noise::measure(&samples);
    let label = |m: &Option<FittedTrack>| m.as_ref().map_or(TrackLabel::UNDETERMINED, |m| m.label(&noise));
    fitted.iter().map(label).collect()
}

/// Track with the static point that explains it best.
struct FittedTrack {
    fit: StaticFit,
    context: TrackContext,
    is_fixed: bool,
    /// Inverse depth at which the ray intersects the ground; zero or negative for the sky.
    ground: Option<f64>,
    /// Inverse of the camera's height over the ground.
    inverse_height: Option<f64>,
}

/// Minimum distance of a static point from the camera, as a share of the camera's height over the ground.
const MIN_DISTANCE: f64 = 0.05;
/// Distance from which points are not distinguished from the sky, in heights of the camera.
pub(super) const HORIZON: f64 = 40.0;

/// Maximum strength of a static point, as a share of the minimum strength of a moving one.
const QUIET: f64 = 0.75;

fn fit_track(track: &PointTrack, surroundings: &Surroundings) -> Option<FittedTrack> {
    let pose = |frame: u32| surroundings.view(frame).map(|view| view.cam_from_world);
    let heights =
        |frame: u32| surroundings.ground.zip(pose(frame)).and_then(|(ground, pose)| ground.camera_height(&pose));
    let height = (track.first..track.end()).find_map(heights);
    let limit = height.map_or(f64::INFINITY, |height| 1.0 / (MIN_DISTANCE * height));
    let fit = fit_static(track, surroundings, limit)?;
    let at_reference = pose(fit.reference)?;
    let ground = surroundings.ground.and_then(|ground| ground.inverse_depth(&at_reference, fit.ray));
    Some(FittedTrack {
        context: context(track, surroundings, fit.reference)?,
        is_fixed: is_fixed(track, surroundings),
        ground,
        inverse_height: height.map(|height| 1.0 / height),
        fit,
    })
}

fn context(track: &PointTrack, surroundings: &Surroundings, reference: u32) -> Option<TrackContext> {
    let [x, y] = track.at(reference)?;
    let (width, height) = surroundings.size;
    Some(TrackContext {
        time_s: *surroundings.times_s.get(reference as usize)?,
        num_frames: track.pixels.len(),
        position: [x / f64::from(width.max(1)), y / f64::from(height.max(1))],
    })
}

/// Returns true if a point that is tracked for at least 1.5 s stays within 1.2 pixels.
fn is_fixed(track: &PointTrack, surroundings: &Surroundings) -> bool {
    let time = |frame: u32| surroundings.times_s.get(frame as usize).copied().unwrap_or(0.0);
    let spread = |k: usize| {
        let values = || track.pixels.iter().map(|pixel| pixel[k]);
        values().fold(f32::MIN, f32::max) - values().fold(f32::MAX, f32::min)
    };
    // In less time a distant static point stays within a pixel as well.
    time(track.end().saturating_sub(1)) - time(track.first) >= 1.5 && spread(0).max(spread(1)) <= 1.2
}

impl FittedTrack {
    fn label(&self, noise: &Noise) -> TrackLabel {
        let noise_px = noise.of(&self.context);
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

    /// Signed distance of the static point from the ground along its ray, beyond the ground's tolerance.
    ///
    /// In times the noise, and in pixels; positive in front of the ground, negative behind it, zeros without a ground.
    fn along_ray(&self, noise_px: f64) -> (f64, f64) {
        let (Some(ground), Some(inverse_height)) = (self.ground, self.inverse_height) else { return (0.0, 0.0) };
        let ground = ground.max(0.0);
        let tolerance = GROUND_TOLERANCE * ground + inverse_height / HORIZON;
        let gap = self.fit.inverse_depth - ground;
        let beyond = gap.signum() * (gap.abs() - tolerance).max(0.0);
        (beyond / (self.fit.inverse_depth_per_px * noise_px).max(1e-12), beyond * self.fit.shift_px)
    }

    /// Returns true if the depth is known and small enough to exclude a vehicle ahead at the camera's speed.
    fn is_depth_known(&self, noise_px: f64) -> bool {
        let sigma = self.fit.inverse_depth_per_px * noise_px;
        let farthest = self.inverse_height.map_or(0.0, |inverse_height| inverse_height / HORIZON);
        self.fit.inverse_depth > farthest.max(MIN_STRENGTH * sigma)
    }
}
