//! Poses of the object in the background's frame.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};

use crate::math::{Rigid3, STD_PER_MAD, Sim3, centroid, median};
use crate::scene::{Frame, FrameId, Image, ObjectId, ObjectPose, ObjectTrajectory, Reconstruction, ScaleEstimate};

/// Id, class and confidence of an object.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectDescription {
    /// Its id.
    pub id: ObjectId,
    /// Its class name.
    pub class: String,
    /// Mean score of its detections, 0 to 1; 1 for given masks.
    pub confidence: f64,
}

/// Assembles the trajectory of an object with a known scale ratio.
///
/// Every frame of `frames` whose image is registered in both models gets a pose, also without a ground plane and with
/// an outlying pose; other frames are absent. The pose is eq. object_to_background_coordinates as a similarity: x_world
/// = c(b) + r R(b)ᵀ R(o) (x_object − c(o)). `position` is [`object_center`] transformed by it. The caller fills in the
/// bases of the ground planes.
pub fn assemble(
    description: ObjectDescription,
    background: &Reconstruction,
    object: &Reconstruction,
    scale: ScaleEstimate,
    frames: &[Frame],
) -> ObjectTrajectory {
    let mut poses = poses(background, object, scale.ratio, frames);
    poses.sort_by_key(|pose: &ObjectPose| -> FrameId { pose.frame });
    let ObjectDescription { id, class, confidence } = description;
    ObjectTrajectory { poses, ..ObjectTrajectory::new(id, class, confidence, scale) }
}

/// Poses of the object at a scale ratio, in the order of `frames` (eq. object_to_background_coordinates).
///
/// Only for frames whose image is registered in both models, and without speeds.
pub(super) fn poses(
    background: &Reconstruction,
    object: &Reconstruction,
    ratio: f64,
    frames: &[Frame],
) -> Vec<ObjectPose> {
    let center = object_center(object);
    let by_name: BTreeMap<&str, (&Image, &Image)> = background
        .paired_images(object)
        .into_iter()
        .map(|(_, in_background, in_object)| (in_background.name.as_str(), (in_background, in_object)))
        .collect();
    let pose = |frame: &Frame| {
        let (in_background, in_object) = by_name.get(frame.name.as_str())?;
        let world_from_object = similarity(&in_background.cam_from_world, &in_object.cam_from_world, ratio);
        Some(ObjectPose {
            frame: frame.id,
            name: frame.name.clone(),
            time_s: frame.time_s,
            position: (world_from_object * center).coords.into(),
            world_from_object,
            metric: None,
        })
    };
    frames.iter().filter_map(pose).collect()
}

/// Similarity from object to world in one frame (eq. object_to_background_coordinates).
///
/// Both camera frames share their origin and axes, so that camera coordinates of the object are scaled by the ratio.
fn similarity(cam_from_world: &Rigid3, cam_from_object: &Rigid3, ratio: f64) -> Sim3 {
    let world_from_cam = cam_from_world.inverse();
    let rotation = world_from_cam.rotation * cam_from_object.rotation;
    let translation = world_from_cam.rotation * cam_from_object.translation * ratio + world_from_cam.translation;
    Sim3::new(ratio, rotation, translation)
}

/// Center of the object's points, in its frame; the origin for a model without points.
///
/// It is the mean of the points within three robust standard deviations of the median along every axis, so that a few
/// stray points do not move it.
pub fn object_center(object: &Reconstruction) -> Point3<f64> {
    let points = object.finite_positions();
    let along = |axis: usize, from: f64| points.iter().map(move |p| p[axis] - from);
    let mut center = Vector3::zeros();
    let mut spread = Vector3::zeros();
    for axis in 0..3 {
        center[axis] = median(along(axis, 0.0).collect()).unwrap_or(0.0);
        spread[axis] = median(along(axis, center[axis]).map(f64::abs).collect()).unwrap_or(0.0);
    }
    let inliers: Vec<Point3<f64>> = points
        .iter()
        .copied()
        .filter(|p| (0..3).all(|axis| (p[axis] - center[axis]).abs() <= 3.0 * STD_PER_MAD * spread[axis]))
        .collect();
    if inliers.is_empty() { Point3::from(center) } else { centroid(&inliers) }
}

