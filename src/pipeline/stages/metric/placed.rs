//! Poses in metres and on the map.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3};

use crate::metric::{ObservedPoint, in_metres, metric_pose, place_std_m};
use crate::pipeline::stages::scale::PoseCovariances;
use crate::scene::{
    BodyCenter, Estimate, Image, MapPlace, MetricFrame, MetricPose, Movement, ObjectId, ObjectPose, ObjectTrajectory,
    Reconstruction, TimeBase, Travel,
};
use crate::telemetry::{Geodetic, LocalFrame};
use crate::trajectory::{CommonStd, PositionError, PositionMeasurement, Smoothed, headings, smooth};

/// Inputs of the metric poses of objects.
pub(super) struct Placing<'a> {
    pub(super) frame: &'a MetricFrame,
    /// True if the frame's scale is nominal: then no metric values are reported.
    pub(super) is_nominal: bool,
    pub(super) map: Option<LocalFrame>,
    pub(super) images: BTreeMap<&'a str, &'a Image>,
    /// Standard deviation of the direction to an object's center, radians: a pixel.
    direction_std: f64,
    poses: &'a PoseCovariances,
    /// Unit of the frames' times: speeds require seconds.
    pub(super) times: TimeBase,
    /// Motion states of the objects, if known.
    movements: BTreeMap<ObjectId, Movement>,
}

/// Assumed time between frames if unknown, seconds: image sequences of traffic have 10 to 30 frames per second. It only
/// sets how sharply a vehicle may turn between frames, within the decades over which the smoother searches.
const NOMINAL_STEP_S: f64 = 0.1;

