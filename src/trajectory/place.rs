//! Trajectory of an object from reconstructions, planes and outlines: the main entry point for users of the library.
//!
//! With the method `joint` the object's reconstruction is first adjusted together with the ground
//! ([`joint`](super::joint())). If that fails, or for another method, it is used unchanged and [`estimate_scale`]
//! determines the ratio. In both cases the trajectory refers to [`PlacedObject::object`].

use std::collections::BTreeMap;

use nalgebra::Matrix3;

use super::estimate::{estimate_scale, joint_estimate, ratios_of, references, with_focal};
use super::pose_error;
use super::{Joint, ObjectDescription, Options, ScaleError, Silhouette, Views, assemble, joint};
use crate::scene::{Frame, FrameId, GroundPlane, ObjectTrajectory, Reconstruction, ScaleEstimate, ScaleMethod};

/// Origin of an object's model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelOrigin {
    /// Structure from motion: `joint` may adjust it.
    Reconstructed,
    /// Given by the user: used unchanged with every method.
    Given,
}

/// Input of [`place()`]: one object and the scene around it.
#[derive(Clone, Debug)]
pub struct Evidence<'a> {
    /// Id, class and score, copied to the trajectory.
    pub description: ObjectDescription,
    /// Origin of `object`.
    pub origin: ModelOrigin,
    /// The background's reconstruction.
    pub background: &'a Reconstruction,
    /// The object's reconstruction, not adjusted.
    pub object: &'a Reconstruction,
    /// The local plane of each frame, in the background's frame; frames without one are absent.
    pub planes: &'a BTreeMap<FrameId, GroundPlane>,
    /// The object's outlines; only `joint` uses them.
    pub silhouettes: &'a BTreeMap<FrameId, Silhouette>,
    /// All frames.
    pub frames: &'a [Frame],
    /// Relative standard deviation of the camera's focal length; `None` where the focal length is given, or the
    /// standard deviation not known.
    pub focal_std: Option<f64>,
}

/// Result for one object: model, adjustment and trajectory.
#[derive(Clone, Debug)]
pub struct PlacedObject {
    /// The model to which the trajectory refers: adjusted with the ground where that was done, otherwise unchanged.
    pub object: Reconstruction,
    /// Outcome of the adjustment with the ground.
    pub adjustment: Adjustment,
    /// The trajectory, in units of the background, or the reason why there is none.
    pub trajectory: Result<ObjectTrajectory, ScaleError>,
    /// Covariance of the position in each frame, in the frame and unit of the background, without that of the ratio.
    pub pose_covariances: BTreeMap<FrameId, Matrix3<f64>>,
    /// Frames in which the model has a pose, but no position.
    pub dropped: DroppedFrames,
}

/// Frames whose pose does not determine the vehicle's position, ascending.
#[derive(Clone, Debug, Default)]
pub struct DroppedFrames {
    /// The standard deviation of the position exceeds the size of the model.
    pub uncertain: Vec<FrameId>,
    /// The motion before and after the frame contradicts the position.
    pub contradicted: Vec<FrameId>,
}

/// Outcome of the adjustment with the ground.
#[derive(Clone, Debug, PartialEq)]
pub enum Adjustment {
    /// Not requested: another method, or a model given by the user.
    None,
    /// The model was adjusted.
    Done(AdjustmentFigures),
    /// The model is unchanged.
    Failed(ScaleError),
}

/// Figures of the adjustment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdjustmentFigures {
    /// Frames whose outline determines the ground; 0 where it was assumed from the lowest points.
    pub frames_with_outline: usize,
    /// Median reprojection error before and after, pixels.
    pub error_px: [f64; 2],
    /// Points that were removed because their position is too uncertain.
    pub num_uncertain: usize,
}

/// Places one object: adjusts its model if `options` request it, estimates the scale ratio, assembles the trajectory.
///
/// Never fails as a whole: [`PlacedObject::trajectory`] and [`PlacedObject::adjustment`] contain the failed steps with
/// their reasons.
pub fn place(evidence: &Evidence, options: &Options) -> PlacedObject {
    let initial_views = Views::new(evidence.background, evidence.object, evidence.planes, options);
    let is_adjusted = options.method == ScaleMethod::Joint && evidence.origin == ModelOrigin::Reconstructed;
    let adjustment = match is_adjusted.then(|| joint(evidence, &initial_views, options)) {
        Some(Ok(found)) => return evidence.adjusted(found, &initial_views, options),
        Some(Err(error)) => Adjustment::Failed(error),
        None => Adjustment::None,
    };
    let method = match options.method {
        ScaleMethod::Joint => ScaleMethod::RobustLeastSquares,
        method => method,
    };
    let scale = estimate_scale(&initial_views, method, options)
        .map(|scale| with_focal(scale, evidence.focal_std, options.max_relative_std));
    evidence.with_scale(evidence.object.clone(), adjustment, scale, options)
}

