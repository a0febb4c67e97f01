//! Rigid transforms of three-dimensional space.

use std::ops::Mul;

use nalgebra::{Matrix3x4, Point3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A rotation followed by a translation, `target_from_source`: `x_target = R x_source + t`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rigid3 {
    /// Rotation from the source to the target frame; in files `rotation_wxyz`.
    #[serde(rename = "rotation_wxyz", with = "super::wxyz")]
    pub rotation: UnitQuaternion<f64>,
    /// Origin of the source frame, in the target frame.
    pub translation: Vector3<f64>,
}

impl Rigid3 {
    /// The identity transform.
    pub fn identity() -> Self {
        Self { rotation: UnitQuaternion::identity(), translation: Vector3::zeros() }
    }

    /// Transform from rotation and translation.
    pub fn new(rotation: UnitQuaternion<f64>, translation: Vector3<f64>) -> Self {
        Self { rotation, translation }
    }

    /// The pose `cam_from_world` of a camera with this rotation and its center at `center_in_world`.
    pub fn from_rotation_and_center(rotation: UnitQuaternion<f64>, center_in_world: Point3<f64>) -> Self {
        Self { rotation, translation: -(rotation * center_in_world.coords) }
    }

    /// `source_from_target`.
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self { rotation, translation: -(rotation * self.translation) }
    }

    /// Origin of the target frame in the source frame: for `cam_from_world`, the camera center in the world.
    pub fn center(&self) -> Point3<f64> {
        Point3::from(-(self.rotation.inverse() * self.translation))
    }

    /// `[R | t]`, 3 × 4.
    pub fn matrix(&self) -> Matrix3x4<f64> {
        let mut m = Matrix3x4::zeros();
        m.fixed_view_mut::<3, 3>(0, 0).copy_from(self.rotation.to_rotation_matrix().matrix());
        m.set_column(3, &self.translation);
        m
    }

    /// The rotation angle between two transforms, radians.
    pub fn angle_to(&self, other: &Self) -> f64 {
        self.rotation.angle_to(&other.rotation)
    }
}

impl Mul for Rigid3 {
    type Output = Self;
    /// `a_from_b * b_from_c = a_from_c`.
    fn mul(self, rhs: Self) -> Self {
        Self { rotation: self.rotation * rhs.rotation, translation: self.rotation * rhs.translation + self.translation }
    }
}

impl Mul<Point3<f64>> for Rigid3 {
    type Output = Point3<f64>;
    fn mul(self, point_in_source: Point3<f64>) -> Point3<f64> {
        self.rotation * point_in_source + self.translation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_and_center_agree() {
        let t = Rigid3::new(UnitQuaternion::from_euler_angles(0.1, -0.7, 2.0), Vector3::new(1.0, -2.0, 3.0));
        assert!((t * t.inverse() * Point3::new(4.0, 5.0, 6.0) - Point3::new(4.0, 5.0, 6.0)).norm() < 1e-12);
        assert!((t * t.center()).coords.norm() < 1e-12);
        let same = Rigid3::from_rotation_and_center(t.rotation, t.center());
        assert!((same.translation - t.translation).norm() < 1e-12);
    }
}
