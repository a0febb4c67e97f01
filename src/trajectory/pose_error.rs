//! Error of an object's position in single frames.
//!
//! The error of the scale ratio is common to all frames. The individual error of a frame is that of its pose relative
//! to the model. With x_j = ω × R (X_j − c) + p in the frame of the camera, c the object's center, the information of
//! the pixels is Σ Jⱼᵀ Jⱼ / σ² for J = ∂pixel/∂(ω, p), and the block of p in its inverse is the covariance of the
//! position. Few points close to one another determine the distance poorly: its error is σ z² / (f · spread · √n).

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Matrix6, Point3, SMatrix, Vector3};

use super::assemble::object_center;
use super::contact::{ContactOptions, solid_points};
use super::place::DroppedFrames;
use super::smoother::{PositionError, PositionMeasurement, Residual, residuals};
use crate::math::quantile_range;
use crate::scene::{FrameId, Image, ObjectPose, ObjectTrajectory, Reconstruction};

/// Minimum standard deviation of an observation, pixels: corners are not localized better, and the residuals of the few
/// that are left at the end of a track are too small by overfitting.
pub(super) const MIN_PIXEL_STD: f64 = 0.3;

/// Covariance of an object's position in each frame, in the frame and unit of the background, without that of the
/// ratio.
///
/// Frames whose pixels do not determine a pose have an infinite covariance, and are absent.
pub(super) fn pose_covariances(
    background: &Reconstruction,
    object: &Reconstruction,
    ratio: f64,
) -> BTreeMap<FrameId, Matrix3<f64>> {
    let center = object_center(object);
    let of_frame = |(frame, in_background, in_object): (FrameId, &Image, &Image)| {
        let world_from_cam = in_background.cam_from_world.rotation.inverse().to_rotation_matrix();
        let in_cam = position_covariance(object, in_object, center)?;
        Some((frame, world_from_cam * in_cam * world_from_cam.transpose() * (ratio * ratio)))
    };
    background.paired_images(object).into_iter().filter_map(of_frame).collect()
}

/// Covariance of the object's center in the camera's frame, in the object's unit.
fn position_covariance(object: &Reconstruction, image: &Image, center: Point3<f64>) -> Option<Matrix3<f64>> {
    let camera = object.projecting_camera(image)?;
    let mut information = Matrix6::zeros();
    let (mut squares, mut count) = (0.0, 0usize);
    for observation in &image.observations {
        let Some(point) = observation.point.and_then(|id| object.points.get(&id)) else { continue };
        let in_cam = image.cam_from_world * point.position;
        let Some(pixel) = camera.pixel_from_cam(in_cam) else { continue };
        let arm = image.cam_from_world.rotation * (point.position - center);
        let projection = camera.project(in_cam).d_point;
        let mut jacobian = SMatrix::<f64, 2, 6>::zeros();
        jacobian.fixed_view_mut::<2, 3>(0, 0).copy_from(&(projection * -arm.cross_matrix()));
        jacobian.fixed_view_mut::<2, 3>(0, 3).copy_from(&projection);
        information += jacobian.transpose() * jacobian;
        squares += (pixel - observation.pixel).norm_squared();
        count += 1;
    }
    let variance = (squares / (2 * count).saturating_sub(6).max(1) as f64).max(MIN_PIXEL_STD * MIN_PIXEL_STD);
    let covariance = information.try_inverse()?.fixed_view::<3, 3>(3, 3) * variance;
    let is_covariance = covariance.iter().all(|x| x.is_finite()) && (0..3).all(|k| covariance[(k, k)] >= 0.0);
    is_covariance.then_some(covariance)
}

/// Removes poses that do not determine the vehicle's position; none if fewer than four would be left.
pub(super) fn drop_outliers(
    trajectory: &mut ObjectTrajectory,
    covariances: &BTreeMap<FrameId, Matrix3<f64>>,
    background: &Reconstruction,
    object: &Reconstruction,
) -> DroppedFrames {
    let Some(size) = model_size(object).map(|size| trajectory.scale.ratio * size) else {
        return DroppedFrames::default();
    };
    let poses = &mut trajectory.poses;
    let uncertain = uncertain(poses, covariances, size);
    let uncertain = remove_frames(poses, uncertain);
    let contradicted = contradicted(poses, covariances, background, size);
    let contradicted = remove_frames(poses, contradicted);
    DroppedFrames { uncertain, contradicted }
}

fn remove_frames(poses: &mut Vec<ObjectPose>, frames: Vec<FrameId>) -> Vec<FrameId> {
    // The smoother needs four positions.
    if poses.len() < 4 + frames.len() {
        return Vec::new();
    }
    poses.retain(|pose| !frames.contains(&pose.frame));
    frames
}

/// Frames in which the standard deviation of the position exceeds the size of the model.
fn uncertain(poses: &[ObjectPose], covariances: &BTreeMap<FrameId, Matrix3<f64>>, size: f64) -> Vec<FrameId> {
    let std = |pose: &ObjectPose| covariances.get(&pose.frame).map_or(f64::INFINITY, |c| c.trace().max(0.0).sqrt());
    poses.iter().filter(|pose| std(pose) > size).map(|pose| pose.frame).collect()
}

