//! Trajectories, in the shape of the output contract (`trajectories.json`).

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Dimensions, FrameId, GroundTrack, Metric, MetricPose, ObjectId, PlaneBasis, ScaleMethod, Travel, Verdict};
use crate::math::Sim3;

/// Ratio r between the object's and the background's unit of length, with its uncertainty.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScaleEstimate {
    /// r > 0: one unit of the object's model is r units of the background.
    pub ratio: f64,
    /// Its standard deviation; `None` where the method gives none.
    pub std: Option<f64>,
    /// The method that gave `ratio`.
    pub method: ScaleMethod,
    /// True if the motion leaves r undetermined: `ratio` must not be used then.
    pub degenerate: bool,
    /// Reason why it is degenerate.
    pub reason: Option<String>,
    /// Ratios by all methods that gave one, for the model that the trajectory refers to.
    pub alternatives: Ratios,
    /// Ratios by all methods for the object before its adjustment with the ground; `None` if that is the same model,
    /// because nothing was adjusted after structure from motion.
    pub as_reconstructed: Option<Ratios>,
    /// Contributions to `std`; `None` where the method gives none.
    pub shares: Option<ScaleShares>,
    /// Evidence for the ratio; `None` in files that do not state it.
    pub support: Option<ScaleSupport>,
    /// Ratio by the camera path, where the vehicle is stationary; it is part of `ratio` and `std`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera_path: Option<CameraPathRatio>,
    /// Results of the reference methods for the object before its adjustment; empty unless requested.
    #[serde(default, skip_serializing_if = "References::is_empty")]
    pub references: References,
}

impl ScaleEstimate {
    /// Ratio without standard deviation and without the results of other methods.
    pub fn new(ratio: f64, method: ScaleMethod) -> Self {
        Self {
            ratio,
            std: None,
            method,
            degenerate: false,
            reason: None,
            alternatives: Ratios::new(),
            as_reconstructed: None,
            shares: None,
            support: None,
            camera_path: None,
            references: References::new(),
        }
    }
}

/// Scale ratio of a stationary vehicle, whose points are triangulated from the cameras of the background.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CameraPathRatio {
    /// The ratio: one in results of this version, in older ones the ratio of two camera paths.
    pub ratio: f64,
    /// Its standard deviation.
    pub std: f64,
    /// Mean error of the points, at least 0.3 pixels, as a share of the vehicle's distance.
    pub residual: f64,
    /// Ratio by the ground.
    pub ratio_without: f64,
    /// Standard deviation of the ratio by the ground; `None` where the method gives none.
    pub std_without: Option<f64>,
    /// True if the ratio is undetermined without the camera path.
    pub degenerate_without: bool,
}

/// Vehicles whose scale ratio comes from the camera path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum StationaryVehicles {
    /// None.
    None,
    /// Vehicles that are classified as stationary.
    #[default]
    Found,
    /// All vehicles: the user knows that none moves.
    All,
}

/// Contributions to the standard deviation of a scale ratio.
///
/// Each is a standard deviation as a share of the ratio. They are independent: the total variance is the sum of their
/// squares.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScaleShares {
    /// Of single frames: errors that planes and image positions share over a stretch of time.
    pub frames: f64,
    /// Of the part of the ground's height and tilt error that all frames share.
    pub plane: f64,
    /// Of the contact of the vehicle with the ground.
    pub contact: f64,
    /// Of the camera's focal length; 0 where it is known.
    pub focal: f64,
    /// Disagreement with the other methods that the other contributions do not explain.
    pub disagreement: f64,
}

impl ScaleShares {
    /// Standard deviation of the ratio, as a share of it.
    pub fn total(&self) -> f64 {
        let Self { frames, plane, contact, focal, disagreement } = *self;
        [frames, plane, contact, focal, disagreement].map(|share| share * share).iter().sum::<f64>().sqrt()
    }

    /// The same for a known focal length.
    pub fn given_focal(&self) -> f64 {
        Self { focal: 0.0, ..*self }.total()
    }
}

