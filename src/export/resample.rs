//! Results at a fixed rate: linear in time between neighboring frames, never across a gap.
//!
//! Times are multiples of the step from the start of the video, the same for all vehicles and the camera. A standard
//! deviation is interpolated like its value. That is an upper bound, however the errors of two frames are correlated:
//! the standard deviation of a weighted mean is at most the weighted mean of the standard deviations. For covariances
//! the same follows from the convexity of the square.

use std::ops::RangeInclusive;

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::{RegisteredFrame, Results};
use crate::math::{Rigid3, Sim3};
use crate::scene::{
    ContactError, Frame, GroundPosition, MapPlace, MetricPose, Motion, ObjectPose, ObjectTrajectory, Trajectories,
};

/// Maximum step between two frames without a gap, in median steps of the camera's frames: one missing frame is bridged,
/// even with a rounded time stamp; two are a gap.
const MAX_STEP: f64 = 2.5;

/// Accepted rates, per second: below, the step exceeds the length of any clip; above, tables have thousands of rows per
/// frame.
pub const RATES: RangeInclusive<f64> = 0.001..=1000.0;

/// Maximum number of samples of one object: an hour at the highest rate. More would exhaust the memory.
const MAX_SAMPLES: f64 = 3.6e6;

impl Results {
    /// Results with positions of vehicles and camera at `rate` samples per second; `None` if there were too many.
    /// Frame, image and intrinsics of a sample are those of the nearer frame.
    pub fn resampled(&self, rate: f64) -> Option<Self> {
        let step = self.median_step().unwrap_or(0.0);
        let grid = Grid { rate, max_gap_s: MAX_STEP * step };
        let trajectories = &self.trajectories;
        let object = |object: &ObjectTrajectory| {
            let poses = grid.resampled(&object.poses, |pose| pose.time_s, pose_between)?;
            Some(ObjectTrajectory { poses, ..object.clone() })
        };
        let objects = trajectories.objects.iter().map(object).collect::<Option<Vec<_>>>()?;
        let mut ground_tracks = trajectories.ground_tracks.clone();
        for track in &mut ground_tracks {
            track.positions = grid.resampled(&track.positions, |position| position.time_s, contact_between)?;
        }
        let views = grid.resampled(&self.views, |view| view.frame.time_s, view_between)?;
        let trajectories = Trajectories { objects, ground_tracks, ..trajectories.clone() };
        Some(Self { views, trajectories, ..self.clone() })
    }
}

/// A time between two samples.
struct Moment {
    time_s: f64,
    /// Weight of the second sample, 0 to 1.
    weight: f64,
}

/// The times of resampled positions.
struct Grid {
    rate: f64,
    max_gap_s: f64,
}

impl Grid {
    /// Samples at the grid times within a gap-free stretch.
    fn resampled<T>(
        &self,
        samples: &[T],
        time: impl Fn(&T) -> f64,
        between: impl Fn(&T, &T, &Moment) -> T,
    ) -> Option<Vec<T>> {
        let (Some(first), Some(last)) = (samples.first(), samples.last()) else { return Some(Vec::new()) };
        if (time(last) - time(first)) * self.rate > MAX_SAMPLES {
            return None;
        }
        let mut found = Vec::new();
        for stretch in samples.chunk_by(|a, b| time(b) - time(a) <= self.max_gap_s) {
            let end = time(&stretch[stretch.len() - 1]);
            // A frame at 0.4 s is at the fourth tenth of a second, although 0.4 · 10 is a little more than 4.
            // Plus zero, which avoids a time of -0.
            let mut index = (time(&stretch[0]) * self.rate - ROUNDING).ceil() + 0.0;
            let mut after = 1;
            while index - ROUNDING <= end * self.rate {
                let time_s = index / self.rate;
                while after + 1 < stretch.len() && time(&stretch[after]) < time_s {
                    after += 1;
                }
                let (a, b) = (&stretch[after - 1], &stretch[after.min(stretch.len() - 1)]);
                let step = time(b) - time(a);
                let weight = if step > 0.0 { ((time_s - time(a)) / step).clamp(0.0, 1.0) } else { 0.0 };
                found.push(between(a, b, &Moment { time_s, weight }));
                index += 1.0;
            }
        }
        Some(found)
    }
}

/// Tolerance for a frame to coincide with a grid time, as a share of a step.
const ROUNDING: f64 = 1e-6;

