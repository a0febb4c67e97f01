//! What is said of a vehicle as a whole.

use serde::Serialize;

use crate::scene::{Dimensions, Estimate, FrameId, MetricFrame, ObjectId, ObjectPose, ObjectTrajectory, TimeBase};

/// A vehicle's way in a few figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Facts {
    /// The vehicle.
    pub vehicle: ObjectId,
    /// Its class.
    pub class: String,
    /// Mean score of its detections, 0 to 1.
    pub confidence: f64,
    /// How far the way can be trusted: `good`, `fair`, `doubtful`, `not-to-be-trusted`; `None` where nobody judged it.
    pub verdict: Option<&'static str>,
    /// What speaks against it most.
    pub doubt: Option<String>,
    /// Frames with a place.
    pub num_frames: usize,
    /// The first one.
    pub first_frame: Option<FrameId>,
    /// The last one.
    pub last_frame: Option<FrameId>,
    /// Time of the first one, seconds; `None` where no times are known.
    pub first_time_s: Option<f64>,
    /// Time of the last one.
    pub last_time_s: Option<f64>,
    /// From the first to the last, seconds.
    pub duration_s: Option<f64>,
    /// Length of the way, units of the background.
    pub path_units: f64,
    /// The same in metres, of the smoothed way where there is one; `None` where they are unknown.
    pub path_m: Option<Estimate>,
    /// Mean of the speed's amount over the frames, metres per second. The deviations of all frames are taken for one
    /// error that they share, which they mostly are: that of the scale.
    pub mean_speed_m_s: Option<Estimate>,
    /// Greatest speed, metres per second, and its deviation in that frame. Of noisy speeds the greatest is too large.
    pub max_speed_m_s: Option<Estimate>,
    /// How large it is.
    pub dimensions: Dimensions,
}

impl Facts {
    /// Of a trajectory.
    ///
    /// * `metric` – how metres follow, if they do.
    pub fn of(object: &ObjectTrajectory, time_base: TimeBase, metric: Option<&MetricFrame>) -> Self {
        let (first, last) = (object.poses.first(), object.poses.last());
        let time = |pose: Option<&ObjectPose>| pose.filter(|_| time_base == TimeBase::Seconds).map(|pose| pose.time_s);
        let (first_time_s, last_time_s) = (time(first), time(last));
        let duration_s = first_time_s.zip(last_time_s).map(|(first, last)| last - first);
        Self {
            vehicle: object.id,
            class: object.class.clone(),
            confidence: object.confidence,
            verdict: object.verdict.as_ref().map(|verdict| verdict.state.key()),
            doubt: object.verdict.as_ref().and_then(|verdict| verdict.against().next()).map(|doubt| doubt.says.clone()),
            num_frames: object.poses.len(),
            first_frame: first.map(|pose| pose.frame),
            last_frame: last.map(|pose| pose.frame),
            first_time_s,
            last_time_s,
            duration_s,
            path_units: object.path_length(),
            path_m: path_m(object, metric, duration_s),
            mean_speed_m_s: mean_speed(object),
            max_speed_m_s: speeds(object).max_by(|a, b| a.value.total_cmp(&b.value)),
            dimensions: object.dimensions.unwrap_or_default(),
        }
    }
}

/// The amounts of the speeds, frame by frame.
fn speeds(object: &ObjectTrajectory) -> impl Iterator<Item = Estimate> {
    let motions = object.poses.iter().filter_map(|pose| pose.metric?.motion);
    motions.map(|motion| Estimate { value: motion.speed_m_s.abs(), std: motion.speed_std_m_s })
}

fn mean_speed(object: &ObjectTrajectory) -> Option<Estimate> {
    let (sum, std, count) =
        speeds(object).fold((0.0, 0.0, 0), |(sum, std, count), speed| (sum + speed.value, std + speed.std, count + 1));
    (count > 0).then(|| Estimate { value: sum / f64::from(count), std: std / f64::from(count) })
}

/// The way's deviation is that of the mean speed over its time; without speeds that of the scale alone.
fn path_m(object: &ObjectTrajectory, metric: Option<&MetricFrame>, duration_s: Option<f64>) -> Option<Estimate> {
    let metric = metric?;
    let std = mean_speed(object).zip(duration_s).map(|(speed, duration_s)| speed.std * duration_s);
    let value = smoothed_path_m(object).unwrap_or_else(|| metric.scale * object.path_length());
    Some(Estimate { value, std: std.unwrap_or_else(|| metric.log_scale_std() * value) })
}

/// `None` unless every frame has a smoothed place.
fn smoothed_path_m(object: &ObjectTrajectory) -> Option<f64> {
    let place = |pose: &ObjectPose| Some(pose.metric?.motion?.smoothed_position_m);
    let places: Vec<[f64; 3]> = object.poses.iter().map(place).collect::<Option<_>>()?;
    let step = |pair: &[[f64; 3]]| (0..3).map(|k| (pair[1][k] - pair[0][k]).powi(2)).sum::<f64>().sqrt();
    Some(places.windows(2).map(step).sum())
}

/// The speed in one frame from its neighbours' positions, units of the background per second; `None` where no time
/// passes between them.
pub(super) fn raw_speed(poses: &[ObjectPose], index: usize) -> Option<f64> {
    let before = &poses[index.saturating_sub(1)];
    let after = poses.get(index + 1).unwrap_or(&poses[index]);
    let seconds = after.time_s - before.time_s;
    let speed = before.distance_to(after) / seconds;
    (seconds > 0.0 && speed.is_finite()).then_some(speed)
}
