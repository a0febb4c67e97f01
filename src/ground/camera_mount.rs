//! Road plane below a vehicle-mounted camera.
//!
//! Such a camera keeps its height over the road and its tilt relative to it for a whole drive, except for suspension
//! motion. The road is therefore one plane in the camera's own frame, and observations in any frame constrain it in
//! every other: where smooth asphalt shows a dozen corners at a time, a drive shows hundreds (eq. 14 to 17 of
//! `docs/maths/ground.md`).
//!
//! The case is recognized from the data: the direction of motion is constant in the camera's frame, the plane is
//! parallel to it, and the height over the plane is the same in all parts of the drive.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::Options;
use super::dominant::DominantPlane;
use super::observations::point_observations;
use super::supports::Supports;
use super::trajectory_plane::{Axes, Fit, Track, best_sample, refined};
use crate::math::{STD_PER_MAD, median, seeded_rng};
use crate::scene::{FrameId, Image, Point3dId, Reconstruction};

/// Reason why a camera is not recognized as vehicle-mounted.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MountFailure {
    /// Too few frames to determine the direction of motion.
    #[error("only {found} frames registered; at least {needed} needed", needed = MIN_FRAMES)]
    TooFewFrames {
        /// Registered frames.
        found: usize,
    },
    /// The camera rotates relative to its direction of motion.
    #[error("camera not rigidly mounted: it turns by {degrees:.1}° relative to its path in half of the frames")]
    Turns {
        /// Median angle from the mean direction.
        degrees: f64,
    },
    /// Too few points of a road.
    #[error(
        "only {found} points below the camera are on one plane along its path; at least {needed} needed",
        needed = MIN_POINTS
    )]
    TooFewPoints {
        /// Points on the best plane.
        found: usize,
    },
    /// The trajectory is too short in relation to the camera height.
    #[error("path too short ({heights:.1} camera heights) to verify a constant camera height")]
    ShortTrajectory {
        /// Length of the trajectory over the height.
        heights: f64,
    },
    /// The height over the plane is not constant.
    #[error("camera height above the plane varies by {percent:.0} %")]
    HeightVaries {
        /// Robust standard deviation over the parts of the trajectory.
        percent: f64,
    },
    /// The points do not determine whether the height is constant.
    #[error("slope undetermined: the points admit a change of the camera height by {percent:.0} %")]
    MayClimb {
        /// Maximum change from the mean that the points allow.
        percent: f64,
    },
}

/// Road plane in the frame of a vehicle-mounted camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mount {
    /// Unit normal in the camera's frame, upwards.
    pub normal_in_cam: Vector3<f64>,
    /// Height of the camera over the road, units of the background.
    pub height: f64,
    /// Standard deviation of the height.
    pub height_std: f64,
    /// Standard deviation of the rotation about the direction of motion, radians.
    pub roll_std: f64,
    /// Standard deviation of the inclination along the direction of motion, radians.
    pub pitch_std: f64,
    /// Variation of the height between parts of the trajectory, as a share of it: suspension, and drift of scale.
    pub drift: f64,
    /// Points on the road.
    pub num_points: usize,
}

impl Mount {
    fn new(axes: &Axes, fit: &Fit, drift: f64, num_points: usize) -> Self {
        let stds = fit.stds();
        Self {
            normal_in_cam: (axes.up + axes.right * fit.roll + axes.forward * fit.pitch).normalize(),
            height: fit.height,
            height_std: stds.x,
            roll_std: stds.y,
            pitch_std: stds.z,
            drift,
            num_points,
        }
    }

    /// Returns true if the dominant plane is the road below the camera's vehicle, and not a bank next to the road.
    ///
    /// The criteria are its inclination and the camera's height over it.
    pub(super) fn agrees(&self, background: &Reconstruction, ground: &DominantPlane) -> bool {
        let difference = |image: &Image| {
            let normal = image.cam_from_world.rotation.inverse() * self.normal_in_cam;
            let height = ground.normal.dot(&(image.cam_from_world.center() - ground.point));
            (normal.angle(&ground.normal), (height / self.height).ln().abs())
        };
        let (angles, ratios): (Vec<f64>, Vec<f64>) = background.images.values().map(difference).unzip();
        let within = |values: Vec<f64>, limit: f64| median(values).is_some_and(|typical| typical <= limit);
        // Maximum angle between the road and the dominant plane, radians, and maximum logarithm of the height ratio.
        within(angles, 0.07) && within(ratios, 0.25)
    }
}