impl Moment {
    fn number(&self, a: f64, b: f64) -> f64 {
        a + self.weight * (b - a)
    }

    fn numbers<const N: usize>(&self, a: [f64; N], b: [f64; N]) -> [f64; N] {
        std::array::from_fn(|k| self.number(a[k], b[k]))
    }

    fn optional(&self, a: Option<f64>, b: Option<f64>) -> Option<f64> {
        a.zip(b).map(|(a, b)| self.number(a, b))
    }

    /// Interpolates degrees along the shorter arc; the result's range starts at `least`.
    fn angle_deg(&self, a: f64, b: f64, least: f64) -> f64 {
        let turn = (b - a + 180.0).rem_euclid(360.0) - 180.0;
        (a + self.weight * turn - least).rem_euclid(360.0) + least
    }

    fn nearer<'a, T>(&self, a: &'a T, b: &'a T) -> &'a T {
        if self.weight < 0.5 { a } else { b }
    }
}

fn pose_between(a: &ObjectPose, b: &ObjectPose, at: &Moment) -> ObjectPose {
    let nearer = at.nearer(a, b);
    let position = at.numbers(a.position, b.position);
    let center = a.world_from_object.inverse() * Point3::from(a.position);
    let rotation = slerp(&a.world_from_object.rotation, &b.world_from_object.rotation, at.weight);
    let scale = a.world_from_object.scale;
    ObjectPose {
        frame: nearer.frame,
        name: nearer.name.clone(),
        time_s: at.time_s,
        // The translation that takes the center to its position.
        world_from_object: Sim3::new(scale, rotation, Vector3::from(position) - rotation * center.coords * scale),
        position,
        metric: a.metric.zip(b.metric).map(|(a, b)| metric_between(&a, &b, at)),
    }
}

fn contact_between(a: &GroundPosition, b: &GroundPosition, at: &Moment) -> GroundPosition {
    let nearer = at.nearer(a, b);
    let error = ContactError {
        noise: std::array::from_fn(|row| at.numbers(a.error.noise[row], b.error.noise[row])),
        drift: at.numbers(a.error.drift, b.error.drift),
        common: at.numbers(a.error.common, b.error.common),
        focal: at.numbers(a.error.focal, b.error.focal),
    };
    GroundPosition {
        frame: nearer.frame,
        name: nearer.name.clone(),
        time_s: at.time_s,
        position: at.numbers(a.position, b.position),
        error,
        metric: a.metric.zip(b.metric).map(|(a, b)| metric_between(&a, &b, at)),
    }
}

fn metric_between(a: &MetricPose, b: &MetricPose, at: &Moment) -> MetricPose {
    MetricPose {
        position_m: at.numbers(a.position_m, b.position_m),
        position_std_m: at.numbers(a.position_std_m, b.position_std_m),
        distance_to_camera_m: at.number(a.distance_to_camera_m, b.distance_to_camera_m),
        distance_to_camera_std_m: at.number(a.distance_to_camera_std_m, b.distance_to_camera_std_m),
        motion: a.motion.zip(b.motion).map(|(a, b)| motion_between(&a, &b, at)),
        place: a.place.zip(b.place).map(|(a, b)| MapPlace {
            longitude: at.angle_deg(a.longitude, b.longitude, -180.0),
            latitude: at.number(a.latitude, b.latitude),
            height_m: at.number(a.height_m, b.height_m),
            place_std_m: at.numbers(a.place_std_m, b.place_std_m),
        }),
    }
}

fn motion_between(a: &Motion, b: &Motion, at: &Moment) -> Motion {
    Motion {
        smoothed_position_m: at.numbers(a.smoothed_position_m, b.smoothed_position_m),
        smoothed_position_std_m: at.numbers(a.smoothed_position_std_m, b.smoothed_position_std_m),
        speed_m_s: at.number(a.speed_m_s, b.speed_m_s),
        speed_std_m_s: at.number(a.speed_std_m_s, b.speed_std_m_s),
        raw_speed_m_s: at.number(a.raw_speed_m_s, b.raw_speed_m_s),
        acceleration_m_s2: at.number(a.acceleration_m_s2, b.acceleration_m_s2),
        acceleration_std_m_s2: at.number(a.acceleration_std_m_s2, b.acceleration_std_m_s2),
        heading_deg: a.heading_deg.zip(b.heading_deg).map(|(a, b)| at.angle_deg(a, b, 0.0)),
        heading_std_deg: at.optional(a.heading_std_deg, b.heading_std_deg),
        yaw_rate_deg_s: at.optional(a.yaw_rate_deg_s, b.yaw_rate_deg_s),
        yaw_rate_std_deg_s: at.optional(a.yaw_rate_std_deg_s, b.yaw_rate_std_deg_s),
    }
}

