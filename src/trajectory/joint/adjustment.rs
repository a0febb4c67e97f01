//! The joint bundle adjustment.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Point3, Unit, UnitQuaternion, Vector3};

use super::JointOptions;
use super::precision::residuals;
use crate::bundle::{self, BundleError, CameraBlock, PlanePrior, PointPrior, Problem, Wanted, Whitening};
use crate::math::{RobustLoss, STD_PER_MAD, Sim3, median, umeyama};
use crate::scene::{FrameId, Image, Reconstruction};
use crate::trajectory::assemble::poses;
use crate::trajectory::views::{common_height_std, lever, mean_normal};
use crate::trajectory::{
    Body, Contact, ContactOptions, Evidence, LeastSquares, Options, ScaleError, Views, contact, forward_axis,
    intersection, least_squares, object_center,
};

/// Maximum relative standard deviation of the ratio of all frames with which it is a better initial value than contact.
const SURE: f64 = 0.1;

/// Standard deviation of a vehicle's inclination relative to its plane, radians: suspension, and ground that is not
/// quite planar.
const SIGMA_TILT: f64 = 0.03;
/// Standard deviations beyond which a plane, or an image position, loses weight (Cauchy): few of Gaussian noise do.
const LOSS_SCALE: f64 = 3.0;

/// Relative change of the cost at which the adjustment of the whole object has converged.
const TOLERANCE: f64 = 1e-6;
/// The same for the object without some of its tracks or frames, whose adjustment starts from the result of the whole
/// one. At 1e-5 the sizes vary as at 1e-6, at 1e-4 the most certain ones vary less.
const PART_TOLERANCE: f64 = 1e-5;

/// Initial ratio: that of all frames where the camera's climb determines it, else that of contact with the ground.
fn initial_ratio(all_frames: &Result<LeastSquares, ScaleError>, views: &Views) -> Result<f64, ScaleError> {
    let usable = all_frames.as_ref().ok().filter(|found| found.ratio > 0.0 && found.ratio.is_finite());
    match usable {
        Some(found) if found.std <= SURE * found.ratio => Ok(found.ratio),
        Some(found) => Ok(intersection(views).map_or(found.ratio, |contact| contact.ratio)),
        None => Ok(intersection(views)?.ratio),
    }
}

/// Poses with enough observations; all if there are none.
fn well_observed(problem: &Problem) -> Vec<usize> {
    // A pose has six degrees of freedom, three points determine it; with eight an outlier is recognizable.
    const POINTS: usize = 8;
    let mut counts = vec![0; problem.poses.len()];
    problem.observations.iter().for_each(|observation| counts[observation.pose as usize] += 1);
    let enough: Vec<usize> = (0..counts.len()).filter(|&pose| counts[pose] >= POINTS).collect();
    if enough.is_empty() { (0..counts.len()).collect() } else { enough }
}

/// Reconstruction of an object with the ground at z = 0, in the background's unit.
#[derive(Clone)]
pub(super) struct Adjustment<'a> {
    pub(super) evidence: &'a Evidence<'a>,
    options: &'a JointOptions,
    contact_options: ContactOptions,
    pub(super) object: Reconstruction,
    /// Standard deviation of an image position, before its inflation.
    noise_px: f64,
    /// Drift of the object's distance to the ground, as a share of the camera's height over it; within its bounds.
    drift: f64,
    /// Median of that height, units of the background.
    camera_height: f64,
    /// Relative change of the cost at which an adjustment has converged.
    tolerance: f64,
}

