//! Stationary vehicles, triangulated from the cameras of the background.

use nalgebra::{Matrix3, Vector3};

use super::place::{Adjustment, DroppedFrames, Evidence, PlacedObject};
use super::pose_error::MIN_PIXEL_STD;
use crate::math::{median, widest_angle};
use crate::scene::{
    CameraPathRatio, ImageId, ObjectPose, Point3d, Ratios, Reconstruction, ScaleEstimate, ScaleMethod, ScaleShares,
};

/// Places a stationary vehicle whose points were triangulated from the background's cameras.
///
/// Its model is in the background's frame and unit, so that the ratio is one.
///
/// * `placed` – the same vehicle with its ratio from the ground, which is reported for comparison.
/// * `accepted` – maximum relative standard deviation of a determined ratio.
///
/// `None` for a model without points.
pub fn place_stationary(evidence: &Evidence, placed: &PlacedObject, accepted: f64) -> Option<PlacedObject> {
    let model = evidence.object;
    // Parallax angle of a point between its cameras, and standard deviation of a ray's direction, radians.
    let parallax = median(model.points.values().map(|point| widest_angle_of(point, model)).collect())?;
    let noise_px = model.mean_reprojection_error_px()?.max(MIN_PIXEL_STD);
    let noise = noise_px / model.cameras.values().next()?.mean_focal();
    let object = with_depth_prior(model, noise);
    // A track drifts, so that its observations count as two, those at its ends. Drifts of neighboring points are
    // correlated, so that all points count as one.
    let std = 2f64.sqrt() * noise / parallax;
    let by_ground = placed.trajectory.as_ref().ok().map(|trajectory| &trajectory.scale);
    let camera_path = by_ground.map(|scale| CameraPathRatio {
        ratio: 1.0,
        std,
        residual: noise,
        ratio_without: scale.ratio,
        std_without: scale.std,
        degenerate_without: scale.degenerate,
    });
    let before = by_ground.cloned().unwrap_or_else(|| ScaleEstimate::new(1.0, ScaleMethod::Joint));
    let degenerate = !(std <= accepted);
    let scale = ScaleEstimate {
        ratio: 1.0,
        std: Some(std),
        degenerate,
        reason: degenerate
            .then(|| "the camera moves too little next to the distance of a stationary vehicle".to_owned()),
        alternatives: Ratios::from([(before.method, 1.0)]),
        shares: Some(ScaleShares { frames: std, ..ScaleShares::default() }),
        camera_path,
        ..before
    };
    let trajectory = evidence.trajectory(&object, scale).ok()?;
    // The pose of a frame is that of the background's camera: only the image noise perpendicular to the ray remains.
    let covariance = |pose: &ObjectPose| {
        let center = evidence.background.images.get(&ImageId::from(pose.frame))?.cam_from_world.center().coords;
        let std = noise * (Vector3::from(pose.position) - center).norm();
        Some((pose.frame, Matrix3::identity() * (std * std)))
    };
    let pose_covariances = trajectory.poses.iter().filter_map(covariance).collect();
    let (adjustment, dropped) = (Adjustment::None, DroppedFrames::default());
    Some(PlacedObject { object, adjustment, trajectory: Ok(trajectory), pose_covariances, dropped })
}

/// Model with its points moved along their rays under a prior on vehicles: depth similar to width.
///
/// Depths of single points are poor where the camera moves little. With q_j the inverse distance of a point from the
/// middle camera, σ_j its standard deviation from the parallax of the point, and q the mean by inverse variances, q_j
/// has the prior q ± q ρ, ρ the spread of the directions to the points.
///
/// * `noise` – standard deviation of a ray's direction, radians.
fn with_depth_prior(object: &Reconstruction, noise: f64) -> Reconstruction {
    let mut object = object.clone();
    let Some(middle) = object.images.values().nth(object.images.len() / 2) else { return object };
    let center = middle.cam_from_world.center();
    let inverse = |point: &Point3d| {
        let offset = point.position - center;
        let std = 2f64.sqrt() * noise / (widest_angle_of(point, &object) * offset.norm());
        (offset.normalize(), offset.norm().recip(), std)
    };
    let found: Vec<(Vector3<f64>, f64, f64)> = object.points.values().map(inverse).collect();
    let usable = || found.iter().filter(|(direction, q, std)| direction.x.is_finite() && q.is_finite() && *std > 0.0);
    let weight: f64 = usable().map(|(_, _, std)| std.powi(-2)).sum();
    let mean = usable().map(|(_, q, std)| q * std.powi(-2)).sum::<f64>() / weight;
    let axis = usable().map(|(direction, ..)| direction).sum::<Vector3<f64>>().normalize();
    let spread = usable().map(|(direction, ..)| (direction - axis).norm_squared()).sum::<f64>() / found.len() as f64;
    // Width and depth of a vehicle differ by a factor of up to 2.5 in either direction.
    let prior_std = 1.5 * mean * spread.sqrt();
    for (point, (direction, q, std)) in object.points.values_mut().zip(&found) {
        let share = prior_std.powi(2) / (prior_std.powi(2) + std.powi(2));
        let moved = center + direction / (mean + share * (q - mean));
        if moved.coords.iter().all(|x| x.is_finite()) {
            point.position = moved;
        }
    }
    object
}

