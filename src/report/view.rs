//! The frame of the 3D view: the scene rotated upright, centered and normalized in size.
//!
//! The view's frame is y up, x along the main direction of the drive, z towards the viewer; its origin is the center
//! of the camera path and the trajectories, and their radius is [`RADIUS`]. All bounds are quantiles, so that a few
//! points or one lost camera far away do not shrink the scene.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use super::data::{Data, Object};
use super::metres;
use crate::math::{self, Rigid3, Sim3, centroid, is_finite, symmetric_eigen};
use crate::scene::{Point3d, Reconstruction};

/// Radius of camera path and trajectories in the view's frame.
pub(super) const RADIUS: f64 = 10.0;
/// Maximum extent of the shown volume from the center, in radii.
pub(super) const MAX_REACH: f64 = 40.0;

/// The transform into the view's frame, with the measured extents.
#[derive(Clone, Debug)]
pub(super) struct View {
    pub view_from_world: Sim3,
    /// Maximum distance of shown points from the center.
    pub reach: f64,
    /// Height of the ground in the view's frame.
    pub ground: f64,
    /// Source of the upward direction, for the reader.
    pub up_source: &'static str,
}

impl View {
    /// The view of a run's data; `None` if nothing was reconstructed.
    pub fn new(data: &Data) -> Option<Self> {
        let background = data.background.reconstruction;
        let centers = centers(background)?;
        let view = Self::around(background, &focus(data, &centers), up(data), centers[0]);
        Some(Self { ground: ground_height(data, &view.view_from_world), ..view })
    }

    /// The view of a bare reconstruction; `None` if nothing is registered.
    pub fn of_model(model: &Reconstruction) -> Option<Self> {
        let centers = centers(model)?;
        let up = (mean_camera_up(model), "mean upward axis of the cameras");
        let view = Self::around(model, &centers, up, centers[0]);
        Some(Self { ground: low_height(model, &view.view_from_world), ..view })
    }

