//! Body of a vehicle from its masks and positions on the ground, without a 3D model.
//!
//! The shapes and their fit to the outlines are those of vehicles with a model ([`template`]); positions and headings
//! are those of a ground track. Instead of points, typical proportions constrain dimensions that the outlines do not
//! determine: the height in a view from straight above. Equations: docs/maths/ground-track.md.

use std::f64::consts::PI;

use nalgebra::{Matrix3, Point3, Rotation3, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::fit::{self, Expected, Fit, Proportion, Unknowns};
use super::outline::OutlineView;
use super::{Logs, PlacedFit, Weighted, template, weight_of};
use crate::camera::Camera;
use crate::math::{Rigid3, median};
use crate::scene::{Estimate, GroundPlane};
use crate::trajectory::body::{HEIGHT_PER_WIDTH, WIDTH_PER_LENGTH, WIDTH_STD};
use crate::trajectory::{Body, Silhouette};

/// View of a vehicle in one frame, in a coordinate frame that all frames share.
#[derive(Clone, Copy, Debug)]
pub(in crate::trajectory) struct GroundView<'a> {
    pub(in crate::trajectory) camera: &'a Camera,
    pub(in crate::trajectory) cam_from_world: &'a Rigid3,
    pub(in crate::trajectory) ground: &'a GroundPlane,
    /// Approximate center of its footprint.
    pub(in crate::trajectory) position: Point3<f64>,
    pub(in crate::trajectory) outline: &'a Silhouette,
    /// The larger extent of the outline at the distance of the position.
    pub(in crate::trajectory) apparent_size: f64,
}

/// Size of a vehicle on the ground, in units of the background, and its axis if it is stationary.
///
/// Standard deviations do not include that of the distance to the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BodyOnGround {
    /// Length from rear to front; this and the next two are `None` where the outlines hardly determine them.
    pub length: Option<Estimate>,
    /// Width from side to side, without mirrors.
    pub width: Option<Estimate>,
    /// Height of its roof above the ground.
    pub height: Option<Estimate>,
    /// Unit vector along its length, and the standard deviation of its direction, radians; front and rear are not
    /// distinguished. `None` for a vehicle that moves, or is as wide as it is long.
    pub axis: Option<([f64; 3], f64)>,
    /// Part of the relative standard deviation of the length that all vehicles share: their masks have the same bias.
    pub mask_std: f64,
}

/// Maximum number of frames used: masks of the frames between have the same errors.
const MAX_FRAMES: usize = 12;
/// Width over length and height over width of a two-wheeler with its rider.
const OF_TWO_WHEELERS: [f64; 2] = [0.36, 1.9];
/// Standard deviation of the logarithm of height over width: half of the range from cars to lorries.
const HEIGHT_STD: f64 = 0.2;
/// Standard deviation of the logarithm of a dimension beyond which it counts as unobserved: half of that of a width by
/// a known length and typical proportions.
const OBSERVED: f64 = 0.15;
/// Relative standard deviation of a dimension by the mask bias common to all frames and vehicles (shadows, dark edges):
/// without it σ of lengths on seven rendered flights is 1.46 times too small.
const MASK_STD: f64 = 0.05;
/// Standard deviation of a dimension by the same bias, pixels, half of it at each edge: cars of 12 px on a drone's clip
/// have a median length of 5.3 m.
const MASK_STD_PX: f64 = 1.0;
/// Standard deviation of the heading of a moving vehicle, radians.
const MOVING_HEADING_STD: f64 = 0.05;
/// Standard deviation of the heading of a stationary vehicle from the next initial heading, radians: neighboring
/// initial headings are an eighth of a turn apart.
const START_HEADING_STD: f64 = 0.5;
/// Number of initial headings for a stationary vehicle, over half a turn.
const NUM_TURNS: u32 = 4;
/// Excess cost over the minimum up to which another solution is ambiguous: two standard deviations.
const AMBIGUOUS_COST: f64 = 4.0;
/// Angle to the best solution above which another solution is a different one, radians: larger than the errors of
/// directions.
const AMBIGUOUS_TURN: f64 = 0.35;

