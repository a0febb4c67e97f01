//! Sparse reconstruction, in COLMAP's terms.

use std::collections::BTreeMap;

use nalgebra::{Point2, Point3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::FrameId;
use crate::camera::{Camera, Model};
use crate::math::{Rigid3, Sim3, is_finite, median};

macro_rules! id {
    ($(#[$doc:meta])* $name:ident($inner:ty)) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
        #[serde(transparent)]
        pub struct $name(pub $inner);
    };
}

id!(
    /// Id of a set of intrinsics; from 1, as in COLMAP.
    CameraId(u32)
);
id!(
    /// Id of an image of a reconstruction; from 1, as in COLMAP. For frames of a source it is the frame index plus one.
    ImageId(u32)
);
id!(
    /// Id of a reconstructed point; from 1, as in COLMAP.
    Point3dId(u64)
);

impl From<FrameId> for ImageId {
    fn from(frame: FrameId) -> Self {
        Self(frame.0 + 1)
    }
}

impl ImageId {
    /// Frame of an image of a frame source; the inverse of `ImageId::from`. Id 0, which does not occur in a source,
    /// counts as frame 0.
    pub fn frame(self) -> FrameId {
        FrameId(self.0.saturating_sub(1))
    }
}

/// A feature position in an image and the point that it observes, if any.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Image position, pixels; the center of the first pixel is at (0.5, 0.5).
    pub pixel: Point2<f64>,
    /// The observed point.
    pub point: Option<Point3dId>,
}

/// Registered image: its pose is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// File name.
    pub name: String,
    /// Its intrinsics.
    pub camera: CameraId,
    /// World to camera.
    pub cam_from_world: Rigid3,
    /// Its features; a [`TrackElement`] refers to them by index.
    pub observations: Vec<Observation>,
}

/// One observation of a point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct TrackElement {
    /// The observing image.
    pub image: ImageId,
    /// Index in [`Image::observations`].
    pub observation_idx: u32,
}

/// A reconstructed point.
#[derive(Clone, Debug, PartialEq)]
pub struct Point3d {
    /// Position in the world frame of the reconstruction.
    pub position: Point3<f64>,
    /// Color.
    pub rgb: [u8; 3],
    /// Mean reprojection error, pixels.
    pub error_px: f64,
    /// Observations.
    pub track: Vec<TrackElement>,
}

/// Form in which the file of origin describes a camera.
#[derive(Clone, Debug, PartialEq)]
pub enum CameraForm {
    /// In a model that [`Camera`] supports, for any parameter values.
    Covered(Model),
    /// In another model, with its parameters. Of its [`Camera`] only image size, focal lengths and principal point are
    /// valid, and points must not be projected with it.
    Foreign(Model, Vec<f64>),
    /// Not at all: a file of poses alone. Points must not be projected with its [`Camera`].
    Unknown,
}

/// Cameras, registered images and points, in one world frame of arbitrary scale.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Reconstruction {
    /// Intrinsics by id.
    pub cameras: BTreeMap<CameraId, Camera>,
    /// Forms in which the files of origin describe their cameras, for writing them in the same form. Cameras estimated
    /// by this program have no entry.
    pub camera_forms: BTreeMap<CameraId, CameraForm>,
    /// Registered images by id, which orders them in time for a video.
    pub images: BTreeMap<ImageId, Image>,
    /// Points by id.
    pub points: BTreeMap<Point3dId, Point3d>,
}

impl Reconstruction {
    /// Returns true if no image is registered.
    pub fn is_empty(&self) -> bool {
        self.images.is_empty()
    }

    /// Images of a video before which the map is interrupted: too few tracks connect them with the images before.
    pub fn gaps(&self) -> Vec<ImageId> {
        let ids: Vec<ImageId> = self.images.keys().copied().collect();
        // By image: tracks that begin before it, less those that end before it.
        let mut change = vec![0isize; ids.len() + 1];
        for point in self.points.values() {
            let seen = || point.track.iter().map(|element| ids.partition_point(|id| *id < element.image));
            if let (Some(first), Some(last)) = (seen().min(), seen().max()) {
                change[first + 1] += 1;
                change[(last + 1).min(ids.len())] -= 1;
            }
        }
        let mut num_shared = 0;
        let mut gaps = Vec::new();
        for k in 1..ids.len() {
            num_shared += change[k];
            // Seven re-detected tracks left two parts of a rendered car 0.18 m apart; other values were not tried.
            // Between neighboring frames a rigid motion takes three.
            let is_next = ids[k].frame().0 == ids[k - 1].frame().0 + 1;
            if num_shared < if is_next { 3 } else { 12 } {
                gaps.push(ids[k]);
            }
        }
        gaps
    }

    /// The intrinsics of an image of this reconstruction.
    pub fn camera_of(&self, image: &Image) -> &Camera {
        &self.cameras[&image.camera]
    }

    /// Returns true if points can be projected with a camera of this reconstruction.
    pub fn can_project(&self, camera: CameraId) -> bool {
        !matches!(self.camera_forms.get(&camera), Some(CameraForm::Foreign(..) | CameraForm::Unknown))
    }

    /// Intrinsics of an image; `None` if points cannot be projected with them.
    pub fn projecting_camera(&self, image: &Image) -> Option<&Camera> {
        self.cameras.get(&image.camera).filter(|_| self.can_project(image.camera))
    }

    /// First camera with which points cannot be projected, and the name of its model.
    pub fn first_foreign(&self) -> Option<(CameraId, &'static str)> {
        self.cameras.keys().find_map(|id| match self.camera_forms.get(id)? {
            CameraForm::Covered(_) => None,
            CameraForm::Foreign(model, _) => Some((*id, model.name())),
            CameraForm::Unknown => Some((*id, "without known camera model")),
        })
    }

