//! Points of an object that its silhouettes contradict.
//!
//! Every point of an object projects into its silhouette in every image: the object is within its visual hull (A.
//! Laurentini, *The Visual Hull Concept for Silhouette-Based Image Understanding*, PAMI 1994). A wrong match, a
//! reflection or a shadow that moves along may fit all images that observe it. The other images, where it projects
//! outside of the mask, show that it is not part of the object.

use std::collections::BTreeMap;

use crate::scene::{ImageId, Mask, Point3dId, Reconstruction};

/// Limits of the silhouette test.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SilhouetteOptions {
    /// Maximum share of images with the point outside of the mask: an occluder cuts the masks too, and masks flicker.
    pub max_outside: f64,
    /// Minimum number of votes of a point.
    pub min_votes: u32,
}

impl Default for SilhouetteOptions {
    fn default() -> Self {
        Self { max_outside: 0.3, min_votes: 5 }
    }
}

/// Votes of the images of one object on its points: inside or outside of the mask.
#[derive(Clone, Debug, Default)]
pub struct SilhouetteVotes {
    /// Number of votes, and number of those for outside.
    votes: BTreeMap<Point3dId, [u32; 2]>,
    /// First images of all sub-maps but the first.
    gaps: Vec<ImageId>,
}

impl SilhouetteVotes {
    /// Votes of the images of one object; those of a sub-map are on its own points only.
    pub fn new(object: &Reconstruction) -> Self {
        Self { gaps: object.gaps(), ..Self::default() }
    }

    /// Adds the votes of one registered image.
    ///
    /// Points at occluded positions get no vote. Points out of view are outside if the mask shows the object as a
    /// whole: no part of it is outside of the image or behind the camera.
    ///
    /// * `silhouette` – the object's mask in this image, dilated by the error of its border.
    /// * `is_occluded` – true where another object may occlude an image position.
    pub fn add(
        &mut self,
        object: &Reconstruction,
        image: ImageId,
        silhouette: &Mask,
        is_occluded: impl Fn(f64, f64) -> bool,
    ) {
        let sub_map = |id: ImageId| self.gaps.partition_point(|gap| *gap <= id);
        let of_image = sub_map(image);
        let Some(image) = object.images.get(&image) else { return };
        let camera = object.camera_of(image);
        let (width, height) = (silhouette.width(), silhouette.height());
        let is_whole = silhouette.bounding_box().is_some_and(|bounds| !bounds.is_truncated(width, height));
        for (&id, point) in &object.points {
            if point.track.first().is_some_and(|element| sub_map(element.image) != of_image) {
                continue;
            }
            let pixel = camera.pixel_from_cam(image.cam_from_world * point.position);
            let is_outside = match pixel.filter(|pixel| camera.contains(*pixel)) {
                Some(pixel) if is_occluded(pixel.x, pixel.y) => continue,
                Some(pixel) => !silhouette.contains(pixel.x, pixel.y),
                None if is_whole => true,
                None => continue,
            };
            let [votes, outside] = self.votes.entry(id).or_default();
            *votes += 1;
            *outside += u32::from(is_outside);
        }
    }

    /// The points that are outside too often.
    pub fn outside(&self, options: &SilhouetteOptions) -> Vec<Point3dId> {
        let is_outside = |[votes, outside]: [u32; 2]| {
            votes >= options.min_votes && f64::from(outside) > options.max_outside * f64::from(votes)
        };
        self.votes.iter().filter(|(_, counts)| is_outside(**counts)).map(|(&id, _)| id).collect()
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};

    use super::*;
    use crate::camera::Camera;
    use crate::math::Rigid3;
    use crate::scene::{CameraId, Image, Point3d, TrackElement};

