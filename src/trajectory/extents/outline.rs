//! Outlines as lines that touch the vehicle, and what of them is to be believed.

use nalgebra::{Point3, Vector2, Vector3};

use crate::camera::Camera;
use crate::math::{Rigid3, quantile};
use crate::trajectory::Silhouette;

/// A line of the picture that touches the vehicle's outline from one side.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch {
    /// Unit normal of the line, away from the vehicle, in coordinates of z = 1.
    pub(super) normal: Vector2<f64>,
    /// Where the line is along the normal.
    pub(super) support: f64,
}

/// One frame's outline.
#[derive(Clone, Debug)]
pub(super) struct OutlineView {
    /// The camera, in the vehicle's frame.
    pub(super) cam_from_vehicle: Rigid3,
    /// Lines all round.
    pub(super) touches: Vec<Touch>,
    /// Standard deviation of where a line is, in coordinates of z = 1.
    pub(super) std: f64,
}

/// Directions in which lines touch an outline.
const DIRECTIONS: u32 = 16;

impl OutlineView {
    /// From a frame's outline; `None` behind the camera. Lines beyond which the vehicle's own points lie are left out:
    /// something hides it on that side. Without points nothing is left out.
    pub(super) fn new(
        camera: &Camera,
        cam_from_vehicle: Rigid3,
        outline: &Silhouette,
        points_in_vehicle: &[Point3<f64>],
    ) -> Option<Self> {
        let hull: Vec<Vector2<f64>> = outline.hull.iter().map(|pixel| camera.normalized_from_pixel(*pixel)).collect();
        let border = Silhouette::BORDER_PX / camera.mean_focal();
        let inside: Vec<Vector2<f64>> = points_in_vehicle.iter().filter_map(|p| seen(&cam_from_vehicle, p)).collect();
        let size = diameter(&hull);
        // A network or a renderer draws it to a pixel, and a body's shape is known to 1.2 % of how large it looks.
        let std = camera.mean_focal().recip().hypot(0.012 * size);
        let touches = (0..DIRECTIONS).filter_map(|k| {
            let angle = f64::from(k) * std::f64::consts::TAU / f64::from(DIRECTIONS);
            let normal = Vector2::new(angle.cos(), angle.sin());
            let support = support(&hull, &normal) + border;
            // By how many of these deviations points of the vehicle may lie outside of an outline before the vehicle
            // counts as hidden there.
            let is_hidden = reach(&inside, &normal).is_some_and(|reach| reach > support + 2.0 * std);
            (!is_hidden).then_some(Touch { normal, support })
        });
        let touches: Vec<Touch> = touches.collect();
        (touches.iter().all(|touch| touch.support.is_finite()) && std.is_finite()).then_some(Self {
            cam_from_vehicle,
            touches,
            std,
        })
    }

    /// Unit direction from the camera to the vehicle, in the vehicle's frame.
    pub(super) fn direction(&self) -> Vector3<f64> {
        (-self.cam_from_vehicle.center().coords).try_normalize(f64::EPSILON).unwrap_or_else(Vector3::z)
    }
}

/// Where a point of the vehicle is seen, in coordinates of z = 1.
pub(super) fn seen(cam_from_vehicle: &Rigid3, point: &Point3<f64>) -> Option<Vector2<f64>> {
    let p = *cam_from_vehicle * *point;
    (p.z > f64::EPSILON).then(|| Vector2::new(p.x / p.z, p.y / p.z))
}

/// Support of points in a direction.
pub(super) fn support(points: &[Vector2<f64>], normal: &Vector2<f64>) -> f64 {
    points.iter().map(|p| normal.dot(p)).fold(f64::NEG_INFINITY, f64::max)
}

/// Support of nearly all points in a direction: inside of an outline that hides nothing.
fn reach(points: &[Vector2<f64>], normal: &Vector2<f64>) -> Option<f64> {
    // Share of the points that lie inside of an outline that hides nothing.
    quantile(&mut points.iter().map(|p| normal.dot(p)).collect::<Vec<_>>(), 0.97)
}

/// Size of a hull: the longer side of the rectangle around it.
fn diameter(hull: &[Vector2<f64>]) -> f64 {
    let along = |normal: Vector2<f64>| support(hull, &normal) + support(hull, &-normal);
    along(Vector2::x()).max(along(Vector2::y()))
}