impl BodyOnGround {
    /// Estimates the body from all frames; `None` if too few show the vehicle.
    pub(in crate::trajectory) fn of(views: &[GroundView], body: Body) -> Option<Self> {
        let size = median(views.iter().map(|view| view.apparent_size).collect())?;
        let poses = poses(views, size)?;
        let placed: Vec<_> = views.iter().zip(&poses.all).filter_map(|(s, pose)| Some((s, pose.as_ref()?))).collect();
        let outline_view = |(view, pose): &(&GroundView, &Rigid3)| {
            OutlineView::new(view.camera, *view.cam_from_world * **pose, view.outline, &[])
        };
        let step = placed.len().div_ceil(MAX_FRAMES).max(1);
        let outline_views: Vec<OutlineView> = placed.iter().step_by(step).filter_map(outline_view).collect();
        let (weight, independent) = weight_of(&outline_views)?;
        // In views from above, detectors classify cars as buses; a box is among the bodies of cars.
        let shapes = template::of_body(if body == Body::TwoWheeler { body } else { Body::Car });
        let turns = if poses.is_stationary { NUM_TURNS } else { 1 };
        let of_shape = |shape| {
            let start = |k| expected(size, body, poses.is_stationary.then(|| PI * f64::from(k) / f64::from(turns)));
            let mut found: Vec<Fit> =
                (0..turns).filter_map(|k| fit::fit(shape, &outline_views, &start(k), weight)).map(widened).collect();
            found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
            (!found.is_empty()).then_some(found)
        };
        let by_shape: Vec<Vec<Fit>> = shapes.iter().filter_map(of_shape).collect();
        let best = by_shape.iter().min_by(|a, b| a[0].misfit.total_cmp(&b[0].misfit))?;
        let is_ambiguous = best[1..].iter().any(|other| is_different(&best[0], other));
        let of_vehicle = |found: &Vec<Fit>| PlacedFit { fit: found[0], object_from_vehicle: Rigid3::identity() };
        let weighted = Weighted::of(by_shape.iter().map(of_vehicle).collect(), independent)?;
        let logs = Logs::of(&weighted)?;
        // One pixel at the distance of the vehicle.
        let pixel = |(view, _): &(&GroundView, &Rigid3)| {
            (view.position - view.cam_from_world.center()).norm() / view.camera.mean_focal()
        };
        let pixel = median(placed.iter().map(pixel).collect())?;
        let of_masks = |size: f64| MASK_STD.hypot(MASK_STD_PX * pixel / size);
        let with_masks =
            |found: Estimate| Estimate { std: found.std.hypot(of_masks(found.value) * found.value), ..found };
        let seen = |k| logs.within(k, OBSERVED).map(with_masks);
        let (length, width) = if is_ambiguous { (None, None) } else { (seen(0), seen(1)) };
        let axis = || {
            let world_from_vehicle = placed.first()?.1;
            let (sin, cos) = best[0].value[5].sin_cos();
            let axis = world_from_vehicle.rotation * Vector3::new(cos, sin, 0.0);
            let between_shapes = weighted.mean(|fit| turn_between(fit, &best[0]).powi(2));
            Some((axis.into(), (best[0].covariance[(5, 5)] + between_shapes).sqrt()))
        };
        let axis = axis().filter(|_| poses.is_stationary && !is_ambiguous);
        Some(Self { length, width, height: seen(2), axis, mask_std: of_masks(logs.value[0].exp()) })
    }
}

/// Fit with its covariance inflated if the residuals are larger than expected.
fn widened(fit: Fit) -> Fit {
    Fit { covariance: fit.covariance * fit.misfit.max(1.0), ..fit }
}

/// Returns true if another solution has a similar cost and a different heading.
fn is_different(best: &Fit, other: &Fit) -> bool {
    other.cost < best.cost + AMBIGUOUS_COST && turn_between(best, other) > AMBIGUOUS_TURN
}

/// Angle between the axes of two solutions, radians.
fn turn_between(one: &Fit, other: &Fit) -> f64 {
    let apart = (other.value[5] - one.value[5]).rem_euclid(PI);
    apart.min(PI - apart)
}

/// Prior on size and pose, before the outlines are used.
///
/// * `turn` – initial heading of a stationary vehicle, relative to its poses.
fn expected(size: f64, body: Body, turn: Option<f64>) -> Expected {
    let shares = if body == Body::TwoWheeler { OF_TWO_WHEELERS } else { [WIDTH_PER_LENGTH, HEIGHT_PER_WIDTH] };
    let width = size * shares[0].sqrt();
    let (length, height) = (width / shares[0], width * shares[1]);
    let yaw = if turn.is_some() { START_HEADING_STD } else { MOVING_HEADING_STD };
    let proportions = [[1, 0], [2, 1]].into_iter().zip(shares).zip([WIDTH_STD, HEIGHT_STD]);
    Expected {
        value: Unknowns::from([length.ln(), width.ln(), height.ln(), 0.0, 0.0, turn.unwrap_or(0.0), 0.0]),
        // The size is nearly free, the position known to half a length.
        std: Unknowns::from([1.0, 1.0, 1.0, 0.5 * length, 0.5 * length, yaw, 0.015 * height]),
        reaches: Vec::new(),
        proportions: proportions.map(|((of, share), std)| Proportion { of, log: share.ln(), std }).collect(),
    }
}

