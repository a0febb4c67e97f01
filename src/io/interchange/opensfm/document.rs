//! Structure of `reconstruction.json`, limited to the used keys.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

#[derive(Deserialize, Serialize)]
pub struct Document {
    pub cameras: BTreeMap<String, CameraEntry>,
    pub shots: BTreeMap<String, ShotEntry>,
    #[serde(default)]
    pub points: BTreeMap<String, PointEntry>,
}

/// Parameters of all projections; those of other projections are absent.
#[derive(Default, Deserialize, Serialize)]
#[serde(default)]
pub struct CameraEntry {
    pub projection_type: String,
    pub width: u32,
    pub height: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal_x: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub focal_y: Option<f64>,
    pub c_x: f64,
    pub c_y: f64,
    pub k1: f64,
    pub k2: f64,
    pub k3: f64,
    pub k4: f64,
    pub p1: f64,
    pub p2: f64,
}

#[derive(Deserialize, Serialize)]
pub struct ShotEntry {
    pub rotation: [f64; 3],
    pub translation: [f64; 3],
    pub camera: String,
}

#[derive(Deserialize, Serialize)]
pub struct PointEntry {
    #[serde(default = "white")]
    pub color: [f64; 3],
    pub coordinates: [f64; 3],
}

fn white() -> [f64; 3] {
    [255.0; 3]
}
