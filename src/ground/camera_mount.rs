//! The road below a camera that is fixed to a vehicle.
//!
//! Such a camera keeps its height over the road and its inclination against it for a whole drive, up to springs. So
//! the road is one plane in the camera's own frame, and what is seen of it in any frame tells of it in every other:
//! where smooth asphalt shows a dozen corners at a time, a drive shows hundreds (eq. 14 to 17 of
//! `docs/maths/ground.md`).
//!
//! The case is recognised from the data: the camera looks in one direction against its way, the plane is parallel to
//! that way, and the height over it is the same in all parts of the drive.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::Options;
use super::dominant::DominantPlane;
use super::observations::sightings;
use super::supports::Supports;
use super::trajectory_plane::{Axes, Fit, Track, best_sample, refined};
use crate::math::{STD_PER_MAD, median, seeded_rng};
use crate::scene::{FrameId, Image, Point3dId, Reconstruction};

/// Why a camera is not taken for one that is fixed to a vehicle.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MountFailure {
    /// Too few frames to see a way.
    #[error("only {found} frames registered; at least {needed} needed", needed = MIN_FRAMES)]
    TooFewFrames {
        /// Registered frames.
        found: usize,
    },
    /// The camera turns against its way.
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
    /// The camera is too high for the way it goes.
    #[error("path too short ({heights:.1} camera heights) to verify a constant camera height")]
    ShortWay {
        /// Length of the way over the height.
        heights: f64,
    },
    /// The height over the plane is not the same everywhere.
    #[error("camera height above the plane varies by {percent:.0} %")]
    HeightVaries {
        /// Robust standard deviation over the parts of the way.
        percent: f64,
    },
    /// The points leave open whether the height is the same everywhere.
    #[error("slope undetermined: the points admit a change of the camera height by {percent:.0} %")]
    MayClimb {
        /// The greatest change from the mean that the points allow.
        percent: f64,
    },
}

/// The road in the frame of a camera fixed to a vehicle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Mount {
    /// Unit normal in the camera's frame, upwards.
    pub normal_in_cam: Vector3<f64>,
    /// The camera's height over the road, units of the background.
    pub height: f64,
    /// Its standard deviation.
    pub height_std: f64,
    /// Standard deviation of the rotation about the way, radians.
    pub roll_std: f64,
    /// Standard deviation of the inclination along the way, radians.
    pub pitch_std: f64,
    /// Variation of the height between parts of the trajectory, as a share of it: springs, and drift of scale.
    pub drift: f64,
    /// Points on the road.
    pub num_points: usize,
}

impl Mount {
    fn new(axes: &Axes, fit: &Fit, drift: f64, num_points: usize) -> Self {
        let stds = fit.stds();
        Self {
            normal_in_cam: (axes.up + axes.right * fit.roll + axes.way * fit.pitch).normalize(),
            height: fit.height,
            height_std: stds.x,
            roll_std: stds.y,
            pitch_std: stds.z,
            drift,
            num_points,
        }
    }

    /// Returns true if the ground found without labels is the road that the camera's vehicle drives on, and not a bank
    /// next to the road, judged by its inclination and by the camera's height over it.
    pub(super) fn agrees(&self, background: &Reconstruction, ground: &DominantPlane) -> bool {
        let off = |image: &Image| {
            let normal = image.cam_from_world.rotation.inverse() * self.normal_in_cam;
            let height = ground.normal.dot(&(image.cam_from_world.center() - ground.point));
            (normal.angle(&ground.normal), (height / self.height).ln().abs())
        };
        let (angles, ratios): (Vec<f64>, Vec<f64>) = background.images.values().map(off).unzip();
        let within = |values: Vec<f64>, limit: f64| median(values).is_some_and(|typical| typical <= limit);
        // Angle between the road and the dominant plane of a place up to which the latter is the ground, too,
        // radians.
        within(angles, 0.07) && within(ratios, 0.25)
    }
}

