//! Incremental reconstruction of one target (the background, or one object) from its tracks.
//!
//! An initial pair with many common points and a large triangulation angle initializes the map. Views are registered
//! one by one, the one that observes the most known points first: its pose by P3P ([`crate::geometry::resection`]), new
//! points by triangulation ([`crate::geometry::triangulation`]), then a local bundle adjustment. A global adjustment
//! follows whenever the map has grown by a fixed share. Views that fail are tried again when they observe more points.
//! Views that contradict the two-view geometries of their pairs are removed and registered again (`view_graph`). If a
//! map has too few views, the next initial pair is tried, and the map that explains the most observations is kept.
//!
//! Every unregistered view has a [`Reason`] in the [`Report`].

mod adjustment;
mod calibration_fit;
mod error;
mod focal_changes;
mod focal_length;
mod hovering_camera;
mod incremental_mapper;
mod initial_pair;
mod initialization;
mod intrinsics_prior;
mod intrinsics_source;
mod long_tracks;
mod map;
mod motion;
mod report;
mod rotating_camera;
pub mod silhouette;
#[cfg(test)]
mod tests;
mod vanishing_points;
mod view_graph;
mod windows;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use calibration_fit::{CalibrationFit, calibration_fit};
pub use hovering_camera::{HoveringCamera, hovering_camera};
pub use incremental_mapper::PosePriors;
pub use intrinsics_source::{Intrinsics, KnownIntrinsics};
pub use long_tracks::cut_long_tracks;
pub use motion::ModelWeakness;
pub use report::{Outcome, Reason, Report};
#[cfg(test)]
pub(crate) use rotating_camera::tests::views_along;
pub use rotating_camera::{RotatingCamera, rotating_camera};
pub use vanishing_points::LineNormal;
#[cfg(test)]
pub(crate) use vanishing_points::tests::street;

use crate::camera::Camera;
use crate::checks::{Checked, ordered, within};
use crate::features::tracks::TrackTable;
use crate::geometry::triangulation::Limits;
use crate::math::{Rigid3, RobustLoss};
use crate::scene::Reconstruction;
pub use error::MapperError;
pub use focal_changes::focal_changes;
use incremental_mapper::IncrementalMapper;
use initialization::InitializationAttempt;
use map::{Map, MapPoints};

/// Options of the mapper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Options {
    /// Minimum number of inliers of the initial pair.
    #[schemars(extend("unit" = "points"))]
    pub min_initial_inliers: usize,
    /// Median triangulation angle from which an initial pair is preferred.
    pub initial_angle_deg: f64,
    /// Minimum number of inliers of a registered view.
    #[schemars(extend("unit" = "points"))]
    pub min_resection_inliers: usize,
    /// Minimum inlier ratio of a registered view.
    #[schemars(extend("unit" = "share"))]
    pub min_inlier_ratio: f64,
    /// Maximum epipolar and resection error of an inlier.
    pub max_pose_error_px: f64,
    /// Maximum reprojection error of an observation.
    pub max_error_px: f64,
    /// Reprojection error below which no observation is rejected.
    pub min_error_px: f64,
    /// Minimum triangulation angle of a point at focal lengths up to 1536 px; smaller in proportion beyond.
    pub min_angle_deg: f64,
    /// Scale of the robust loss before the noise is measured.
    pub loss_scale_px: f64,
    /// Maximum number of initialization attempts.
    #[schemars(extend("unit" = "starts"))]
    pub max_starts: usize,
    /// True if the map starts from pose priors where there are any.
    pub pose_priors: bool,
    /// True if views are in temporal order.
    pub ordered: bool,
    /// Number of views after which a track is split.
    #[schemars(extend("unit" = "views"))]
    pub max_track_views: usize,
    /// Tolerance of the global adjustments between the end of growth and the last one, as a share of the cost.
    #[schemars(extend("unit" = "share"))]
    pub coarse_tolerance: f64,
    /// Views of a map beyond which it is adjusted in windows: up to here one adjustment takes no more memory than the
    /// rest of the program.
    #[schemars(extend("unit" = "views"))]
    pub max_views_at_once: usize,
}