/// Minimum number of registered frames.
const MIN_FRAMES: usize = 10;
/// Minimum number of distinct points of the road.
const MIN_POINTS: usize = 15;
/// Number of parts of the trajectory whose heights are compared.
const NUM_PARTS: usize = 8;

/// Finds the road plane below a vehicle-mounted camera.
///
/// * `ground_points` – labeled ground points, ascending; other points are ignored. `None`: all points are used.
///
/// # Errors
/// [`MountFailure`] gives the evidence against a vehicle-mounted camera.
pub fn find_mount(
    background: &Reconstruction,
    ground_points: Option<&[Point3dId]>,
    options: &Options,
    seed: u64,
) -> Result<Mount, MountFailure> {
    let images: Vec<(FrameId, &Image)> = background.images.iter().map(|(id, image)| (id.frame(), image)).collect();
    if images.len() < MIN_FRAMES {
        return Err(MountFailure::TooFewFrames { found: images.len() });
    }
    let axes = Axes::new(motion_in_cam(&images)?);
    let points = point_observations(background, |id| ground_points.is_none_or(|ids| ids.binary_search(&id).is_ok()));
    let tracks: Vec<Track> = points.iter().filter_map(|point| Track::new(point, &axes, options)).collect();
    let rng = &mut seeded_rng(seed, 0x006d_6f75_6e74);
    let too_few = |found| MountFailure::TooFewPoints { found };
    let start = best_sample(&tracks, options.max_samples, rng);
    let fit = start.and_then(|start| refined(&tracks, start)).ok_or_else(|| too_few(0))?;
    let found = tracks.iter().filter(|track| track.tukey_weight(&fit) > 0.0).count();
    if found < MIN_POINTS {
        return Err(too_few(found));
    }
    let heights = trajectory_length(&images) / fit.height;
    // Below ten heights a constant height is no evidence for a vehicle.
    if !(heights >= 10.0) {
        return Err(MountFailure::ShortTrajectory { heights });
    }
    let climb = possible_climb(&tracks, &fit, &images);
    // Maximum climb that the points may leave possible, as a share of the height.
    if !(climb <= 0.15) {
        return Err(MountFailure::MayClimb { percent: 100.0 * climb });
    }
    // With too few points to compare parts of the trajectory, the bound is that of the whole trajectory.
    let drift = drift(&tracks, &fit, &images).unwrap_or(0.5 * climb);
    if !(drift <= 0.05) {
        return Err(MountFailure::HeightVaries { percent: 100.0 * drift });
    }
    Ok(Mount::new(&axes, &fit, drift, found))
}

/// Mean direction of motion in the camera's frame.
fn motion_in_cam(images: &[(FrameId, &Image)]) -> Result<Vector3<f64>, MountFailure> {
    let centers: Vec<Point3<f64>> = images.iter().map(|(_, image)| image.cam_from_world.center()).collect();
    let chord = |k: usize| centers[(k + 2).min(images.len() - 1)] - centers[k.saturating_sub(2)];
    let chords: Vec<Vector3<f64>> =
        images.iter().enumerate().map(|(k, (_, image))| image.cam_from_world.rotation * chord(k)).collect();
    // While the vehicle is stationary, the displacement is noise.
    let typical = median(chords.iter().map(|chord| chord.norm()).collect()).unwrap_or(0.0);
    let moving: Vec<Vector3<f64>> = chords.iter().filter(|c| c.norm() > 0.2 * typical).map(|c| c.normalize()).collect();
    let turns = |degrees| MountFailure::Turns { degrees };
    let mean = moving.iter().sum::<Vector3<f64>>().try_normalize(f64::EPSILON).ok_or(turns(90.0))?;
    let angle =
        median(moving.iter().map(|direction| direction.angle(&mean)).collect()).unwrap_or(std::f64::consts::FRAC_PI_2);
    // Maximum median angle between the direction of motion and its mean for a mounted camera, radians.
    if angle <= 0.04 { Ok(mean) } else { Err(turns(angle.to_degrees())) }
}

fn trajectory_length(images: &[(FrameId, &Image)]) -> f64 {
    let center = |(_, image): (FrameId, &Image)| image.cam_from_world.center();
    images.windows(2).map(|pair| (center(pair[1]) - center(pair[0])).norm()).sum()
}

