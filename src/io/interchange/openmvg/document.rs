//! Structure of the file.

use serde::{Deserialize, Serialize};

#[derive(Deserialize, Serialize)]
pub struct Document {
    #[serde(default)]
    pub sfm_data_version: String,
    #[serde(default)]
    pub root_path: String,
    pub views: Vec<Entry<Polymorphic<View>>>,
    pub intrinsics: Vec<Entry<Polymorphic<Intrinsic>>>,
    pub extrinsics: Vec<Entry<Extrinsic>>,
    pub structure: Vec<Entry<Landmark>>,
    #[serde(default, skip_deserializing)]
    pub control_points: [u8; 0],
}

#[derive(Deserialize, Serialize)]
pub struct Entry<T> {
    pub key: u32,
    pub value: T,
}

#[derive(Deserialize, Serialize)]
pub struct Polymorphic<T> {
    pub polymorphic_id: u32,
    /// Present only at the first occurrence of a type.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub polymorphic_name: Option<String>,
    pub ptr_wrapper: Pointer<T>,
}

#[derive(Deserialize, Serialize)]
pub struct Pointer<T> {
    #[serde(default)]
    pub id: u32,
    pub data: T,
}

#[derive(Deserialize, Serialize)]
pub struct View {
    #[serde(default)]
    pub local_path: String,
    pub filename: String,
    #[serde(default)]
    pub width: u32,
    #[serde(default)]
    pub height: u32,
    #[serde(default)]
    pub id_view: u32,
    pub id_intrinsic: u32,
    pub id_pose: u32,
}

#[derive(Default, Deserialize, Serialize)]
pub struct Intrinsic {
    /// Size of `spherical`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub value0: Option<Size>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub width: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height: Option<u32>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focal_length: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub principal_point: Option<[f64; 2]>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub disto_k1: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub disto_k3: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub disto_t2: Vec<f64>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fisheye: Vec<f64>,
}

#[derive(Clone, Copy, Deserialize, Serialize)]
pub struct Size {
    pub width: u32,
    pub height: u32,
}

#[derive(Deserialize, Serialize)]
pub struct Extrinsic {
    pub rotation: [[f64; 3]; 3],
    pub center: [f64; 3],
}

#[derive(Deserialize, Serialize)]
pub struct Landmark {
    #[serde(rename = "X")]
    pub position: [f64; 3],
    pub observations: Vec<Entry<Feature>>,
}

#[derive(Deserialize, Serialize)]
pub struct Feature {
    #[serde(default)]
    pub id_feat: u32,
    pub x: [f64; 2],
}