fn view_between(a: &RegisteredFrame, b: &RegisteredFrame, at: &Moment) -> RegisteredFrame {
    let nearer = at.nearer(a, b);
    let center = at.numbers(a.cam_from_world.center().into(), b.cam_from_world.center().into());
    let rotation = slerp(&a.cam_from_world.rotation, &b.cam_from_world.rotation, at.weight);
    RegisteredFrame {
        frame: Frame { time_s: at.time_s, ..nearer.frame.clone() },
        cam_from_world: Rigid3::from_rotation_and_center(rotation, Point3::from(center)),
        ..nearer.clone()
    }
}

/// Spherical linear interpolation; the nearer rotation where two are opposite, which no two neighboring frames are.
fn slerp(a: &UnitQuaternion<f64>, b: &UnitQuaternion<f64>, weight: f64) -> UnitQuaternion<f64> {
    let nearer = if weight < 0.5 { a } else { b };
    a.try_slerp(b, weight, 1e-9).unwrap_or(*nearer)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::{results, with_metres};

    #[test]
    fn samples_are_on_the_line_between_two_frames() {
        let results = with_metres(results());
        let found = results.resampled(40.0).unwrap();
        let (before, after) = (&results.trajectories.objects[0].poses, &found.trajectories.objects[0].poses);
        assert!(after.len() > 2 * before.len());
        for pose in after {
            assert!((pose.time_s * 40.0 - (pose.time_s * 40.0).round()).abs() < 1e-9);
            let next = before.iter().position(|other| other.time_s >= pose.time_s - 1e-9).unwrap().max(1);
            let (a, b) = (&before[next - 1], &before[next]);
            let [to_a, to_b] = [pose.distance_to(a), pose.distance_to(b)];
            assert!((to_a + to_b - a.distance_to(b)).abs() < 1e-9, "on the line");
            let share = (pose.time_s - a.time_s) / (b.time_s - a.time_s);
            assert!((to_a - share * a.distance_to(b)).abs() < 1e-9, "linear in time");
            // The center is transformed by the similarity.
            let center = a.world_from_object.inverse() * Point3::from(a.position);
            assert!((pose.world_from_object * center - Point3::from(pose.position)).norm() < 1e-9);
            assert_eq!(pose.metric.unwrap().motion.unwrap().speed_m_s, 8.0);
        }
        assert!(found.views.len() > 2 * results.views.len());
    }

    #[test]
    fn resampling_at_the_frame_rate_reproduces_the_frames() {
        let results = with_metres(results());
        let found = results.resampled(15.0).unwrap();
        for (before, after) in results.trajectories.objects.iter().zip(&found.trajectories.objects) {
            assert_eq!(before.poses.len(), after.poses.len());
            for (a, b) in before.poses.iter().zip(&after.poses) {
                assert!(a.frame == b.frame && a.name == b.name && a.distance_to(b) < 1e-4);
            }
        }
    }

    #[test]
    fn gaps_stay_and_nothing_is_extrapolated() {
        let mut results = with_metres(results());
        let poses = &mut results.trajectories.objects[0].poses;
        let times: Vec<f64> = poses.iter().map(|pose| pose.time_s).collect();
        poses.drain(4..7);
        let found = results.resampled(60.0).unwrap();
        let after: Vec<f64> = found.trajectories.objects[0].poses.iter().map(|pose| pose.time_s).collect();
        assert!(!after.iter().any(|time| *time > times[3] + 1e-6 && *time < times[7] - 1e-6), "{after:?}");
        assert!(after[0] >= times[0] - 1e-6 && after[after.len() - 1] <= times[times.len() - 1] + 1e-6);
        assert!(results.resampled(1e12).is_none());
    }

    #[test]
    fn angles_take_the_shorter_way() {
        let at = Moment { time_s: 0.0, weight: 0.5 };
        assert_eq!((at.angle_deg(350.0, 10.0, 0.0), at.angle_deg(10.0, 350.0, 0.0)), (0.0, 0.0));
        assert!((at.angle_deg(179.9, -179.9, -180.0).abs() - 180.0).abs() < 1e-9);
    }
}
