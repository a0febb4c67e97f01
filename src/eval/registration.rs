//! Registration of a background reconstruction with the true world.
//!
//! The paper's section *Registration of Background Reconstruction and Virtual Environment*: Umeyama's similarity
//! between camera centres gives an initial scale; then the points c + m u and c + m f are added for each camera, where
//! u = Rᵀ (0, 1, 0) and f = Rᵀ (0, 0, 1) are its up and forward vectors, and the similarity is computed again over all
//! of them. The magnitude m is one metre for the true cameras and one metre by the initial scale for the estimated
//! ones. The vectors settle what centres alone leave open: a straight flight says nothing about the roll round its
//! line.
//!
//! Where the centres lie exactly on a line, Umeyama's method has no initial answer; the scale is then the ratio of the
//! centres' spreads.

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::{Rigid3, Sim3, centroid, umeyama};

/// Fewest cameras: three centres and their residuals can contradict one another, two always agree.
pub const MIN_CAMERAS: usize = 3;

/// Length of the true up and forward vectors, metres.
const MAGNITUDE_M: f64 = 1.0;

/// Spread below which camera centres lie in one place, relative to the length of the vectors.
const MIN_SPREAD: f64 = 1e-6;

/// A similarity to the true world, in metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Registration {
    /// T_s; its scale is r_(bv), metres per unit of the background.
    pub world_from_background: Sim3,
    /// Cameras that took part.
    pub num_cameras: usize,
    /// Where the initial scale came from.
    pub initial_scale: InitialScale,
}

/// Source of the initial scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum InitialScale {
    /// Umeyama's similarity on camera centres.
    Centers,
    /// The centres' spreads, since they lie on a line.
    Spread,
}

/// Registers pairs of one frame's (estimated, true) `cam_from_world`.
///
/// # Errors
/// The reason, in words: too few cameras, or a camera that does not move.
pub fn register(pairs: &[(Rigid3, Rigid3)]) -> Result<Registration, String> {
    register_with(pairs, MAGNITUDE_M)
}

/// As [`register`], with up and forward vectors of another length than a metre.
pub(super) fn register_with(pairs: &[(Rigid3, Rigid3)], magnitude: f64) -> Result<Registration, String> {
    if pairs.len() < MIN_CAMERAS {
        return Err(format!("{} frames have a background camera, at least {MIN_CAMERAS} needed", pairs.len()));
    }
    let (mut source, mut target): (Vec<_>, Vec<_>) = pairs.iter().map(|(e, t)| (e.center(), t.center())).unzip();
    let (source_spread, target_spread) = (spread(&source), spread(&target));
    if !(target_spread > MIN_SPREAD * magnitude && source_spread > 0.0) {
        return Err("the camera does not move, so its scale cannot be compared".into());
    }
    let (scale, initial_scale) = match umeyama(&source, &target) {
        Some(initial) if initial.scale > 0.0 => (initial.scale, InitialScale::Centers),
        _ => (target_spread / source_spread, InitialScale::Spread),
    };
    for (estimated, truth) in pairs {
        source.extend(direction_points(estimated, magnitude / scale));
        target.extend(direction_points(truth, magnitude));
    }
    let world_from_background = umeyama(&source, &target).ok_or(
        "the camera positions do not determine the similarity \
         transform",
    )?;
    Ok(Registration { world_from_background, num_cameras: pairs.len(), initial_scale })
}

/// c + m u and c + m f.
fn direction_points(cam_from_world: &Rigid3, magnitude: f64) -> [Point3<f64>; 2] {
    let world_from_cam = cam_from_world.rotation.inverse();
    [Vector3::y(), Vector3::z()].map(|axis| cam_from_world.center() + world_from_cam * axis * magnitude)
}

/// Root mean square distance from the mean.
pub(super) fn spread(points: &[Point3<f64>]) -> f64 {
    let mean = centroid(points);
    (points.iter().map(|p| (p - mean).norm_squared()).sum::<f64>() / points.len() as f64).sqrt()
}
