//! Tracks on the ground of vehicles without a usable 3D model, in the shape of the output contract
//! (`trajectories.json`, key `ground_tracks`).

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{Dimensions, Estimate, FrameId, MetricFrame, MetricPose, ObjectId, PlaneBasis, Travel};
use crate::math::rounding::counted;
use crate::math::{Sim3, median};

/// Method of a ground track; the name is that of the contract.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub enum GroundTrackMethod {
    /// Intersection of the ray of the lower mask edge with the local ground plane.
    #[default]
    #[serde(rename = "ground-contact")]
    GroundContact,
}

with_names!(GroundTrackMethod { GroundContact = "ground-contact" });

/// Error of a contact point in four independent parts, by their correlation over the frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ContactError {
    /// Covariance of the part that is independent in every frame: pixels of the mask edge.
    pub noise: [[f64; 3]; 3],
    /// Displacement by one standard deviation of the part that changes slowly: local plane, mask, view of the vehicle.
    pub drift: [f64; 3],
    /// Displacement by one standard deviation of the part that all frames share: plane, mask bias.
    pub common: [f64; 3],
    /// The same for the error of the focal length, including the change of the plane that goes with it.
    #[serde(default)]
    pub focal: [f64; 3],
}

impl ContactError {
    /// Covariance of the part that is independent in every frame.
    pub fn noise(&self) -> Matrix3<f64> {
        Matrix3::from_fn(|row, column| self.noise[row][column])
    }

    /// Covariance of the parts that the frames do not share.
    pub fn frame_covariance(&self) -> Matrix3<f64> {
        let drift = Vector3::from(self.drift);
        self.noise() + drift * drift.transpose()
    }

    /// Covariance of all parts.
    pub fn covariance(&self) -> Matrix3<f64> {
        let outer = |v: [f64; 3]| Vector3::from(v) * Vector3::from(v).transpose();
        self.frame_covariance() + outer(self.common) + outer(self.focal)
    }

    /// The same error with its standard deviations multiplied by a factor.
    pub fn scaled(&self, factor: f64) -> Self {
        Self {
            noise: self.noise.map(|row| row.map(|covariance| covariance * factor * factor)),
            drift: self.drift.map(|std| std * factor),
            common: self.common.map(|std| std * factor),
            focal: self.focal.map(|std| std * factor),
        }
    }

    /// The same error in another frame and unit.
    pub fn transformed(&self, target_from_source: &Sim3) -> Self {
        let rotation = target_from_source.rotation.to_rotation_matrix();
        let scale = target_from_source.scale;
        let turned = |v: [f64; 3]| (rotation * Vector3::from(v) * scale).into();
        let noise = rotation * self.noise() * rotation.transpose() * (scale * scale);
        Self {
            noise: [0, 1, 2].map(|row| [0, 1, 2].map(|column| noise[(row, column)])),
            drift: turned(self.drift),
            common: turned(self.common),
            focal: turned(self.focal),
        }
    }
}

/// Contact point of a vehicle in one frame: the center of its footprint on the ground.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroundPosition {
    /// The frame.
    pub frame: FrameId,
    /// Its image name.
    pub name: String,
    /// Its time, seconds.
    pub time_s: f64,
    /// Center of the vehicle's footprint, in the background's frame and unit.
    pub position: [f64; 3],
    /// Its error, in the same frame and unit.
    pub error: ContactError,
    /// Meters, speed and georeferenced position; `None` where meters are unknown.
    #[serde(flatten)]
    pub metric: Option<MetricPose>,
}

/// Reason why a frame with a mask has no contact point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum NoContact {
    /// The background has no camera for the frame.
    NoCamera,
    /// The mask is truncated by the image border, or tiny.
    Truncated,
    /// The lower edge is occluded by another vehicle.
    Occluded,
    /// No ground plane is known there.
    NoGroundPlane,
    /// The contact line is so near the horizon that its distance is undetermined.
    NearHorizon,
}

impl NoContact {
    /// The reason in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::NoCamera => "frame not registered",
            Self::Truncated => "mask truncated by the image border, or below 50 px²",
            Self::Occluded => "lower edge occluded by another vehicle",
            Self::NoGroundPlane => "no ground plane",
            Self::NearHorizon => "contact line at the horizon: distance open",
        }
    }
}

