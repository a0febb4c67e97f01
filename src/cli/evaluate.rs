//! `tractrix evaluate OUT --truth SEQUENCE`: how far a run is from the truth.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;

use crate::eval::{self, AsReconstructed, Evaluation, Input, MeshIndex, Model, ObjectInput, TruthFrame};
use crate::io::{IoError, Sequence, SequenceFrame, atomic, colmap, masks, trajectories};
use crate::pipeline::as_reconstructed;
use crate::scene::{FrameId, Mask, ObjectId, ObjectTrajectory, Reconstruction, Trajectories};

/// Compares the output of a run with a sequence whose truth is known.
#[derive(Clone, Debug, clap::Args)]
pub struct Args {
    /// Output folder of `tractrix run`
    #[arg(value_name = "OUT")]
    pub output: PathBuf,
    /// Folder of the sequence: scene.json, masks/, object_mesh.ply
    #[arg(long, value_name = "SEQUENCE")]
    pub truth: PathBuf,
    /// Print the figures as JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// Evaluates, writes `OUT/evaluation.json` and prints the figures.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let evaluation = evaluate(&args.output, &args.truth)?;
    let path = args.output.join("evaluation.json");
    if let Err(error) = atomic::write_json(&path, &evaluation) {
        // The figures are still worth printing.
        tracing::warn!("{:#}", anyhow::Error::from(error));
    }
    let text = if args.json { serde_json::to_string_pretty(&evaluation)? + "\n" } else { evaluation.to_string() };
    std::io::stdout().lock().write_all(text.as_bytes()).context("cannot print the figures")
}

/// Evaluates the run in `output` against the sequence in `truth`.
///
/// # Errors
/// A sequence that cannot be read, or an output folder that is not there. What is missing *in* the output is part of the
/// evaluation.
pub fn evaluate(output: &Path, truth: &Path) -> anyhow::Result<Evaluation> {
    let sequence = Sequence::open(truth)?;
    anyhow::ensure!(output.is_dir(), "{} is not a folder; run `tractrix run` first", output.display());
    Ok(eval::evaluate(&gather(output, &sequence)?))
}

/// Reads what there is of a run. A part that is missing or broken is noted as such.
fn gather(output: &Path, sequence: &Sequence) -> Result<Input, IoError> {
    let all = trajectories::read(&output.join("trajectories.json")).map_err(|e| reason(&e));
    let ids = object_ids(output, all.as_ref().ok());
    let masks = MaskFigures::read(output, &ids, sequence)?;
    let before = as_reconstructed(output).map_err(|error| error.to_string());
    let before_of = |id| match &before {
        Ok(before) => before.get(&id).map(|before| {
            Ok(AsReconstructed { model: model(&before.model, sequence)?, ratios: before.ratios.clone() })
        }),
        Err(reason) => Some(Err(reason.clone())),
    };
    let truth = |frame: &SequenceFrame| TruthFrame {
        cam_from_world: frame.cam_from_world,
        world_from_object: frame.world_from_object,
        target_px2: masks.target_px2[&frame.id],
    };
    let mesh = sequence.mesh().map_err(|e| reason(&e));
    Ok(Input {
        sequence: sequence.name.clone(),
        vehicle: sequence.vehicle.clone(),
        frames: sequence.frames.iter().map(|f| (f.id, truth(f))).collect(),
        mesh: mesh.and_then(|m| MeshIndex::new(&m).ok_or_else(|| "the true mesh has no triangles".into())),
        background: model(&output.join("background"), sequence),
        objects: ids.into_iter().map(|id| object(output, id, sequence, &all, masks.iou(id), before_of(id))).collect(),
    })
}

/// An error with its causes, as one line.
fn reason(error: &IoError) -> String {
    let mut text = error.to_string();
    let mut source = std::error::Error::source(error);
    while let Some(cause) = source {
        text += &format!(": {cause}");
        source = cause.source();
    }
    text
}

/// Objects with a model, a trajectory or a track.
fn object_ids(output: &Path, trajectories: Option<&Trajectories>) -> BTreeSet<ObjectId> {
    let from_folder = |name: &str| -> Vec<ObjectId> {
        let entries = std::fs::read_dir(output.join(name)).into_iter().flatten().flatten();
        entries.filter_map(|e| e.file_name().to_str()?.parse().ok()).map(ObjectId).collect()
    };
    let from_trajectories = trajectories.into_iter().flat_map(|t| t.objects.iter().map(|o| o.id));
    from_folder("objects").into_iter().chain(from_folder("tracks")).chain(from_trajectories).collect()
}

fn model(folder: &Path, sequence: &Sequence) -> Result<Model, String> {
    let reconstruction: Reconstruction = colmap::read(folder).map_err(|e| reason(&e))?;
    Ok(Model::new(&reconstruction, |name| sequence.frame_named(name).map(|f| f.id)))
}

fn object(
    output: &Path,
    id: ObjectId,
    sequence: &Sequence,
    all: &Result<Trajectories, String>,
    iou: Option<f64>,
    as_reconstructed: Option<Result<AsReconstructed, String>>,
) -> ObjectInput {
    let trajectory: Result<ObjectTrajectory, String> = all.as_ref().map_err(Clone::clone).and_then(|all| {
        let found = all.objects.iter().find(|o| o.id == id).cloned();
        found.ok_or_else(|| format!("object {id} has no trajectory"))
    });
    let poses = trajectory.iter().flat_map(|t| &t.poses);
    let placements = poses.filter_map(|p| Some((sequence.frame_named(&p.name)?.id, p.world_from_object))).collect();
    let model = model(&output.join("objects").join(id.to_string()), sequence);
    ObjectInput { id, iou, model, as_reconstructed, trajectory, placements }
}

/// What the masks of a run and a sequence say, gathered frame by frame so that only a few are held at a time.
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
    fn read(output: &Path, ids: &BTreeSet<ObjectId>, sequence: &Sequence) -> Result<Self, IoError> {
        let mut figures = Self::default();
        for frame in &sequence.frames {
            let target = sequence.target_mask(frame)?;
            figures.target_px2.insert(frame.id, target.area_px2());
            for id in ids {
                figures.add(*id, &target, track_mask(&output.join("tracks").join(id.to_string()), frame));
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
fn track_mask(folder: &Path, frame: &SequenceFrame) -> Option<Mask> {
    let names = [format!("{:06}.jpg", frame.id.0), frame.name.clone()];
    let path = names.iter().find_map(|name| masks::find(folder, name))?;
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
