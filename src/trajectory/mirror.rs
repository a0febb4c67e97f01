//! The other reconstruction that a small object has.
//!
//! Where an object is small next to its distance, its pictures are nearly parallel projections, and of those the mirror
//! image of the object, turning the other way, makes the same ones (the Necker reversal; J. J. Koenderink and A. J. van
//! Doorn, *Affine structure from motion*, JOSA A 1991). Which of the two reprojects better is then decided by noise.
//! The ground knows: against the wrong one it seems to tilt by tens of degrees.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use super::Views;
use super::assemble::object_center;
use crate::math::{Rigid3, median};
use crate::scene::Reconstruction;

/// The reversed reconstruction: every point is mirrored in depth about the object's centre, in every camera's frame.
pub(super) fn mirrored(object: &Reconstruction) -> Reconstruction {
    let center = object_center(object);
    let mirror = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
    let mut out = object.clone();
    for point in out.points.values_mut() {
        point.position = Point3::from(mirror * (point.position - center));
    }
    for image in out.images.values_mut() {
        let rotation = image.cam_from_world.rotation.to_rotation_matrix().into_inner();
        // The middle stays where it is; D R D turns the mirrored points to the mirrored places.
        let translation = (image.cam_from_world * center).coords;
        let turned = Rotation3::from_matrix_unchecked(mirror * rotation * mirror);
        image.cam_from_world = Rigid3::new(UnitQuaternion::from_rotation_matrix(&turned), translation);
    }
    out
}

/// The mean direction of the ground's normals in the object's frame, and the median angle between it and them, radians.
pub(super) fn mean_normal(views: &Views) -> Option<(Vector3<f64>, f64)> {
    let normals = || views.views.iter().map(|view| view.normal_in_object);
    let mean = normals().sum::<Vector3<f64>>().try_normalize(f64::EPSILON)?;
    let angle = median(normals().map(|normal| normal.angle(&mean)).collect())?;
    Some((mean, angle))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{Options, drive};

    #[test]
    fn the_mirror_image_makes_nearly_the_same_pictures_and_is_its_own_inverse() {
        let world = drive(&Options { distance_m: [220.0, 250.0], ..Options::default() }, 3);
        let other = mirrored(&world.object);
        for (image, turned) in world.object.images.values().zip(other.images.values()) {
            let camera = world.object.camera_of(image);
            for (a, b) in world.object.points.values().zip(other.points.values()) {
                let pixel = |image: &crate::scene::Image, point: Point3<f64>| {
                    camera.pixel_from_cam(image.cam_from_world * point).unwrap()
                };
                assert!((pixel(image, a.position) - pixel(turned, b.position)).norm() < 0.5);
            }
        }
        let back = mirrored(&other);
        let (a, b) = (&world.object, &back);
        let distance = |model: &Reconstruction| {
            let mut points = model.points.values();
            (points.next().unwrap().position - points.next().unwrap().position).norm()
        };
        assert!((distance(a) - distance(b)).abs() < 1e-12);
    }
}