impl<'a> Adjustment<'a> {
    pub(super) fn new(evidence: &'a Evidence<'a>, views: &Views, options: &'a Options) -> Result<Self, ScaleError> {
        let (up, _) = mean_normal(views).ok_or(ScaleError::NoMeanNormal { num_views: views.views.len() })?;
        let all_frames = match views.camera_hovers {
            true => Err(ScaleError::CameraHovers),
            false => least_squares(views, &options.least_squares),
        };
        let options = &options.joint;
        let ratio = initial_ratio(&all_frames, views)?;
        let spread = all_frames.as_ref().map_or(f64::INFINITY, |found| found.residual_std);
        let level = UnitQuaternion::rotation_between(&up, &Vector3::z())
            .unwrap_or_else(|| UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0));
        let center = object_center(evidence.object);
        let heights: Vec<f64> =
            views.views.iter().map(|view| view.camera_height + ratio * view.offset(&center)).collect();
        let height = median(heights).unwrap_or(0.0);
        let camera_height = median(views.views.iter().map(|view| view.camera_height.abs()).collect()).unwrap_or(0.0);
        let [least, most] = options.sigma_distance;
        let drift = (spread / camera_height).max(least).min(most);
        let lift = Vector3::z() * height - level * (center.coords * ratio);
        let mut object = evidence.object.clone();
        object.transform(&Sim3::new(ratio, level, lift));
        let residuals = residuals(&object).flat_map(|residual| [residual.x.abs(), residual.y.abs()]).collect();
        let noise_px = STD_PER_MAD * median(residuals).ok_or(ScaleError::NoObservations)?;
        let noise_px = noise_px.max(1e-3);
        let contact_options = Body::of_class(&evidence.description.class).contact(&options.contact);
        Ok(Self { evidence, options, contact_options, object, noise_px, drift, camera_height, tolerance: TOLERANCE })
    }

    /// The same adjustment for a part of the object.
    pub(super) fn with_object(&self, object: Reconstruction) -> Self {
        Self { object, ..self.clone() }
    }

    /// The same for a part, with a tolerance that suffices for the difference of its size.
    pub(super) fn of_part(&self, object: Reconstruction) -> Self {
        Self { tolerance: PART_TOLERANCE, ..self.with_object(object) }
    }

    /// The same with the maximum drift: a small drift over a few frames is not evidence of an accurate object.
    pub(super) fn with_max_drift(&self) -> Self {
        Self { drift: self.options.max_drift(), ..self.clone() }
    }

    /// Height of the ground by the outlines.
    pub(super) fn contact(&self) -> Result<Contact, ScaleError> {
        contact(&self.object, self.evidence.silhouettes, self.forward(), &self.contact_options).ok_or_else(|| {
            let num_points = self.object.points.len();
            ScaleError::NoSolidPoints { num_points, min_track: self.options.contact.min_track }
        })
    }

    /// Forward direction of the vehicle, from its path in the background.
    fn forward(&self) -> Option<Unit<Vector3<f64>>> {
        let Evidence { background, frames, .. } = self.evidence;
        forward_axis(&poses(background, &self.object, 1.0, frames))
    }

    /// Runs one adjustment, with the height of the ground by the outlines at `contact`.
    pub(super) fn round(&mut self, contact: &Contact) -> Result<(), ScaleError> {
        let mut problem = self.problem(contact);
        let options = bundle::Options { function_tolerance: self.tolerance, ..self.bundle_options(&problem) };
        bundle::adjust(&mut problem, &options).map_err(|error| ScaleError::Adjustment(error.to_string()))?;
        problem.store(&mut self.object);
        Ok(())
    }

    fn bundle_options(&self, problem: &Problem) -> bundle::Options {
        let scale = LOSS_SCALE / self.std_inflation(problem);
        bundle::Options { loss: RobustLoss::Cauchy { scale }, threads: 1, ..bundle::Options::default() }
    }

    /// Factor on the standard deviation of an image position, for the effective number of points per frame.
    fn std_inflation(&self, problem: &Problem) -> f64 {
        let per_frame = problem.observations.len() as f64 / problem.poses.len().max(1) as f64;
        let drift = self.drift / self.options.sigma_distance[1];
        ((per_frame / self.options.independent_points).sqrt() * drift).max(1.0)
    }

    fn problem(&self, contact: &Contact) -> Problem {
        let mut problem = Problem::from_reconstruction(&self.object, |_, camera| CameraBlock::fixed(*camera));
        let sigma = self.noise_px * self.std_inflation(&problem);
        for observation in &mut problem.observations {
            observation.whitening = Whitening::isotropic(sigma);
        }
        problem.priors.planes = self.planes();
        problem.priors.points = self.anchors(contact);
        problem
    }

    /// Priors of the planes below the center of the vehicle, by frame.
    fn planes(&self) -> Vec<PlanePrior> {
        let Evidence { background, planes, .. } = self.evidence;
        let middle = object_center(&self.object);
        let pose_of: BTreeMap<&str, usize> =
            self.object.images.values().map(|image| image.name.as_str()).zip(0..).collect();
        let known = |(frame, in_background, in_object): (FrameId, &Image, &Image)| {
            let plane = planes.get(&frame)?;
            Some(PlanePrior {
                pose: *pose_of.get(in_object.name.as_str())?,
                normal_in_cam: in_background.cam_from_world.rotation * plane.normal,
                camera_height: plane.signed_distance(in_background.cam_from_world.center()),
                point: Point3::new(middle.x, middle.y, 0.0),
                up: Vector3::z(),
                sigma_distance: self.sigma_distance(in_object, &middle).max(plane.own_height_std()),
                sigma_tilt: SIGMA_TILT.max(plane.tilt_std),
                loss: RobustLoss::Cauchy { scale: LOSS_SCALE },
            })
        };
        let mut found: Vec<PlanePrior> = background.paired_images(&self.object).into_iter().filter_map(known).collect();
        found.retain(|plane| plane.camera_height.is_finite() && plane.normal_in_cam.norm_squared() > 0.5);
        found
    }

    /// Standard deviation of a plane's distance to the vehicle, from the drift over all frames.
    fn sigma_distance(&self, image: &Image, middle: &Point3<f64>) -> f64 {
        let distance = (middle - image.cam_from_world.center()).norm();
        (self.drift * lever(self.camera_height, distance)).max(f64::MIN_POSITIVE)
    }

    /// Standard deviation of the ground's height that all frames share, as a share of the camera's height.
    pub(super) fn common_height_std(&self) -> f64 {
        let share = common_height_std(self.evidence.planes.values()) / self.camera_height;
        if share.is_finite() { share } else { 0.0 }
    }

    /// Height of the ground by the outlines, as priors on all points.
    ///
    /// The prior of a point is its position, lowered by the height of the ground by the outlines. Together they have
    /// the weight of the contact's standard deviation.
    fn anchors(&self, contact: &Contact) -> Vec<PointPrior> {
        let sigma = (contact.std * (self.object.points.len() as f64).sqrt()).max(f64::MIN_POSITIVE);
        let lowered = self.object.points.values().map(|point| point.position - Vector3::z() * contact.z);
        let anchor = |(point, position)| PointPrior { point, position, sigma };
        lowered.enumerate().map(anchor).filter(|anchor| anchor.position.coords.iter().all(|x| x.is_finite())).collect()
    }

    /// Relative standard deviation of the object's size.
    ///
    /// It is that of its distance from the camera, since its size in the image is known exactly: the median over a few
    /// frames with enough observations.
    pub(super) fn relative_std(&self, contact: &Contact) -> Result<f64, ScaleError> {
        // An odd number, for a median; each costs a solution of the normal equations.
        const FRAMES: usize = 5;
        let problem = self.problem(contact);
        let candidates = well_observed(&problem);
        let last = candidates.len().saturating_sub(1);
        let poses: BTreeSet<usize> =
            (0..FRAMES).filter_map(|k| candidates.get(k * last / (FRAMES - 1)).copied()).collect();
        let wanted = Wanted { poses: poses.iter().copied().collect(), ..Wanted::default() };
        let options = self.bundle_options(&problem);
        let failed = |error: BundleError| match error {
            BundleError::Singular { .. } | BundleError::NoCovariance { .. } => ScaleError::NoCovariance,
            other => ScaleError::Adjustment(other.to_string()),
        };
        let found = bundle::covariances(&problem, &options, &wanted).map_err(failed)?;
        let middle = object_center(&self.object);
        let stds = poses.iter().zip(&found.poses).map(|(pose, covariance)| {
            let sight = middle - problem.poses[*pose].cam_from_world.center();
            let distance = sight.norm();
            let along = sight / distance;
            (along.dot(&(covariance.center * along)).max(0.0)).sqrt() / distance
        });
        median(stds.collect()).filter(|std| std.is_finite()).ok_or(ScaleError::NoCovariance)
    }

    /// Similarity that aligns the points with those of the original reconstruction.
    pub(super) fn similarity_to(&self, original: &Reconstruction) -> Option<Sim3> {
        let solid: Vec<_> = self
            .object
            .points
            .iter()
            .filter(|(_, point)| point.track.len() >= self.options.contact.min_track)
            .filter_map(|(id, point)| Some((point.position, original.points.get(id)?.position)))
            .filter(|(a, b)| a.coords.iter().chain(b.coords.iter()).all(|x| x.is_finite()))
            .collect();
        let (from, to): (Vec<_>, Vec<_>) = solid.into_iter().unzip();
        umeyama(&from, &to).filter(|found| found.scale > 0.0 && found.scale.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{self, drive};

    #[test]
    fn poses_with_few_observations_are_skipped() {
        let mut object = drive(&drive::Options { num_frames: 8, ..drive::Options::default() }, 1).object;
        let last = object.images.values_mut().last().unwrap();
        last.observations.iter_mut().skip(7).for_each(|seen| seen.point = None);
        let problem =
            |object: &Reconstruction| Problem::from_reconstruction(object, |_, camera| CameraBlock::fixed(*camera));
        assert_eq!(well_observed(&problem(&object)), [0, 1, 2, 3, 4, 5, 6]);
        for image in object.images.values_mut() {
            image.observations.iter_mut().skip(7).for_each(|seen| seen.point = None);
        }
        assert_eq!(well_observed(&problem(&object)).len(), 8);
    }
}
