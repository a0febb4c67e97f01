//! Evaluation of a run against ground truth: reads an output folder and the sequence, for [`eval`].

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::stages::report;
use super::{PipelineError, Result, Workspace};
use crate::checks::text::with_causes;
use crate::eval::{self, AsReconstructed, Evaluation, Input, MeshIndex, Model, ObjectInput, TruthFrame};
use crate::io::{IoError, OwnedFolder, RunFolder, Sequence, SequenceFrame, atomic, masks};
use crate::scene::{FrameId, Mask, ObjectId, ObjectTrajectory, Reconstruction, Trajectories};

/// Evaluates the run in `output` against the sequence in `truth`.
///
/// # Errors
/// A sequence that cannot be read, or an output folder that is not there. What is missing *in* the output is part of
/// the evaluation.
pub fn evaluate(output: &Path, truth: &Path) -> Result<Evaluation> {
    let sequence = Sequence::open(truth)?;
    if !output.is_dir() {
        let text = format!("{}: not a folder; run `tractrix run` first", output.display());
        return Err(PipelineError::Options(text));
    }
    Ok(eval::evaluate(&gather(&RunFolder::at(output), &sequence)?))
}

/// Extent to which an evaluation was saved in the output folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SavedEvaluation {
    /// `evaluation.json` is written, and the page shows it.
    Everywhere,
    /// `evaluation.json` is written; why the page could not be made again.
    WithoutPage(String),
    /// The folder was not made by a run, so nothing is written into it.
    Nowhere,
}

/// Writes `evaluation.json` into the output folder, if that is a run's own, and makes the page again with it.
///
/// # Errors
/// [`PipelineError::Folder`] where another run is at work on the folder, or something stands in the way.
pub fn keep_evaluation(output: &Path, truth: &Path, evaluation: &Evaluation) -> Result<SavedEvaluation> {
    if !OwnedFolder::is_own(output, RunFolder::MADE_BY) {
        return Ok(SavedEvaluation::Nowhere);
    }
    Workspace::inspect(output, &[("--truth", truth)])?;
    let workspace = Workspace::open(output)?;
    workspace.put_file(&workspace.evaluation(), |fresh| atomic::write_json(fresh, evaluation))?;
    Ok(match report::renew(&workspace) {
        Ok(()) => SavedEvaluation::Everywhere,
        Err(error) => SavedEvaluation::WithoutPage(error.to_string()),
    })
}

/// Reads what there is of a run. A part that is missing or broken is noted as such.
fn gather(output: &RunFolder, sequence: &Sequence) -> Result<Input, IoError> {
    let all = output.read_trajectories().map_err(|e| with_causes(&e));
    let ids = object_ids(output, all.as_ref().ok());
    let masks = MaskFigures::read(output, &ids, sequence)?;
    let truth = |frame: &SequenceFrame| TruthFrame {
        cam_from_world: frame.cam_from_world,
        world_from_object: frame.world_from_object,
        target_px2: masks.target_px2[&frame.id],
        visible_share: frame.visible_share,
    };
    let mesh = sequence.mesh().map_err(|e| with_causes(&e));
    Ok(Input {
        sequence: sequence.name.clone(),
        vehicle: sequence.vehicle.clone(),
        frames: sequence.frames.iter().map(|f| (f.id, truth(f))).collect(),
        mesh: mesh.and_then(|m| MeshIndex::new(&m).ok_or_else(|| "true mesh without triangles".into())),
        background: model(output.read_background(), sequence),
        objects: ids.into_iter().map(|id| object(output, id, sequence, &all, masks.iou(id))).collect(),
    })
}

/// Objects with a model, a trajectory or a track.
fn object_ids(output: &RunFolder, trajectories: Option<&Trajectories>) -> BTreeSet<ObjectId> {
    let from_trajectories = trajectories.into_iter().flat_map(|t| t.objects.iter().map(|o| o.id));
    output.object_ids().into_iter().chain(from_trajectories).collect()
}

