//! Height of the camera over the ground, and the up direction.
//!
//! In evenly spaced frames a plane is fitted to the ground points nearest to the camera (eq. 4 to 8 of
//! `docs/maths/ground.md`). The height is that over this plane, with the standard deviation of the plane at the foot of
//! the camera. The result is the mean over the frames, since a climbing camera has no single height.

use nalgebra::{Point3, Vector3};
use thiserror::Error;

use super::Options;
use super::plane::{Candidate, fit_plane};
use crate::camera::SLOPE_STD;
use crate::math::{Neighbors, is_finite, median, seeded_rng};
use crate::scene::{Image, Point3dId, Reconstruction};

/// Height of the camera over the ground, in units of the background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraHeight {
    /// Mean over the frames.
    pub mean: f64,
    /// Standard deviation of the mean.
    pub std: f64,
    /// Standard deviation of the heights over the frames, as a share of the mean.
    pub spread: f64,
    /// Mean unit normal of the planes, towards the camera.
    pub up_in_world: Vector3<f64>,
    /// RMS angle between the normals and their mean, radians.
    pub tilt_spread: f64,
    /// Frames with a plane below the camera.
    pub num_frames: usize,
    /// Foot of the first of these cameras on its plane.
    pub foot_in_world: Point3<f64>,
}

impl CameraHeight {
    /// Standard deviation of the normal as the vertical, radians.
    ///
    /// The ground is not level, and half of the spread of the planes is common to all of them.
    pub fn tilt_std(&self) -> f64 {
        SLOPE_STD.hypot(0.5 * self.tilt_spread)
    }
}

/// Reason why the height of the camera over the ground is unknown.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum HeightFailure {
    /// Too few ground points.
    #[error("only {found} ground points; at least {needed} needed")]
    TooFewPoints {
        /// Number of ground points.
        found: usize,
        /// Minimum number of ground points.
        needed: usize,
    },
    /// Too few frames have ground near the camera.
    #[error("only {found} of {of} examined frames have ground near the camera")]
    TooFewFrames {
        /// Number of frames with a plane.
        found: usize,
        /// Number of examined frames.
        of: usize,
    },
}

/// Common error of the planes of one scene (drift, cambers, grass), as a share of the height. In seven rendered flights
/// (bumpy road, crossing, left curves, overtaking, two of right curves, steep street) heights were 0.4 to 3.3 % short.
const COMMON_STD: f64 = 0.018;

/// Estimates the height of the camera over the ground, and the mean normal of the ground.
///
/// * `ground_points` – ascending.
///
/// # Errors
/// [`HeightFailure`] where too little of the ground is near the camera.
pub fn camera_height(
    background: &Reconstruction,
    ground_points: &[Point3dId],
    options: &Options,
    seed: u64,
) -> Result<CameraHeight, HeightFailure> {
    let points = ground_points.iter().filter_map(|id| background.points.get(id)).map(|point| point.position);
    let points: Vec<[f64; 3]> = points.filter(is_finite).map(|position| position.coords.into()).collect();
    let needed = options.min_points.max(3);
    let too_few = HeightFailure::TooFewPoints { found: points.len(), needed };
    let tree = Neighbors::new(&points).filter(|_| points.len() >= needed).ok_or(too_few)?;
    // More than 60 frames add little information.
    let every = background.images.len().div_ceil(60).max(1);
    let images: Vec<&Image> = background.images.values().step_by(every).collect();
    let found: Vec<PlaneBelow> = (0..)
        .zip(&images)
        .filter_map(|(k, image)| {
            let center = image.cam_from_world.center();
            // Enough points to extend beyond a lane.
            let near = tree.nearest(&center.coords.into(), 200).into_iter().map(|i| points[i].into());
            PlaneBelow::of(background, image, near, options, (seed, 0x6865_6967_6874 + k))
        })
        .collect();
    mean(&found, images.len()).ok_or(HeightFailure::TooFewFrames { found: found.len(), of: images.len() })
}