    /// * `focus` – points that the initial view contains.
    /// * `up` – unit vector away from the ground, and its source.
    /// * `place` – a camera's position.
    fn around(
        background: &Reconstruction,
        focus: &[Point3<f64>],
        (up, up_source): (Vector3<f64>, &'static str),
        place: Point3<f64>,
    ) -> Self {
        let forward: Vector3<f64> =
            background.images.values().map(|i| i.cam_from_world.rotation.inverse() * Vector3::z()).sum();
        let rotation = upright(up, focus, forward);
        let turned: Vec<_> = focus.iter().map(|p| rotation * p).collect();
        let (middle, mut radius) = bounds(&turned);
        if !(radius > 0.0) {
            // A stationary camera and no trajectory: the observed points give the size.
            let distances = background.points.values().map(|p| (p.position - place).norm());
            radius = quantile(&mut distances.filter(|d| d.is_finite()).collect::<Vec<_>>(), 0.5).max(1e-9);
        }
        let scale = RADIUS / radius;
        let view_from_world = Sim3::new(scale, rotation, -middle.coords * scale);
        let reach = reach(background, &view_from_world);
        Self { view_from_world, reach, ground: 0.0, up_source }
    }

    /// A camera: its center, and `view_from_cam` as w x y z.
    pub fn camera(&self, cam_from_world: &Rigid3) -> [f64; 7] {
        let [x, y, z] = self.point(cam_from_world.center());
        let q = self.view_from_world.rotation * cam_from_world.rotation.inverse();
        [x, y, z, rounded(q.w), rounded(q.i), rounded(q.j), rounded(q.k)]
    }

    pub fn point(&self, world: Point3<f64>) -> [f64; 3] {
        (self.view_from_world * world).coords.map(rounded).into()
    }
}

/// The positions of the cameras; `None` without any.
fn centers(model: &Reconstruction) -> Option<Vec<Point3<f64>>> {
    let centers: Vec<_> = model.images.values().map(|i| i.cam_from_world.center()).filter(is_finite).collect();
    (!centers.is_empty()).then_some(centers)
}

/// Points that the initial view contains: camera centers and trusted trajectories (all, if none is).
fn focus(data: &Data, centers: &[Point3<f64>]) -> Vec<Point3<f64>> {
    let positions = |object: &Object| -> Vec<Point3<f64>> {
        object.trajectory.iter().flat_map(|t| &t.poses).map(|p| Point3::from(p.position)).filter(is_finite).collect()
    };
    let sure = |o: &&Object| o.trajectory.is_some_and(|t| !t.is_ruled_out());
    let mut moving: Vec<_> = data.objects.iter().filter(sure).flat_map(positions).collect();
    let contacts = data.objects.iter().filter_map(|o| o.ground_track).flat_map(|track| &track.positions);
    moving.extend(contacts.map(|at| Point3::from(at.position)).filter(is_finite));
    if moving.is_empty() {
        moving = data.objects.iter().flat_map(positions).collect();
    }
    moving.extend(centers);
    moving
}

/// Unit vector away from the ground, and its source.
fn up(data: &Data) -> (Vector3<f64>, &'static str) {
    let background = data.background.reconstruction;
    if let Some(ground) = data.ground {
        let sum: Vector3<f64> = ground.planes.values().map(|p| p.normal).sum();
        if sum.norm() > 0.5 * ground.planes.len() as f64 && sum.norm() > 0.0 {
            return (sum.normalize(), "mean normal of the local ground planes");
        }
        let points: Vec<_> = ground.point_ids.iter().filter_map(|id| background.points.get(id)).collect();
        if let Some(normal) = plane_normal(&points) {
            let camera = mean_camera_up(background);
            let side = if normal.dot(&camera) < 0.0 { -normal } else { normal };
            return (side, "plane through the ground points");
        }
    }
    match data.metric.and_then(metres::frame).filter(|frame| frame.origin.is_some()) {
        Some(frame) => (frame.metric_from_world().rotation.inverse() * Vector3::z(), "vertical of the map"),
        None => (mean_camera_up(background), "mean upward axis of the cameras"),
    }
}

/// Mean of the cameras' −y axes, in the world.
fn mean_camera_up(background: &Reconstruction) -> Vector3<f64> {
    let sum: Vector3<f64> =
        background.images.values().map(|i| i.cam_from_world.rotation.inverse() * -Vector3::y()).sum();
    sum.try_normalize(1e-9).unwrap_or_else(|| -Vector3::y())
}

/// Direction of least variance of a set of points; `None` for fewer than ten.
fn plane_normal(points: &[&Point3d]) -> Option<Vector3<f64>> {
    let positions: Vec<_> = points.iter().map(|p| p.position).filter(is_finite).collect();
    if positions.len() < 10 {
        return None;
    }
    let middle = centroid(&positions);
    let spread: Matrix3<f64> = positions.iter().map(|p| p - middle).map(|v| v * v.transpose()).sum();
    let eigen = symmetric_eigen(spread)?;
    let least = eigen.eigenvalues.imin();
    eigen.eigenvectors.column(least).into_owned().try_normalize(1e-12)
}

/// The rotation that takes `up` to +y and the main horizontal direction of the focus to ±x, such that the cameras look
/// away from the viewer.
fn upright(up: Vector3<f64>, focus: &[Point3<f64>], forward: Vector3<f64>) -> UnitQuaternion<f64> {
    let middle = centroid(focus);
    let flat = |v: Vector3<f64>| v - up * up.dot(&v);
    let spread: Matrix3<f64> = focus.iter().map(|p| flat(p - middle)).map(|v| v * v.transpose()).sum();
    let longest = symmetric_eigen(spread).map(|eigen| eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned());
    let main = longest.map_or(Vector3::zeros(), flat);
    let any = flat(if up.x.abs() < 0.7 { Vector3::x() } else { Vector3::z() });
    let mut x = if main.norm() > 1e-6 { main.normalize() } else { any.normalize() };
    let mut z = x.cross(&up);
    if forward.dot(&z) > 0.0 {
        (x, z) = (-x, -z);
    }
    let rows = Matrix3::from_rows(&[x.transpose(), up.transpose(), z.transpose()]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows))
}