/// Maximum reprojection error over the measured noise, for ordered views.
const MAX_ERROR_SIGMAS: f64 = 8.0;
/// Scale of the robust loss over the measured noise.
const LOSS_SIGMAS: f64 = 2.0;
/// Minimum scale of the loss, pixels: smaller residuals are rounding, and a smaller scale would only slow the solver
/// down.
const MIN_LOSS_SCALE_PX: f64 = 0.02;

impl Options {
    /// Options for the background.
    pub fn background() -> Self {
        Self {
            min_initial_inliers: 60,
            initial_angle_deg: 12.0,
            min_resection_inliers: 20,
            min_inlier_ratio: 0.2,
            max_pose_error_px: 4.0,
            max_error_px: 3.0,
            min_error_px: 0.4,
            min_angle_deg: 1.0,
            loss_scale_px: 1.0,
            max_starts: 3,
            pose_priors: true,
            ordered: true,
            max_track_views: 96,
            coarse_tolerance: 1e-4,
            max_views_at_once: 800,
        }
    }

    /// Options for one object: it has far fewer points, so the required numbers are lower and the error limits
    /// stricter.
    pub fn object() -> Self {
        Self {
            min_initial_inliers: 16,
            initial_angle_deg: 8.0,
            min_resection_inliers: 7,
            min_inlier_ratio: 0.25,
            max_pose_error_px: 3.0,
            max_error_px: 2.0,
            ..Self::background()
        }
    }

    /// Rejects options that are out of range or contradict one another.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("min_initial_inliers", self.min_initial_inliers, 6..=1_000_000)?;
        within("initial_angle_deg", self.initial_angle_deg, 0.0..=90.0)?;
        within("min_resection_inliers", self.min_resection_inliers, 4..=1_000_000)?;
        within("min_inlier_ratio", self.min_inlier_ratio, 0.0..=1.0)?;
        within("max_pose_error_px", self.max_pose_error_px, 0.01..=1000.0)?;
        within("max_error_px", self.max_error_px, 0.01..=1000.0)?;
        within("min_error_px", self.min_error_px, 0.001..=1000.0)?;
        ordered(("min_error_px", self.min_error_px), ("max_error_px", self.max_error_px))?;
        within("min_angle_deg", self.min_angle_deg, 0.0..=90.0)?;
        within("loss_scale_px", self.loss_scale_px, MIN_LOSS_SCALE_PX..=1000.0)?;
        within("max_starts", self.max_starts, 1..=1000)?;
        within("max_track_views", self.max_track_views, 4..=1_000_000_000)?;
        within("coarse_tolerance", self.coarse_tolerance, 1e-12..=0.1)?;
        within("max_views_at_once", self.max_views_at_once, 800..=1_000_000_000)
    }

    /// Options with the minimum triangulation angle adapted to the focal lengths of the cameras.
    ///
    /// Feature positions are accurate to a fraction of a pixel whatever the frame's size, so the parallax in pixels, f
    /// · angle, determines a depth. `min_angle_deg` holds up to a focal length of 1536 px, a field of view of 45° in
    /// frames of 1280 pixels. Beyond, the same parallax in pixels is required.
    fn at_focal(&self, cameras: &[Camera]) -> Self {
        // Focal length up to which `min_angle_deg` holds unchanged, pixels (see above).
        const USUAL_FOCAL_PX: f64 = 1536.0;
        let longest = cameras.iter().map(Camera::mean_focal).fold(USUAL_FOCAL_PX, f64::max);
        Self { min_angle_deg: self.min_angle_deg * USUAL_FOCAL_PX / longest, ..self.clone() }
    }

    /// Limits of inlier observations at the measured noise.
    fn limits(&self, noise: Noise) -> Limits {
        let of_noise = |sigma_px: f64| (MAX_ERROR_SIGMAS * sigma_px).clamp(self.min_error_px, self.max_error_px);
        let max_error_px = noise.filter(|_| self.ordered).map_or(self.max_error_px, of_noise);
        Limits { max_error_px, min_angle: self.min_angle_deg.to_radians() }
    }

    /// Robust loss of bundle adjustment at the measured noise.
    fn loss(&self, noise: Noise) -> RobustLoss {
        let of_noise = |sigma_px: f64| (LOSS_SIGMAS * sigma_px).clamp(MIN_LOSS_SCALE_PX, self.loss_scale_px);
        let scale = noise.map_or(self.loss_scale_px, of_noise);
        RobustLoss::SoftL1 { scale }
    }
}

