//! The body of a vehicle of which only masks and places on the ground are known, below a camera of any kind.
//!
//! The bodies are those of models ([`template`]), and so is their fit to the outlines; places and headings are those
//! of a ground track. Without points, usual proportions complete what outlines leave open, such as the height from
//! straight above.
//! docs/maths/ground-track.md has the equations.

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

/// A vehicle in one frame, in a frame of reference that all frames share.
#[derive(Clone, Copy, Debug)]
pub(in crate::trajectory) struct Stand<'a> {
    pub(in crate::trajectory) camera: &'a Camera,
    pub(in crate::trajectory) cam_from_world: &'a Rigid3,
    pub(in crate::trajectory) ground: &'a GroundPlane,
    /// Approximate middle of its footprint.
    pub(in crate::trajectory) position: Point3<f64>,
    pub(in crate::trajectory) outline: &'a Silhouette,
    /// The larger extent of the outline at the distance of the position.
    pub(in crate::trajectory) apparent_size: f64,
}

/// Size of a vehicle on the ground, in units of the background, and how it is turned where it does not move. Standard
/// deviations are without that of the distance to the camera.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BodyOnGround {
    /// Between its ends; this and the next two are `None` where outlines hardly show them.
    pub length: Option<Estimate>,
    /// Between its sides, without mirrors.
    pub width: Option<Estimate>,
    /// Of its roof above the ground.
    pub height: Option<Estimate>,
    /// Unit vector along its length, and the standard deviation of its direction, radians; front and rear are not
    /// distinguished. `None` of a vehicle that moves, or is as wide as it is long.
    pub axis: Option<([f64; 3], f64)>,
    /// The part of the standard deviation of the length, as a share of it, that all vehicles have in common: their
    /// masks are too large or too small alike.
    pub mask_std: f64,
}

/// Maximum number of frames used: masks of the frames between have the same errors.
const MAX_FRAMES: usize = 12;
/// Width over length and height over width of a two-wheeler with its rider.
const OF_TWO_WHEELERS: [f64; 2] = [0.36, 1.9];
/// Standard deviation of the logarithm of height over width: half of the range from cars to lorries.
const HEIGHT_STD: f64 = 0.2;
/// Standard deviation of the logarithm of a dimension beyond which it counts as unobserved: half of that of a width by
/// a known length and usual proportions.
const OBSERVED: f64 = 0.15;
/// Standard deviation of a dimension by masks that are too large or too small in all frames, and of all vehicles
/// (shadows, dark edges), as a share of it: without it σ of lengths on seven rendered flights is 1.46 times too small.
const MASK_STD: f64 = 0.05;
/// Standard deviation of a dimension by the same masks, pixels, half of one at each edge: cars of 12 px on a drone's
/// clip are 5.3 m long in the median.
const MASK_STD_PX: f64 = 1.0;
/// Standard deviation of the heading of a moving vehicle, radians.
const MOVING_HEADING_STD: f64 = 0.05;
/// Standard deviation of the heading of a vehicle at rest from the next start, radians: a quarter of a turn is shared
/// by two.
const START_HEADING_STD: f64 = 0.5;
/// Number of starts for a vehicle at rest, over half a turn.
const NUM_TURNS: u32 = 4;
/// Cost over the least one up to which another answer is as good: two standard deviations.
const AMBIGUOUS_COST: f64 = 4.0;
/// Turn from the best answer above which another answer is a different one, radians: more than a direction is off.
const AMBIGUOUS_TURN: f64 = 0.35;

