//! Errors of the background cameras.

use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::registration::Registration;
use crate::math::{Rigid3, Sim3, umeyama};

/// Errors of the estimated cameras.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CameraErrors {
    /// Root mean square distance of centres, metres, after the similarity that is best for centres alone: the usual
    /// figure of other programs.
    pub center_rmse_m: f64,
    /// The same after the registration that the trajectory is measured with.
    pub registered_center_rmse_m: f64,
    /// Mean angle between estimated and true cameras after the registration, degrees.
    pub rotation_mean_deg: f64,
    /// The largest such angle, degrees.
    pub rotation_max_deg: f64,
}

/// Compares (estimated, true) cameras of the frames that have both.
///
/// # Errors
/// Those of the registration.
pub(super) fn compare_cameras(
    pairs: &[(Rigid3, Rigid3)],
    registration: Result<&Registration, &str>,
) -> Result<CameraErrors, String> {
    let world_from_background = registration?.world_from_background;
    let (estimated, truth): (Vec<_>, Vec<_>) = pairs.iter().map(|(e, t)| (e.center(), t.center())).unzip();
    // Centres on a line have no similarity of their own.
    let best_for_centers = umeyama(&estimated, &truth).unwrap_or(world_from_background);
    let angles_deg: Vec<_> =
        pairs.iter().map(|(e, t)| world_from_background.transform_camera(e).angle_to(t).to_degrees()).collect();
    Ok(CameraErrors {
        center_rmse_m: rmse(&best_for_centers, &estimated, &truth),
        registered_center_rmse_m: rmse(&world_from_background, &estimated, &truth),
        rotation_mean_deg: angles_deg.iter().sum::<f64>() / angles_deg.len() as f64,
        rotation_max_deg: angles_deg.iter().copied().fold(0.0, f64::max),
    })
}

fn rmse(target_from_source: &Sim3, source: &[Point3<f64>], target: &[Point3<f64>]) -> f64 {
    let sum: f64 = source.iter().zip(target).map(|(s, t)| (*target_from_source * *s - t).norm_squared()).sum();
    (sum / source.len() as f64).sqrt()
}
