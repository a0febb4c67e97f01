//! Places the object into the background, frame by frame.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};

use crate::math::{Rigid3, STD_PER_MAD, Sim3, centroid, median};
use crate::scene::{Frame, FrameId, Image, ObjectId, ObjectPose, ObjectTrajectory, Reconstruction, ScaleEstimate};

/// Description of an object besides its geometry.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectDescription {
    /// Its id.
    pub id: ObjectId,
    /// Its class name.
    pub class: String,
    /// Mean score of its detections, 0 to 1; 1 for given masks.
    pub confidence: f64,
}

/// The trajectory of an object whose scale ratio is known.
///
/// Every frame of `frames` whose image is registered in both models gets a pose, also one without a ground plane and
/// one whose pose looks like an outlier; frames that are not in both models are absent. The pose is eq.
/// object_to_background_coordinates as a similarity: x_world = c(b) + r R(b)ᵀ R(o) (x_object − c(o)). `position` is
/// [`object_center`] placed by it.
/// What its ground rests on is for the caller to say.
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

/// The object's pose in every frame whose image is registered in both models, in the order of `frames`, at the scale
/// ratio `ratio` (eq. object_to_background_coordinates); without speeds.
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
        let world_from_object = place(&in_background.cam_from_world, &in_object.cam_from_world, ratio);
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

/// The similarity world ← object of one frame (eq. object_to_background_coordinates): camera coordinates of the object
/// are scaled by the ratio, since both camera frames share their origin and axes.
fn place(cam_from_world: &Rigid3, cam_from_object: &Rigid3, ratio: f64) -> Sim3 {
    let world_from_cam = cam_from_world.inverse();
    let rotation = world_from_cam.rotation * cam_from_object.rotation;
    let translation = world_from_cam.rotation * cam_from_object.translation * ratio + world_from_cam.translation;
    Sim3::new(ratio, rotation, translation)
}

/// The middle of the object's points, in its own frame: the mean of those within three robust standard deviations of
/// the median along every axis, so that a handful of stray points does not move it. The origin for a model without
/// points.
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

/// Half of the time over which a speed is taken, seconds: long enough for a vehicle in traffic to move further than the
/// noise of its position, short enough for it not to change its mind.
pub(super) const HALF_WINDOW_S: f64 = 0.5;

/// Velocity at one pose, units of the world per second: of the straight line, by least squares, through the positions
/// within half a second of it, and at least its neighbors. `None` when these have the same time or there are none.
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
    fn objects_are_placed_where_they_are() {
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
        // In the curve the centre of the reconstructed points, not being on the axis, drives a circle of its own.
        for (route, tolerance) in [(Route::Straight, 1e-9), (curve, 0.2)] {
            let options = Options { background_unit_m: 1.0, route, ..Options::default() };
            let poses = assembled(&drive(&options, 7)).poses;
            for speed in (0..poses.len()).map(|k| velocity(&poses, k).unwrap().norm()) {
                assert!((speed - options.speed_m_s).abs() < tolerance, "{speed}");
            }
        }
    }

    #[test]
    fn stray_points_do_not_move_the_centre() {
        let mut world = drive(&Options { num_frames: 5, ..Options::default() }, 1);
        let before = object_center(&world.object);
        for point in world.object.points.values_mut().take(3) {
            point.position.x += 1e4;
        }
        assert!((object_center(&world.object) - before).norm() < 0.2);
        assert_eq!(object_center(&Reconstruction::default()), Point3::origin());
    }
}