/// Poses of the vehicle in all frames: x forward, y to the left, z up.
struct Poses {
    /// From the vehicle's frame to the common one; `None` where the heading is undetermined.
    all: Vec<Option<Rigid3>>,
    /// True for a vehicle that moves by less than its size: one position, and x is an arbitrary direction.
    is_stationary: bool,
}

fn poses(views: &[GroundView], size: f64) -> Option<Poses> {
    let first = views.first()?;
    let farthest = views.iter().map(|view| (view.position - first.position).norm()).fold(0.0, f64::max);
    let is_stationary = farthest < size;
    if !is_stationary {
        let pose =
            |k: usize| line_at(views, k, 0.5 * size).and_then(|(at, forward)| pose(at, forward, views[k].ground));
        return Some(Poses { all: (0..views.len()).map(pose).collect(), is_stationary });
    }
    let of = |k: usize| median(views.iter().map(|view| view.position[k]).collect());
    let (middle, normal) = (Point3::new(of(0)?, of(1)?, of(2)?), &first.ground.normal);
    // An arbitrary horizontal direction.
    let level = normal.cross(&Vector3::ith(normal.iamin(), 1.0));
    Some(Poses { all: vec![pose(middle, level, first.ground); views.len()], is_stationary })
}

fn pose(position: Point3<f64>, forward: Vector3<f64>, ground: &GroundPlane) -> Option<Rigid3> {
    let up = Unit::try_new(ground.normal, f64::EPSILON)?;
    let left = up.cross(&forward).try_normalize(f64::EPSILON)?;
    let columns = Matrix3::from_columns(&[left.cross(&up), left, up.into_inner()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns));
    Some(Rigid3::new(rotation, position.coords))
}

