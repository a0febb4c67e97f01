//! Properties of a vehicle as a whole.

use schemars::JsonSchema;
use serde::Serialize;

use crate::scene::{
    Dimensions, Estimate, FrameId, GroundTrack, ObjectId, ObjectPose, ObjectTrajectory, Position, TimeBase, Travel,
};

/// Summary figures of a vehicle's trajectory.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Facts {
    /// The vehicle.
    pub vehicle: ObjectId,
    /// Its class.
    pub class: String,
    /// Mean score of its detections, 0 to 1.
    pub confidence: f64,
    /// Verdict: `good`, `fair`, `doubtful`, `rejected`; `None` if it was not judged.
    pub verdict: Option<&'static str>,
    /// Strongest evidence against it.
    pub doubt: Option<String>,
    /// Number of frames with a position.
    pub num_frames: usize,
    /// The first frame.
    pub first_frame: Option<FrameId>,
    /// The last frame.
    pub last_frame: Option<FrameId>,
    /// Time of the first frame, seconds; `None` where times are unknown.
    pub first_time_s: Option<f64>,
    /// Time of the last frame, seconds.
    pub last_time_s: Option<f64>,
    /// Duration from the first frame to the last, seconds.
    pub duration_s: Option<f64>,
    /// Path length, units of the background; this and the fields below as in [`Travel`](crate::scene::Travel).
    pub path_units: Option<f64>,
    /// Its standard deviation.
    pub path_std_units: Option<f64>,
    /// Path length, meters.
    pub path_m: Option<Estimate>,
    /// Displacement, meters.
    pub displacement_m: Option<Estimate>,
    /// Mean speed.
    pub mean_speed_m_s: Option<Estimate>,
    /// Maximum speed.
    pub max_speed_m_s: Option<Estimate>,
    /// Size.
    pub dimensions: Dimensions,
}

impl Facts {
    /// Facts of a vehicle with a trajectory.
    pub fn of(object: &ObjectTrajectory, time_base: TimeBase) -> Self {
        let verdict = object.verdict.as_ref();
        Self {
            vehicle: object.id,
            class: object.class.clone(),
            confidence: object.confidence,
            verdict: verdict.map(|verdict| verdict.state.name()),
            doubt: verdict.and_then(|verdict| verdict.complaints().next()).map(|doubt| doubt.says.clone()),
            dimensions: object.dimensions.unwrap_or_default(),
            ..Self::along(&object.poses, object.travel, time_base)
        }
    }

    /// Facts of a ground track; it has verdict words of its own, and the doubt is its reason.
    pub fn of_ground_track(track: &GroundTrack, time_base: TimeBase) -> Self {
        Self {
            vehicle: track.id,
            class: track.class.clone(),
            confidence: track.confidence,
            verdict: track.verdict.as_ref().map(|verdict| verdict.state.name()),
            doubt: track.verdict.as_ref().map(|verdict| verdict.says.clone()),
            dimensions: track.dimensions.unwrap_or_default(),
            ..Self::along(&track.positions, track.travel, time_base)
        }
    }

    /// Properties derived from the positions and the travel.
    fn along<'a, T>(positions: &'a [T], travel: Option<Travel>, time_base: TimeBase) -> Self
    where
        Position<'a>: From<&'a T>,
    {
        let (first, last) = (positions.first().map(Position::from), positions.last().map(Position::from));
        let time = |at: Option<Position>| at.filter(|_| time_base == TimeBase::Seconds).map(|at| at.time_s);
        let (first_time_s, last_time_s) = (time(first), time(last));
        Self {
            num_frames: positions.len(),
            first_frame: first.map(|at| at.frame),
            last_frame: last.map(|at| at.frame),
            first_time_s,
            last_time_s,
            duration_s: first_time_s.zip(last_time_s).map(|(first, last)| last - first),
            path_units: travel.map(|travel| travel.path_units.value),
            path_std_units: travel.map(|travel| travel.path_units.std),
            path_m: travel.and_then(|travel| travel.path_m),
            displacement_m: travel.and_then(|travel| travel.displacement_m),
            mean_speed_m_s: travel.and_then(|travel| travel.mean_speed_m_s),
            max_speed_m_s: travel.and_then(|travel| travel.max_speed_m_s),
            ..Self::default()
        }
    }
}

/// The speed in one frame from its neighbors' positions, units of the background per second; `None` where their
/// times coincide.
pub(super) fn raw_speed(poses: &[ObjectPose], index: usize) -> Option<f64> {
    let before = &poses[index.saturating_sub(1)];
    let after = poses.get(index + 1).unwrap_or(&poses[index]);
    let seconds = after.time_s - before.time_s;
    let speed = before.distance_to(after) / seconds;
    (seconds > 0.0 && speed.is_finite()).then_some(speed)
}
