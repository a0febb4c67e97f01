//! Metric scale of a result, in the shape of its keys in `trajectories.json`: the similarity from the background's
//! frame, its sources, and the metric values of every object and frame.
//!
//! These values complement those in units of the background and replace none. Each standard deviation is the total one:
//! it includes that of the scale, which is common to all lengths of a result.

use std::collections::BTreeMap;

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::math::Sim3;

/// Main source of the metric scale.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MetricVerdict {
    /// Mostly surveyed measurements.
    Surveyed,
    /// Mostly telemetry of a receiver.
    Telemetry,
    /// Priors on vehicles only.
    PriorOnly,
    /// None: the metric scale is unknown.
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
    /// The source, for messages.
    pub source: String,
    /// Meters per unit by it alone.
    pub scale: f64,
    /// Their standard deviation, meters per unit.
    pub std: f64,
    /// Its share of the weight, 0 to 1.
    pub share: f64,
}

/// Sources with at least 1 % of the weight, the heaviest first: `typical vehicle sizes (63 %) and telemetry (37 %)`.
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

/// Source that contradicts the others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetricContradiction {
    /// The source.
    pub source: String,
    /// Meters per unit by it over those by the others.
    pub ratio: f64,
    /// The difference in standard deviations.
    pub deviations: f64,
}

/// Axes of the metric frame. The third axis points up in both variants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MetricAxes {
    /// East, north, up.
    EastNorthUp,
    /// The third axis points up; the others have no meaning on a map.
    Up,
}

/// Origin of the metric frame on the WGS 84 ellipsoid.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapOrigin {
    /// East of Greenwich, degrees.
    pub longitude: f64,
    /// North of the equator, degrees.
    pub latitude: f64,
    /// Height, meters; see `knows_height`.
    pub height_m: f64,
    /// True if heights are the receiver's absolute ones; otherwise they count from take-off or an unknown level.
    pub knows_height: bool,
}

/// Transform into meters: a point X of the background is at `scale * R * X + translation`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetricFrame {
    /// Meters per unit of the background.
    pub scale: f64,
    /// Unit quaternion w, x, y, z of R.
    pub rotation_wxyz: [f64; 4],
    /// Translation, meters.
    pub translation: [f64; 3],
    /// Axes of the frame.
    pub axes: MetricAxes,
    /// Georeferenced origin; `None` without georeference.
    pub origin: Option<MapOrigin>,
    /// Standard deviations.
    pub std: MetricStd,
    /// The point of the background, in its units, at which `covariance` is taken.
    pub anchor: [f64; 3],
    /// Rows of the covariance of log scale, rotation vector (axes of the metric frame, radians) and the anchor's
    /// position (meters). Quantities without meaning (north and position without georeference) have variance 0.
    pub covariance: [[f64; 7]; 7],
}

/// Standard deviations of a [`MetricFrame`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetricStd {
    /// Of the scale, meters per unit.
    pub scale: f64,
    /// Of the vertical, degrees.
    pub tilt_deg: f64,
    /// Of north, degrees; `None` where north is not known.
    pub heading_deg: Option<f64>,
    /// Of the anchor's position, meters along the axes; `None` without georeference.
    pub place_m: Option<[f64; 3]>,
}

impl MetricFrame {
    /// Transform from the background's frame and unit to the metric frame.
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

/// Metric scale of a result.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Metric {
    /// Main source.
    pub verdict: MetricVerdict,
    /// Reason why the scale is unknown, or a remark; for messages.
    pub reason: Option<String>,
    /// The transform; `None` where meters are unknown.
    #[serde(flatten)]
    pub frame: Option<MetricFrame>,
    /// Contributions of all sources.
    pub shares: Vec<MetricShare>,
    /// Sources that contradict the others, the worst first.
    pub contradictions: Vec<MetricContradiction>,
    /// Clock of the telemetry minus time of the video, seconds; `None` without telemetry.
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
    /// The zone stated by each image.
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
    /// Dates of photographs by image name, ISO 8601; without `Z` in local time.
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
    /// Value and standard deviation in another unit.
    pub fn scaled(self, factor: f64) -> Self {
        Self { value: factor * self.value, std: factor * self.std }
    }
}