    /// Recomputed reprojection errors of a point, pixels, in those images of its track whose camera it is in front of.
    /// `None` if one of the cameras is not known.
    pub fn errors_of(&self, point: &Point3d) -> Option<Vec<f64>> {
        let error = |element: &TrackElement| {
            let image = self.images.get(&element.image)?;
            let seen = image.observations.get(element.observation_idx as usize)?.pixel;
            let camera = self.projecting_camera(image)?;
            let projected = camera.pixel_from_cam(image.cam_from_world * point.position);
            Some(projected.map(|pixel| (pixel - seen).norm()))
        };
        Some(point.track.iter().map(error).collect::<Option<Vec<_>>>()?.into_iter().flatten().collect())
    }

    /// Recomputes the mean reprojection errors of all points whose cameras are known.
    pub fn renew_errors(&mut self) {
        let error_of = |errors: Vec<f64>| errors.iter().sum::<f64>() / errors.len().max(1) as f64;
        let errors: Vec<Option<f64>> = self.points.values().map(|point| self.errors_of(point).map(error_of)).collect();
        for (point, error) in self.points.values_mut().zip(errors) {
            point.error_px = error.unwrap_or(point.error_px);
        }
    }

    /// Images that this reconstruction (background) and that of an object have in common, matched by name, with their
    /// frame in this reconstruction. In the order of this reconstruction's ids.
    pub fn paired_images<'a>(&'a self, object: &'a Self) -> Vec<(FrameId, &'a Image, &'a Image)> {
        let by_name: BTreeMap<&str, &Image> =
            object.images.values().map(|image| (image.name.as_str(), image)).collect();
        self.images
            .iter()
            .filter_map(|(id, image)| by_name.get(image.name.as_str()).map(|own| (id.frame(), image, *own)))
            .collect()
    }

    /// Mean reprojection error over all observations, pixels; `None` without observations.
    pub fn mean_reprojection_error_px(&self) -> Option<f64> {
        let (sum, count) = self
            .points
            .values()
            .fold((0.0, 0usize), |(sum, count), p| (sum + p.error_px * p.track.len() as f64, count + p.track.len()));
        (count > 0).then(|| sum / count as f64)
    }

    /// Positions of all points with finite coordinates.
    pub fn finite_positions(&self) -> Vec<Point3<f64>> {
        self.points.values().map(|point| point.position).filter(is_finite).collect()
    }

    /// Positions of an object's reliable points: observed in at least `min_track` images, and along no axis farther
    /// from the median than `max_deviation` times the median absolute deviation.
    pub fn solid_points(&self, min_track: usize, max_deviation: f64) -> Vec<Point3<f64>> {
        let seen = self.points.values().filter(|point| point.track.len() >= min_track);
        let mut points: Vec<Point3<f64>> = seen.map(|point| point.position).filter(is_finite).collect();
        for axis in 0..3 {
            let Some(middle) = median(points.iter().map(|p| p[axis]).collect()) else { break };
            let spread = median(points.iter().map(|p| (p[axis] - middle).abs()).collect()).unwrap_or(0.0);
            points.retain(|p| (p[axis] - middle).abs() <= max_deviation * spread);
        }
        points
    }

    /// Removes points; the features that observed them stay.
    pub fn remove_points(&mut self, ids: &[Point3dId]) {
        for id in ids {
            let Some(point) = self.points.remove(id) else { continue };
            for element in point.track {
                let observations = self.images.get_mut(&element.image).map(|image| &mut image.observations);
                if let Some(seen) = observations.and_then(|all| all.get_mut(element.observation_idx as usize)) {
                    seen.point = None;
                }
            }
        }
    }

    /// Removes images with their observations, and points that fewer than two other images observe.
    pub fn remove_images(&mut self, ids: &[ImageId]) {
        for id in ids {
            let Some(image) = self.images.remove(id) else { continue };
            for point in image.observations.iter().filter_map(|seen| seen.point) {
                if let Some(point) = self.points.get_mut(&point) {
                    point.track.retain(|element| element.image != *id);
                }
            }
        }
        let lost: Vec<Point3dId> =
            self.points.iter().filter(|(_, point)| point.track.len() < 2).map(|(id, _)| *id).collect();
        self.remove_points(if ids.is_empty() { &[] } else { &lost });
    }

    /// Transforms cameras and points by a similarity of the world frame.
    pub fn transform(&mut self, target_from_world: &Sim3) {
        for image in self.images.values_mut() {
            image.cam_from_world = target_from_world.transform_camera(&image.cam_from_world);
        }
        for point in self.points.values_mut() {
            point.position = *target_from_world * point.position;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{Options, drive};

    #[test]
    fn removing_images_removes_their_observations() {
        let whole = drive(&Options { num_frames: 8, ..Options::default() }, 1).object;
        let mut model = whole.clone();
        model.remove_images(&[]);
        assert_eq!(model, whole);
        let gone: Vec<ImageId> = whole.images.keys().copied().take(5).collect();
        model.remove_images(&gone);
        assert_eq!(model.images.len(), 3);
        assert!(!model.points.is_empty() && model.points.len() <= whole.points.len());
        let is_there = |element: &TrackElement| model.images.contains_key(&element.image);
        assert!(model.points.values().all(|point| point.track.len() >= 2 && point.track.iter().all(is_there)));
        let seen = model.images.values().flat_map(|image| &image.observations).filter_map(|seen| seen.point);
        assert!(seen.into_iter().all(|id| model.points.contains_key(&id)));
        // Points that only one image observes are removed.
        let but_one: Vec<ImageId> = model.images.keys().copied().skip(1).collect();
        model.remove_images(&but_one);
        assert_eq!((model.images.len(), model.points.len()), (1, 0));
    }
}