    /// Ten cameras in a row, 10 m before a ball of radius 1, and points in it, next to it and behind it.
    #[test]
    fn points_outside_of_a_ball_are_found() {
        let camera = Camera::with_focal(200, 200, 150.0);
        let mut object = Reconstruction::default();
        object.cameras.insert(CameraId(1), camera);
        let positions = [[0.0, 0.0, 0.0], [0.6, -0.5, 0.4], [0.0, 0.9, 0.0], [0.0, 1.6, 0.0], [0.0, 0.0, 6.0]];
        for (id, position) in (1..).zip(positions) {
            let position = Point3::from(Vector3::from(position));
            object.points.insert(Point3dId(id), Point3d { position, rgb: [0; 3], error_px: 0.1, track: Vec::new() });
        }
        let mut votes = SilhouetteVotes::default();
        for k in 0..10u32 {
            let center = Vector3::new(f64::from(k) - 4.5, 0.0, -10.0);
            let cam_from_world = Rigid3::new(nalgebra::UnitQuaternion::identity(), -center);
            let image = Image { name: k.to_string(), camera: CameraId(1), cam_from_world, observations: Vec::new() };
            object.images.insert(ImageId(k + 1), image);
            let ball = camera.pixel_from_cam(Point3::from(-center)).unwrap();
            let radius = 150.0 / 10.0;
            let mask = Mask::from_fn(200, 200, |x, y| {
                (f64::from(x) + 0.5 - ball.x).hypot(f64::from(y) + 0.5 - ball.y) < radius + 1.0
            });
            // The mask of the second image is lost: one wrong vote of ten has no effect.
            let mask = if k == 1 { Mask::empty(200, 200) } else { mask };
            votes.add(&object, ImageId(k + 1), &mask, |_, _| false);
        }
        let options = SilhouetteOptions::default();
        assert_eq!(votes.outside(&options), [Point3dId(4), Point3dId(5)]);
        assert_eq!(votes.outside(&SilhouetteOptions { min_votes: 11, ..options }), []);
    }

    /// One point in front of all images, observed in some.
    fn point(images: &[u32], observed: &[u32]) -> Reconstruction {
        let mut object = Reconstruction::default();
        object.cameras.insert(CameraId(1), Camera::with_focal(100, 100, 100.0));
        let element = |image: &u32| TrackElement { image: ImageId(*image), observation_idx: 0 };
        let track = observed.iter().map(element).collect();
        let point = Point3d { position: Point3::new(0.0, 0.0, 5.0), rgb: [0; 3], error_px: 0.1, track };
        object.points.insert(Point3dId(1), point);
        let image = Image {
            name: String::new(),
            camera: CameraId(1),
            cam_from_world: Rigid3::identity(),
            observations: Vec::new(),
        };
        object.images.extend(images.iter().map(|id| (ImageId(*id), image.clone())));
        object
    }

    #[test]
    fn occluded_points_have_no_vote() {
        let object = point(&[1], &[]);
        let options = SilhouetteOptions { min_votes: 1, ..SilhouetteOptions::default() };
        let nothing = Mask::empty(100, 100);
        let mut votes = SilhouetteVotes::default();
        votes.add(&object, ImageId(1), &nothing, |_, _| true);
        assert_eq!(votes.outside(&options), []);
        votes.add(&object, ImageId(1), &nothing, |_, _| false);
        assert_eq!(votes.outside(&options), [Point3dId(1)]);
    }

    #[test]
    fn points_behind_a_camera_that_sees_the_whole_object_are_outside() {
        let mut object = point(&[1], &[]);
        object.points.values_mut().for_each(|point| point.position.z = -0.1);
        let options = SilhouetteOptions { min_votes: 1, ..SilhouetteOptions::default() };
        let mask = |from: u32| Mask::from_fn(100, 100, |x, y| (from..60).contains(&x) && (40..60).contains(&y));
        let mut votes = SilhouetteVotes::default();
        votes.add(&object, ImageId(1), &mask(0), |_, _| false);
        assert_eq!(votes.outside(&options), [], "the border cuts the object");
        votes.add(&object, ImageId(1), &mask(40), |_, _| false);
        assert_eq!(votes.outside(&options), [Point3dId(1)]);
    }

    #[test]
    fn another_sub_map_has_no_vote() {
        let object = point(&[1, 2, 9], &[1, 2]);
        let options = SilhouetteOptions { min_votes: 1, ..SilhouetteOptions::default() };
        let mut votes = SilhouetteVotes::new(&object);
        votes.add(&object, ImageId(9), &Mask::empty(100, 100), |_, _| false);
        assert_eq!(votes.outside(&options), []);
        votes.add(&object, ImageId(1), &Mask::empty(100, 100), |_, _| false);
        assert_eq!(votes.outside(&options), [Point3dId(1)]);
    }
}
