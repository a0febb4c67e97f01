//! Center of a vehicle's footprint from one mask, with its error.
//!
//! It is half of the footprint's depth behind the contact with the ground on the camera's side.

use nalgebra::{Matrix2, Matrix3, Matrix3x2, Point2, Point3, Vector2, Vector3};

use super::{FocalError, footprint};
use crate::camera::Camera;
use crate::math::Rigid3;
use crate::scene::{ContactError, GroundPlane, NoContact};
use crate::trajectory::Silhouette;

/// Constant part of the standard deviation of a mask's edge, independent in every frame, pixels. On four rendered
/// sequences with masks by the program it is 0.7 to 1.4 px in all at 100 px; docs/maths/ground-track.md.
const EDGE_PX: f64 = 0.5;
/// Part of the same standard deviation that grows with the mask, as a share of its extent across the edge.
const EDGE_SHARE: f64 = 0.01;
/// Constant part of the standard deviation of a mask's edge that all frames share, pixels: masks include shadows below
/// the vehicle, or exclude its tires. On the same sequences it is 1 to 2 px in all at 100 to 150 px.
const BIAS_PX: f64 = 1.0;
/// Part of the same standard deviation that grows with the mask, as a share of its extent across the edge.
const BIAS_SHARE: f64 = 0.02;

/// Contact of a vehicle with the ground.
#[derive(Clone, Debug)]
pub(super) struct ContactPoint {
    /// Center of its footprint.
    pub(super) position: Point3<f64>,
    pub(super) error: ContactError,
    /// Width and height of the mask at the distance of the point.
    pub(super) apparent_size: [f64; 2],
}

/// Lower edge of a mask in the image.
struct LowerEdge {
    /// Middle of the edge.
    pixel: Point2<f64>,
    /// Unit vector towards the ground.
    down: Vector2<f64>,
    /// Extent of the mask along the edge and across it, pixels.
    size: [f64; 2],
}

/// Camera over a plane, for the intersection of its rays with the plane.
struct Ray<'a> {
    camera: &'a Camera,
    cam_from_world: &'a Rigid3,
    plane: &'a GroundPlane,
    /// The camera's height over the plane.
    height: f64,
}

impl ContactPoint {
    /// Finds the contact point.
    ///
    /// * `occluders` – outlines that may occlude the vehicle.
    ///
    /// # Errors
    /// The reason why the frame has none.
    pub(super) fn find(
        (camera, cam_from_world): (&Camera, &Rigid3),
        plane: &GroundPlane,
        outline: &Silhouette,
        occluders: &[&Silhouette],
        focal: &FocalError,
    ) -> Result<Self, NoContact> {
        let height = plane.signed_distance(cam_from_world.center());
        let ray = Ray { camera, cam_from_world, plane, height };
        let edge = Some(ray.lower_edge(outline)).filter(|_| height > 0.0).flatten().ok_or(NoContact::NoGroundPlane)?;
        // The edge is occluded if another vehicle's mask contains the point this many pixels below it.
        let below = edge.pixel + edge.down * 3.0;
        if occluders.iter().any(|other| other.contains(below, 0.0)) {
            return Err(NoContact::Occluded);
        }
        let position = ray.intersection(edge.pixel).ok_or(NoContact::NearHorizon)?;
        let found = ray.with_error(position, &edge, focal).ok_or(NoContact::NearHorizon)?;
        let line_of_sight = position - cam_from_world.center();
        let along = line_of_sight.normalize();
        let variance = (along.transpose() * found.error.covariance() * along)[0];
        // With a standard deviation of a third of the distance, three standard deviations reach infinity.
        let is_known = variance.sqrt() <= 1.0 / 3.0 * line_of_sight.norm();
        is_known.then_some(found).ok_or(NoContact::NearHorizon)
    }
}