/// Residual from the smooth motion, in standard deviations, beyond which a position is an outlier: correct ones have up
/// to 3, one of a mask that slipped to a parked car had 800.
const OUTLIER_STDS: f64 = 6.0;
/// Minimum residual of an outlier, as a share of the model's diagonal: the smoothed path follows smaller ones.
const OUTLIER_SHARE: f64 = 0.25;

/// Frames whose position contradicts the motion before and after.
///
/// Their pixels are consistent, but not those of the vehicle: its mask may slip to another vehicle during an occlusion.
fn contradicted(
    poses: &[ObjectPose],
    covariances: &BTreeMap<FrameId, Matrix3<f64>>,
    background: &Reconstruction,
    size: f64,
) -> Vec<FrameId> {
    // The smoother's model of acceleration is in meters; the diagonal of a car is 5 m.
    let unit = 5.0 / size;
    let measurement = |pose: &ObjectPose| {
        Some(PositionMeasurement {
            time_s: pose.time_s,
            position_m: unit * Vector3::from(pose.position),
            camera_m: unit * background.images.get(&pose.frame.into())?.cam_from_world.center().coords,
            forward: None,
            error: PositionError::Model { pose: covariances.get(&pose.frame)? * (unit * unit) },
        })
    };
    let measured: Option<Vec<_>> = poses.iter().map(measurement).collect();
    let Some(residuals) = measured.and_then(|measured| residuals(&measured)) else { return Vec::new() };
    let is_contradicted =
        |residual: &Residual| residual.normalized > OUTLIER_STDS && residual.distance_m > OUTLIER_SHARE * unit * size;
    let found = poses.iter().zip(&residuals).filter(|(_, residual)| is_contradicted(residual));
    found.map(|(pose, _)| pose.frame).collect()
}