/// Evidence for a scale ratio.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScaleSupport {
    /// Points of the object's model.
    pub num_points: usize,
    /// Frames with both cameras and a ground plane.
    pub num_views: usize,
    /// Frames whose outline shows the contact with the ground; 0 where none was examined.
    pub frames_with_outline: usize,
    /// Median angle between the planes' normals and the object's upright direction, radians.
    pub tilt: f64,
    /// Standard deviation of the object's distance to the ground over the frames, as a share of the camera's height
    /// above ground.
    pub ground_residual: f64,
    /// Largest difference from another method's ratio of the same model, as a share of the ratio; `None` where no other
    /// method gives one.
    pub disagreement: Option<f64>,
}

/// State of the object's model to which a result refers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ModelState {
    /// From structure from motion, or as given.
    #[default]
    AsReconstructed,
    /// Adjusted together with the ground.
    Adjusted,
}

/// Scale ratios by method. The field that contains them states the object's model to which they refer.
pub type Ratios = BTreeMap<ScaleMethod, f64>;

/// Result of a reference method.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Reference {
    /// Its scale ratio; `None` where it has none.
    pub ratio: Option<f64>,
    /// Its standard deviation.
    pub std: Option<f64>,
    /// Reason why the ratio is undetermined; `None` if it is determined.
    pub undetermined: Option<String>,
}

/// Results of the reference methods.
pub type References = BTreeMap<ScaleMethod, Reference>;

/// Unit of length of a result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Unit {
    /// That of the background reconstruction: arbitrary.
    Background,
    /// Meters.
    Metre,
}

/// Pose of an object in one frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ObjectPose {
    /// The frame.
    pub frame: FrameId,
    /// Its image name.
    pub name: String,
    /// Its time, seconds.
    pub time_s: f64,
    /// The same point of the object in every frame, in the background's frame: the center of the body where
    /// [`ObjectTrajectory::body_center`] is known, otherwise that of its points.
    pub position: [f64; 3],
    /// Transform from the frame of the object's model to that of the background.
    pub world_from_object: Sim3,
    /// Position and motion in meters; `None` where they are unknown.
    #[serde(flatten)]
    pub metric: Option<MetricPose>,
}

/// Center of a vehicle's body, in the frame and unit of its model: the middle between front and rear, between the
/// sides, and between roof and ground.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct BodyCenter {
    /// Position.
    pub in_object: [f64; 3],
    /// Its covariance, without that of the scale ratio.
    pub covariance: [[f64; 3]; 3],
}

impl BodyCenter {
    /// Its covariance in the frame and unit of the background; the error is the same in all frames of the vehicle.
    pub fn covariance_in_world(&self, world_from_object: &Sim3) -> Matrix3<f64> {
        let rotation = world_from_object.rotation.to_rotation_matrix();
        let covariance = Matrix3::from_fn(|j, k| self.covariance[j][k]);
        rotation * covariance * rotation.transpose() * world_from_object.scale.powi(2)
    }
}

/// One object's trajectory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ObjectTrajectory {
    /// The object.
    pub id: ObjectId,
    /// Its class name.
    pub class: String,
    /// Mean score of its detections, 0 to 1; 1 for given masks.
    pub confidence: f64,
    /// Its scale ratio.
    pub scale: ScaleEstimate,
    /// Number of frames by the basis of their ground plane.
    #[serde(default)]
    pub ground: BTreeMap<PlaneBasis, usize>,
    /// Point of the object to which the positions refer; `None` where outlines do not determine it: then they refer to
    /// the center of the points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub body_center: Option<BodyCenter>,
    /// Verdict; `None` if the trajectory was not judged.
    #[serde(default)]
    pub verdict: Option<Verdict>,
    /// Size in meters; `None` where meters are unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dimensions: Option<Dimensions>,
    /// Path length, displacement and speeds; `None` for fewer than four poses.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub travel: Option<Travel>,
    /// Ascending in time; frames without both cameras are absent.
    #[serde(rename = "frames")]
    pub poses: Vec<ObjectPose>,
}