impl BodyOnGround {
    /// From all frames; `None` where too few show the vehicle.
    pub(in crate::trajectory) fn of(stands: &[Stand], body: Body) -> Option<Self> {
        let size = median(stands.iter().map(|stand| stand.apparent_size).collect())?;
        let places = places(stands, size)?;
        let placed: Vec<_> =
            stands.iter().zip(&places.all).filter_map(|(s, place)| Some((s, place.as_ref()?))).collect();
        let sight = |(stand, place): &(&Stand, &Rigid3)| {
            OutlineView::new(stand.camera, *stand.cam_from_world * **place, stand.outline, &[])
        };
        let step = placed.len().div_ceil(MAX_FRAMES).max(1);
        let sights: Vec<OutlineView> = placed.iter().step_by(step).filter_map(sight).collect();
        let (weight, independent) = weight_of(&sights)?;
        // From above, detectors take a car for a bus; a box is among the bodies of cars.
        let shapes = template::of_body(if body == Body::TwoWheeler { body } else { Body::Car });
        let turns = if places.are_at_rest { NUM_TURNS } else { 1 };
        let of_shape = |shape| {
            let start = |k| expected(size, body, places.are_at_rest.then(|| PI * f64::from(k) / f64::from(turns)));
            let mut found: Vec<Fit> =
                (0..turns).filter_map(|k| fit::fit(shape, &sights, &start(k), weight)).map(widened).collect();
            found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
            (!found.is_empty()).then_some(found)
        };
        let by_shape: Vec<Vec<Fit>> = shapes.iter().filter_map(of_shape).collect();
        let best = by_shape.iter().min_by(|a, b| a[0].misfit.total_cmp(&b[0].misfit))?;
        let is_ambiguous = best[1..].iter().any(|other| is_other(&best[0], other));
        let of_vehicle = |found: &Vec<Fit>| PlacedFit { fit: found[0], object_from_vehicle: Rigid3::identity() };
        let weighted = Weighted::of(by_shape.iter().map(of_vehicle).collect(), independent)?;
        let logs = Logs::of(&weighted)?;
        // One pixel at the distance of the vehicle.
        let pixel = |(stand, _): &(&Stand, &Rigid3)| {
            (stand.position - stand.cam_from_world.center()).norm() / stand.camera.mean_focal()
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
        let axis = axis().filter(|_| places.are_at_rest && !is_ambiguous);
        Some(Self { length, width, height: seen(2), axis, mask_std: of_masks(logs.value[0].exp()) })
    }
}

/// The covariance grows where residuals are larger than expected.
fn widened(fit: Fit) -> Fit {
    Fit { covariance: fit.covariance * fit.misfit.max(1.0), ..fit }
}

/// Returns true if another answer is about as good and turned otherwise.
fn is_other(best: &Fit, other: &Fit) -> bool {
    other.cost < best.cost + AMBIGUOUS_COST && turn_between(best, other) > AMBIGUOUS_TURN
}

/// Angle between the axes of two answers, radians.
fn turn_between(one: &Fit, other: &Fit) -> f64 {
    let apart = (other.value[5] - one.value[5]).rem_euclid(PI);
    apart.min(PI - apart)
}

/// Expected size and place before outlines are used.
///
/// * `turn` – against the places, of a vehicle at rest.
fn expected(size: f64, body: Body, turn: Option<f64>) -> Expected {
    let shares = if body == Body::TwoWheeler { OF_TWO_WHEELERS } else { [WIDTH_PER_LENGTH, HEIGHT_PER_WIDTH] };
    let width = size * shares[0].sqrt();
    let (length, height) = (width / shares[0], width * shares[1]);
    let yaw = if turn.is_some() { START_HEADING_STD } else { MOVING_HEADING_STD };
    let proportions = [[1, 0], [2, 1]].into_iter().zip(shares).zip([WIDTH_STD, HEIGHT_STD]);
    Expected {
        value: Unknowns::from([length.ln(), width.ln(), height.ln(), 0.0, 0.0, turn.unwrap_or(0.0), 0.0]),
        // The size is open, the place half a length.
        std: Unknowns::from([1.0, 1.0, 1.0, 0.5 * length, 0.5 * length, yaw, 0.015 * height]),
        reaches: Vec::new(),
        proportions: proportions.map(|((of, share), std)| Proportion { of, log: share.ln(), std }).collect(),
    }
}

/// Where the vehicle is in every frame: its frame has x forward, y to the left and z upwards.
struct Places {
    /// From the vehicle's frame to the common one; `None` where nothing shows the heading.
    all: Vec<Option<Rigid3>>,
    /// True of a vehicle that does not move by its size: one place, and x is any direction.
    are_at_rest: bool,
}

fn places(stands: &[Stand], size: f64) -> Option<Places> {
    let first = stands.first()?;
    let furthest = stands.iter().map(|stand| (stand.position - first.position).norm()).fold(0.0, f64::max);
    let are_at_rest = furthest < size;
    if !are_at_rest {
        let place = |k: usize| line_at(stands, k, 0.5 * size).and_then(|(at, way)| place(at, way, stands[k].ground));
        return Some(Places { all: (0..stands.len()).map(place).collect(), are_at_rest });
    }
    let of = |k: usize| median(stands.iter().map(|stand| stand.position[k]).collect());
    let (middle, normal) = (Point3::new(of(0)?, of(1)?, of(2)?), &first.ground.normal);
    // Any level direction.
    let level = normal.cross(&Vector3::ith(normal.iamin(), 1.0));
    Some(Places { all: vec![place(middle, level, first.ground); stands.len()], are_at_rest })
}

fn place(position: Point3<f64>, forward: Vector3<f64>, ground: &GroundPlane) -> Option<Rigid3> {
    let up = Unit::try_new(ground.normal, f64::EPSILON)?;
    let left = up.cross(&forward).try_normalize(f64::EPSILON)?;
    let columns = Matrix3::from_columns(&[left.cross(&up), left, up.into_inner()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns));
    Some(Rigid3::new(rotation, position.coords))
}

/// Place and displacement at one of the positions, by a line through those up to `reach` away on both sides; `None`
/// where they are no further apart.
fn line_at(stands: &[Stand], k: usize, reach: f64) -> Option<(Point3<f64>, Vector3<f64>)> {
    let is_far = |other: &usize| (stands[*other].position - stands[k].position).norm() >= reach;
    let first = (0..k).rev().find(is_far).unwrap_or(0);
    let last = (k + 1..stands.len()).find(is_far).unwrap_or(stands.len() - 1);
    let near = &stands[first..=last];
    let middle = 0.5 * (near.len() - 1) as f64;
    let mean = near.iter().map(|stand| stand.position.coords).sum::<Vector3<f64>>() / near.len() as f64;
    let steps = || (0..near.len()).map(|j| j as f64 - middle);
    let slope = near.iter().zip(steps()).map(|(stand, step)| (stand.position.coords - mean) * step);
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

    /// A camera so many metres high looks down so many degrees at a car that stands still, or drives along its length;
    /// metres and pixels.
    struct World {
        camera: Camera,
        cam_from_world: Rigid3,
        ground: GroundPlane,
        outlines: Vec<Silhouette>,
        positions: Vec<Point3<f64>>,
    }

    impl World {
        /// * `step` – forward from frame to frame, of a vehicle that is turned by `heading` radians.
        /// * `edge_px` – the outlines are so much wider on all sides.
        /// * `shape` – among the bodies of cars.
        fn new([height, down]: [f64; 2], shape: usize, size: [f64; 3], heading: f64, step: f64, edge_px: f64) -> Self {
            let camera = Camera::with_focal(1280, 720, 1100.0);
            let (sin, cos) = down.to_radians().sin_cos();
            // Looks north.
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
            let stand = |(outline, position): (_, &Point3<f64>)| Stand {
                camera: &self.camera,
                cam_from_world: &self.cam_from_world,
                ground: &self.ground,
                position: position + off,
                outline,
                apparent_size: size,
            };
            let stands: Vec<Stand> = self.outlines.iter().zip(&self.positions).map(stand).collect();
            BodyOnGround::of(&stands, Body::Long).unwrap()
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
    fn a_parked_car_has_length_width_and_axis_from_obliquely_and_from_above() {
        for (down, height) in [(35.0, 25.0), (60.0, 50.0), (90.0, 60.0)] {
            for heading in [0.0, 0.6, 1.3, 2.5] {
                let found =
                    World::new([height, down], 1, CAR, heading, 0.0, 0.0).body(4.5, Vector3::new(0.3, 0.5, 0.0));
                agrees(found.length, CAR[0]);
                // From ahead and behind hardly anything separates width and height.
                assert!(found.width.is_some() || down < 50.0);
                found.width.iter().for_each(|width| agrees(Some(*width), CAR[1]));
                let (axis, std) = found.axis.expect("at rest");
                assert!(angle_to(axis, heading) < 2.0 * std, "{down} {heading}: {axis:?} ± {std}");
            }
        }
    }

    #[test]
    fn a_car_that_drives_has_its_size_along_its_way_and_no_axis() {
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
    fn the_axis_of_a_square_is_open() {
        let found = World::new([60.0, 90.0], 3, [1.9, 1.9, 1.5], 0.0, 0.0, 0.0).body(2.0, Vector3::zeros());
        assert_eq!((found.axis, found.length), (None, None));
    }

    #[test]
    fn small_masks_show_less() {
        let std = |height: f64| {
            let found = World::new([height, 60.0], 1, CAR, 0.4, 0.0, 0.5).body(4.5, Vector3::zeros());
            found.length.map_or(f64::INFINITY, |length| length.std)
        };
        assert!(std(40.0) < std(100.0) && std(100.0) < std(700.0), "{} {} {}", std(40.0), std(100.0), std(700.0));
    }
}