/// Size of an object, meters; `None` for a dimension that was never visible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Dimensions {
    /// Length from rear to front, along the heading.
    pub length_m: Option<Estimate>,
    /// Width from side to side.
    pub width_m: Option<Estimate>,
    /// Height above the ground.
    pub height_m: Option<Estimate>,
}

/// Travel of an object from its first to its last pose, from the smoothed trajectory (docs/maths/smoother.md,
/// *Travel*): the one definition behind every output.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Travel {
    /// Path length, units of the background. The standard deviation lacks that of meters per unit.
    pub path_units: Estimate,
    /// Straight line from the first to the last position, units of the background.
    pub displacement_units: Estimate,
    /// Path length, meters; `None` where meters are unknown, as for all below.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub path_m: Option<Estimate>,
    /// Displacement, meters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub displacement_m: Option<Estimate>,
    /// Path length over the time from the first to the last frame; `None` where no times are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_speed_m_s: Option<Estimate>,
    /// Greatest speed in any frame, with its standard deviation there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_speed_m_s: Option<Estimate>,
}

/// An object's pose in one frame, in meters.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MetricPose {
    /// `position` in the metric frame, not smoothed.
    pub position_m: [f64; 3],
    /// Its standard deviations along the axes, relative to the other objects and the camera of this result: without
    /// that of the georeference.
    pub position_std_m: [f64; 3],
    /// Distance from the camera center.
    pub distance_to_camera_m: f64,
    /// Its standard deviation.
    pub distance_to_camera_std_m: f64,
    /// Smoothed motion in this frame; `None` where there are too few frames.
    #[serde(flatten)]
    pub motion: Option<Motion>,
    /// Georeferenced position; `None` without georeference.
    #[serde(flatten)]
    pub place: Option<MapPlace>,
}

/// An object's motion in one frame, smoothed over all frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Motion {
    /// Position in the metric frame, smoothed.
    pub smoothed_position_m: [f64; 3],
    /// Its standard deviations along the axes, defined as those of the raw position.
    pub smoothed_position_std_m: [f64; 3],
    /// Speed over the ground; negative when reversing.
    pub speed_m_s: f64,
    /// Its standard deviation.
    pub speed_std_m_s: f64,
    /// Speed between the neighboring raw positions, for comparison with `speed_m_s`.
    pub raw_speed_m_s: f64,
    /// Rate of change of the speed, m/s².
    pub acceleration_m_s2: f64,
    /// Its standard deviation.
    pub acceleration_std_m_s2: f64,
    /// Heading, degrees clockwise from north, 0 to 360; from the metric frame's second axis where north is not known.
    /// `None` where it is undetermined.
    pub heading_deg: Option<f64>,
    /// Its standard deviation; without that of north.
    pub heading_std_deg: Option<f64>,
    /// Rate of change of the heading, degrees per second, clockwise; `None` where the heading is.
    pub yaw_rate_deg_s: Option<f64>,
    /// Its standard deviation.
    pub yaw_rate_std_deg_s: Option<f64>,
}

/// Georeferenced position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MapPlace {
    /// East of Greenwich, degrees (WGS 84).
    pub longitude: f64,
    /// North of the equator, degrees.
    pub latitude: f64,
    /// Height, meters; `metric.origin.knows_height` gives its kind.
    pub height_m: f64,
    /// Standard deviation of the georeferenced position, east, north and up, meters.
    pub place_std_m: [f64; 3],
}

impl MapPlace {
    /// Horizontal standard deviation, meters.
    pub fn horizontal_std_m(&self) -> f64 {
        self.place_std_m[0].hypot(self.place_std_m[1])
    }
}