/// Center and radius of the box between the 2nd and the 98th percentile of each coordinate.
fn bounds(points: &[Point3<f64>]) -> (Point3<f64>, f64) {
    let mut middle = Point3::origin();
    let mut half = Vector3::zeros();
    for k in 0..3 {
        let mut values: Vec<_> = points.iter().map(|p| p[k]).collect();
        let (low, high) = (quantile(&mut values, 0.02), quantile(&mut values, 0.98));
        middle[k] = (low + high) / 2.0;
        half[k] = (high - low) / 2.0;
    }
    (middle, half.norm())
}

/// A quantile, nearest rank; 0 for no values.
pub(super) fn quantile(values: &mut [f64], q: f64) -> f64 {
    math::quantile(values, q).unwrap_or(0.0)
}

/// Radius of the shown volume: it contains most of the points, without those at the horizon.
fn reach(background: &Reconstruction, view_from_world: &Sim3) -> f64 {
    let distances = background.points.values().map(|p| (*view_from_world * p.position).coords.norm());
    let most = quantile(&mut distances.filter(|d| d.is_finite()).collect::<Vec<_>>(), 0.95);
    (1.3 * most).clamp(3.0 * RADIUS, MAX_REACH * RADIUS)
}

/// Median height of the known ground, else the 10th percentile of all points.
fn ground_height(data: &Data, view_from_world: &Sim3) -> f64 {
    let background = data.background.reconstruction;
    let height = |p: Point3<f64>| (*view_from_world * p).y;
    let mut known: Vec<f64> = match data.ground {
        Some(g) if !g.planes.is_empty() => g.planes.values().map(|p| height(p.point)).collect(),
        Some(g) => g.point_ids.iter().filter_map(|id| background.points.get(id)).map(|p| height(p.position)).collect(),
        None => Vec::new(),
    };
    known.retain(|h| h.is_finite());
    if !known.is_empty() {
        return quantile(&mut known, 0.5);
    }
    low_height(background, view_from_world)
}

/// The 10th percentile of the heights of all points nearby.
fn low_height(model: &Reconstruction, view_from_world: &Sim3) -> f64 {
    let near = model.points.values().map(|p| *view_from_world * p.position);
    let mut all: Vec<_> = near.filter(|p| p.coords.norm() < 3.0 * RADIUS).map(|p| p.y).collect();
    quantile(&mut all, 0.1)
}

/// Rounds to five decimals: a hundredth of a pixel on any screen.
pub(super) fn rounded(v: f64) -> f64 {
    (v * 1e5).round() / 1e5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;
    use crate::scene::{ImageId, MapOrigin};
    use crate::synthetic::showcase::showcase;

    #[test]
    fn one_lost_camera_does_not_move_the_view() {
        let mut world = testing::world();
        let before = View::new(&world.data()).unwrap();
        world.background.images.get_mut(&ImageId(5)).unwrap().cam_from_world.translation *= 1e6;
        let after = View::new(&world.data()).unwrap();
        let ratio = after.view_from_world.scale / before.view_from_world.scale;
        assert!((0.5..2.0).contains(&ratio), "{ratio}");
    }

    #[test]
    fn photographs_taken_straight_down_are_upright_by_their_positions() {
        let (world, mut metric) = (testing::world(), showcase(4, 1).metric);
        let frame = metric.frame.as_mut().unwrap();
        frame.rotation_wxyz = [0.8, 0.6, 0.0, 0.0];
        frame.origin = Some(MapOrigin { longitude: 8.5, latitude: 47.3, height_m: 0.0, knows_height: false });
        let up = frame.metric_from_world().rotation.inverse() * Vector3::z();
        let view = View::new(&Data { ground: None, metric: Some(&metric), ..world.data() }).unwrap();
        assert!((view.view_from_world.rotation * up - Vector3::y()).norm() < 1e-9);
    }

    #[test]
    fn an_empty_run_has_no_view() {
        let mut world = testing::world();
        world.background = Reconstruction::default();
        assert!(View::new(&world.data()).is_none());
    }
}