/// Robust standard deviation of the height between parts of the trajectory, as a share of it (eq. 17).
///
/// `None` where fewer than three parts have enough points.
fn drift(tracks: &[Track], fit: &Fit, images: &[(FrameId, &Image)]) -> Option<f64> {
    let starts: Vec<FrameId> = (0..NUM_PARTS).map(|part| images[part * images.len() / NUM_PARTS].0).collect();
    let mut parts: Vec<Vec<&Track>> = vec![Vec::new(); NUM_PARTS];
    for track in tracks {
        let part = starts.partition_point(|start| *start <= track.observations[0].frame).max(1) - 1;
        parts[part].push(track);
    }
    let heights = parts.iter().filter(|part| part.len() >= MIN_POINTS).filter_map(|part| height_of_part(part, fit));
    let differences: Vec<f64> = heights.map(|height| (height / fit.height - 1.0).abs()).collect();
    (differences.len() >= 3).then(|| STD_PER_MAD * median(differences).unwrap_or(0.0))
}

/// Maximum possible change of the height over the trajectory, as a share of the height (eq. 17a).
///
/// The change is linear or quadratic in time. It is possible if nearly as many points are on the plane below the camera
/// as for the best change. A few points on a part of the trajectory fit many changes.
fn possible_climb(tracks: &[Track], fit: &Fit, images: &[(FrameId, &Image)]) -> f64 {
    let (first, last) = (images[0].0.0, images[images.len() - 1].0.0);
    let along = |frame: FrameId| 2.0 * f64::from(frame.0 - first) / f64::from((last - first).max(1)) - 1.0;
    let linear = |climb: f64| move |frame: FrameId| 1.0 + climb * along(frame);
    let quadratic = |climb: f64| move |frame: FrameId| 1.0 + climb * (2.0 * along(frame).powi(2) - 1.0);
    let supports = Supports::new(tracks, fit);
    let tried = (-10..=10).flat_map(|k| {
        let climb = 0.05 * f64::from(k);
        [
            (climb.abs(), support_of_profile(tracks, &supports, fit, linear(climb))),
            (climb.abs(), support_of_profile(tracks, &supports, fit, quadratic(climb))),
        ]
    });
    let tried: Vec<(f64, f64)> = tried.collect();
    let best = tried.iter().map(|(_, support)| *support).fold(0.0, f64::max);
    // A climb whose support is more than two points below the best is ruled out.
    let possible = tried.into_iter().filter(|(_, support)| *support >= best - 2.0);
    possible.map(|(climb, _)| climb).fold(0.0, f64::max)
}

/// Maximum support (eq. 5) of a plane whose distance from the camera follows `profile`, up to a factor.
fn support_of_profile(tracks: &[Track], supports: &Supports, fit: &Fit, profile: impl Fn(FrameId) -> f64) -> f64 {
    let along_normal = fit.along_normal();
    let height_at = |track: &Track| -along_normal(&track.observations[0].at) / profile(track.observations[0].frame);
    let is_possible = |height: &f64| (0.5..2.0).contains(&(height / fit.height));
    let possible: Vec<f64> = tracks.iter().map(height_at).filter(is_possible).collect();
    // Bounds the cost; these are an even sample of the points that support the plane.
    let tried = possible.iter().step_by(possible.len().div_ceil(60).max(1));
    let mut heights: Vec<f64> = tried.copied().chain([fit.height]).collect();
    heights.sort_by(f64::total_cmp);
    supports.at_heights(&heights, profile).into_iter().fold(0.0, f64::max)
}

/// Height with the largest support by the points of a part, between half and twice the mean.
///
/// All points take part: those on the plane of the whole trajectory alone would confirm it.
fn height_of_part(tracks: &[&Track], fit: &Fit) -> Option<f64> {
    let along_normal = fit.along_normal();
    // Bounds the cost: every candidate is compared with all points.
    let tried = tracks.iter().step_by(tracks.len().div_ceil(200)).map(|track| -along_normal(&track.observations[0].at));
    let mut heights: Vec<f64> = tried.filter(|height| (0.5..2.0).contains(&(height / fit.height))).collect();
    heights.sort_by(f64::total_cmp);
    let supports = Supports::new(tracks.iter().copied(), fit).at_heights(&heights, |_| 1.0);
    supports.into_iter().zip(heights).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, height)| height)
}
