//! Heading of a vehicle.
//!
//! The direction of motion is noise while a vehicle is stationary. But the object's model turns with the vehicle, so
//! that one direction in the model's frame is "forward" in all frames. It is estimated where the vehicle moves, and
//! used everywhere.

use nalgebra::{Unit, Vector3};

use super::assemble::velocity;
use crate::scene::{ObjectPose, ObjectTrajectory};

/// Forward direction of the vehicle in the object's frame.
///
/// It is the mean, weighted by speed, of the directions of motion rotated into that frame. A vehicle that reverses for
/// a part of the path gets the direction of the longer part. `None` for a trajectory without motion, or if the
/// directions cancel (length of the sum below half of that of parallel directions): then the positions are noise, or
/// the object's poses do not turn with the vehicle.
pub fn forward_axis(poses: &[ObjectPose]) -> Option<Unit<Vector3<f64>>> {
    let (mut sum, mut length) = (Vector3::zeros(), 0.0);
    for (k, pose) in poses.iter().enumerate() {
        let Some(velocity) = velocity(poses, k) else { continue };
        sum += pose.world_from_object.rotation.inverse() * velocity;
        length += velocity.norm();
    }
    (sum.norm() > 0.5 * length).then(|| Unit::new_normalize(sum))
}

/// Heading at each pose as a unit vector in the background's frame; empty without a [`forward_axis`].
pub fn headings(trajectory: &ObjectTrajectory) -> Vec<Unit<Vector3<f64>>> {
    let Some(forward) = forward_axis(&trajectory.poses) else { return Vec::new() };
    trajectory.poses.iter().map(|pose| pose.world_from_object.rotation * forward).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::scene::{ObjectId, ScaleEstimate, ScaleMethod};
    use crate::synthetic::drive::{Options, Route, drive};
    use crate::trajectory::{ObjectDescription, assemble};

    fn trajectory(options: &Options) -> ObjectTrajectory {
        let world = drive(options, 2);
        let scale = ScaleEstimate::new(world.ratio, ScaleMethod::Intersection);
        let description = ObjectDescription { id: ObjectId(1), class: "car".into(), confidence: 1.0 };
        assemble(description, &world.background, &world.object, scale, &world.frames)
    }

    #[test]
    fn headings_follow_a_curve() {
        let options = Options { route: Route::Curve { radius_m: 30.0 }, ..Options::default() };
        let found = trajectory(&options);
        let headings = headings(&found);
        assert_eq!(headings.len(), 60);
        for (around, heading) in found.poses.windows(3).zip(&headings[1..]) {
            let chord = Vector3::from(around[2].position) - Vector3::from(around[0].position);
            assert!(heading.angle(&chord) < 0.03, "{:?}", around[1].frame);
        }
    }

    #[test]
    fn a_stationary_vehicle_has_no_heading() {
        let mut found = trajectory(&Options { num_frames: 5, ..Options::default() });
        for pose in &mut found.poses {
            pose.position = [1.0, 2.0, 3.0];
        }
        assert!(forward_axis(&found.poses).is_none() && headings(&found).is_empty());
        found.poses.clear();
        assert!(forward_axis(&found.poses).is_none());
    }
}
