//! The adjustment itself.

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

/// Maximum relative standard deviation of the ratio of all frames with which it is a better start than contact.
const SURE: f64 = 0.1;

/// Standard deviation of a vehicle's inclination against its plane, radians: springs, and planes that are not quite
/// plane.
const SIGMA_TILT: f64 = 0.03;
/// Standard deviations beyond which a plane, or an image position, loses weight (Cauchy): few of normal noise do.
const LOSS_SCALE: f64 = 3.0;

/// Relative change of the cost at which the adjustment of the whole object ends.
const TOLERANCE: f64 = 1e-6;
/// The same of the object without some of its tracks or frames, whose adjustment begins where that of the whole one
/// ended. At 1e-5 the sizes vary as they do at 1e-6, at 1e-4 the surest less.
const PART_TOLERANCE: f64 = 1e-5;

/// The ratio to begin with: of all frames where the camera's climb determines it, else where the object meets the
/// ground.
fn start(all_frames: &Result<LeastSquares, ScaleError>, views: &Views) -> Result<f64, ScaleError> {
    let usable = all_frames.as_ref().ok().filter(|found| found.ratio > 0.0 && found.ratio.is_finite());
    match usable {
        Some(found) if found.std <= SURE * found.ratio => Ok(found.ratio),
        Some(found) => Ok(intersection(views).map_or(found.ratio, |contact| contact.ratio)),
        None => Ok(intersection(views)?.ratio),
    }
}

/// The poses that see enough points to be known; all where there are none.
fn well_seen(problem: &Problem) -> Vec<usize> {
    // A pose has six degrees of freedom, three points determine it; with eight an outlier shows.
    const POINTS: usize = 8;
    let mut counts = vec![0; problem.poses.len()];
    problem.observations.iter().for_each(|observation| counts[observation.pose as usize] += 1);
    let enough: Vec<usize> = (0..counts.len()).filter(|&pose| counts[pose] >= POINTS).collect();
    if enough.is_empty() { (0..counts.len()).collect() } else { enough }
}