impl Evidence<'_> {
    /// Result after an adjustment; `views_before` are the views of the model before.
    fn adjusted(&self, found: Joint, views_before: &Views, options: &Options) -> PlacedObject {
        let views = Views::new(self.background, &found.object, self.planes, options);
        let as_reconstructed = Some(ratios_of(views_before, options));
        let references = references(views_before, options);
        let scale = joint_estimate(&views, &found, options, self.focal_std);
        let scale = ScaleEstimate { as_reconstructed, references, ..scale };
        let Joint { object, contact, error_px, num_uncertain, .. } = found;
        let figures = AdjustmentFigures { frames_with_outline: contact.num_frames, error_px, num_uncertain };
        self.with_scale(object, Adjustment::Done(figures), Ok(scale), options)
    }

    /// Result for an object whose scale ratio was estimated, or has failed.
    fn with_scale(
        &self,
        object: Reconstruction,
        adjustment: Adjustment,
        scale: Result<ScaleEstimate, ScaleError>,
        options: &Options,
    ) -> PlacedObject {
        let mut trajectory = scale.and_then(|scale| self.trajectory(&object, scale));
        let (mut pose_covariances, mut dropped) = (BTreeMap::new(), DroppedFrames::default());
        if let Ok(trajectory) = &mut trajectory {
            pose_covariances = pose_error::pose_covariances(self.background, &object, trajectory.scale.ratio);
            if self.origin == ModelOrigin::Reconstructed && !options.method_only {
                dropped = pose_error::drop_outliers(trajectory, &pose_covariances, self.background, &object);
            }
        }
        PlacedObject { object, adjustment, trajectory, pose_covariances, dropped }
    }

    pub(super) fn trajectory(
        &self,
        object: &Reconstruction,
        scale: ScaleEstimate,
    ) -> Result<ObjectTrajectory, ScaleError> {
        let description = self.description.clone();
        let mut trajectory = assemble(description, self.background, object, scale, self.frames);
        for plane in self.background.paired_images(object).iter().filter_map(|(frame, ..)| self.planes.get(frame)) {
            *trajectory.ground.entry(plane.basis).or_default() += 1;
        }
        match trajectory.poses.is_empty() {
            true => Err(ScaleError::NoCommonFrame),
            false => Ok(trajectory),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::ObjectId;
    use crate::synthetic::drive::{self, Drive, Noise, drive};

    const NOISE: Noise = Noise { pixel_px: 0.3, plane_height_m: 0.03, plane_tilt_deg: 0.3, bad_planes: 0.0 };

    fn evidence<'a>(
        world: &'a Drive,
        silhouettes: &'a BTreeMap<FrameId, Silhouette>,
        origin: ModelOrigin,
    ) -> Evidence<'a> {
        let description = ObjectDescription { id: ObjectId(1), class: "car".into(), confidence: 1.0 };
        let Drive { background, object, planes, frames, .. } = world;
        Evidence { description, origin, background, object, planes, silhouettes, frames, focal_std: None }
    }

    fn world() -> Drive {
        drive(&drive::Options { noise: NOISE, ..drive::Options::default() }, 3)
    }

    #[test]
    fn a_reconstructed_object_is_adjusted_and_keeps_its_earlier_ratios() {
        let (world, none) = (world(), BTreeMap::new());
        let placed = place(&evidence(&world, &none, ModelOrigin::Reconstructed), &Options::default());
        assert!(matches!(placed.adjustment, Adjustment::Done(_)), "{:?}", placed.adjustment);
        let scale = placed.trajectory.unwrap().scale;
        assert_eq!(scale.method, ScaleMethod::Joint);
        assert_eq!(scale.alternatives[&ScaleMethod::Joint], scale.ratio);
        let before = scale.as_reconstructed.unwrap();
        assert!(!before.contains_key(&ScaleMethod::Joint) && before.contains_key(&ScaleMethod::Intersection));
        assert_ne!(placed.object, world.object);
    }

    #[test]
    fn the_std_is_the_sum_of_its_shares_and_grows_with_that_of_the_focal_length() {
        let (world, none) = (world(), BTreeMap::new());
        for method in [ScaleMethod::Joint, ScaleMethod::RobustLeastSquares] {
            let options = Options { method, ..Options::default() };
            let scale = |focal_std| {
                let evidence = Evidence { focal_std, ..evidence(&world, &none, ModelOrigin::Reconstructed) };
                place(&evidence, &options).trajectory.unwrap().scale
            };
            let [known, open, unknown] = [None, Some(0.04), Some(0.5)].map(scale);
            assert!(!open.degenerate && unknown.degenerate && unknown.reason.unwrap().contains("--intrinsics"));
            for scale in [&known, &open] {
                let shares = scale.shares.unwrap();
                assert!((shares.total() / (scale.std.unwrap() / scale.ratio) - 1.0).abs() < 1e-12, "{shares:?}");
            }
            assert_eq!(known.shares.unwrap().focal, 0.0);
            assert!(open.shares.unwrap().focal >= 0.04 && open.std > known.std && open.ratio == known.ratio);
            let support = known.support.unwrap();
            assert!(support.num_views == 60 && support.num_points > 50 && support.tilt < 0.05, "{support:?}");
        }
    }

    #[test]
    fn a_given_model_and_another_method_leave_the_model_unchanged() {
        let (world, none) = (world(), BTreeMap::new());
        let contact = Options { method: ScaleMethod::Intersection, ..Options::default() };
        for (origin, options, method) in [
            (ModelOrigin::Given, Options::default(), ScaleMethod::RobustLeastSquares),
            (ModelOrigin::Reconstructed, contact, ScaleMethod::Intersection),
        ] {
            let placed = place(&evidence(&world, &none, origin), &options);
            assert_eq!((placed.adjustment, &placed.object), (Adjustment::None, &world.object));
            let scale = placed.trajectory.unwrap().scale;
            assert_eq!((scale.method, scale.as_reconstructed), (method, None));
        }
    }

    #[test]
    fn failures_are_reported_with_their_reasons() {
        let (mut world, none) = (world(), BTreeMap::new());
        world.planes.clear();
        let placed = place(&evidence(&world, &none, ModelOrigin::Reconstructed), &Options::default());
        assert!(matches!(placed.adjustment, Adjustment::Failed(ScaleError::TooFewViews { usable: 0, .. })));
        assert!(matches!(placed.trajectory, Err(ScaleError::TooFewViews { .. })));
        assert_eq!(placed.object, world.object);
    }
}