/// Widest angle between the rays to a point, radians.
fn widest_angle_of(point: &Point3d, object: &Reconstruction) -> f64 {
    let images = point.track.iter().filter_map(|element| object.images.get(&element.image));
    widest_angle(point.position, images.map(|image| image.cam_from_world.center()))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use nalgebra::Point3;

    use super::*;
    use crate::scene::{FrameId, GroundPlane, ObjectId};
    use crate::synthetic::drive::Drive;
    use crate::trajectory::assemble::object_center;
    use crate::trajectory::relative_motion::tests::shaken;
    use crate::trajectory::{ModelOrigin, ObjectDescription, Options, Silhouette, place};

    fn evidence<'a>(
        world: &'a Drive,
        object: &'a Reconstruction,
        planes: &'a BTreeMap<FrameId, GroundPlane>,
        silhouettes: &'a BTreeMap<FrameId, Silhouette>,
    ) -> Evidence<'a> {
        Evidence {
            description: ObjectDescription { id: ObjectId(1), class: "car".into(), confidence: 1.0 },
            origin: ModelOrigin::Reconstructed,
            background: &world.background,
            object,
            planes,
            silhouettes,
            frames: &world.frames,
            focal_std: None,
        }
    }

    #[test]
    fn a_stationary_vehicle_is_at_the_position_of_its_points() {
        let (world, object) = shaken(0.0, 1.0);
        let none = BTreeMap::new();
        let evidence = evidence(&world, &object, &world.planes, &none);
        let by_ground = place(&evidence, &Options::default());
        let placed = place_stationary(&evidence, &by_ground, 0.1).unwrap();
        let trajectory = placed.trajectory.unwrap();
        let center = object_center(&object);
        for pose in &trajectory.poses {
            let error = (Point3::from(Vector3::from(pose.position)) - center).norm();
            assert!(error < 0.02 * (world.background.images[&ImageId::from(pose.frame)].cam_from_world * center).z);
            assert!(placed.pose_covariances[&pose.frame][(0, 0)] > 0.0);
        }
        let (scale, path) = (&trajectory.scale, trajectory.scale.camera_path.unwrap());
        assert!(scale.ratio == 1.0 && scale.std.unwrap() < 0.02 && !scale.degenerate, "{scale:?}");
        assert_eq!(Ok(path.ratio_without), by_ground.trajectory.map(|trajectory| trajectory.scale.ratio));
    }

    #[test]
    fn points_of_small_parallax_are_moved_to_the_others() {
        let (_, object) = shaken(0.0, 1.0);
        let mut noisy = object.clone();
        let eye = object.images.values().nth(object.images.len() / 2).unwrap().cam_from_world.center();
        for (k, point) in noisy.points.values_mut().enumerate() {
            point.position = eye + (point.position - eye) / (1.0 + [0.2, -0.2][k % 2]);
        }
        let extent = |model: &Reconstruction| {
            let from_eye: Vec<f64> = model.points.values().map(|point| (point.position - eye).norm()).collect();
            from_eye.iter().copied().fold(0.0, f64::max) - from_eye.iter().copied().fold(f64::INFINITY, f64::min)
        };
        let rays_std = 0.2;
        assert!(extent(&with_depth_prior(&noisy, rays_std)) < 0.5 * extent(&noisy));
        assert!((extent(&with_depth_prior(&object, 1e-6)) / extent(&object) - 1.0).abs() < 0.01);
    }
}
