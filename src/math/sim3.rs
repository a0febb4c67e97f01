//! Similarity transforms of three-dimensional space.

use std::ops::Mul;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Rigid3;

/// Scale, rotation, translation, `target_from_source`: `x_target = s R x_source + t`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Sim3 {
    /// Length in the target frame of one unit of the source frame.
    pub scale: f64,
    /// Rotation from the source to the target frame; in files `rotation_wxyz`.
    #[serde(rename = "rotation_wxyz", with = "super::wxyz")]
    #[schemars(with = "[f64; 4]")]
    pub rotation: UnitQuaternion<f64>,
    /// Origin of the source frame, in the target frame.
    #[schemars(with = "[f64; 3]")]
    pub translation: Vector3<f64>,
}

impl Sim3 {
    /// The identity transform.
    pub fn identity() -> Self {
        Self { scale: 1.0, rotation: UnitQuaternion::identity(), translation: Vector3::zeros() }
    }

    /// Transform from scale, rotation and translation.
    pub fn new(scale: f64, rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        Self { scale, rotation, translation }
    }

    /// `source_from_target`. The scale must not be zero.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        let scale = 1.0 / self.scale;
        Self { scale, rotation, translation: -(rotation * self.translation) * scale }
    }

    /// The pose `cam_from_target` of a camera given as `cam_from_source`.
    ///
    /// The camera frame has the target's unit of length, so image positions are unchanged.
    pub fn transform_camera(&self, cam_from_source: &Rigid3) -> Rigid3 {
        Rigid3::from_rotation_and_center(
            cam_from_source.rotation * self.rotation.inverse(),
            *self * cam_from_source.center(),
        )
    }
}

impl From<Rigid3> for Sim3 {
    fn from(t: Rigid3) -> Self {
        Self { scale: 1.0, rotation: t.rotation, translation: t.translation }
    }
}

impl Mul for Sim3 {
    type Output = Self;
    /// `a_from_b * b_from_c = a_from_c`.
    fn mul(self, rhs: Self) -> Self {
        Self {
            scale: self.scale * rhs.scale,
            rotation: self.rotation * rhs.rotation,
            translation: self.rotation * rhs.translation * self.scale + self.translation,
        }
    }
}

impl Mul<Point3<f64>> for Sim3 {
    type Output = Point3<f64>;
    fn mul(self, point_in_source: Point3<f64>) -> Point3<f64> {
        Point3::from(self.rotation * point_in_source.coords * self.scale + self.translation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_undoes_and_cameras_keep_their_view() {
        let s = Sim3::new(2.5, UnitQuaternion::from_euler_angles(0.4, 0.2, -1.0), Vector3::new(1.0, 2.0, -3.0));
        let p = Point3::new(0.3, -4.0, 8.0);
        assert!((s.inverse() * (s * p) - p).norm() < 1e-12);
        assert!(((s * s.inverse()) * p - p).norm() < 1e-12);
        let cam = Rigid3::new(UnitQuaternion::from_euler_angles(0.1, 0.3, 0.2), Vector3::new(0.5, 0.1, 9.0));
        let before = cam * p;
        let after = s.transform_camera(&cam) * (s * p);
        assert!((before.coords * s.scale - after.coords).norm() < 1e-12);
    }

    #[test]
    fn quaternions_are_stored_with_the_real_part_first() {
        // A quarter turn round z.
        let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2);
        let s = Sim3::new(2.0, quarter, Vector3::new(1.0, 2.0, 3.0));
        let value = serde_json::to_value(s).unwrap();
        let keys: Vec<_> = value.as_object().unwrap().keys().collect();
        assert_eq!(keys, ["scale", "rotation_wxyz", "translation"]);
        let wxyz: [f64; 4] = serde_json::from_value(value["rotation_wxyz"].clone()).unwrap();
        let expected = [0.5f64.sqrt(), 0.0, 0.0, 0.5f64.sqrt()];
        assert!(wxyz.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-15), "{wxyz:?}");
        let text = serde_json::to_string(&s).unwrap();
        assert_eq!(serde_json::from_str::<Sim3>(&text).unwrap(), s);
        let rigid = Rigid3::new(quarter, s.translation);
        assert_eq!(serde_json::to_value(rigid).unwrap()["rotation_wxyz"], value["rotation_wxyz"]);
        let stretched = text.replace(&format!("{}", wxyz[0]), "0.8");
        assert!(
            serde_json::from_str::<Sim3>(&stretched).unwrap_err().to_string().contains("unit length"),
            "{stretched}"
        );
    }
}
