//! Common view of the positions of trajectories and ground tracks.

use nalgebra::Point3;

use super::{FrameId, GroundPosition, MetricPose, ObjectPose};

/// Position in one frame.
#[derive(Clone, Copy, Debug)]
pub struct Position<'a> {
    /// The frame.
    pub frame: FrameId,
    /// Its image name.
    pub name: &'a str,
    /// Its time, seconds.
    pub time_s: f64,
    /// In the background's frame and unit.
    pub in_world: Point3<f64>,
    /// Meters, speed and georeferenced position; `None` where they are unknown.
    pub metric: Option<&'a MetricPose>,
}

impl<'a> From<&'a ObjectPose> for Position<'a> {
    fn from(pose: &'a ObjectPose) -> Self {
        let ObjectPose { frame, ref name, time_s, position, ref metric, .. } = *pose;
        Self { frame, name, time_s, in_world: position.into(), metric: metric.as_ref() }
    }
}

impl<'a> From<&'a GroundPosition> for Position<'a> {
    fn from(contact: &'a GroundPosition) -> Self {
        let GroundPosition { frame, ref name, time_s, position, ref metric, .. } = *contact;
        Self { frame, name, time_s, in_world: position.into(), metric: metric.as_ref() }
    }
}