impl Ray<'_> {
    /// Point of the plane at a pixel; `None` at the horizon and above.
    fn intersection(&self, pixel: Point2<f64>) -> Option<Point3<f64>> {
        let ray = self.cam_from_world.rotation.inverse() * self.camera.normalized_from_pixel(pixel).push(1.0);
        let sinking = -self.plane.normal.dot(&ray);
        let point = self.cam_from_world.center() + ray * (self.height / sinking);
        (sinking > 0.0 && point.iter().all(|x| x.is_finite())).then_some(point)
    }

    /// Point of the plane at a pixel for another focal length and its plane, at the same distance below the camera.
    ///
    /// * `turn` – change of the plane's normal.
    fn with_focal(&self, pixel: Point2<f64>, log_focal: f64, turn: Vector3<f64>) -> Option<Point3<f64>> {
        let normal = (self.plane.normal + turn).normalize();
        let plane = GroundPlane { normal, ..*self.plane };
        let camera = self.camera.zoomed(log_focal.exp());
        Ray { camera: &camera, plane: &plane, ..*self }.intersection(pixel)
    }

    /// Lower edge of an outline; `None` where the pixels have no direction towards the ground.
    fn lower_edge(&self, outline: &Silhouette) -> Option<LowerEdge> {
        let count = outline.hull.len().max(1) as f64;
        let middle = Point2::from(outline.hull.iter().map(|corner| corner.coords).sum::<Vector2<f64>>() / count);
        let down = self.down(middle)?;
        let along = Vector2::new(-down.y, down.x);
        let span = |axis: Vector2<f64>| {
            let all = outline.hull.iter().map(|corner| axis.dot(&corner.coords));
            all.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| (low.min(at), high.max(at)))
        };
        let ((left, right), (top, bottom)) = (span(along), span(down));
        let border = Silhouette::BORDER_PX;
        let pixel = Point2::from(down * (bottom + border) + along * (0.5 * (left + right)));
        let size = [right - left + 2.0 * border, bottom - top + 2.0 * border];
        size.iter().all(|s| s.is_finite()).then_some(LowerEdge { pixel, down, size })
    }

    /// Direction in the image towards the ground, at a pixel.
    fn down(&self, pixel: Point2<f64>) -> Option<Vector2<f64>> {
        let ray = self.camera.normalized_from_pixel(pixel).push(1.0);
        let up = self.cam_from_world.rotation * self.plane.normal;
        let step = 1e-3 * ray.norm();
        let moved = self.camera.pixel_from_cam(Point3::from(ray - up * step))?;
        // Within a degree of the nadir every direction leads away from it; the direction to the lower edge of the image
        // is used.
        let is_steep = up.cross(&ray.normalize()).norm() < 0.02;
        if is_steep { Some(Vector2::y()) } else { (moved - pixel).try_normalize(0.0) }
    }

    /// Center of the footprint with its error; `None` where the ray of a higher pixel does not intersect the ground.
    ///
    /// * `position` – the contact with the ground on the camera's side.
    fn with_error(&self, position: Point3<f64>, edge: &LowerEdge, focal: &FocalError) -> Option<ContactPoint> {
        let LowerEdge { pixel, down, size: [width_px, height_px] } = *edge;
        let along = Vector2::new(-down.y, down.x);
        // Displacement per pixel: towards the horizon, where the error is larger, and along the edge.
        let step = 0.5;
        let away = (self.intersection(pixel - down * step)? - position) / step;
        let aside = (self.intersection(pixel + along * step)? - position) / step;
        let jacobian = Matrix3x2::from_columns(&[away, aside]);
        let [edge_px, side_px] = [height_px, width_px].map(|extent| EDGE_PX.hypot(EDGE_SHARE * extent));
        let bias_px = BIAS_PX.hypot(BIAS_SHARE * height_px);
        let line_of_sight = position - self.cam_from_world.center();
        let distance = line_of_sight.norm();
        let sinking = self.height / distance;
        // Size of a pixel across the line of sight, at the distance of the point.
        let pixel_size = distance / self.camera.mean_focal();
        let apparent_size = [width_px, height_px].map(|extent| pixel_size * extent);
        let noise: Matrix3<f64> = jacobian
            * Matrix2::from_diagonal(&Vector2::new(edge_px * edge_px, side_px * side_px))
            * jacobian.transpose();
        let level = away.try_normalize(0.0)?;
        let (depth, depth_std) = footprint::depth(apparent_size, sinking)?;
        // A higher plane moves the point towards the camera along the ray; other errors move it along the ground.
        let shift = |plane_std: f64, of_mask: f64, of_depth: f64| {
            let per_height = (1.0 - sinking * sinking).max(0.0).sqrt() / sinking;
            level * of_mask.hypot(of_depth).hypot(per_height * plane_std) - self.plane.normal * plane_std
        };
        // Errors of masks that are propagated from frame to frame persist for a while, and so do those of the view.
        let drift = shift(self.plane.own_height_std(), away.norm() * edge_px, 0.5 * depth_std);
        let common = shift(self.plane.common_height_std, away.norm() * bias_px, 0.0);
        let by_focal = match focal.turns {
            None => level * (focal.std * distance),
            Some(turns) => {
                let [shorter, longer] = [-1.0, 1.0].map(|sign| self.with_focal(pixel, sign * focal.std, turns * sign));
                // The depth of the footprint changes, too.
                0.5 * (longer? - shorter?) - level * (0.5 * depth * focal.std)
            }
        };
        let error = ContactError {
            noise: [0, 1, 2].map(|row| [0, 1, 2].map(|column| noise[(row, column)])),
            drift: drift.into(),
            common: common.into(),
            focal: by_focal.into(),
        };
        let numbers: [Vector3<f64>; 3] = [drift, common, by_focal];
        let is_finite = noise.iter().chain(numbers.iter().flat_map(|v| v.iter())).all(|x| x.is_finite());
        let position = position + level * (0.5 * depth);
        is_finite.then_some(ContactPoint { position, error, apparent_size })
    }
}
