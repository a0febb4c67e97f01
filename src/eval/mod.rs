//! Comparison with ground truth: the paper's protocol.
//!
//! 1. **Registration.** A similarity from the background reconstruction to the true world, by Umeyama's method on
//!    camera centres with up and forward vectors ([`registration`]).
//! 2. **Trajectory error.** Every object point, placed in every frame, and its distance to the true mesh in that
//!    frame's pose; the mean over frames and points is the error of the sequence ([`trajectory`]).
//! 3. **Reference scale ratio.** Rays from the object's cameras through its points meet the true mesh; medians of
//!    medians give the ratio that a perfect estimator would find (eqs. scale_ratios_ov, scale_ratios_ov_gt,
//!    scale_ratios_ob_ref; [`mod@reference`]). The deviation of an estimated ratio r is |r − r_ref| / r_ref.
//!
//! The rest says how far a reconstruction came: registered fractions, camera errors, and which of the reconstructed
//! objects is the target at all. What cannot be computed is an [`Outcome::Unavailable`] with its reason; no number here
//! is ever NaN. `docs/evaluation.md` has the whole protocol.
//!
//! Entry point: [`evaluate`].

pub mod benchmark;
pub mod calibration;
mod cameras;
pub mod comparison;
mod figures;
mod input;
mod mesh;
mod outcome;
pub mod reference;
pub mod registration;
pub mod spread;
mod table;
pub mod trajectory;

pub use cameras::CameraErrors;
pub use figures::{
    Alternative, AsReconstructedFigures, Evaluation, ReferenceFigures, RegisteredFrames, ScaleFigures, Target,
};
pub use input::{AsReconstructed, Input, Model, ObjectInput, TruthFrame};
pub use mesh::MeshIndex;
pub use outcome::Outcome;

use std::collections::BTreeMap;

use crate::math::{Rigid3, Sim3};
use crate::scene::{FrameId, Ratios, Reference, ScaleMethod};
use registration::Registration;

/// Least overlap of masks with which a track is taken for the target.
pub const MIN_TARGET_IOU: f64 = 0.1;

/// Share of the target's outline from which it is seen well enough to ask for its pose.
pub const CLEAR_SHARE: f64 = 0.3;

/// Compares one run with the truth of its sequence.
pub fn evaluate(input: &Input) -> Evaluation {
    let cameras = camera_pairs(input);
    let background = input.background.as_ref().map_err(Clone::clone);
    let registration = Outcome::from(background.and_then(|_| registration::register(&cameras)));
    let (target, others) = choose_target(&input.objects);
    let object = target.as_ref().ok().copied();
    let subject = Subject::new(input, &registration, object);
    let reference = Outcome::from(subject.as_ref().map_err(Clone::clone).and_then(Subject::reference));
    let ratio = reference.as_ref().map(|r| r.ratio);
    let scale = Outcome::from(scale_figures(object, ratio));
    let at_ratio = |ratio: f64| subject.as_ref().map_err(Clone::clone).and_then(|s| s.error_at(ratio));
    let at_reference = reference.as_ref().map_err(String::from).and_then(|r| at_ratio(r.ratio));
    let trajectory = subject.as_ref().map_err(Clone::clone).and_then(Subject::error_of_estimate);
    Evaluation {
        version: 1,
        sequence: input.sequence.clone(),
        vehicle: input.vehicle.clone(),
        registered: registered_frames(input, object),
        cameras: cameras::compare_cameras(&cameras, registration.as_ref()).into(),
        registration: registration.clone(),
        target: target.map(|o| Target { object: o.id, iou: o.iou }).into(),
        others,
        trajectory: trajectory.into(),
        trajectory_at_reference: at_reference.into(),
        alternatives: match object.map(|o| o.trajectory.as_ref()) {
            Some(Ok(trajectory)) => alternatives(&trajectory.scale.alternatives, ratio, at_ratio),
            _ => BTreeMap::new(),
        },
        as_reconstructed: object
            .and_then(|o| o.as_reconstructed.as_ref())
            .map(|before| {
                let AsReconstructed { model, ratios } = before.as_ref().map_err(Clone::clone)?;
                as_reconstructed(&subject.as_ref().map_err(Clone::clone)?.with(model)?, ratios)
            })
            .map(Outcome::from),
        references: object.map_or_else(BTreeMap::new, |object| references(subject.as_ref().ok(), object)),
        reference_scale: reference,
        scale,
    }
}