/// Ground plane below one camera.
struct PlaneBelow {
    height: f64,
    std: f64,
    normal: Vector3<f64>,
    foot: Point3<f64>,
}

impl PlaneBelow {
    fn of(
        background: &Reconstruction,
        image: &Image,
        near: impl Iterator<Item = Point3<f64>>,
        options: &Options,
        (seed, stream): (u64, u64),
    ) -> Option<Self> {
        let center = image.cam_from_world.center();
        let per_distance = options.max_error_px / background.camera_of(image).mean_focal();
        let candidate =
            |position: Point3<f64>| Candidate { position, tolerance: per_distance * (position - center).norm() };
        let candidates: Vec<Candidate> = near.map(candidate).filter(|candidate| candidate.tolerance > 0.0).collect();
        let rng = &mut seeded_rng(seed, stream);
        let plane = fit_plane(&candidates, options.min_points, options.max_samples, |_, support| support, rng).ok()?;
        let height = plane.distance(&center);
        let normal = plane.normal * height.signum();
        let foot = center - normal * height.abs();
        let std = plane.height_std_at(&foot).hypot(plane.rms / (plane.num_inliers as f64).sqrt());
        // Maximum standard deviation of a usable plane at the foot of the camera, as a share of the height.
        (std <= 0.1 * height.abs()).then_some(Self { height: height.abs(), std, normal, foot })
    }
}

/// Means over the frames; `None` where fewer than a fifth of them have a plane.
fn mean(found: &[PlaneBelow], num_frames: usize) -> Option<CameraHeight> {
    let first = found.first().filter(|_| 5 * found.len() >= num_frames)?;
    let num = found.len() as f64;
    let mean = found.iter().map(|below| below.height).sum::<f64>() / num;
    let spread = (found.iter().map(|below| (below.height - mean).powi(2)).sum::<f64>() / num).sqrt() / mean;
    let up_in_world = found.iter().map(|below| below.normal).sum::<Vector3<f64>>().try_normalize(f64::EPSILON)?;
    let angles: f64 = found.iter().map(|below| below.normal.angle(&up_in_world).powi(2)).sum();
    // Planes of neighboring frames share points, so their errors do not average out. The heights in frames without a
    // plane are unknown as well.
    let of_planes = median(found.iter().map(|below| below.std / below.height).collect())?;
    let of_other_frames = spread * (1.0 - num / num_frames as f64);
    let share = COMMON_STD.hypot(of_planes).hypot(of_other_frames);
    (mean.is_finite() && mean > 0.0 && share.is_finite()).then_some(CameraHeight {
        mean,
        std: share * mean,
        spread,
        up_in_world,
        tilt_spread: (angles / num).sqrt(),
        num_frames: found.len(),
        foot_in_world: first.foot,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{self, Noise, Terrain, drive};

    #[test]
    fn the_height_over_flat_ground_is_that_of_the_cameras() {
        let noise = Noise { pixel_px: 0.5, ..Noise::default() };
        let world = drive(&drive::Options { noise, terrain: Terrain::Flat, ..Default::default() }, 3);
        let found = camera_height(&world.background, &world.ground_points, &Options::default(), 7).unwrap();
        let up = world.planes.values().next().unwrap().normal;
        let heights = world.background.images.iter().map(|(id, image)| {
            let plane = &world.planes[&id.frame()];
            plane.signed_distance(image.cam_from_world.center())
        });
        let expected = heights.sum::<f64>() / world.background.images.len() as f64;
        assert!((found.mean / expected - 1.0).abs() < 0.02, "{found:?} {expected}");
        assert!(found.std / found.mean < 0.05 && found.up_in_world.angle(&up) < 0.03, "{found:?}");
    }

    #[test]
    fn without_ground_there_is_no_height() {
        let world = drive(&drive::Options { num_frames: 4, ..Default::default() }, 3);
        let none = camera_height(&world.background, &[], &Options::default(), 7);
        assert!(matches!(none, Err(HeightFailure::TooFewPoints { found: 0, .. })), "{none:?}");
        assert!(none.unwrap_err().to_string().contains("0 ground points"));
    }
}