/// Half of the time over which a speed is computed, seconds: long enough for a vehicle in traffic to move farther than
/// the noise of its position, short enough for a constant motion.
pub(super) const HALF_WINDOW_S: f64 = 0.5;

/// Velocity at one pose, units of the world per second.
///
/// Least squares line through the positions within half a second, and at least the neighbors. `None` if these have the
/// same time or there are none.
pub(super) fn velocity(poses: &[ObjectPose], k: usize) -> Option<Vector3<f64>> {
    let now = poses[k].time_s;
    let near = |i: &usize| i.abs_diff(k) <= 1 || (poses[*i].time_s - now).abs() <= HALF_WINDOW_S;
    let window: Vec<&ObjectPose> = (0..poses.len()).filter(near).map(|i| &poses[i]).collect();
    let count = window.len() as f64;
    let mean_time = window.iter().map(|p| p.time_s - now).sum::<f64>() / count;
    let mean = window.iter().map(|p| Vector3::from(p.position)).sum::<Vector3<f64>>() / count;
    let (mut slope, mut spread) = (Vector3::zeros(), 0.0);
    for pose in window {
        let t = pose.time_s - now - mean_time;
        slope += (Vector3::from(pose.position) - mean) * t;
        spread += t * t;
    }
    (spread > 0.0).then(|| slope / spread)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::ScaleMethod;
    use crate::synthetic::drive::{Drive, Options, Route, drive};

    fn known(ratio: f64) -> ScaleEstimate {
        ScaleEstimate::new(ratio, ScaleMethod::ConstantDistance)
    }

    fn assembled(world: &Drive) -> ObjectTrajectory {
        let description = ObjectDescription { id: ObjectId(1), class: "car".into(), confidence: 1.0 };
        assemble(description, &world.background, &world.object, known(world.ratio), &world.frames)
    }

    #[test]
    fn poses_are_those_of_the_object() {
        let world = drive(&Options::default(), 1);
        let found = assembled(&world);
        assert_eq!(found.poses.len(), world.frames.len());
        for pose in &found.poses {
            let truth = world.world_from_object[&pose.frame];
            assert_eq!(pose.world_from_object.scale, world.ratio);
            assert!(pose.world_from_object.rotation.angle_to(&truth.rotation) < 1e-9);
            assert!((pose.world_from_object.translation - truth.translation).norm() < 1e-9);
            assert!((Point3::from(pose.position) - truth * object_center(&world.object)).norm() < 1e-9);
        }
    }

    #[test]
    fn frames_without_both_cameras_are_absent() {
        let mut world = drive(&Options { num_frames: 10, ..Options::default() }, 1);
        world.background.images.pop_first();
        world.object.images.pop_last();
        let found = assembled(&world);
        assert_eq!(found.poses.iter().map(|p| p.frame.0).collect::<Vec<_>>(), (1..9).collect::<Vec<_>>());
    }

    #[test]
    fn velocities_are_those_of_the_vehicle() {
        let curve = Route::Curve { radius_m: 40.0 };
        // In the curve the center of the reconstructed points is not on the axis and has a circle of its own.
        for (route, tolerance) in [(Route::Straight, 1e-9), (curve, 0.2)] {
            let options = Options { background_unit_m: 1.0, route, ..Options::default() };
            let poses = assembled(&drive(&options, 7)).poses;
            for speed in (0..poses.len()).map(|k| velocity(&poses, k).unwrap().norm()) {
                assert!((speed - options.speed_m_s).abs() < tolerance, "{speed}");
            }
        }
    }

    #[test]
    fn stray_points_do_not_move_the_center() {
        let mut world = drive(&Options { num_frames: 5, ..Options::default() }, 1);
        let before = object_center(&world.object);
        for point in world.object.points.values_mut().take(3) {
            point.position.x += 1e4;
        }
        assert!((object_center(&world.object) - before).norm() < 0.2);
        assert_eq!(object_center(&Reconstruction::default()), Point3::origin());
    }
}