/// Position and displacement at one of the positions, by a line through those up to `reach` away on both sides.
///
/// `None` where the displacement is shorter than `reach`.
fn line_at(views: &[GroundView], k: usize, reach: f64) -> Option<(Point3<f64>, Vector3<f64>)> {
    let is_far = |other: &usize| (views[*other].position - views[k].position).norm() >= reach;
    let first = (0..k).rev().find(is_far).unwrap_or(0);
    let last = (k + 1..views.len()).find(is_far).unwrap_or(views.len() - 1);
    let near = &views[first..=last];
    let middle = 0.5 * (near.len() - 1) as f64;
    let mean = near.iter().map(|view| view.position.coords).sum::<Vector3<f64>>() / near.len() as f64;
    let steps = || (0..near.len()).map(|j| j as f64 - middle);
    let slope = near.iter().zip(steps()).map(|(view, step)| (view.position.coords - mean) * step);
    let slope = slope.sum::<Vector3<f64>>() / steps().map(|step| step * step).sum::<f64>();
    let displacement = slope * (2.0 * middle);
    let position = Point3::from(mean + slope * ((k - first) as f64 - middle));
    (displacement.norm() >= reach).then_some((position, displacement))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::PlaneBasis;

    const CAR: [f64; 3] = [4.4, 1.8, 1.5];
    const BUS: [f64; 3] = [12.0, 2.5, 3.1];

    /// Simulated views of a stationary car, or of one that drives along its length; meters and pixels.
    struct World {
        camera: Camera,
        cam_from_world: Rigid3,
        ground: GroundPlane,
        outlines: Vec<Silhouette>,
        positions: Vec<Point3<f64>>,
    }

    impl World {
        /// * `height`, `down` – of the camera: meters above the ground, and degrees below the horizon.
        /// * `shape` – index among the bodies of cars.
        /// * `step` – displacement from frame to frame of a vehicle with a `heading` in radians.
        /// * `edge_px` – enlargement of the outlines on all sides.
        fn new([height, down]: [f64; 2], shape: usize, size: [f64; 3], heading: f64, step: f64, edge_px: f64) -> Self {
            let camera = Camera::with_focal(1280, 720, 1100.0);
            let (sin, cos) = down.to_radians().sin_cos();
            // The camera faces north.
            let axes = [Vector3::x(), Vector3::new(0.0, -sin, -cos), Vector3::new(0.0, cos, -sin)];
            let rotation = Rotation3::from_matrix_unchecked(Matrix3::from_rows(&axes.map(|axis| axis.transpose())));
            let eye = Point3::new(0.0, -height * cos / sin, height);
            let cam_from_world = Rigid3::from_rotation_and_center(rotation.into(), eye);
            let ground = GroundPlane {
                normal: Vector3::z(),
                point: Point3::origin(),
                num_points: 50,
                num_inliers: 50,
                rms: 0.0,
                basis: PlaneBasis::Dominant,
                height_std: 0.0,
                common_height_std: 0.0,
                tilt_std: 0.0,
            };
            let body = template::of_body(Body::Car)[shape].corners();
            let turned = Rotation3::from_axis_angle(&Vector3::z_axis(), heading);
            let positions: Vec<_> = (0..20).map(|k| turned * Point3::new(f64::from(k - 10) * step, 0.0, 0.0)).collect();
            let outline = |at: &Point3<f64>| {
                let corners = body.iter().map(|c| *at + turned * c.component_mul(&Vector3::from(size)));
                let seen: Vec<_> = corners.filter_map(|c| camera.pixel_from_cam(cam_from_world * c)).collect();
                let middle = seen.iter().map(|p| p.coords).sum::<nalgebra::Vector2<f64>>() / seen.len() as f64;
                // The border of a mask is added to its hull.
                let wider = edge_px - Silhouette::BORDER_PX;
                let widened = seen.iter().map(|p| p + (p.coords - middle).normalize() * wider);
                Silhouette { hull: crate::trajectory::contact::convex_hull(widened.collect()) }
            };
            let outlines = positions.iter().map(outline).collect();
            Self { camera, cam_from_world, ground, outlines, positions }
        }

        /// * `off` – error of the positions.
        fn body(&self, size: f64, off: Vector3<f64>) -> BodyOnGround {
            let view = |(outline, position): (_, &Point3<f64>)| GroundView {
                camera: &self.camera,
                cam_from_world: &self.cam_from_world,
                ground: &self.ground,
                position: position + off,
                outline,
                apparent_size: size,
            };
            let views: Vec<GroundView> = self.outlines.iter().zip(&self.positions).map(view).collect();
            BodyOnGround::of(&views, Body::Long).unwrap()
        }
    }

    #[track_caller]
    fn agrees(found: Option<Estimate>, truth: f64) {
        let found = found.expect("observed");
        assert!((found.value - truth).abs() < 1.5 * found.std, "{found:?}, not {truth}");
    }

    fn angle_to(axis: [f64; 3], heading: f64) -> f64 {
        let off = (axis[1].atan2(axis[0]) - heading).rem_euclid(PI);
        off.min(PI - off)
    }

    #[test]
    fn a_stationary_car_has_length_width_and_axis_from_obliquely_and_from_above() {
        for (down, height) in [(35.0, 25.0), (60.0, 50.0), (90.0, 60.0)] {
            for heading in [0.0, 0.6, 1.3, 2.5] {
                let found =
                    World::new([height, down], 1, CAR, heading, 0.0, 0.0).body(4.5, Vector3::new(0.3, 0.5, 0.0));
                agrees(found.length, CAR[0]);
                // From the front and rear width and height are hardly separable.
                assert!(found.width.is_some() || down < 50.0);
                found.width.iter().for_each(|width| agrees(Some(*width), CAR[1]));
                let (axis, std) = found.axis.expect("at rest");
                assert!(angle_to(axis, heading) < 2.0 * std, "{down} {heading}: {axis:?} ± {std}");
            }
        }
    }

    #[test]
    fn a_moving_car_has_its_size_along_its_path_and_no_axis() {
        for heading in [0.2, 1.5] {
            for (shape, size) in [(1, CAR), (3, BUS)] {
                let found = World::new([50.0, 60.0], shape, size, heading, 1.2, 0.0).body(size[0], Vector3::zeros());
                agrees(found.length, size[0]);
                agrees(found.width, size[1]);
                assert_eq!(found.axis, None);
            }
        }
    }

    #[test]
    fn a_height_from_straight_above_is_not_observed() {
        assert_eq!(World::new([60.0, 90.0], 1, CAR, 0.3, 0.0, 0.0).body(4.5, Vector3::zeros()).height, None);
    }

    #[test]
    fn the_axis_of_a_square_is_undetermined() {
        let found = World::new([60.0, 90.0], 3, [1.9, 1.9, 1.5], 0.0, 0.0, 0.0).body(2.0, Vector3::zeros());
        assert_eq!((found.axis, found.length), (None, None));
    }

    #[test]
    fn small_masks_increase_the_std() {
        let std = |height: f64| {
            let found = World::new([height, 60.0], 1, CAR, 0.4, 0.0, 0.5).body(4.5, Vector3::zeros());
            found.length.map_or(f64::INFINITY, |length| length.std)
        };
        assert!(std(40.0) < std(100.0) && std(100.0) < std(700.0), "{} {} {}", std(40.0), std(100.0), std(700.0));
    }
}
