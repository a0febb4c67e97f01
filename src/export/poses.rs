//! Poses in the formats of TUM and KITTI (`io::camera_path` reads both): the camera, and each vehicle.
//!
//! The camera's pose is `world_from_camera`, with axes x right, y down, z forward. A vehicle's is that of its model:
//! the position is its center, the axes are those of its model, which are body-fixed with arbitrary orientation. World
//! and unit are those of the exports; `about.txt` states them, as do the headers of TUM's files.

use std::fmt::Write;
use std::path::Path;

use nalgebra::{Matrix3x4, Point3, UnitQuaternion};

use super::{ExportError, Results};
use crate::io::{ExportFolder, atomic};
use crate::math::{Rigid3, Sim3};
use crate::scene::TimeBase;

/// A pose at a time.
struct Pose {
    time_s: f64,
    world_from_body: Rigid3,
}

/// The poses of the camera and the vehicles by file stem.
fn bodies(results: &Results) -> Vec<(String, Vec<Pose>)> {
    let export_from_world = results.export_from_world();
    let camera = results.views.iter().map(|view| {
        let rotation = view.cam_from_world.rotation.inverse();
        pose(&export_from_world, view.frame.time_s, rotation, view.cam_from_world.center())
    });
    let mut bodies = vec![("camera".to_owned(), camera.collect())];
    for object in &results.trajectories.objects {
        let poses = object.poses.iter().map(|found| {
            pose(&export_from_world, found.time_s, found.world_from_object.rotation, Point3::from(found.position))
        });
        bodies.push((format!("vehicle-{}", object.id), poses.collect()));
    }
    bodies
}

fn pose(export_from_world: &Sim3, time_s: f64, world_from_body: UnitQuaternion<f64>, position: Point3<f64>) -> Pose {
    let rotation = export_from_world.rotation * world_from_body;
    Pose { time_s, world_from_body: Rigid3::new(rotation, (*export_from_world * position).coords) }
}

/// Writes a file per body: time, position, quaternion with its scalar last.
pub(super) fn write_tum(folder: &Path, results: &Results) -> Result<(), ExportError> {
    for (stem, poses) in bodies(results) {
        let mut text = format!("# {}\n# timestamp tx ty tz qx qy qz qw\n", frame_in_words(results));
        for Pose { time_s, world_from_body } in &poses {
            let (t, q) = (world_from_body.translation, world_from_body.rotation);
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{time_s} {} {} {} {} {} {} {}", t.x, t.y, t.z, q.i, q.j, q.k, q.w);
        }
        atomic::write(&folder.join(format!("{stem}.txt")), text.as_bytes())?;
    }
    Ok(())
}

/// Writes two files per body: the upper 3 × 4 of the matrix, row by row, and the times, line by line.
pub(super) fn write_kitti(folder: &Path, results: &Results) -> Result<(), ExportError> {
    for (stem, poses) in bodies(results) {
        let rows: String = poses.iter().map(|pose| row(&pose.world_from_body.matrix())).collect();
        let times: String = poses.iter().map(|pose| format!("{}\n", pose.time_s)).collect();
        atomic::write(&folder.join(format!("{stem}.txt")), rows.as_bytes())?;
        atomic::write(&folder.join(format!("{stem}.times.txt")), times.as_bytes())?;
    }
    let about = format!("{}\n", frame_in_words(results));
    Ok(atomic::write(&folder.join(ExportFolder::ABOUT), about.as_bytes())?)
}

fn row(matrix: &Matrix3x4<f64>) -> String {
    let numbers: Vec<String> = matrix.transpose().iter().map(ToString::to_string).collect();
    numbers.join(" ") + "\n"
}

fn frame_in_words(results: &Results) -> String {
    let times = match results.time_base {
        TimeBase::Frames => "frame indices",
        _ => "seconds from the start of the video",
    };
    format!("world_from_body; unit: {}; axes of the world: {}; times: {times}", results.unit(), results.axes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::{results, with_metres};
    use crate::io::interchange::camera_path;
    use crate::scene::ImageId;

    #[test]
    fn written_poses_are_read_back() {
        for results in [results(), with_metres(results())] {
            let folder = tempfile::tempdir().unwrap();
            write_tum(folder.path(), &results).unwrap();
            let tum = camera_path::read_tum(&folder.path().join("camera.txt")).unwrap();
            let text = std::fs::read_to_string(folder.path().join("vehicle-1.txt")).unwrap();
            assert!(text.contains(results.unit()), "{text}");
            write_kitti(folder.path(), &results).unwrap();
            let kitti = camera_path::read_kitti(&folder.path().join("camera.txt")).unwrap();
            let vehicle = camera_path::read_kitti(&folder.path().join("vehicle-1.txt")).unwrap();
            let export_from_world = results.export_from_world();
            for (index, view) in (1..).zip(&results.views) {
                let expected = export_from_world.transform_camera(&view.cam_from_world);
                for model in [&tum, &kitti] {
                    let found = model.images[&ImageId(index)].cam_from_world;
                    assert!((found.center() - expected.center()).norm() < 1e-9);
                    assert!(found.angle_to(&expected) < 1e-6);
                }
            }
            let expected = export_from_world * Point3::from(results.trajectories.objects[0].poses[0].position);
            assert!((vehicle.images[&ImageId(1)].cam_from_world.center() - expected).norm() < 1e-9);
            let times = std::fs::read_to_string(folder.path().join("camera.times.txt")).unwrap();
            assert_eq!(times.lines().count(), results.views.len());
            assert!(folder.path().join("about.txt").is_file());
        }
    }
}
