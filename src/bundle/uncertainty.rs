//! Standard deviations of a reconstruction's camera positions.

use std::collections::BTreeMap;

use nalgebra::Matrix3;

use super::clustered::Groups;
use super::covariance::{PoseCovariance, System};
use super::intrinsics_share::intrinsics_share;
use super::layout::Layout;
use super::options::{Behind, Options};
use super::problem::{BundleError, CameraBlock, IntrinsicsPrior, Problem};
use super::ties::FAR;
use crate::camera::NUM_INTRINSICS;
use crate::math::bin;
use crate::scene::{CameraId, ImageId, Reconstruction};

/// Factor on the residuals' noise for errors common to all observations: errors of the distortion or shutter model, and
/// points that slide with the view. Such errors do not average out, and intrinsics absorb them.
pub const COMMON_ERROR_FACTOR: f64 = 5.0;

/// Number of images above which loop closures would fill the normal equations.
const MANY_IMAGES: usize = 400;

/// Approximate number of images used of longer videos, by taking every second image, every third, and so on.
///
/// It bounds the size of the normal equations. Tracks keep at least [`LEAST_LEFT`] images on average.
const MOST_IMAGES: usize = 800;
/// Minimum mean track length after subsampling, images; see [`MOST_IMAGES`].
const LEAST_LEFT: usize = 4;

/// Standard deviations of camera centers.
#[derive(Clone, Debug, PartialEq)]
pub struct CenterDeviations {
    /// Standard deviation of a pixel coordinate, from the residuals.
    pub pixel_px: f64,
    /// The image that fixes the gauge: exact by definition.
    pub held: ImageId,
    /// The image farthest from it, which fixes the scale by the largest coordinate of `held` in its frame.
    pub farthest: ImageId,
    /// Per image: square root of the trace of its center's covariance, world units.
    pub centers: BTreeMap<ImageId, f64>,
}

/// Standard deviations of the centers of at most `num_images` images, evenly spread.
///
/// They are computed from the covariance of the reconstruction's bundle adjustment.
///
/// * `intrinsics` – prior standard deviations of fx, fy, cx, cy, k1, k2 of each camera; zero for constant parameters.
///   Intrinsics of absent cameras are constant.
///
/// With constant intrinsics, two values are computed, and the larger one is used. The first assumes independent
/// observation errors, with the pixel noise estimated from the residuals, σ² = Σ r² / (residuals − unknowns). The
/// second assumes errors correlated within a part of the time and of the image (a sandwich estimator over these
/// groups), as for sliding tracks.
///
/// In models of more than 400 images, the earlier observations of points re-detected after more than 96 images are
/// thinned ([`Problem::thin_ties`]).
///
/// Long videos are subsampled. Independent errors then average out over fewer images, and are scaled by the square root
/// of the subsampling factor; errors common to a group are not.
///
/// The values are relative to the gauge: the first image, which is exact by definition and omitted, and its distance to
/// the image farthest from it. The contribution of the intrinsics is added, except for a similarity of the whole
/// trajectory; it is an error common to all observations ([`COMMON_ERROR_FACTOR`]). Wrong matches are not modeled.
/// `None` if there are no more residuals than unknowns.
///
/// # Errors
/// As [`super::covariances`].
pub fn center_deviations(
    model: &Reconstruction,
    num_images: usize,
    intrinsics: &BTreeMap<CameraId, [f64; NUM_INTRINSICS]>,
) -> Result<Option<CenterDeviations>, BundleError> {
    let one_in = one_in(model);
    let mut problem = Problem::from_images(model, |_, camera| CameraBlock::fixed(*camera), one_in);
    if one_in > 1 {
        remove_single_observations(&mut problem);
    }
    problem.check()?;
    let Some(pixel_px) = pixel_deviation(&problem) else { return Ok(None) };
    if problem.poses.len() > MANY_IMAGES {
        problem.thin_ties(FAR as usize / one_in);
    }
    let observed: std::collections::BTreeSet<usize> = problem.observations.iter().map(|o| o.pose as usize).collect();
    let mut free: Vec<usize> = observed.into_iter().collect();
    if free.len() < 2 {
        return Ok(None);
    }
    let held = free.remove(0);
    let center = |pose: usize| problem.poses[pose].cam_from_world.center();
    let distance = |pose: usize| (center(pose) - center(held)).norm();
    let farthest = free.iter().copied().max_by(|a, b| distance(*a).total_cmp(&distance(*b)).then(b.cmp(a)));
    let farthest = farthest.unwrap_or(held);
    let count = num_images.min(free.len());
    let poses: Vec<usize> = (0..count).map(|k| free[k * (free.len() - 1) / (count - 1).max(1)]).collect();
    let ids: Vec<ImageId> = model.images.keys().copied().step_by(one_in).collect();
    let options = Options { threads: 1, behind: Behind::Project, ..Options::default() };
    let layout = Layout::new(&problem, &options, false);
    let mut system = System::new(&problem, &options, &layout, false, &groups(&problem))?;
    let alone: Vec<PoseCovariance> = poses.iter().map(|pose| system.pose(*pose)).collect::<Result<_, _>>()?;
    let clustered: Vec<Matrix3<f64>> =
        poses.iter().map(|pose| system.clustered_center(*pose)).collect::<Result<_, _>>()?;
    let of_intrinsics = shares_of_intrinsics(model, problem, &options, intrinsics, pixel_px / (one_in as f64).sqrt())?;
    let deviation = |(pose, (alone, clustered)): (&usize, (&PoseCovariance, &Matrix3<f64>))| {
        let alone = pixel_px * (alone.center.trace().max(0.0) / one_in as f64).sqrt();
        let share = of_intrinsics.get(*pose).map_or(0.0, |share| share.trace().max(0.0).sqrt());
        (ids[*pose], alone.max(clustered.trace().max(0.0).sqrt()).hypot(share))
    };
    let centers = poses.iter().zip(alone.iter().zip(&clustered)).map(deviation).collect();
    Ok(Some(CenterDeviations { pixel_px, held: ids[held], farthest: ids[farthest], centers }))
}