/// Fewest registered frames.
const MIN_FRAMES: usize = 10;
/// Fewest different points of the road.
const MIN_POINTS: usize = 15;
/// Parts of the way whose heights are compared.
const NUM_PARTS: usize = 8;

/// Finds the road below a camera that is fixed to a vehicle.
///
/// * `ground_points` – ascending; where labels say which points are ground, no other is looked at. `None`: all are.
///
/// # Errors
/// [`MountFailure`] says what speaks against such a camera.
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
    let axes = Axes::new(way_in_cam(&images)?);
    let seen = sightings(background, |id| ground_points.is_none_or(|ids| ids.binary_search(&id).is_ok()));
    let tracks: Vec<Track> = seen.iter().filter_map(|sighting| Track::new(sighting, &axes, options)).collect();
    let rng = &mut seeded_rng(seed, 0x006d_6f75_6e74);
    let too_few = |found| MountFailure::TooFewPoints { found };
    let start = best_sample(&tracks, options.max_samples, rng);
    let fit = start.and_then(|start| refined(&tracks, start)).ok_or_else(|| too_few(0))?;
    let found = tracks.iter().filter(|track| track.weight_on(&fit) > 0.0).count();
    if found < MIN_POINTS {
        return Err(too_few(found));
    }
    let heights = way_length(&images) / fit.height;
    // Below ten a constant height is no sign of a vehicle.
    if !(heights >= 10.0) {
        return Err(MountFailure::ShortWay { heights });
    }
    let climb = possible_climb(&tracks, &fit, &images);
    // Up to which share of the height points may leave it open whether the camera climbs.
    if !(climb <= 0.15) {
        return Err(MountFailure::MayClimb { percent: 100.0 * climb });
    }
    // Too few points to compare parts of the way leave what the whole way allows.
    let drift = drift(&tracks, &fit, &images).unwrap_or(0.5 * climb);
    if !(drift <= 0.05) {
        return Err(MountFailure::HeightVaries { percent: 100.0 * drift });
    }
    Ok(Mount::new(&axes, &fit, drift, found))
}

/// Mean direction of the camera's way in its own frame.
fn way_in_cam(images: &[(FrameId, &Image)]) -> Result<Vector3<f64>, MountFailure> {
    let centers: Vec<Point3<f64>> = images.iter().map(|(_, image)| image.cam_from_world.center()).collect();
    let chord = |k: usize| centers[(k + 2).min(images.len() - 1)] - centers[k.saturating_sub(2)];
    let chords: Vec<Vector3<f64>> =
        images.iter().enumerate().map(|(k, (_, image))| image.cam_from_world.rotation * chord(k)).collect();
    // Where the vehicle stands, what is left is noise.
    let typical = median(chords.iter().map(|chord| chord.norm()).collect()).unwrap_or(0.0);
    let moving: Vec<Vector3<f64>> = chords.iter().filter(|c| c.norm() > 0.2 * typical).map(|c| c.normalize()).collect();
    let turns = |degrees| MountFailure::Turns { degrees };
    let mean = moving.iter().sum::<Vector3<f64>>().try_normalize(f64::EPSILON).ok_or(turns(90.0))?;
    let angle = median(moving.iter().map(|way| way.angle(&mean)).collect()).unwrap_or(std::f64::consts::FRAC_PI_2);
    // Median angle of the way against its mean direction in the camera's frame up to which the camera is fixed,
    // radians.
    if angle <= 0.04 { Ok(mean) } else { Err(turns(angle.to_degrees())) }
}

fn way_length(images: &[(FrameId, &Image)]) -> f64 {
    let center = |(_, image): (FrameId, &Image)| image.cam_from_world.center();
    images.windows(2).map(|pair| (center(pair[1]) - center(pair[0])).norm()).sum()
}

