//! Metres of a result, in the shape of their keys in `trajectories.json`: the similarity from the background's frame,
//! on what it rests, and what follows from it for every object and frame.
//!
//! Everything here stands next to what is given in units of the background and replaces none of it. Deviations are
//! standard deviations, and whole ones: that of the scale is in each of them, common to all lengths of a result.

use std::collections::BTreeMap;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::Sim3;

/// On what metres rest.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MetricVerdict {
    /// Mostly on what somebody measured.
    Surveyed,
    /// Mostly on a receiver.
    Telemetry,
    /// On what vehicles are like.
    PriorOnly,
    /// On nothing: there are none.
    #[default]
    Unknown,
}

with_names!(MetricVerdict {
    Surveyed = "surveyed",
    Telemetry = "telemetry",
    PriorOnly = "prior-only",
    Unknown = "unknown",
});

/// Contribution of one source to the meters per unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetricShare {
    /// The source, for people.
    pub source: String,
    /// Metres per unit by it alone.
    pub scale: f64,
    /// Their standard deviation, metres per unit.
    pub std: f64,
    /// Its part of the weight, from 0 to 1.
    pub share: f64,
}

/// Sources with a weight that shows, the heaviest first, such as `typical vehicle sizes (63 %) and telemetry (37 %)`.
pub fn sources_in_words(shares: &[MetricShare]) -> String {
    let mut with_weight: Vec<(&str, f64)> =
        shares.iter().map(|share| (share.source.as_str(), (100.0 * share.share).round())).collect();
    with_weight.retain(|(_, percent)| *percent >= 1.0);
    with_weight.sort_by(|(_, a), (_, b)| b.total_cmp(a));
    if let [(source, _)] = with_weight[..] {
        return source.to_owned();
    }
    let named: Vec<String> = with_weight.iter().map(|(source, percent)| format!("{source} ({percent} %)")).collect();
    match named.split_last() {
        Some((last, before)) => format!("{} and {last}", before.join(", ")),
        None => "unknown source".to_owned(),
    }
}

/// A source that does not agree with the others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetricContradiction {
    /// The source.
    pub source: String,
    /// Metres per unit by it over those by the others.
    pub ratio: f64,
    /// The difference in standard deviations.
    pub deviations: f64,
}

/// Axes of the metric frame. The third points up in both.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MetricAxes {
    /// East, north, up.
    EastNorthUp,
    /// The third axis points up; the others have no meaning on a map.
    Up,
}

/// Where the origin of the metric frame lies on the ellipsoid of WGS 84.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapOrigin {
    /// East of Greenwich, degrees.
    pub longitude: f64,
    /// North of the equator, degrees.
    pub latitude: f64,
    /// Height, metres; see `knows_height`.
    pub height_m: f64,
    /// True if heights are the receiver's absolute ones; otherwise they count from take-off or an unknown level.
    pub knows_height: bool,
}

/// The transform into metres: a point X of the background is at `scale * R * X + translation`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetricFrame {
    /// Metres per unit of the background.
    pub scale: f64,
    /// Unit quaternion w, x, y, z of R.
    pub rotation_wxyz: [f64; 4],
    /// Metres.
    pub translation: [f64; 3],
    /// Axes of the frame.
    pub axes: MetricAxes,
    /// Where they lie on the map; `None` where nothing says so.
    pub origin: Option<MapOrigin>,
    /// Standard deviations.
    pub std: MetricStd,
    /// The point of the background, in its units, at which `covariance` is taken.
    pub anchor: [f64; 3],
    /// Rows of the covariance of log scale, rotation vector (axes of the metric frame, radians) and the anchor's place
    /// (metres). What has no meaning (north and place without a map) has variance 0.
    pub covariance: [[f64; 7]; 7],
}

/// Standard deviations of a [`MetricFrame`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetricStd {
    /// Of the scale, metres per unit.
    pub scale: f64,
    /// Of the vertical, degrees.
    pub tilt_deg: f64,
    /// Of north, degrees; `None` where north is not known.
    pub heading_deg: Option<f64>,
    /// Of the anchor's place, metres along the axes; `None` where the place on the map is not known.
    pub place_m: Option<[f64; 3]>,
}

impl MetricFrame {
    /// Metres of the metric frame from units of the background's frame.
    pub fn metric_from_world(&self) -> Sim3 {
        let [w, x, y, z] = self.rotation_wxyz;
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
        Sim3::new(self.scale, rotation, Vector3::from(self.translation))
    }

    /// Standard deviation of the scale as a share of it.
    pub fn log_scale_std(&self) -> f64 {
        self.std.scale / self.scale
    }
}

