//! The whole way from reconstructions, planes and outlines to an object that is placed: the one call that a user of the
//! library needs.
//!
//! With the method `joint` the object's reconstruction is first adjusted together with the ground
//! ([`joint`](super::joint())); where that cannot be done, or another method is wanted, it is taken as it is and
//! [`estimate_scale`] finds the ratio. Either way the trajectory refers to [`PlacedObject::object`].

use std::collections::BTreeMap;

use nalgebra::Matrix3;

use super::estimate::{estimate_scale, joint_estimate, ratios_of, references, with_focal};
use super::pose_error;
use super::{Joint, ObjectDescription, Options, ScaleError, Silhouette, Views, assemble, joint};
use crate::scene::{Frame, FrameId, GroundPlane, ObjectTrajectory, Reconstruction, ScaleEstimate, ScaleMethod};

/// Where an object's model comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ModelOrigin {
    /// Structure from motion: `joint` may adjust it.
    Reconstructed,
    /// The user: it is taken as it is, whatever the method.
    Given,
}

/// Input on one object and the place around it.
#[derive(Clone, Debug)]
pub struct Evidence<'a> {
    /// Id, class and score, handed on to the trajectory.
    pub description: ObjectDescription,
    /// Where `object` comes from.
    pub origin: ModelOrigin,
    /// The background's reconstruction.
    pub background: &'a Reconstruction,
    /// The object's, as it was reconstructed.
    pub object: &'a Reconstruction,
    /// The local plane of each frame, in the background's frame; frames without one are absent.
    pub planes: &'a BTreeMap<FrameId, GroundPlane>,
    /// The object's outlines; only `joint` looks at them.
    pub silhouettes: &'a BTreeMap<FrameId, Silhouette>,
    /// All frames.
    pub frames: &'a [Frame],
    /// Standard deviation of the camera's focal length as a share of it; `None` where it is given, or not known.
    pub focal_std: Option<f64>,
}

/// An object in its place.
#[derive(Clone, Debug)]
pub struct PlacedObject {
    /// The model to which the trajectory refers: adjusted with the ground where that was done, else as it was.
    pub object: Reconstruction,
    /// Whether, and how, the model was adjusted.
    pub adjustment: Adjustment,
    /// The trajectory, in units of the background, or why there is none.
    pub trajectory: Result<ObjectTrajectory, ScaleError>,
    /// Covariance of the position in each frame, in the frame and unit of the background, without that of the ratio.
    pub pose_covariances: BTreeMap<FrameId, Matrix3<f64>>,
    /// Frames in which the model has a pose, but no position.
    pub dropped: DroppedFrames,
}

/// Frames whose pose says nothing of where the vehicle is, ascending.
#[derive(Clone, Debug, Default)]
pub struct DroppedFrames {
    /// The standard deviation of the position exceeds the size of the model.
    pub uncertain: Vec<FrameId>,
    /// The motion before and after contradicts the position.
    pub contradicted: Vec<FrameId>,
}

/// Outcome of the adjustment with the ground.
#[derive(Clone, Debug, PartialEq)]
pub enum Adjustment {
    /// Not wanted: another method, or a model that the user gave.
    None,
    /// The model was adjusted.
    Done(AdjustmentFigures),
    /// The model stays as it was.
    Failed(ScaleError),
}

/// Results of the adjustment besides the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AdjustmentFigures {
    /// Frames whose outline shows where the ground is; 0 where it was guessed from the lowest points.
    pub frames_with_outline: usize,
    /// Median error of the image positions before and after, pixels.
    pub error_px: [f64; 2],
    /// Points that were left out because their place is too uncertain.
    pub num_uncertain: usize,
}

/// Places one object: adjusts its model if `options` want that, finds the scale ratio, and assembles the trajectory.
///
/// Never fails as a whole: [`PlacedObject::trajectory`] and [`PlacedObject::adjustment`] say what could not be done and
/// why.
pub fn place(evidence: &Evidence, options: &Options) -> PlacedObject {
    let as_it_is = Views::new(evidence.background, evidence.object, evidence.planes, options);
    let is_adjusted = options.method == ScaleMethod::Joint && evidence.origin == ModelOrigin::Reconstructed;
    let adjustment = match is_adjusted.then(|| joint(evidence, &as_it_is, options)) {
        Some(Ok(found)) => return evidence.adjusted(found, &as_it_is, options),
        Some(Err(error)) => Adjustment::Failed(error),
        None => Adjustment::None,
    };
    let method = match options.method {
        ScaleMethod::Joint => ScaleMethod::RobustLeastSquares,
        method => method,
    };
    let scale = estimate_scale(&as_it_is, method, options)
        .map(|scale| with_focal(scale, evidence.focal_std, options.max_relative_std));
    evidence.finished(evidence.object.clone(), adjustment, scale, options)
}

impl Evidence<'_> {
    /// The object after an adjustment; `as_it_was` are the views of the model before.
    fn adjusted(&self, found: Joint, as_it_was: &Views, options: &Options) -> PlacedObject {
        let views = Views::new(self.background, &found.object, self.planes, options);
        let as_reconstructed = Some(ratios_of(as_it_was, options));
        let references = references(as_it_was, options);
        let scale = joint_estimate(&views, &found, options, self.focal_std);
        let scale = ScaleEstimate { as_reconstructed, references, ..scale };
        let Joint { object, contact, error_px, num_uncertain, .. } = found;
        let figures = AdjustmentFigures { frames_with_outline: contact.num_frames, error_px, num_uncertain };
        self.finished(object, Adjustment::Done(figures), Ok(scale), options)
    }

    /// The object in its place, once its scale ratio is known.
    fn finished(
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
                dropped = pose_error::drop_wrong(trajectory, &pose_covariances, self.background, &object);
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
    fn a_reconstructed_object_is_adjusted_and_says_what_it_was_before() {
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
    fn the_deviation_is_the_sum_of_its_shares_and_grows_with_the_focal_lengths() {
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
    fn a_given_model_and_another_method_leave_the_model_as_it_is() {
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
    fn what_cannot_be_placed_says_why() {
        let (mut world, none) = (world(), BTreeMap::new());
        world.planes.clear();
        let placed = place(&evidence(&world, &none, ModelOrigin::Reconstructed), &Options::default());
        assert!(matches!(placed.adjustment, Adjustment::Failed(ScaleError::TooFewViews { usable: 0, .. })));
        assert!(matches!(placed.trajectory, Err(ScaleError::TooFewViews { .. })));
        assert_eq!(placed.object, world.object);
    }
}
