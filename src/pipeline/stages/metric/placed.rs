//! Poses in metres and on the map.

use std::collections::BTreeMap;

use nalgebra::Point3;

use crate::metric::{ObservedPoint, metric_pose, place_std_m};
use crate::scene::{
    Estimate, Image, MapPlace, MetricFrame, MetricPose, Movement, ObjectId, ObjectPose, ObjectTrajectory,
    Reconstruction, TimeBase, Travel,
};
use crate::telemetry::{Geodetic, LocalFrame};
use crate::trajectory::{CommonStd, PositionMeasurement, Smoothed, headings, smooth};

/// All that places objects in metres.
pub(super) struct Placing<'a> {
    frame: &'a MetricFrame,
    map: Option<LocalFrame>,
    images: BTreeMap<&'a str, &'a Image>,
    direction_std: f64,
    /// Unit of the frames' times: only with seconds are there speeds.
    times: TimeBase,
    /// Motion states of the objects, where they are known.
    movements: BTreeMap<ObjectId, Movement>,
}

/// Deviation of a ratio of which its method states none, as a share: what methods differ by where they work.
const UNSTATED_RATIO_STD: f64 = 0.1;

/// Time from frame to frame where none is known, seconds: image sequences of traffic have 10 to 30 frames a second. It
/// sets only how sharply a vehicle may turn from frame to frame, within the decades over which the smoother searches.
const NOMINAL_STEP_S: f64 = 0.1;

/// Deviation of an object's middle in the picture, pixels.
const PIXEL_STD: f64 = 1.0;

impl<'a> Placing<'a> {
    pub(super) fn new(
        background: &'a Reconstruction,
        frame: &'a MetricFrame,
        map: Option<LocalFrame>,
        times: TimeBase,
        movements: BTreeMap<ObjectId, Movement>,
    ) -> Self {
        let images: BTreeMap<&str, &Image> =
            background.images.values().map(|image| (image.name.as_str(), image)).collect();
        let focal = background.images.values().next().map_or(1.0, |image| background.camera_of(image).mean_focal());
        Self { frame, map, images, direction_std: PIXEL_STD / focal, times, movements }
    }

    /// Fills in all metric values.
    pub(super) fn fill(&self, trajectory: &mut ObjectTrajectory) {
        let log_ratio_std = log_ratio_std(trajectory);
        for pose in &mut trajectory.poses {
            pose.metric = self.metric(pose, log_ratio_std);
        }
        let Some(found) = self.smoothed(trajectory) else { return };
        trajectory.travel = Some(self.travel(trajectory, &found));
        if self.times == TimeBase::Seconds {
            let placed = trajectory.poses.iter_mut().filter_map(|pose| pose.metric.as_mut());
            placed.zip(found.motions).for_each(|(metric, motion)| metric.motion = Some(motion));
        }
    }

    /// Fills in the travel alone, in units, where metres are unknown and the frame's scale is a nominal one.
    pub(super) fn fill_units(&self, trajectory: &mut ObjectTrajectory) {
        let found = self.smoothed(trajectory);
        trajectory.travel = found.map(|found| Travel {
            path_m: None,
            displacement_m: None,
            mean_speed_m_s: None,
            max_speed_m_s: None,
            ..self.travel(trajectory, &found)
        });
    }

    fn smoothed(&self, trajectory: &ObjectTrajectory) -> Option<Smoothed> {
        let common = CommonStd { ratio: log_ratio_std(trajectory), scale: self.frame.log_scale_std() };
        let movement = self.movements.get(&trajectory.id).copied().unwrap_or(Movement::Undetermined);
        smooth(&self.sightings(trajectory), &common, movement)
    }

    fn travel(&self, trajectory: &ObjectTrajectory, found: &Smoothed) -> Travel {
        let MetricFrame { scale, .. } = *self.frame;
        let in_units = |metres: Estimate| {
            let share = self.frame.log_scale_std() * metres.value;
            let std = (metres.std.powi(2) - share.powi(2)).max(0.0).sqrt();
            Estimate { std, ..metres }.scaled(scale.recip())
        };
        let seconds = match (trajectory.poses.first(), trajectory.poses.last()) {
            (Some(first), Some(last)) if self.times == TimeBase::Seconds => last.time_s - first.time_s,
            _ => 0.0,
        };
        let is_timed = seconds > 0.0;
        Travel {
            path_units: in_units(found.path_m),
            displacement_units: in_units(found.displacement_m),
            path_m: Some(found.path_m),
            displacement_m: Some(found.displacement_m),
            mean_speed_m_s: is_timed.then(|| found.path_m.scaled(seconds.recip())),
            max_speed_m_s: is_timed.then_some(found.max_speed_m_s),
        }
    }

    /// Where the object is in metres, in the frames in which that is known.
    fn sightings(&self, trajectory: &ObjectTrajectory) -> Vec<PositionMeasurement> {
        let metric_from_world = self.frame.metric_from_world();
        let headings = headings(trajectory);
        let step_s = if self.times == TimeBase::Seconds { 1.0 } else { NOMINAL_STEP_S };
        let sighting = |(k, pose): (usize, &ObjectPose)| {
            let center = self.images.get(pose.name.as_str())?.cam_from_world.center();
            Some(PositionMeasurement {
                time_s: step_s * pose.time_s,
                position_m: (metric_from_world * Point3::from(pose.position)).coords,
                camera_m: (metric_from_world * center).coords,
                forward: headings.get(k).map(|heading| metric_from_world.rotation * heading.into_inner()),
            })
        };
        trajectory.poses.iter().enumerate().filter_map(sighting).collect()
    }

    fn metric(&self, pose: &ObjectPose, log_ratio_std: f64) -> Option<MetricPose> {
        let center = self.images.get(pose.name.as_str())?.cam_from_world.center();
        let direction_std = self.direction_std;
        let sighted = ObservedPoint { point: Point3::from(pose.position), center, log_ratio_std, direction_std };
        let found = metric_pose(self.frame, &sighted);
        // Lengths that no number holds are no metres.
        let is_finite = found.position_m.iter().chain(&found.position_std_m).all(|value| value.is_finite());
        is_finite.then(|| MetricPose { place: self.map.map(|map| self.place(&map, &found, &sighted)), ..found })
    }

    fn place(&self, map: &LocalFrame, found: &MetricPose, sighted: &ObservedPoint) -> MapPlace {
        let Geodetic { longitude_deg, latitude_deg, height_m } = map.to_geodetic(Point3::from(found.position_m));
        let place_std_m = place_std_m(self.frame, sighted);
        MapPlace { longitude: longitude_deg, latitude: latitude_deg, height_m, place_std_m }
    }
}

fn log_ratio_std(trajectory: &ObjectTrajectory) -> f64 {
    trajectory.scale.std.map_or(UNSTATED_RATIO_STD, |std| std / trajectory.scale.ratio)
}