fn model(read: Result<Reconstruction, IoError>, sequence: &Sequence) -> Result<Model, String> {
    let reconstruction = read.map_err(|e| with_causes(&e))?;
    Ok(Model::new(&reconstruction, |name| sequence.frame_named(name).map(|f| f.id)))
}

fn object(
    output: &RunFolder,
    id: ObjectId,
    sequence: &Sequence,
    all: &Result<Trajectories, String>,
    iou: Option<f64>,
) -> ObjectInput {
    let trajectory: Result<ObjectTrajectory, String> = all.as_ref().map_err(Clone::clone).and_then(|all| {
        let found = all.objects.iter().find(|o| o.id == id).cloned();
        found.ok_or_else(|| format!("object {id}: no trajectory"))
    });
    let before = trajectory.as_ref().ok().and_then(|found| found.scale.as_reconstructed.clone());
    let as_reconstructed =
        before.map(|ratios| Ok(AsReconstructed { model: model(output.read_as_reconstructed(id), sequence)?, ratios }));
    let poses = trajectory.iter().flat_map(|t| &t.poses);
    let placements = poses.filter_map(|p| Some((sequence.frame_named(&p.name)?.id, p.world_from_object))).collect();
    let model = model(output.read_object(id), sequence);
    ObjectInput { id, iou, model, as_reconstructed, trajectory, placements }
}

/// Comparison of the masks of a run and a sequence, computed frame by frame so that only a few are in memory.
#[derive(Default)]
struct MaskFigures {
    /// Pixels at which the target is seen.
    target_px2: BTreeMap<FrameId, usize>,
    /// Pixels that an object and the target share, and pixels that either has, over the frames.
    overlaps: BTreeMap<ObjectId, (usize, usize)>,
    /// Objects of which some mask could be read.
    masked: BTreeSet<ObjectId>,
}

impl MaskFigures {
    fn read(output: &RunFolder, ids: &BTreeSet<ObjectId>, sequence: &Sequence) -> Result<Self, IoError> {
        let mut figures = Self::default();
        for frame in &sequence.frames {
            let target = sequence.target_mask(frame)?;
            figures.target_px2.insert(frame.id, target.area_px2());
            for id in ids {
                figures.add(*id, &target, track_mask(output, *id, frame));
            }
        }
        Ok(figures)
    }

    fn add(&mut self, id: ObjectId, target: &Mask, mask: Option<Mask>) {
        let (both, either) = self.overlaps.entry(id).or_default();
        let Some(mask) = mask else {
            *either += target.area_px2();
            return;
        };
        self.masked.insert(id);
        // A run may have worked on smaller frames; what it did not have counts at its size.
        let target = resized(target, mask.width(), mask.height());
        let common = mask.intersection_px2(&target);
        *both += common;
        *either += mask.area_px2() + target.area_px2() - common;
    }

    /// Intersection over union over all frames; `None` for an object without masks.
    fn iou(&self, id: ObjectId) -> Option<f64> {
        let (both, either) = self.overlaps.get(&id).filter(|_| self.masked.contains(&id))?;
        (*either > 0).then(|| *both as f64 / *either as f64)
    }
}

/// The mask of an object in one frame, whether the run saw the sequence's video or its pictures.
fn track_mask(output: &RunFolder, id: ObjectId, frame: &SequenceFrame) -> Option<Mask> {
    let of_video = format!("{:06}.jpg", frame.id.0);
    let path = output.find_mask(id, &[&of_video, &frame.name])?;
    masks::read_mask_of_any_size(&path).ok()
}

/// The mask at another size, by nearest pixel.
fn resized(mask: &Mask, width: u32, height: u32) -> Mask {
    if (width, height) == (mask.width(), mask.height()) {
        return mask.clone();
    }
    let at = |v: u32, from: u32, to: u32| (i64::from(v) * 2 + 1) * i64::from(from) / (2 * i64::from(to.max(1)));
    Mask::from_fn(width, height, |x, y| mask.get(at(x, mask.width(), width), at(y, mask.height(), height)))
}

#[cfg(test)]
mod tests;