/// Estimated and true camera of each frame that has both.
fn camera_pairs(input: &Input) -> Vec<(Rigid3, Rigid3)> {
    let Ok(background) = &input.background else { return Vec::new() };
    let pair = |(id, frame): (&FrameId, &TruthFrame)| Some((*background.cam_from_world.get(id)?, frame.cam_from_world));
    input.frames.iter().filter_map(pair).collect()
}

/// The object whose masks overlap the target's most. Without any mask to compare, object 1, which is what the target is
/// called in given masks.
fn choose_target(objects: &[ObjectInput]) -> (Result<&ObjectInput, String>, Vec<Target>) {
    let overlapping =
        objects.iter().filter(|o| o.iou.is_some()).max_by(|a, b| a.iou.partial_cmp(&b.iou).expect("finite"));
    let target = match overlapping {
        Some(best) if best.iou >= Some(MIN_TARGET_IOU) => Ok(best),
        Some(best) => Err(format!(
            "no track matches the target; the best, object {}, has an overlap of {:.3}",
            best.id,
            best.iou.unwrap_or_default()
        )),
        None => {
            objects.iter().find(|o| o.id.0 == 1).ok_or_else(|| "object 1 not found, and there are no tracks".into())
        }
    };
    let is_target = |o: &&ObjectInput| target.as_ref().is_ok_and(|t| t.id == o.id);
    let others = objects.iter().filter(|o| !is_target(o)).map(|o| Target { object: o.id, iou: o.iou }).collect();
    (target, others)
}

fn registered_frames(input: &Input, object: Option<&ObjectInput>) -> RegisteredFrames {
    let in_background = |id: &FrameId| input.background.as_ref().is_ok_and(|m| m.cam_from_world.contains_key(id));
    let model = object.and_then(|o| o.model.as_ref().ok());
    let in_object = |id: &FrameId| model.is_some_and(|m| m.cam_from_world.contains_key(id));
    let is_placed = |id: &FrameId| object.is_some_and(|o| o.placements.contains_key(id));
    let visible: Vec<_> = input.frames.iter().filter(|(_, f)| f.target_px2 > 0).map(|(id, _)| id).collect();
    let is_clear = |f: &TruthFrame| f.visible_share.map(|share| share >= CLEAR_SHARE);
    let clear: Option<Vec<_>> = input.frames.iter().map(|(id, f)| Some((id, is_clear(f)?))).collect();
    let clear = clear.map(|all| all.into_iter().filter_map(|(id, clear)| clear.then_some(id)).collect::<Vec<_>>());
    let num_background = input.frames.keys().filter(|id| in_background(id)).count();
    let num_object = visible.iter().filter(|id| in_object(id)).count();
    let fraction = |count: usize, of: usize| (of > 0).then(|| count as f64 / of as f64);
    RegisteredFrames {
        num_frames: input.frames.len(),
        num_background,
        background_fraction: fraction(num_background, input.frames.len()),
        num_visible: visible.len(),
        num_object,
        object_fraction: fraction(num_object, visible.len()),
        num_clear: clear.as_ref().map(Vec::len),
        num_object_clear: clear.as_ref().map(|clear| clear.iter().filter(|id| in_object(id)).count()),
        num_placed_clear: clear.map(|clear| clear.into_iter().filter(|id| is_placed(id)).count()),
        num_both: visible.iter().filter(|id| in_object(id) && in_background(id)).count(),
        unmatched: input.background.as_ref().map_or(Vec::new(), |m| m.unmatched.clone()),
    }
}

fn scale_figures(object: Option<&ObjectInput>, reference: Result<f64, &str>) -> Result<ScaleFigures, String> {
    let trajectory = object.ok_or("target not found")?.trajectory.as_ref()?;
    let scale = &trajectory.scale;
    Ok(ScaleFigures {
        ratio: scale.ratio,
        std: scale.std,
        method: scale.method,
        degenerate: scale.degenerate,
        reason: scale.reason.clone(),
        deviation: reference.ok().map(|r| (scale.ratio - r).abs() / r),
    })
}