/// Covariances of the centers of a problem's poses caused by intrinsics with these prior standard deviations.
///
/// Empty if all are constant.
fn shares_of_intrinsics(
    model: &Reconstruction,
    mut problem: Problem,
    options: &Options,
    intrinsics: &BTreeMap<CameraId, [f64; NUM_INTRINSICS]>,
    pixel_px: f64,
) -> Result<Vec<Matrix3<f64>>, BundleError> {
    let unit_px = COMMON_ERROR_FACTOR * pixel_px;
    for (camera, (id, block)) in model.cameras.keys().zip(&mut problem.cameras).enumerate() {
        let Some(std) = intrinsics.get(id).filter(|_| unit_px > 0.0) else { continue };
        if std.iter().all(|std| !(*std > 0.0)) {
            continue;
        }
        block.free = std.map(|std| std > 0.0);
        let mut sigma = std.map(|std| if std > 0.0 { std / unit_px } else { f64::INFINITY });
        // A single focal length has the priors of fx and of fy.
        sigma[..2].iter_mut().for_each(|std| *std *= std::f64::consts::SQRT_2);
        problem.priors.intrinsics.push(IntrinsicsPrior { camera, values: block.camera.intrinsics(), sigma });
    }
    if problem.priors.intrinsics.is_empty() {
        return Ok(Vec::new());
    }
    let shares = intrinsics_share(&problem, options)?;
    Ok(shares.into_iter().map(|share| share * unit_px.powi(2)).collect())
}

/// Subsampling factor of the images.
fn one_in(model: &Reconstruction) -> usize {
    let num_seen: usize = model.points.values().map(|point| point.track.len()).sum();
    let mean_track = num_seen / model.points.len().max(1);
    (model.images.len() / MOST_IMAGES).min(mean_track / LEAST_LEFT).max(1)
}

/// Removes points with a single observation, whose depth is undetermined.
fn remove_single_observations(problem: &mut Problem) {
    let mut counts = vec![0u32; problem.points.len()];
    problem.observations.iter().for_each(|o| counts[o.point as usize] += 1);
    problem.observations.retain(|o| counts[o.point as usize] > 1);
}

/// Groups of points with correlated errors: those of one part of the time and of the image.
fn groups(problem: &Problem) -> Groups {
    // Parts of the time: with those of the image 48 groups, several times as many as a camera has parameters.
    const TIMES: usize = 8;
    // Parts of the image, across and down.
    const PARTS: [usize; 2] = [3, 2];
    let mut sums = vec![[0.0; 4]; problem.points.len()];
    for o in &problem.observations {
        let camera = &problem.cameras[problem.poses[o.pose as usize].camera].camera;
        let [u, v] = [o.pixel.x / f64::from(camera.width), o.pixel.y / f64::from(camera.height)];
        let sum = &mut sums[o.point as usize];
        for (cell, value) in sum.iter_mut().zip([f64::from(o.pose), u, v, 1.0]) {
            *cell += value;
        }
    }
    let group = |[pose, u, v, count]: &[f64; 4]| {
        let count = count.max(1.0);
        let time = bin(pose / count / problem.poses.len().max(1) as f64, TIMES);
        (time * PARTS[0] + bin(u / count, PARTS[0])) * PARTS[1] + bin(v / count, PARTS[1])
    };
    Groups { of_point: sums.iter().map(group).collect(), count: TIMES * PARTS[0] * PARTS[1] }
}

/// Standard deviation of a pixel coordinate, from the sum of squared residuals and the redundancy.
///
/// The seven gauge degrees of freedom are added back to the redundancy.
fn pixel_deviation(problem: &Problem) -> Option<f64> {
    let residual_sq = |o: &super::Observation| problem.residual_px(o).norm_squared();
    let sum: f64 = problem.observations.iter().map(residual_sq).filter(|sq| sq.is_finite()).sum();
    let mut is_seen = vec![false; problem.points.len()];
    problem.observations.iter().for_each(|o| is_seen[o.point as usize] = true);
    let num_points = is_seen.into_iter().filter(|seen| *seen).count();
    let unknowns = (problem.poses.len() * 6 + num_points * 3).saturating_sub(7);
    let redundancy = (2 * problem.observations.len()).checked_sub(unknowns).filter(|r| *r > 0)?;
    Some((sum / redundancy as f64).sqrt())
}