impl ObjectTrajectory {
    /// Trajectory without poses, with a scale ratio only.
    pub fn new(id: ObjectId, class: impl Into<String>, confidence: f64, scale: ScaleEstimate) -> Self {
        Self {
            id,
            class: class.into(),
            confidence,
            scale,
            ground: BTreeMap::new(),
            body_center: None,
            verdict: None,
            dimensions: None,
            travel: None,
            poses: Vec::new(),
        }
    }

    /// Standard deviation of the scale ratio, as a share of it.
    pub fn log_ratio_std(&self) -> f64 {
        // Typical difference of a method without standard deviation from the others, where it works.
        self.scale.std.map_or(0.1, |std| std / self.scale.ratio)
    }

    /// Name of the vehicle: class and id.
    pub fn name(&self) -> String {
        let class = if self.class.is_empty() { "vehicle" } else { &self.class };
        format!("{class} {}", self.id)
    }

    /// Headings without jumps at north, degrees: each within half a turn of the one before, and their mean from 0 to
    /// 360. One per pose; `None` where none is known.
    pub fn unwrapped_headings_deg(&self) -> Vec<Option<f64>> {
        let mut before: Option<f64> = None;
        let unwrapped = |pose: &ObjectPose| {
            let heading = pose.metric?.motion?.heading_deg?;
            let turns = before.map_or(0.0, |before| ((before - heading) / 360.0).round());
            before = Some(heading + 360.0 * turns);
            before
        };
        let headings: Vec<Option<f64>> = self.poses.iter().map(unwrapped).collect();
        let (sum, count) =
            headings.iter().flatten().fold((0.0, 0.0), |(sum, count), heading| (sum + heading, count + 1.0));
        let mean: f64 = if count > 0.0 { sum / count } else { 0.0 };
        let shift = 360.0 * (mean / 360.0).floor();
        headings.into_iter().map(|heading| Some(heading? - shift)).collect()
    }

    /// Makes all positions refer to the center of the body.
    pub fn refer_to(&mut self, body: BodyCenter) {
        for pose in &mut self.poses {
            pose.position = (pose.world_from_object * Point3::from(body.in_object)).coords.into();
        }
        self.body_center = Some(body);
    }

    /// Returns true if the trajectory must not be used for measurements: its scale is undetermined, or it is rejected.
    pub fn is_ruled_out(&self) -> bool {
        self.scale.degenerate || self.verdict.as_ref().is_some_and(Verdict::is_refuted)
    }
}

impl ObjectPose {
    /// Distance of the object's center from its position in another frame.
    pub fn distance_to(&self, other: &Self) -> f64 {
        self.position.iter().zip(&other.position).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
    }
}

/// All trajectories of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectories {
    /// Unit of every length without a unit in its name.
    pub unit: Unit,
    /// Metric scale; `None` in files that do not state it.
    pub metric: Option<Metric>,
    /// Ascending by id.
    pub objects: Vec<ObjectTrajectory>,
    /// Tracks on the ground of vehicles without a usable 3D model, ascending by id.
    pub ground_tracks: Vec<GroundTrack>,
}

impl Trajectories {
    /// No trajectories.
    pub fn empty() -> Self {
        Self { unit: Unit::Background, metric: None, objects: Vec::new(), ground_tracks: Vec::new() }
    }

    /// Class of a vehicle with a trajectory or a ground track; its size may have corrected that of the detector.
    pub fn class_of(&self, id: ObjectId) -> Option<&str> {
        let object = self.objects.iter().find(|object| object.id == id).map(|object| object.class.as_str());
        object.or_else(|| self.ground_track(id).map(|track| track.class.as_str()))
    }

    /// Ground track of a vehicle.
    pub fn ground_track(&self, id: ObjectId) -> Option<&GroundTrack> {
        self.ground_tracks.iter().find(|track| track.id == id)
    }
}
