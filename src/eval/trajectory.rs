//! Trajectory error: distances of placed object points to the true mesh.

use std::collections::BTreeMap;

use nalgebra::Point3;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::input::TruthFrame;
use super::mesh::MeshIndex;
use crate::math::{Rigid3, Sim3, median};
use crate::scene::FrameId;

/// Distances of the points of a trajectory to the true mesh, metres.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TrajectoryError {
    /// The trajectory error of the paper: the mean over frames and points.
    pub mean_m: f64,
    /// The median over frames and points.
    pub median_m: f64,
    /// The mean over frames of each one's error over the true distance between camera and target.
    #[serde(default)]
    pub mean_share_of_distance: Option<f64>,
    /// Points in each frame.
    pub num_points: usize,
    /// Frames that took part.
    pub num_frames: usize,
    /// Mean over the points of each frame.
    pub frames: Vec<FrameError>,
}

/// The error in one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct FrameError {
    /// The frame.
    pub frame: FrameId,
    /// Mean over its points, metres.
    pub mean_m: f64,
}

/// The member of the trajectory family with scale ratio r: for each frame that has both cameras, the similarity
/// X ↦ c_b + r R_bᵀ (R_o X + t_o) from the object's model into the background's frame
/// (eq. object_to_background_coordinates).
pub fn family(
    background: &BTreeMap<FrameId, Rigid3>,
    object: &BTreeMap<FrameId, Rigid3>,
    ratio: f64,
) -> BTreeMap<FrameId, Sim3> {
    let member = |(id, cam_from_object): (&FrameId, &Rigid3)| {
        let background_from_cam = background.get(id)?.inverse();
        let rotation = background_from_cam.rotation * cam_from_object.rotation;
        let translation =
            background_from_cam.translation + background_from_cam.rotation * cam_from_object.translation * ratio;
        Some((*id, Sim3::new(ratio, rotation, translation)))
    };
    object.iter().filter_map(member).collect()
}

/// Mean distance of points, placed into the background's frame by `placements`, to the mesh in its true pose. Frames
/// without a placement or without truth take no part.
///
/// # Errors
/// The reason, in words, if no frame is left.
pub fn error(
    points: &[Point3<f64>],
    placements: &BTreeMap<FrameId, Sim3>,
    world_from_background: &Sim3,
    frames: &BTreeMap<FrameId, TruthFrame>,
    mesh: &MeshIndex,
) -> Result<TrajectoryError, String> {
    let placed: Vec<_> = placements.iter().filter_map(|(id, p)| Some((*id, p, frames.get(id)?))).collect();
    if placed.is_empty() || points.is_empty() {
        return Err("the target has no position in any frame of the sequence".into());
    }
    let distances = |(_, background_from_model, truth): &(FrameId, &Sim3, &TruthFrame)| {
        let mesh_from_world = Sim3::from(truth.world_from_object.inverse());
        let mesh_from_model = mesh_from_world * *world_from_background * **background_from_model;
        points.iter().map(|p| mesh.distance(mesh_from_model * *p)).collect::<Vec<_>>()
    };
    let per_frame: Vec<_> = placed.par_iter().map(distances).collect();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
    let errors: Vec<_> =
        placed.iter().zip(&per_frame).map(|((id, ..), d)| FrameError { frame: *id, mean_m: mean(d) }).collect();
    let mean_m = errors.iter().map(|e| e.mean_m).sum::<f64>() / errors.len() as f64;
    let median_m = median(per_frame.concat()).filter(|_| mean_m.is_finite());
    let median_m = median_m.ok_or("the distances are not finite")?;
    let share =
        |((_, _, truth), error): (&(FrameId, &Sim3, &TruthFrame), &FrameError)| error.mean_m / truth.distance_m();
    let share = placed.iter().zip(&errors).map(share).sum::<f64>() / errors.len() as f64;
    Ok(TrajectoryError {
        mean_m,
        median_m,
        mean_share_of_distance: Some(share).filter(|share| share.is_finite()),
        num_points: points.len(),
        num_frames: errors.len(),
        frames: errors,
    })
}