/// Metres of a result.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Metric {
    /// On what they rest.
    pub verdict: MetricVerdict,
    /// Why they are unknown, or what there is to say of them; for people.
    pub reason: Option<String>,
    /// The transform; `None` where metres are unknown.
    #[serde(flatten)]
    pub frame: Option<MetricFrame>,
    /// Contributions of all sources.
    pub shares: Vec<MetricShare>,
    /// The sources that contradict the others, the worst first.
    pub contradictions: Vec<MetricContradiction>,
    /// Clock of the telemetry = time of the video + this, seconds; `None` without telemetry.
    pub time_offset_s: Option<f64>,
    /// Its standard deviation, seconds.
    pub time_offset_std_s: Option<f64>,
    /// Dates; `None` where none are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dates: Option<Dates>,
}

/// Zone of the clock on which [`Dates`] count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ClockZone {
    /// Universal time.
    Utc,
    /// Local time of an unknown zone.
    Local,
    /// As each image states it.
    PerImage,
}

/// Dates of a result: of the video's start, or of each photograph.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Dates {
    /// The video's start, seconds after 1970-01-01T00:00:00 on the clock of `zone`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start_s: Option<f64>,
    /// Zone of that clock.
    pub zone: ClockZone,
    /// Dates of photographs by image name, ISO 8601; without `Z` they are local ones.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub images: BTreeMap<String, String>,
}

/// A value and its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub std: f64,
}

impl Estimate {
    /// Both in another unit.
    pub fn scaled(self, factor: f64) -> Self {
        Self { value: factor * self.value, std: factor * self.std }
    }
}

/// Size of an object, meters; `None` for a dimension that was never visible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Dimensions {
    /// Between its ends, along the direction in which it points.
    pub length_m: Option<Estimate>,
    /// Between its sides.
    pub width_m: Option<Estimate>,
    /// Above the ground.
    pub height_m: Option<Estimate>,
}

/// Travel of an object from its first to its last pose, from the smoothed trajectory (docs/maths/smoother.md,
/// *Travel*): the one definition behind every outlet.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Travel {
    /// Path length, units of the background. The standard deviation lacks that of metres per unit.
    pub path_units: Estimate,
    /// Straight line from the first to the last position, units of the background.
    pub displacement_units: Estimate,
    /// Path length, metres; `None` where metres are unknown, as for all below.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path_m: Option<Estimate>,
    /// Displacement, metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub displacement_m: Option<Estimate>,
    /// Path length over the time from the first to the last frame; `None` where no times are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_speed_m_s: Option<Estimate>,
    /// Greatest speed in any frame, with its standard deviation there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_speed_m_s: Option<Estimate>,
}

/// An object's pose in one frame, in metres.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetricPose {
    /// `position` in the metric frame, as it was reconstructed.
    pub position_m: [f64; 3],
    /// Its standard deviations along the axes, relative to the other objects and the camera of this result: without
    /// that of the place on the map.
    pub position_std_m: [f64; 3],
    /// From the camera's centre.
    pub distance_to_camera_m: f64,
    /// Its standard deviation.
    pub distance_to_camera_std_m: f64,
    /// Smoothed motion at this frame; `None` where there are too few frames.
    #[serde(flatten)]
    pub motion: Option<Motion>,
    /// Where it is on the map; `None` where the map is not known.
    #[serde(flatten)]
    pub place: Option<MapPlace>,
}

/// An object's motion in one frame, from all frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Motion {
    /// Position in the metric frame, smoothed.
    pub smoothed_position_m: [f64; 3],
    /// Its standard deviations along the axes, as those of the raw one.
    pub smoothed_position_std_m: [f64; 3],
    /// Speed over the ground; negative when backing up.
    pub speed_m_s: f64,
    /// Its standard deviation.
    pub speed_std_m_s: f64,
    /// Between the neighbouring raw positions, to be seen next to `speed_m_s`.
    pub raw_speed_m_s: f64,
    /// Change of the speed, metres per second².
    pub acceleration_m_s2: f64,
    /// Its standard deviation.
    pub acceleration_std_m_s2: f64,
    /// Direction in which it points, degrees clockwise from north, 0 to 360; from the metric frame's second axis where
    /// north is not known. `None` where nothing shows it.
    pub heading_deg: Option<f64>,
    /// Its standard deviation; without that of north.
    pub heading_std_deg: Option<f64>,
    /// Change of the heading, degrees per second, clockwise; `None` with it.
    pub yaw_rate_deg_s: Option<f64>,
    /// Its standard deviation.
    pub yaw_rate_std_deg_s: Option<f64>,
}

/// A place on the map.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapPlace {
    /// East of Greenwich, degrees (WGS 84).
    pub longitude: f64,
    /// North of the equator, degrees.
    pub latitude: f64,
    /// Height, metres; of which kind, `metric.origin.knows_height` says.
    pub height_m: f64,
    /// Standard deviation of the place on the map, east, north and up, metres.
    pub place_std_m: [f64; 3],
}

impl MapPlace {
    /// Horizontal standard deviation, meters.
    pub fn horizontal_std_m(&self) -> f64 {
        self.place_std_m[0].hypot(self.place_std_m[1])
    }
}
