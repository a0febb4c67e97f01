//! Background points in the camera frames nearest to them, with the covariance of their positions.

use nalgebra::{Matrix3, Point3, UnitQuaternion, Vector3};

use crate::scene::{FrameId, Image, Point3dId, Reconstruction};

/// Point in the frame of one camera that observes it.
#[derive(Clone, Copy, Debug)]
pub(super) struct PointView {
    pub frame: FrameId,
    pub in_cam: Point3<f64>,
    /// Mean focal length, pixels.
    pub focal: f64,
    cam_from_world: UnitQuaternion<f64>,
}

/// Point in the frames of the nearest cameras that observe it.
#[derive(Clone, Debug)]
pub(super) struct PointObservations {
    pub views: Vec<PointView>,
    /// Covariance of its position in the world, for a noise of one pixel.
    covariance: Matrix3<f64>,
}

impl PointObservations {
    /// Variance along a direction in a camera's frame, for a noise of one pixel.
    pub(super) fn variance_along(&self, view: &PointView, direction_in_cam: &Vector3<f64>) -> f64 {
        let in_world = view.cam_from_world.inverse() * direction_in_cam;
        in_world.dot(&(self.covariance * in_world)).max(0.0)
    }

    /// Views of a point, and its covariance from all rays of its track: (Σ (1 − d dᵀ) f² / l²)⁻¹, d and l the
    /// direction and length of a ray (eq. 14). `None` where the rays do not determine the position.
    fn of(background: &Reconstruction, position: Point3<f64>, images: &[(FrameId, &Image)]) -> Option<Self> {
        let mut information = Matrix3::zeros();
        let mut views = Vec::new();
        for (frame, image) in images {
            let in_cam = image.cam_from_world * position;
            let focal = background.camera_of(image).mean_focal();
            let ray = position - image.cam_from_world.center();
            let (depth, length_sq) = (in_cam.z, ray.norm_squared());
            if !(depth > 0.0) {
                continue;
            }
            information += (Matrix3::identity() - ray * ray.transpose() / length_sq) * (focal * focal / length_sq);
            views.push(PointView { frame: *frame, in_cam, focal, cam_from_world: image.cam_from_world.rotation });
        }
        let covariance = information.try_inverse().filter(|c| c.iter().all(|x| x.is_finite()))?;
        views.sort_by(|a, b| a.in_cam.z.total_cmp(&b.in_cam.z));
        // Further views add little information.
        views.truncate(8);
        (!views.is_empty()).then_some(Self { views, covariance })
    }
}

/// All points of a background for which `is_wanted` is true, ascending by id.
pub(super) fn point_observations(
    background: &Reconstruction,
    is_wanted: impl Fn(Point3dId) -> bool,
) -> Vec<PointObservations> {
    let wanted = background.points.iter().filter(|(id, _)| is_wanted(**id));
    wanted
        .filter_map(|(_, point)| {
            let observing = point.track.iter().map(|element| element.image);
            let images: Vec<_> = observing.filter_map(|id| Some((id.frame(), background.images.get(&id)?))).collect();
            PointObservations::of(background, point.position, &images)
        })
        .collect()
}
