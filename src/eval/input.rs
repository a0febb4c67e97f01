//! Input of an evaluation, as values: every map is keyed by the frame of the truth.

use std::collections::BTreeMap;

use nalgebra::Point3;

use super::mesh::MeshIndex;
use crate::math::{Rigid3, Sim3};
use crate::scene::{FrameId, ObjectId, ObjectTrajectory, Ratios, Reconstruction};

/// A run and the truth of its sequence. What is missing is the reason for which it is.
pub struct Input {
    /// Name of the sequence.
    pub sequence: String,
    /// Type of the target vehicle, if known.
    pub vehicle: Option<String>,
    /// The truth, for every frame of the sequence.
    pub frames: BTreeMap<FrameId, TruthFrame>,
    /// The target's shape, object coordinates, metres.
    pub mesh: Result<MeshIndex, String>,
    /// The background reconstruction.
    pub background: Result<Model, String>,
    /// Every object that the run knows of, ascending by id.
    pub objects: Vec<ObjectInput>,
}

/// The truth of one frame; the world is in metres.
#[derive(Clone, Debug, PartialEq)]
pub struct TruthFrame {
    /// The camera.
    pub cam_from_world: Rigid3,
    /// The target.
    pub world_from_object: Rigid3,
    /// Pixels at which the target is seen.
    pub target_px2: usize,
    /// Visible share of its outline, 0 to 1, where the sequence states it.
    pub visible_share: Option<f64>,
}

impl TruthFrame {
    /// From the camera's centre to the target's origin, metres.
    pub fn distance_m(&self) -> f64 {
        (self.cam_from_world * self.world_from_object).translation.norm()
    }
}

/// One object of a run.
pub struct ObjectInput {
    /// Its id.
    pub id: ObjectId,
    /// Overlap of its masks with the target's: pixels in both over pixels in either, over all frames. `None` if it has
    /// no masks.
    pub iou: Option<f64>,
    /// Its reconstruction.
    pub model: Result<Model, String>,
    /// The object as it was before it was adjusted with the ground; `None` where nothing was adjusted.
    pub as_reconstructed: Option<Result<AsReconstructed, String>>,
    /// Its trajectory.
    pub trajectory: Result<ObjectTrajectory, String>,
    /// `world_from_object` of the trajectory's frames, where the world is the background's.
    pub placements: BTreeMap<FrameId, Sim3>,
}

/// An object as structure from motion left it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AsReconstructed {
    /// Its reconstruction.
    pub model: Model,
    /// Ratios by the estimators that leave the model unchanged.
    pub ratios: Ratios,
}

/// Data of a reconstruction that an evaluation uses.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Model {
    /// Camera poses.
    pub cam_from_world: BTreeMap<FrameId, Rigid3>,
    /// Points.
    pub points: Vec<Point3<f64>>,
    /// Indices in `points` of those observed in a frame.
    pub seen: BTreeMap<FrameId, Vec<usize>>,
    /// Names of registered images that are no frame of the sequence.
    pub unmatched: Vec<String>,
}

impl Model {
    /// From a reconstruction; `frame_of` finds the frame that an image name means.
    pub fn new(reconstruction: &Reconstruction, frame_of: impl Fn(&str) -> Option<FrameId>) -> Self {
        let index_of: BTreeMap<_, _> = reconstruction.points.keys().zip(0..).collect();
        let points = reconstruction.points.values().map(|p| p.position).collect();
        let mut model = Self { points, ..Self::default() };
        for image in reconstruction.images.values() {
            let Some(frame) = frame_of(&image.name) else {
                model.unmatched.push(image.name.clone());
                continue;
            };
            let seen = image.observations.iter().filter_map(|o| index_of.get(&o.point?).copied()).collect();
            model.cam_from_world.insert(frame, image.cam_from_world);
            model.seen.insert(frame, seen);
        }
        model
    }
}
