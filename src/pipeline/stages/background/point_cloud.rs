//! Point clouds in PLY format.

use std::path::PathBuf;

use nalgebra::Point3;

use crate::io::interchange::ply;
use crate::pipeline::Result;
use crate::pipeline::driver::run::Run;
use crate::scene::{ObjectTrajectory, Reconstruction};

/// Writes the background's points; returns the file path.
pub(in crate::pipeline) fn background(run: &Run, model: &Reconstruction) -> Result<PathBuf> {
    let points: Vec<_> = model.points.values().map(|point| (point.position, point.rgb)).collect();
    write(run, run.workspace.background_points(), &points)
}

/// Writes an object's points at all poses of its trajectory, in the background's frame; returns the file path.
pub(in crate::pipeline) fn object(run: &Run, trajectory: &ObjectTrajectory, model: &Reconstruction) -> Result<PathBuf> {
    let placed = |pose: &crate::scene::ObjectPose| {
        let world_from_object = pose.world_from_object;
        model.points.values().map(move |point| (world_from_object * point.position, point.rgb))
    };
    let points: Vec<_> = trajectory.poses.iter().flat_map(placed).collect();
    write(run, run.workspace.object_points(trajectory.id), &points)
}

fn write(run: &Run, path: PathBuf, points: &[(Point3<f64>, [u8; 3])]) -> Result<PathBuf> {
    run.workspace.put_file(&path, |fresh| ply::write_points(fresh, points))?;
    Ok(path)
}