fn alternatives(
    ratios: &Ratios,
    reference: Result<f64, &str>,
    error_at: impl Fn(f64) -> Result<trajectory::TrajectoryError, String>,
) -> BTreeMap<ScaleMethod, Alternative> {
    ratios.iter().map(|(method, ratio)| (*method, alternative(*ratio, reference, &error_at))).collect()
}

fn alternative(
    ratio: f64,
    reference: Result<f64, &str>,
    error_at: impl Fn(f64) -> Result<trajectory::TrajectoryError, String>,
) -> Alternative {
    Alternative {
        ratio,
        deviation: reference.ok().map(|r| (ratio - r).abs() / r),
        trajectory_error_m: error_at(ratio).ok().map(|e| e.mean_m),
    }
}

/// Figures of the reference methods, which speak of the target as structure from motion left it.
fn references(subject: Option<&Subject>, object: &ObjectInput) -> BTreeMap<ScaleMethod, ReferenceFigures> {
    let Ok(trajectory) = &object.trajectory else { return BTreeMap::new() };
    let subject = match &object.as_reconstructed {
        None => subject.map(|subject| Subject { ..*subject }),
        Some(Ok(before)) => subject.and_then(|subject| subject.with(&before.model).ok()),
        Some(Err(_)) => None,
    };
    let reference = subject.as_ref().ok_or("target not found".to_owned()).and_then(Subject::reference);
    let reference = reference.as_ref().map(|reference| reference.ratio).map_err(String::as_str);
    let error_at = |ratio| subject.as_ref().ok_or("target not found".to_owned())?.error_at(ratio);
    let figures = |found: &Reference| ReferenceFigures {
        found: found.ratio.map(|ratio| alternative(ratio, reference, error_at)),
        std: found.std,
        undetermined: found.undetermined.clone(),
    };
    trajectory.scale.references.iter().map(|(method, found)| (*method, figures(found))).collect()
}

fn as_reconstructed(subject: &Subject, ratios: &Ratios) -> Result<AsReconstructedFigures, String> {
    let reference_ratio = subject.reference()?.ratio;
    Ok(AsReconstructedFigures {
        reference_ratio,
        error_at_reference_m: subject.error_at(reference_ratio)?.mean_m,
        alternatives: alternatives(ratios, Ok(reference_ratio), |ratio| subject.error_at(ratio)),
    })
}

/// All that the target's trajectory is measured with; it exists only if every part does.
struct Subject<'a> {
    input: &'a Input,
    registration: &'a Registration,
    background: &'a Model,
    object: &'a ObjectInput,
    model: &'a Model,
    mesh: &'a MeshIndex,
}

impl<'a> Subject<'a> {
    fn new(
        input: &'a Input,
        registration: &'a Outcome<Registration>,
        object: Option<&'a ObjectInput>,
    ) -> Result<Self, String> {
        let registration = registration.as_ref().map_err(|reason| format!("no registration: {reason}"))?;
        let object = object.ok_or("target not found")?;
        let model = object.model.as_ref()?;
        let background = input.background.as_ref()?;
        Self { input, registration, background, object, model, mesh: input.mesh.as_ref()? }.with(model)
    }

    /// The same with another reconstruction of the target.
    fn with(&self, model: &'a Model) -> Result<Self, String> {
        if model.points.is_empty() {
            return Err("the object's model has no points".into());
        }
        Ok(Self { model, ..*self })
    }

    fn reference(&self) -> Result<reference::ReferenceScale, String> {
        reference::reference_scale(
            self.model,
            &self.input.frames,
            self.mesh,
            self.registration.world_from_background.scale,
        )
    }

    /// The error of the placements that the run gave.
    fn error_of_estimate(&self) -> Result<trajectory::TrajectoryError, String> {
        self.object.trajectory.as_ref()?;
        self.error(&self.object.placements)
    }

    /// The error of the trajectory family's member with this scale ratio.
    fn error_at(&self, ratio: f64) -> Result<trajectory::TrajectoryError, String> {
        self.error(&trajectory::family(&self.background.cam_from_world, &self.model.cam_from_world, ratio))
    }

    fn error(&self, placements: &BTreeMap<FrameId, Sim3>) -> Result<trajectory::TrajectoryError, String> {
        let world_from_background = &self.registration.world_from_background;
        trajectory::error(&self.model.points, placements, world_from_background, &self.input.frames, self.mesh)
    }
}

#[cfg(test)]
mod tests;