/// Diagonal of the box around the reliable points.
fn model_size(object: &Reconstruction) -> Option<f64> {
    let points = solid_points(object, &ContactOptions::default());
    let mut squares = 0.0;
    for axis in 0..3 {
        let [low, high] = quantile_range(&mut points.iter().map(|point| point[axis]).collect::<Vec<_>>(), 0.02)?;
        squares += (high - low).powi(2);
    }
    (squares > 0.0).then(|| squares.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{Sim3, seeded_rng};
    use crate::scene::ImageId;
    use crate::synthetic::drive::{self, Drive, Noise, drive};
    use rand::Rng as _;
    use rand_distr::StandardNormal;

    /// A vehicle that drives away from 30 to 110 m and has five observed points in the last frames.
    fn drives_away(seed: u64) -> Drive {
        let options = drive::Options { distance_m: [30.0, 110.0], ..drive::Options::default() };
        let mut world = drive(&options, seed);
        for frame in 52..60 {
            let image = world.object.images.get_mut(&ImageId::from(FrameId(frame))).unwrap();
            image
                .observations
                .iter_mut()
                .filter(|seen| seen.point.is_some())
                .skip(5)
                .for_each(|seen| seen.point = None);
        }
        world
    }

    fn std_m(world: &Drive, covariance: &Matrix3<f64>) -> f64 {
        covariance.trace().sqrt() / world.background_from_metric.scale
    }

    #[test]
    fn the_std_grows_with_few_points_and_with_the_distance() {
        let world = drives_away(1);
        let found = pose_covariances(&world.background, &world.object, world.ratio);
        let std = |frame: u32| std_m(&world, &found[&FrameId(frame)]);
        assert!(std(0) < 0.1 && std(50) > 3.0 * std(0), "{} {}", std(0), std(50));
        assert!(std(55) > 3.0 * std(50), "{} {}", std(50), std(55));
    }

    #[test]
    fn stds_are_those_of_resected_poses() {
        // Poses of the object's cameras are perturbed according to their covariance; the positions follow.
        let options =
            drive::Options { noise: Noise { pixel_px: 0.3, ..Noise::default() }, ..drive::Options::default() };
        let (mut within, mut all) = ([0.0; 2], 0.0);
        for seed in 0..10 {
            let world = drive(&options, seed);
            let found = pose_covariances(&world.background, &world.object, world.ratio);
            let truth = |frame: &FrameId| world.world_from_object[frame];
            for (frame, image, in_object) in world.background.paired_images(&world.object) {
                let cam_from_object = in_object.cam_from_world;
                let placed: Sim3 = {
                    let world_from_cam = image.cam_from_world.inverse();
                    let rotation = world_from_cam.rotation * cam_from_object.rotation;
                    let arm = world_from_cam.rotation * cam_from_object.translation * world.ratio;
                    Sim3::new(world.ratio, rotation, arm + world_from_cam.translation)
                };
                let center = object_center(&world.object);
                let error = placed * center - truth(&frame) * center;
                let off = error.norm() / found[&frame].trace().sqrt();
                within[0] += f64::from(off <= 1.0);
                within[1] += f64::from(off <= 3.0);
                all += 1.0;
            }
        }
        // The synthetic noise of poses is roughly that of their observations.
        assert!(within[1] / all > 0.9, "{:?}", within.map(|count| count / all));
    }

    #[test]
    fn positions_with_a_std_above_the_size_of_the_vehicle_are_dropped() {
        let mut world = drives_away(2);
        for frame in 57..60 {
            let image = world.object.images.get_mut(&ImageId::from(FrameId(frame))).unwrap();
            image
                .observations
                .iter_mut()
                .filter(|seen| seen.point.is_some())
                .skip(2)
                .for_each(|seen| seen.point = None);
        }
        let covariances = pose_covariances(&world.background, &world.object, world.ratio);
        let mut poses = super::super::assemble::poses(&world.background, &world.object, world.ratio, &world.frames);
        let size = world.ratio * model_size(&world.object).unwrap();
        let frames = uncertain(&poses, &covariances, size);
        let dropped = remove_frames(&mut poses, frames);
        assert!(dropped.len() >= 3 && dropped.iter().all(|frame| frame.0 >= 52), "{dropped:?}");
        assert_eq!(poses.len(), 60 - dropped.len());
        // A model without observations has no covariances, and all poses stay.
        world.object.images.values_mut().for_each(|image| image.observations.clear());
        let none = pose_covariances(&world.background, &world.object, world.ratio);
        let frames = uncertain(&poses, &none, size);
        assert!(none.is_empty() && !frames.is_empty() && remove_frames(&mut poses, frames).is_empty());
    }

    #[test]
    fn a_position_off_the_path_is_an_outlier_before_a_gap_and_within() {
        // The camera of the object is moved along the vehicle, as by the points of a parked car to which its mask
        // slipped: they are consistent, the path is not.
        let mut world = drive(&drive::Options::default(), 4);
        let forward = Vector3::x();
        for frame in 31..45 {
            world.object.images.remove(&ImageId::from(FrameId(frame)));
        }
        let size = model_size(&world.object).unwrap();
        for (frame, share) in [(30, 0.8), (50, -0.5), (55, 0.1)] {
            let image = world.object.images.get_mut(&ImageId::from(FrameId(frame))).unwrap();
            let moved = image.cam_from_world.rotation * (forward * (share * size));
            image.cam_from_world.translation += moved;
            for observation in &mut image.observations {
                let Some(point) = observation.point.and_then(|id| world.object.points.get(&id)) else { continue };
                let in_cam = image.cam_from_world * point.position;
                observation.pixel = world.object.cameras[&image.camera].pixel_from_cam(in_cam).unwrap();
            }
        }
        let covariances = pose_covariances(&world.background, &world.object, world.ratio);
        let poses = super::super::assemble::poses(&world.background, &world.object, world.ratio, &world.frames);
        let found = contradicted(&poses, &covariances, &world.background, world.ratio * size);
        assert_eq!(found, [30, 50].map(FrameId));
    }

    #[test]
    fn a_jump_at_the_end_of_a_path_is_within_its_std() {
        // Errors according to the covariances, meters in the last frames: the smoothed end must cover the truth.
        let world = drives_away(3);
        let covariances = pose_covariances(&world.background, &world.object, world.ratio);
        let rng = &mut seeded_rng(3, 1);
        let metric_from_world = world.background_from_metric.inverse();
        let center = object_center(&world.object);
        let measured = |frame: &crate::scene::Frame| {
            let covariance = covariances[&frame.id];
            let root = covariance.cholesky().unwrap().l();
            let error = root * nalgebra::Vector3::from_fn(|_, _| rng.sample::<f64, _>(StandardNormal));
            let image = &world.background.images[&ImageId::from(frame.id)];
            let rotation = metric_from_world.rotation.to_rotation_matrix();
            crate::trajectory::PositionMeasurement {
                time_s: frame.time_s,
                position_m: (metric_from_world * (world.world_from_object[&frame.id] * center + error)).coords,
                camera_m: (metric_from_world * image.cam_from_world.center()).coords,
                forward: None,
                error: crate::trajectory::PositionError::Model {
                    pose: rotation * covariance * rotation.transpose() * metric_from_world.scale.powi(2),
                },
            }
        };
        let measured: Vec<_> = world.frames.iter().map(measured).collect();
        let smoothed = crate::trajectory::smooth(
            &measured,
            &crate::trajectory::CommonStd::default(),
            crate::scene::Movement::Undetermined,
        )
        .unwrap();
        let truth = metric_from_world * (world.world_from_object[&FrameId(59)] * center);
        let (first, last) = (&smoothed.motions[20], &smoothed.motions[59]);
        let size = |std: [f64; 3]| nalgebra::Vector3::from(std).norm();
        assert!(size(last.smoothed_position_std_m) > 3.0 * size(first.smoothed_position_std_m));
        let error = (Point3::from(last.smoothed_position_m) - truth).norm();
        assert!(error < 3.0 * size(last.smoothed_position_std_m), "{error} {last:?}");
        assert!(last.speed_std_m_s > 2.0 * first.speed_std_m_s);
    }
}