/// Trust in a ground track; its words differ from those for trajectories, since no model is judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GroundTrackTrust {
    /// Distances and displacements are known to ±10 % or better.
    Usable,
    /// Distances are known less precisely.
    Coarse,
    /// Positions deviate from a smooth path by more than their standard deviations allow.
    Inconsistent,
}

with_names!(GroundTrackTrust { Usable = "usable", Coarse = "coarse", Inconsistent = "inconsistent" });

/// Verdict on a ground track.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroundTrackVerdict {
    /// Trust.
    pub state: GroundTrackTrust,
    /// Median standard deviation of the distance to the camera, as a share of it.
    pub distance_std: f64,
    /// Reason, with its figure.
    pub says: String,
}

/// Positions on the ground of a vehicle without a usable 3D model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GroundTrack {
    /// The vehicle.
    pub id: ObjectId,
    /// Its class name.
    pub class: String,
    /// Mean score of its detections, 0 to 1; 1 for given masks.
    pub confidence: f64,
    /// Method.
    pub method: GroundTrackMethod,
    /// Reason why its 3D model cannot be used.
    pub reason: String,
    /// Verdict; `None` before the stage `metric`.
    pub verdict: Option<GroundTrackVerdict>,
    /// Number of frames by the basis of their ground plane.
    pub ground: BTreeMap<PlaneBasis, usize>,
    /// Frames with a mask but without a position, by reason.
    pub omitted: BTreeMap<NoContact, usize>,
    /// Median width and height of the mask at the distance of the contact point, units of the background.
    pub apparent_size: [f64; 2],
    /// Apparent width and height, meters; `None` where meters are unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub apparent_size_m: Option<[Estimate; 2]>,
    /// Length, width and height from the outlines, meters; `None` where meters are unknown.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dimensions: Option<Dimensions>,
    /// Direction of the longitudinal axis of a stationary vehicle with its standard deviation, degrees clockwise from
    /// north, 0 to 180: front and rear are not distinguished. From the metric frame's second axis where north is not
    /// known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub axis_deg: Option<Estimate>,
    /// Path length, displacement and speeds; `None` for fewer than four positions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub travel: Option<Travel>,
    /// Ascending in time.
    #[serde(rename = "frames")]
    pub positions: Vec<GroundPosition>,
}

impl GroundTrack {
    /// Ground track without positions.
    pub fn new(id: ObjectId, class: impl Into<String>, confidence: f64) -> Self {
        Self {
            id,
            class: class.into(),
            confidence,
            method: GroundTrackMethod::GroundContact,
            reason: String::new(),
            verdict: None,
            ground: BTreeMap::new(),
            omitted: BTreeMap::new(),
            apparent_size: [0.0; 2],
            apparent_size_m: None,
            dimensions: None,
            axis_deg: None,
            travel: None,
            positions: Vec::new(),
        }
    }

    /// Corners of a stationary vehicle around the median of its positions, in the background's frame, counterclockwise
    /// from above; `None` without length, width and axis.
    pub fn footprint(&self, frame: &MetricFrame) -> Option<[Point3<f64>; 4]> {
        let Dimensions { length_m, width_m, .. } = self.dimensions?;
        let (sin, cos) = self.axis_deg?.value.to_radians().sin_cos();
        let world_from_metric = frame.metric_from_world().inverse();
        let half = |size: Option<Estimate>, [x, y]: [f64; 2]| {
            Some(world_from_metric.rotation * Vector3::new(x, y, 0.0) * (0.5 * size?.value / frame.scale))
        };
        let (ahead, aside) = (half(length_m, [sin, cos])?, half(width_m, [cos, -sin])?);
        let of = |k: usize| median(self.positions.iter().map(|at| at.position[k]).collect());
        let middle = Point3::new(of(0)?, of(1)?, of(2)?);
        Some([ahead + aside, ahead - aside, -ahead - aside, aside - ahead].map(|to| middle + to))
    }

    /// Name of the track: class and id.
    pub fn name(&self) -> String {
        let class = if self.class.is_empty() { "vehicle" } else { &self.class };
        format!("{class} {}", self.id)
    }

    /// Frames without a position, for messages: `3 frames: near ...; 2 frames: ...`; `None` if there are none.
    pub fn omissions(&self) -> Option<String> {
        let omission = |(why, count): (&NoContact, &usize)| format!("{}: {}", counted(*count, "frame"), why.words());
        let all: Vec<String> = self.omitted.iter().map(omission).collect();
        (!all.is_empty()).then(|| all.join("; "))
    }
}
