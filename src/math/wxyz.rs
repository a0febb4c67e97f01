//! Serialization of rotations: a unit quaternion as `[w, x, y, z]`, independent of the library's order.
//!
//! For `#[serde(with = "wxyz")]`.

use nalgebra::{Quaternion, UnitQuaternion};
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// Maximum deviation of a stored quaternion's norm from 1.
pub const MAX_UNIT_ERROR: f64 = 1e-6;

pub(super) fn serialize<S: Serializer>(rotation: &UnitQuaternion<f64>, to: S) -> Result<S::Ok, S::Error> {
    [rotation.w, rotation.i, rotation.j, rotation.k].serialize(to)
}

pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<UnitQuaternion<f64>, D::Error> {
    let [w, x, y, z] = <[f64; 4]>::deserialize(from)?;
    let quaternion = Quaternion::new(w, x, y, z);
    if !((quaternion.norm() - 1.0).abs() <= MAX_UNIT_ERROR) {
        return Err(de::Error::custom(format!("quaternion [{w}, {x}, {y}, {z}] is not of unit length")));
    }
    // Preserved bit for bit: a written value is read back unchanged.
    Ok(UnitQuaternion::new_unchecked(quaternion))
}