impl<'a> Placing<'a> {
    pub(super) fn new(
        background: &'a Reconstruction,
        (frame, is_nominal): (&'a MetricFrame, bool),
        poses: &'a PoseCovariances,
        times: TimeBase,
        movements: BTreeMap<ObjectId, Movement>,
    ) -> Self {
        let images: BTreeMap<&str, &Image> =
            background.images.values().map(|image| (image.name.as_str(), image)).collect();
        let focal = background.images.values().next().map_or(1.0, |image| background.camera_of(image).mean_focal());
        let map = frame.origin.map(|origin| LocalFrame { origin });
        Self { frame, is_nominal, map, images, direction_std: 1.0 / focal, poses, times, movements }
    }

    /// Computes the travel, and all metric values if metres are known.
    pub(super) fn fill(&self, trajectory: &mut ObjectTrajectory) {
        let log_ratio_std = trajectory.log_ratio_std();
        for pose in trajectory.poses.iter_mut().filter(|_| !self.is_nominal) {
            let of_body = body_covariance(trajectory.body_center, pose);
            pose.metric = self.metric(trajectory.id, pose, log_ratio_std, of_body);
        }
        let Some(found) = self.smoothed(trajectory) else { return };
        trajectory.travel = Some(self.travel(span(&trajectory.poses, |pose| pose.time_s), &found));
        if self.times == TimeBase::Seconds {
            let placed = trajectory.poses.iter_mut().filter(|pose| pose.metric.is_some());
            for (pose, mut motion) in placed.zip(found.motions) {
                // The error of the center is the same in all frames: smoothing does not reduce it.
                let of_body = in_metres(self.frame, &body_covariance(trajectory.body_center, pose));
                for (k, std) in motion.smoothed_position_std_m.iter_mut().enumerate() {
                    *std = std.hypot(of_body[(k, k)].max(0.0).sqrt());
                }
                pose.metric.iter_mut().for_each(|metric| metric.motion = Some(motion));
            }
        }
    }

    fn smoothed(&self, trajectory: &ObjectTrajectory) -> Option<Smoothed> {
        let common = CommonStd { ratio: trajectory.log_ratio_std(), scale: self.frame.log_scale_std() };
        let movement = self.movements.get(&trajectory.id).copied().unwrap_or(Movement::Undetermined);
        smooth(&self.sightings(trajectory), &common, movement)
    }

    /// * `seconds` – time from the first frame to the last.
    pub(super) fn travel(&self, seconds: f64, found: &Smoothed) -> Travel {
        let MetricFrame { scale, .. } = *self.frame;
        let in_units = |metres: Estimate| {
            let share = self.frame.log_scale_std() * metres.value;
            let std = (metres.std.powi(2) - share.powi(2)).max(0.0).sqrt();
            Estimate { std, ..metres }.scaled(scale.recip())
        };
        let is_metric = !self.is_nominal;
        let is_timed = is_metric && self.times == TimeBase::Seconds && seconds > 0.0;
        Travel {
            path_units: in_units(found.path_m),
            displacement_units: in_units(found.displacement_m),
            path_m: is_metric.then_some(found.path_m),
            displacement_m: is_metric.then_some(found.displacement_m),
            mean_speed_m_s: is_timed.then(|| found.path_m.scaled(seconds.recip())),
            max_speed_m_s: is_timed.then_some(found.max_speed_m_s),
        }
    }

    /// Seconds per unit of the frames' times.
    pub(super) fn step_s(&self) -> f64 {
        if self.times == TimeBase::Seconds { 1.0 } else { NOMINAL_STEP_S }
    }

    /// Position measurements of the object in metres, in the frames with a known position.
    fn sightings(&self, trajectory: &ObjectTrajectory) -> Vec<PositionMeasurement> {
        let metric_from_world = self.frame.metric_from_world();
        let headings = headings(trajectory);
        let sighting = |(k, pose): (usize, &ObjectPose)| {
            let center = self.images.get(pose.name.as_str())?.cam_from_world.center();
            Some(PositionMeasurement {
                time_s: self.step_s() * pose.time_s,
                position_m: (metric_from_world * Point3::from(pose.position)).coords,
                camera_m: (metric_from_world * center).coords,
                forward: headings.get(k).map(|heading| metric_from_world.rotation * heading.into_inner()),
                error: PositionError::Model { pose: in_metres(self.frame, &self.pose_covariance(trajectory.id, pose)) },
            })
        };
        trajectory.poses.iter().enumerate().filter_map(sighting).collect()
    }

    /// Covariance of a pose in its frame, in the frame and unit of the background.
    fn pose_covariance(&self, id: ObjectId, pose: &ObjectPose) -> Matrix3<f64> {
        self.poses.get(&id).and_then(|of_frames| of_frames.get(&pose.frame)).copied().unwrap_or_default()
    }

    /// * `of_body` – covariance of the center of the body, in the frame and unit of the background.
    fn metric(&self, id: ObjectId, pose: &ObjectPose, log_ratio_std: f64, of_body: Matrix3<f64>) -> Option<MetricPose> {
        let center = self.images.get(pose.name.as_str())?.cam_from_world.center();
        let direction_std = self.direction_std;
        let (point, pose_covariance) = (Point3::from(pose.position), self.pose_covariance(id, pose) + of_body);
        let observed = ObservedPoint { point, center, log_ratio_std, direction_std, pose_covariance };
        metric_of(self.frame, self.map.as_ref(), &observed)
    }
}

/// Position in meters, and on the map if there is one; `None` for lengths that are not finite.
pub(super) fn metric_of(frame: &MetricFrame, map: Option<&LocalFrame>, observed: &ObservedPoint) -> Option<MetricPose> {
    let found = metric_pose(frame, observed);
    let is_finite = found.position_m.iter().chain(&found.position_std_m).all(|value| value.is_finite());
    let place = |map: &LocalFrame| {
        let Geodetic { longitude_deg, latitude_deg, height_m } = map.to_geodetic(Point3::from(found.position_m));
        let place_std_m = place_std_m(frame, observed);
        MapPlace { longitude: longitude_deg, latitude: latitude_deg, height_m, place_std_m }
    };
    is_finite.then(|| MetricPose { place: map.map(place), ..found })
}

/// Time from the first to the last of some poses, seconds.
pub(super) fn span<T>(poses: &[T], time_s: impl Fn(&T) -> f64) -> f64 {
    poses.first().zip(poses.last()).map_or(0.0, |(first, last)| time_s(last) - time_s(first))
}

/// Covariance of the center of the body in a frame, in the frame and unit of the background.
fn body_covariance(center: Option<BodyCenter>, pose: &ObjectPose) -> Matrix3<f64> {
    center.map_or_else(Matrix3::zeros, |center| center.covariance_in_world(&pose.world_from_object))
}
