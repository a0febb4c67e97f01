//! Size and quality of one reconstruction, from its observations alone: what its files say of their own errors is not
//! believed.

use serde::{Deserialize, Serialize};

use crate::math::median;
use crate::scene::{Image, Point3d, Reconstruction};

/// Width of the bins of [`ModelFigures::errors`], pixels.
pub const ERROR_BIN_PX: f64 = 0.1;
/// Bins of [`ModelFigures::errors`]; the last one holds all that is larger.
pub const NUM_ERROR_BINS: usize = 41;
/// Bins of [`ModelFigures::track_lengths`]: tracks of two images come first, the last one holds all longer ones.
pub const NUM_TRACK_BINS: usize = 20;

/// Size and quality of one reconstruction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelFigures {
    /// Registered images.
    pub num_images: usize,
    /// Sets of intrinsics.
    pub num_cameras: usize,
    /// Points.
    pub num_points: usize,
    /// Observations of points.
    pub num_observations: usize,
    /// Mean observations per point; `None` without points.
    pub mean_track_length: Option<f64>,
    /// Reprojection errors, recomputed from cameras, points and observations; `None` without observations.
    pub reprojection: Option<Reprojection>,
    /// Numbers of points with 2, 3, … observations.
    pub track_lengths: Vec<usize>,
    /// Numbers of observations with an error of 0 to 0.1 px, 0.1 to 0.2 px, …
    pub errors: Vec<usize>,
}

/// Reprojection errors, pixels. Two means are in use: this program's is that over observations, COLMAP's that over
/// points, each with the mean over its own observations.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reprojection {
    /// Mean over all observations.
    pub mean_px: f64,
    /// Mean over points of each point's mean.
    pub mean_per_point_px: f64,
    /// Median over all observations.
    pub median_px: f64,
    /// Root mean square over all observations.
    pub rms_px: f64,
    /// Observations of points that do not lie in front of the camera; they have no error.
    pub num_behind: usize,
}

impl ModelFigures {
    /// Of one reconstruction.
    pub fn new(model: &Reconstruction) -> Self {
        let num_observations: usize = model.points.values().map(|p| p.track.len()).sum();
        let num_points = model.points.len();
        let per_point: Vec<Vec<Option<f64>>> = model.points.values().map(|p| errors_of(model, p)).collect();
        let found: Vec<f64> = per_point.iter().flatten().copied().flatten().collect();
        Self {
            num_images: model.images.len(),
            num_cameras: model.cameras.len(),
            num_points,
            num_observations,
            mean_track_length: (num_points > 0).then(|| num_observations as f64 / num_points as f64),
            track_lengths: binned(
                model.points.values().map(|p| p.track.len().saturating_sub(2)).collect(),
                NUM_TRACK_BINS,
            ),
            errors: binned(found.iter().map(|e| (e / ERROR_BIN_PX) as usize).collect(), NUM_ERROR_BINS),
            reprojection: reprojection(&per_point, found),
        }
    }
}

fn reprojection(per_point: &[Vec<Option<f64>>], found: Vec<f64>) -> Option<Reprojection> {
    let mean = |values: &[f64]| (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64);
    let of_point = |errors: &Vec<Option<f64>>| mean(&errors.iter().copied().flatten().collect::<Vec<_>>());
    let points: Vec<f64> = per_point.iter().filter_map(of_point).collect();
    let squares: Vec<f64> = found.iter().map(|e| e * e).collect();
    Some(Reprojection {
        mean_px: mean(&found)?,
        mean_per_point_px: mean(&points)?,
        rms_px: mean(&squares)?.sqrt(),
        num_behind: per_point.iter().flatten().filter(|e| e.is_none()).count(),
        median_px: median(found)?,
    })
}

/// The error of every observation of a point; `None` where it does not lie in front of the camera, or where the lens is
/// one that nothing can be projected with.
fn errors_of(model: &Reconstruction, point: &Point3d) -> Vec<Option<f64>> {
    let seen = |image: &Image, observation: u32| {
        let camera = model.projecting_camera(image)?;
        let pixel = camera.pixel_from_cam(image.cam_from_world * point.position)?;
        let error = (pixel - image.observations.get(observation as usize)?.pixel).norm();
        error.is_finite().then_some(error)
    };
    let error = |element: &crate::scene::TrackElement| seen(model.images.get(&element.image)?, element.observation_idx);
    point.track.iter().map(error).collect()
}

/// Mean reprojection error of the points that one image sees, pixels.
pub fn error_of_image(model: &Reconstruction, image: &Image) -> Option<f64> {
    let camera = model.projecting_camera(image)?;
    let error = |seen: &crate::scene::Observation| {
        let point = model.points.get(&seen.point?)?;
        let pixel = camera.pixel_from_cam(image.cam_from_world * point.position)?;
        Some((pixel - seen.pixel).norm()).filter(|e| e.is_finite())
    };
    let errors: Vec<f64> = image.observations.iter().filter_map(error).collect();
    (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
}

/// Histogram of values 0, 1, …; the last bin holds all larger ones.
fn binned(values: Vec<usize>, num_bins: usize) -> Vec<usize> {
    let mut bins = vec![0; num_bins];
    for value in values {
        bins[value.min(num_bins - 1)] += 1;
    }
    bins
}