/// An object's reconstruction with the ground at z = 0, in the background's unit.
#[derive(Clone)]
pub(super) struct Adjustment<'a> {
    pub(super) evidence: &'a Evidence<'a>,
    options: &'a JointOptions,
    contact_options: ContactOptions,
    pub(super) object: Reconstruction,
    /// Standard deviation of an image position before it is made to count less.
    noise_px: f64,
    /// Drift of the object's distance to the ground, as a share of the camera's height over it; within bounds.
    wander: f64,
    /// The median of that height, units of the background.
    camera_height: f64,
    /// Share of the cost at which an adjustment ends.
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
        let ratio = start(&all_frames, views)?;
        let spread = all_frames.as_ref().map_or(f64::INFINITY, |found| found.residual_std);
        let level = UnitQuaternion::rotation_between(&up, &Vector3::z())
            .unwrap_or_else(|| UnitQuaternion::from_euler_angles(std::f64::consts::PI, 0.0, 0.0));
        let center = object_center(evidence.object);
        let heights: Vec<f64> =
            views.views.iter().map(|view| view.camera_height + ratio * view.offset(&center)).collect();
        let height = median(heights).unwrap_or(0.0);
        let camera_height = median(views.views.iter().map(|view| view.camera_height.abs()).collect()).unwrap_or(0.0);
        let [least, most] = options.sigma_distance;
        let wander = (spread / camera_height).max(least).min(most);
        let lift = Vector3::z() * height - level * (center.coords * ratio);
        let mut object = evidence.object.clone();
        object.transform(&Sim3::new(ratio, level, lift));
        let residuals = residuals(&object).flat_map(|residual| [residual.x.abs(), residual.y.abs()]).collect();
        let noise_px = STD_PER_MAD * median(residuals).ok_or(ScaleError::NoObservations)?;
        let noise_px = noise_px.max(1e-3);
        let contact_options = Body::of_class(&evidence.description.class).contact(&options.contact);
        Ok(Self { evidence, options, contact_options, object, noise_px, wander, camera_height, tolerance: TOLERANCE })
    }

    /// The same adjustment of a part of the object.
    pub(super) fn with_object(&self, object: Reconstruction) -> Self {
        Self { object, ..self.clone() }
    }

    /// The same, adjusted as far as it takes to see by how much the part's size differs.
    pub(super) fn of_part(&self, object: Reconstruction) -> Self {
        Self { tolerance: PART_TOLERANCE, ..self.with_object(object) }
    }

    /// The same, as little believed as can be: how little an object wanders in a few frames is no proof.
    pub(super) fn in_doubt(&self) -> Self {
        Self { wander: self.options.max_drift(), ..self.clone() }
    }

    /// Where the outlines put the ground.
    pub(super) fn contact(&self) -> Result<Contact, ScaleError> {
        contact(&self.object, self.evidence.silhouettes, self.forward(), &self.contact_options).ok_or_else(|| {
            let num_points = self.object.points.len();
            ScaleError::NoSolidPoints { num_points, min_track: self.options.contact.min_track }
        })
    }

    /// The vehicle's forward direction, from its way through the background.
    fn forward(&self) -> Option<Unit<Vector3<f64>>> {
        let Evidence { background, frames, .. } = self.evidence;
        forward_axis(&poses(background, &self.object, 1.0, frames))
    }

    /// One adjustment; outlines say that the ground is at `contact`.
    pub(super) fn round(&mut self, contact: &Contact) -> Result<(), ScaleError> {
        let mut problem = self.problem(contact);
        let options = bundle::Options { function_tolerance: self.tolerance, ..self.bundle_options(&problem) };
        bundle::adjust(&mut problem, &options).map_err(|error| ScaleError::Adjustment(error.to_string()))?;
        problem.store(&mut self.object);
        Ok(())
    }

    fn bundle_options(&self, problem: &Problem) -> bundle::Options {
        let scale = LOSS_SCALE / self.devaluation(problem);
        bundle::Options { loss: RobustLoss::Cauchy { scale }, threads: 1, ..bundle::Options::default() }
    }

    /// Factor on the standard deviation of an image position, so that those of one frame count as few.
    fn devaluation(&self, problem: &Problem) -> f64 {
        let per_frame = problem.observations.len() as f64 / problem.poses.len().max(1) as f64;
        let drift = self.wander / self.options.sigma_distance[1];
        ((per_frame / self.options.independent_points).sqrt() * drift).max(1.0)
    }

    fn problem(&self, contact: &Contact) -> Problem {
        let mut problem = Problem::from_reconstruction(&self.object, |_, camera| CameraBlock::fixed(*camera));
        let sigma = self.noise_px * self.devaluation(&problem);
        for observation in &mut problem.observations {
            observation.whitening = Whitening::isotropic(sigma);
        }
        problem.priors.planes = self.planes();
        problem.priors.points = self.anchors(contact);
        problem
    }

    /// Plane i below the middle of the vehicle.
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

    /// Standard deviation of a plane's distance to the vehicle, by what is seen of it over all frames.
    fn sigma_distance(&self, image: &Image, middle: &Point3<f64>) -> f64 {
        let distance = (middle - image.cam_from_world.center()).norm();
        (self.wander * lever(self.camera_height, distance)).max(f64::MIN_POSITIVE)
    }

    /// Standard deviation of the ground's height that all frames have in common, as a share of the camera's height.
    pub(super) fn common_height_std(&self) -> f64 {
        let share = common_height_std(self.evidence.planes.values()) / self.camera_height;
        if share.is_finite() { share } else { 0.0 }
    }

    /// The outlines' word on where the ground is, spread over all points: each is near where it is, but lower by the
    /// height at which the outlines see the ground. Together they weigh as much as the contact is known.
    fn anchors(&self, contact: &Contact) -> Vec<PointPrior> {
        let sigma = (contact.std * (self.object.points.len() as f64).sqrt()).max(f64::MIN_POSITIVE);
        let lowered = self.object.points.values().map(|point| point.position - Vector3::z() * contact.z);
        let anchor = |(point, position)| PointPrior { point, position, sigma };
        lowered.enumerate().map(anchor).filter(|anchor| anchor.position.coords.iter().all(|x| x.is_finite())).collect()
    }

    /// Standard deviation of the object's size, relative to it: that of its distance from the camera, since its size in
    /// the picture is known exactly. The median of a few frames that see it well.
    pub(super) fn relative_std(&self, contact: &Contact) -> Result<f64, ScaleError> {
        // Odd, for a median; each costs a solution of the normal equations.
        const FRAMES: usize = 5;
        let problem = self.problem(contact);
        let candidates = well_seen(&problem);
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
        let deviations = poses.iter().zip(&found.poses).map(|(pose, covariance)| {
            let sight = middle - problem.poses[*pose].cam_from_world.center();
            let distance = sight.norm();
            let along = sight / distance;
            (along.dot(&(covariance.center * along)).max(0.0)).sqrt() / distance
        });
        median(deviations.collect()).filter(|std| std.is_finite()).ok_or(ScaleError::NoCovariance)
    }

    /// The similarity onto the points of the reconstruction that this was made from.
    pub(super) fn back_to(&self, original: &Reconstruction) -> Option<Sim3> {
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
    fn views_of_few_points_are_not_asked_how_sure_they_are() {
        let mut object = drive(&drive::Options { num_frames: 8, ..drive::Options::default() }, 1).object;
        let last = object.images.values_mut().last().unwrap();
        last.observations.iter_mut().skip(7).for_each(|seen| seen.point = None);
        let problem =
            |object: &Reconstruction| Problem::from_reconstruction(object, |_, camera| CameraBlock::fixed(*camera));
        assert_eq!(well_seen(&problem(&object)), [0, 1, 2, 3, 4, 5, 6]);
        for image in object.images.values_mut() {
            image.observations.iter_mut().skip(7).for_each(|seen| seen.point = None);
        }
        assert_eq!(well_seen(&problem(&object)).len(), 8);
    }
}