/// Robust standard deviation of the height between parts of the way, as a share of it (eq. 17); `None` where fewer than
/// three parts have points enough.
fn drift(tracks: &[Track], fit: &Fit, images: &[(FrameId, &Image)]) -> Option<f64> {
    let starts: Vec<FrameId> = (0..NUM_PARTS).map(|part| images[part * images.len() / NUM_PARTS].0).collect();
    let mut parts: Vec<Vec<&Track>> = vec![Vec::new(); NUM_PARTS];
    for track in tracks {
        let part = starts.partition_point(|start| *start <= track.places[0].frame).max(1) - 1;
        parts[part].push(track);
    }
    let heights = parts.iter().filter(|part| part.len() >= MIN_POINTS).filter_map(|part| height_of_part(part, fit));
    let off: Vec<f64> = heights.map(|height| (height / fit.height - 1.0).abs()).collect();
    (off.len() >= 3).then(|| STD_PER_MAD * median(off).unwrap_or(0.0))
}

/// Maximum change of the height over the trajectory, steadily or up and down again, so that nearly as many points lie
/// on the plane below the camera as at best: a share of the height (eq. 17a). A few points on a part of the trajectory
/// fit many.
fn possible_climb(tracks: &[Track], fit: &Fit, images: &[(FrameId, &Image)]) -> f64 {
    let (first, last) = (images[0].0.0, images[images.len() - 1].0.0);
    let along = |frame: FrameId| 2.0 * f64::from(frame.0 - first) / f64::from((last - first).max(1)) - 1.0;
    let steadily = |climb: f64| move |frame: FrameId| 1.0 + climb * along(frame);
    let up_and_down = |climb: f64| move |frame: FrameId| 1.0 + climb * (2.0 * along(frame).powi(2) - 1.0);
    let places = Supports::new(tracks, fit);
    let tried = (-10..=10).flat_map(|k| {
        let climb = 0.05 * f64::from(k);
        [
            (climb.abs(), support_of_course(tracks, &places, fit, steadily(climb))),
            (climb.abs(), support_of_course(tracks, &places, fit, up_and_down(climb))),
        ]
    });
    let tried: Vec<(f64, f64)> = tried.collect();
    let best = tried.iter().map(|(_, support)| *support).fold(0.0, f64::max);
    // Two points less than the best rule a climb out.
    let possible = tried.into_iter().filter(|(_, support)| *support >= best - 2.0);
    possible.map(|(climb, _)| climb).fold(0.0, f64::max)
}

/// The most support (eq. 5) that a plane gets whose distance from the camera follows `course`, up to a factor.
fn support_of_course(tracks: &[Track], places: &Supports, fit: &Fit, course: impl Fn(FrameId) -> f64) -> f64 {
    let slope = fit.slope();
    let height_at = |track: &Track| -slope(&track.places[0].at) / course(track.places[0].frame);
    let is_possible = |height: &f64| (0.5..2.0).contains(&(height / fit.height));
    let possible: Vec<f64> = tracks.iter().map(height_at).filter(is_possible).collect();
    // Bounds the cost; the support is a vote of many points, of which these are an even sample.
    let tried = possible.iter().step_by(possible.len().div_ceil(60).max(1));
    let mut heights: Vec<f64> = tried.copied().chain([fit.height]).collect();
    heights.sort_by(f64::total_cmp);
    places.supports(&heights, course).into_iter().fold(0.0, f64::max)
}

/// The height, up to twice or half of the mean, at which the most points of a part lie on the plane. All points take
/// part: those on the plane of the whole way would confirm it.
fn height_of_part(tracks: &[&Track], fit: &Fit) -> Option<f64> {
    let slope = fit.slope();
    // Bounds the cost: every candidate is compared with all points.
    let tried = tracks.iter().step_by(tracks.len().div_ceil(200)).map(|track| -slope(&track.places[0].at));
    let mut heights: Vec<f64> = tried.filter(|height| (0.5..2.0).contains(&(height / fit.height))).collect();
    heights.sort_by(f64::total_cmp);
    let supports = Supports::new(tracks.iter().copied(), fit).supports(&heights, |_| 1.0);
    supports.into_iter().zip(heights).max_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, height)| height)
}
