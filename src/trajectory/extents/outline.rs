//! Outlines as tangent lines of the vehicle, without occluded ones.

use nalgebra::{Point3, Vector2, Vector3};

use crate::camera::Camera;
use crate::math::{Rigid3, quantile};
use crate::trajectory::Silhouette;

/// Line in the image that touches the vehicle's outline from one side.
#[derive(Clone, Copy, Debug)]
pub(super) struct Tangent {
    /// Unit normal of the line, away from the vehicle, in coordinates of z = 1.
    pub(super) normal: Vector2<f64>,
    /// Position of the line along the normal.
    pub(super) support: f64,
}

/// Outline in one frame.
#[derive(Clone, Debug)]
pub(super) struct OutlineView {
    /// The camera, in the vehicle's frame.
    pub(super) cam_from_vehicle: Rigid3,
    /// Lines in all directions.
    pub(super) tangents: Vec<Tangent>,
    /// Standard deviation of the position of a line, in coordinates of z = 1.
    pub(super) std: f64,
}

/// Number of directions of the tangent lines of an outline.
const DIRECTIONS: u32 = 16;

impl OutlineView {
    /// Tangent lines of a frame's outline; `None` behind the camera.
    ///
    /// Lines beyond which the vehicle's own points are located are skipped: the vehicle is occluded on that side.
    /// Without points no line is skipped.
    pub(super) fn new(
        camera: &Camera,
        cam_from_vehicle: Rigid3,
        outline: &Silhouette,
        points_in_vehicle: &[Point3<f64>],
    ) -> Option<Self> {
        let hull: Vec<Vector2<f64>> = outline.hull.iter().map(|pixel| camera.normalized_from_pixel(*pixel)).collect();
        let border = Silhouette::BORDER_PX / camera.mean_focal();
        let inside: Vec<Vector2<f64>> =
            points_in_vehicle.iter().filter_map(|p| projected(&cam_from_vehicle, p)).collect();
        let size = diameter(&hull);
        // Masks of a network or a renderer are accurate to a pixel, and a body's shape to 1.2 % of its apparent size.
        let std = camera.mean_focal().recip().hypot(0.012 * size);
        let tangents = (0..DIRECTIONS).filter_map(|k| {
            let angle = f64::from(k) * std::f64::consts::TAU / f64::from(DIRECTIONS);
            let normal = Vector2::new(angle.cos(), angle.sin());
            let support = support(&hull, &normal) + border;
            // Points of the vehicle more than two of these standard deviations outside of an outline show an occlusion.
            let is_occluded = reach(&inside, &normal).is_some_and(|reach| reach > support + 2.0 * std);
            (!is_occluded).then_some(Tangent { normal, support })
        });
        let tangents: Vec<Tangent> = tangents.collect();
        (tangents.iter().all(|tangent| tangent.support.is_finite()) && std.is_finite()).then_some(Self {
            cam_from_vehicle,
            tangents,
            std,
        })
    }

    /// Unit direction from the camera to the vehicle, in the vehicle's frame.
    pub(super) fn direction(&self) -> Vector3<f64> {
        (-self.cam_from_vehicle.center().coords).try_normalize(f64::EPSILON).unwrap_or_else(Vector3::z)
    }
}

/// Projection of a point of the vehicle, in coordinates of z = 1; `None` behind the camera.
pub(super) fn projected(cam_from_vehicle: &Rigid3, point: &Point3<f64>) -> Option<Vector2<f64>> {
    let p = *cam_from_vehicle * *point;
    (p.z > f64::EPSILON).then(|| Vector2::new(p.x / p.z, p.y / p.z))
}

/// Support of points in a direction.
pub(super) fn support(points: &[Vector2<f64>], normal: &Vector2<f64>) -> f64 {
    points.iter().map(|p| normal.dot(p)).fold(f64::NEG_INFINITY, f64::max)
}

/// Support of nearly all points in a direction, which is inside of an outline without occlusion.
fn reach(points: &[Vector2<f64>], normal: &Vector2<f64>) -> Option<f64> {
    // Share of the points that are inside of an outline without occlusion.
    quantile(&mut points.iter().map(|p| normal.dot(p)).collect::<Vec<_>>(), 0.97)
}

/// Size of a hull: the longer side of the rectangle around it.
fn diameter(hull: &[Vector2<f64>]) -> f64 {
    let along = |normal: Vector2<f64>| support(hull, &normal) + support(hull, &-normal);
    along(Vector2::x()).max(along(Vector2::y()))
}