/// Robust standard deviation of a coordinate of the residuals, pixels; `None` before the first adjustment.
///
/// Where positions have a covariance, it is that of a good corner (a whitening of one).
///
/// The noise of different front ends, videos and objects differs tenfold. A loss or a threshold that is too wide for
/// the data admits systematic errors: on the shared rendered sequence measured limits reduced the camera error of the
/// background from 2.8 to 0.5 mm.
type Noise = Option<f64>;

/// Reconstructs the cameras and points that explain the tracks best.
///
/// Long videos cost the least after [`cut_long_tracks`].
///
/// * `cameras` – intrinsics, indexed by [`crate::features::tracks::View::camera`].
/// * `intrinsics` – prior knowledge of them, common to all cameras or by camera.
///
/// The reconstruction is empty if no initial pair yields a map; the report then gives the reason.
///
/// Adjustments run on the threads of the caller's rayon pool.
///
/// # Errors
/// [`MapperError::Option`] for options that [`Options::check`] refuses; [`MapperError::Bundle`] only on an invalid
/// bundle adjustment problem, which would be a bug.
pub fn reconstruct(
    table: &TrackTable,
    cameras: &[Camera],
    intrinsics: impl Into<KnownIntrinsics>,
    options: &Options,
    seed: u64,
) -> Result<(Reconstruction, Report), MapperError> {
    reconstruct_watched(table.clone(), cameras, intrinsics, options, seed, None, &mut |_| {})
}

/// As [`reconstruct`], initialized from `poses` where these are given, with progress.
///
/// `watch` receives the finished share of the work. It is an estimate: further initialization attempts set it back.
///
/// The tracks are dropped before the views get their observations: for a long video memory does not hold both.
///
/// # Errors
/// As [`reconstruct`].
pub fn reconstruct_watched(
    table: TrackTable,
    cameras: &[Camera],
    intrinsics: impl Into<KnownIntrinsics>,
    options: &Options,
    seed: u64,
    poses: Option<&PosePriors>,
    watch: &mut dyn FnMut(f64),
) -> Result<(Reconstruction, Report), MapperError> {
    options.check()?;
    let known: &KnownIntrinsics = &intrinsics.into();
    let options = &options.at_focal(cameras);
    let poses = poses.filter(|_| options.pose_priors);
    let attempt = InitializationAttempt { table: &table, cameras, known, options, poses };
    let (found, report) = match attempt.grow(seed, watch)? {
        Ok(mapper) => {
            let (map, report) = mapper.into_result();
            (Some(map.into_points()), report)
        }
        Err(report) => (None, report),
    };
    let TrackTable { views, tracks } = table;
    drop(tracks);
    Ok(with_views(found, report, views.into_iter()))
}

/// Triangulates the points of a stationary target from known camera poses.
///
/// * `poses` – camera from world, by view.
///
/// Returns the model in the frame of the cameras, the report, and the inlier ratio of the observations.
///
/// # Errors
/// As [`reconstruct`].
pub fn triangulate(
    table: &TrackTable,
    cameras: &[Camera],
    poses: &[Option<Rigid3>],
    options: &Options,
) -> Result<(Reconstruction, Report, f64), MapperError> {
    options.check()?;
    let options = &options.at_focal(cameras);
    let map = Map::new(table, cameras, Intrinsics::FIXED.into());
    let mut mapper = IncrementalMapper::new(map, options, 0);
    let explained = mapper.triangulate_from(poses)?;
    let (map, report) = mapper.into_result();
    let (model, report) = with_views(Some(map.into_points()), report, table.views.iter().cloned());
    Ok((model, report, explained))
}

fn with_views(
    found: Option<MapPoints>,
    mut report: Report,
    views: impl Iterator<Item = crate::features::tracks::View>,
) -> (Reconstruction, Report) {
    let reconstruction = found.map(|found| found.with_views(views)).unwrap_or_default();
    report.mean_error_px = reconstruction.mean_reprojection_error_px();
    (reconstruction, report)
}
