//! Lines of `live.jsonl`.

use schemars::JsonSchema;
use serde::Serialize;

use crate::scene::{NoContact, ObjectId};

/// A line of live.jsonl and of stdout: one JSON object.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "kebab-case")]
#[schemars(extend("type" = "object"))]
pub enum Line {
    /// A vehicle in one frame.
    Vehicle(VehicleLine),
    /// The camera in one frame.
    Camera(CameraLine),
    /// The map around the camera was updated.
    Map(MapLine),
    /// There has been no map for a while, and no position; sent once.
    NoMap(NoMapLine),
    /// The workload was reduced, or a reduction was taken back.
    Load(LoadLine),
    /// The end of the recording.
    End(EndLine),
}

/// State of a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum State {
    /// From its own frame and those before it.
    Provisional,
    /// From the frames before and after it; it is not revised any more.
    Final,
}

/// Method of a position.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PositionMethod {
    /// Of the point of the ground below the middle of the lower mask edge.
    GroundContact,
    /// Of the center of the 3D model.
    Model,
}

/// Motion state of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum MotionState {
    /// Its speed is below walking pace, by two standard deviations.
    Stationary,
    /// Its speed differs from zero by three standard deviations.
    Moving,
}

/// Unit of length of positions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum LengthUnit {
    /// Meters.
    M,
    /// Unknown: no source of scale. Lengths are in proportion to one another.
    Arbitrary,
}

/// A position on the ellipsoid of WGS 84, by the telemetry.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct GeoPosition {
    /// Latitude, degrees.
    pub latitude: f64,
    /// Longitude, degrees.
    pub longitude: f64,
    /// Height as the telemetry counts it, meters; null where it has none above the ellipsoid or the sea.
    pub height: Option<f64>,
    /// Standard deviation of the horizontal position, meters: root of the sum of the squares of that to the east and
    /// that to the north.
    pub horizontal_std: f64,
    /// Standard deviation of the height, meters; null with it.
    pub vertical_std: Option<f64>,
    /// Distance from the camera, meters.
    pub distance: f64,
    /// Velocity to the east, to the north and up, meters per second.
    pub velocity: Option<[f64; 3]>,
    /// Standard deviation of the speed, meters per second.
    pub speed_std: Option<f64>,
    /// Direction of motion, degrees clockwise from north; null for a vehicle at rest.
    pub course_deg: Option<f64>,
    /// Its standard deviation, degrees.
    pub course_std_deg: Option<f64>,
}

/// A vehicle in one frame.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct VehicleLine {
    /// Time of the frame, seconds of the recording.
    pub t: f64,
    /// The same in UTC by the clock of the telemetry, ISO 8601; null where it is unknown.
    pub utc: Option<String>,
    /// Index of the frame in the recording, from 0.
    pub frame: u32,
    /// Id of the vehicle; not that of the run on the recording.
    pub id: ObjectId,
    /// Class name.
    pub class: String,
    /// Mean score of its detections, 0 to 1.
    pub confidence: f64,
    /// State of the position.
    pub state: State,
    /// Number of the map that the position refers to.
    pub revision: u32,
    /// Box around its mask, pixels: x0, y0, x1, y1.
    #[serde(rename = "box")]
    pub rect: [f64; 4],
    /// Unit of all lengths.
    pub unit: LengthUnit,
    /// Method of the position; null where there is none.
    pub method: Option<PositionMethod>,
    /// Position in the local frame: z up, the second axis ahead, the origin below the first camera. Null where there is
    /// none.
    pub position: Option<[f64; 3]>,
    /// Covariance of the position: xx, xy, xz, yy, yz, zz. Null with it.
    pub covariance: Option<[f64; 6]>,
    /// Georeferenced position; null without telemetry or points of a map, and before a camera that flies has moved far
    /// enough.
    pub geo: Option<Box<GeoPosition>>,
    /// Why there is no position.
    pub reason: Option<NoContact>,
    /// Motion state; null where the positions leave it open.
    pub motion: Option<MotionState>,
    /// Velocity, per second; null for fewer than four positions.
    pub velocity: Option<[f64; 3]>,
    /// Standard deviation of the speed, per second.
    pub speed_std: Option<f64>,
    /// Direction in which it moves, degrees clockwise from the second axis; null for a vehicle at rest.
    pub heading_deg: Option<f64>,
    /// Standard deviation of the heading, degrees.
    pub heading_std_deg: Option<f64>,
    /// Seconds from the decoding of the frame, or of the last frame of the window of a final position, to this line.
    pub lag_s: f64,
}

/// The camera in one frame.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct CameraLine {
    /// Time of the frame, seconds of the recording.
    pub t: f64,
    /// Index of the frame in the recording, from 0.
    pub frame: u32,
    /// State of the pose.
    pub state: State,
    /// Number of the map that the pose refers to.
    pub revision: u32,
    /// Unit of all lengths.
    pub unit: LengthUnit,
    /// Center, in the local frame.
    pub position: [f64; 3],
    /// Georeferenced center; null without telemetry.
    pub geo: Option<GeoPosition>,
    /// Rotation from the local frame to that of the camera (x right, y down, z forward), as a unit quaternion.
    pub rotation_wxyz: [f64; 4],
}

/// The map around the camera.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct MapLine {
    /// Time of its last frame, seconds of the recording.
    pub t: f64,
    /// Number of the map.
    pub revision: u32,
    /// Registered keyframes.
    pub keyframes: usize,
    /// Points.
    pub points: usize,
    /// Focal length, pixels.
    pub focal_px: f64,
    /// Its standard deviation as a share; null where it is given.
    pub focal_std: Option<f64>,
    /// True if it is in the frame of the maps before. Otherwise it has a new local frame.
    pub is_continued: bool,
    /// True if the camera does not translate: the map is the plane of the ground.
    pub is_hovering: bool,
    /// Standard deviation of the logarithm of lengths by the chain of alignments.
    pub drift_std: f64,
    /// Meters per unit of the map; null where they are unknown.
    pub scale: Option<f64>,
    /// Their standard deviation.
    pub scale_std: Option<f64>,
    /// Vehicles with a 3D model in the local frame.
    pub models: usize,
    /// Problem of the ground.
    pub problem: Option<String>,
    /// Why the telemetry does not georeference this map; positions use the alignment of an earlier one, if there is
    /// one.
    pub telemetry_problem: Option<String>,
    /// Time of computation, seconds.
    pub seconds: f64,
}

/// Absence of a map.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct NoMapLine {
    /// Time of the frame, seconds of the recording.
    pub t: f64,
    /// Why, and what helps.
    pub reason: String,
}

/// A change of the workload.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct LoadLine {
    /// Time of the frame, seconds of the recording.
    pub t: f64,
    /// Number of reductions in force; 0 is full work.
    pub level: usize,
    /// Reductions in force, in order.
    pub reductions: Vec<&'static str>,
    /// Why it changed.
    pub reason: String,
    /// Frames dropped so far.
    pub dropped: u64,
}

/// Totals.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct EndLine {
    /// Time of the last frame, seconds of the recording.
    pub t: f64,
    /// Frames processed.
    pub frames: u64,
    /// Frames dropped since a newer one was there.
    pub dropped: u64,
    /// Frames skipped to reduce the workload.
    pub skipped: u64,
    /// Frames with a camera pose.
    pub registered: u64,
    /// Maps.
    pub maps: u32,
    /// Mean time per frame, milliseconds, by part: perception, points, positions.
    pub mean_ms: [f64; 3],
}
