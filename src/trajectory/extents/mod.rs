//! Length, width and height of an object.
//!
//! The points of a reconstruction do not reach the ends of a vehicle, and outlines from a few sides reach beyond them.
//! A body of a vehicle's shape ([`template`]) is therefore scaled in length, width and height, translated and rotated
//! slightly until the tangents of its outline in all frames are those of the masks ([`fit`]); docs/maths/extents.md.
//! Several shapes are fitted. They are averaged with weights by their misfit, and their spread is part of the standard
//! deviations.
//!
//! Dimensions that were not visible are absent: the length of a vehicle in views from behind.

mod fit;
mod on_ground;
mod outline;
mod template;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Rotation3, SMatrix, Unit, UnitQuaternion, Vector3};

use self::fit::{Expected, Fit, NUM, Reach, Unknowns};
pub use self::on_ground::BodyOnGround;
pub(super) use self::on_ground::GroundView;
use self::outline::OutlineView;
use self::template::Template;
use super::contact::solid_points;
use super::{Body, Options, Silhouette, View, Views, forward_axis};
use crate::math::{Rigid3, centroid, median, quantile_range, symmetric_eigen};
use crate::scene::{BodyCenter, Estimate, FrameId, GroundPlane, Image, ObjectTrajectory, Reconstruction};

/// Object to measure, with its data.
#[derive(Clone, Copy, Debug)]
pub struct Subject<'a> {
    /// Its trajectory and scale ratio.
    pub trajectory: &'a ObjectTrajectory,
    /// The model to which the trajectory refers.
    pub object: &'a Reconstruction,
    /// The background's reconstruction.
    pub background: &'a Reconstruction,
    /// The local plane of each frame, in the background's frame.
    pub planes: &'a BTreeMap<FrameId, GroundPlane>,
    /// Outlines of its masks; truncated ones are absent.
    pub silhouettes: &'a BTreeMap<FrameId, Silhouette>,
    /// Options with which its scale ratio was estimated.
    pub options: &'a Options,
}

/// Size of an object, in units of the background, and its center.
///
/// `None` for a dimension that was not visible. Standard deviations are total ones, including that of the scale ratio.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Extents {
    /// Length from rear to front.
    pub length: Option<Estimate>,
    /// Width from side to side, without mirrors.
    pub width: Option<Estimate>,
    /// Height of its roof above the ground.
    pub height: Option<Estimate>,
    /// Center of the body; its covariance includes dimensions that were not visible. `None` where outlines do not
    /// determine it.
    pub center: Option<BodyCenter>,
}

/// Minimum number of frames with an outline of the object.
const MIN_VIEWS: usize = 3;
/// Standard deviations of the logarithms of length, width and height by differences from all shapes of bodies.
const SHAPE_STD: [f64; 3] = [0.02, 0.025, 0.03];

/// Measures length, width and height of an object; all are `None` without a ground plane, which gives the vertical.
pub fn extents(subject: &Subject) -> Extents {
    measured(subject).unwrap_or_default()
}

fn measured(subject: &Subject) -> Option<Extents> {
    let start = InitialBody::of(subject)?;
    let has_heading = start.has_heading;
    // Without a heading either end may be the front.
    let starts = if has_heading { vec![start] } else { vec![start.turned(), start] };
    let body = Body::of_class(&subject.trajectory.class);
    let fitted: Vec<_> = starts.iter().filter_map(|start| fits(subject, start, body, None)).collect();
    let independent = fitted.first()?.1;
    let fits = Weighted::of(fitted.into_iter().flat_map(|(fits, _)| fits).collect(), independent)?;
    let scale = &subject.trajectory.scale;
    let logs = Logs::of(&fits)?;
    let estimate = |k: usize| logs.estimate(k, scale.ratio, scale.std.unwrap_or(0.0) / scale.ratio);
    let all = Extents { length: estimate(0), width: estimate(1), height: estimate(2), center: fits.center() };
    Some(if has_heading { all } else { logs.longer_first(all) })
}

/// Weight of a line, and the number of independent lines; `None` for too few frames.
fn weight_of(outline_views: &[OutlineView]) -> Option<(f64, f64)> {
    // The sides of a vehicle's outline.
    let independent = 4.0 * num_views(outline_views) as f64;
    let num_lines: usize = outline_views.iter().map(|outline_view| outline_view.tangents.len()).sum();
    (outline_views.len() >= MIN_VIEWS).then(|| ((independent / num_lines.max(1) as f64).min(1.0), independent))
}

/// Fits bodies of all shapes that the object may have; returns them with the number of independent lines.
///
/// * `known` – body of known shape and size, if any.
///
/// `None` if too few frames show the object.
fn fits(
    subject: &Subject,
    start: &InitialBody,
    body: Body,
    known: Option<&PlacedFit>,
) -> Option<(Vec<PlacedFit>, f64)> {
    let outline_views = start.outline_views(subject);
    let (weight, independent) = weight_of(&outline_views)?;
    let mut expected = start.expected(&outline_views);
    for (known, k) in known.into_iter().flat_map(|known| (0..3).map(move |k| (known, k))) {
        expected.value[k] = known.fit.value[k];
        expected.std[k] = known.fit.covariance[(k, k)].sqrt();
    }
    let is_tried = |shape: &&'static Template| known.is_none_or(|known| std::ptr::eq(known.fit.template, *shape));
    let object_from_vehicle = start.vehicle_from_object.inverse();
    let shapes = template::of_body(body).iter().filter(is_tried);
    let fits = shapes.filter_map(|shape| fit::fit(shape, &outline_views, &expected, weight));
    Some((fits.map(|fit| PlacedFit { fit, object_from_vehicle }).collect(), independent))
}

/// Initial frame of the vehicle, and the extents of its points.
///
/// x is forward, y left, z up; the origin is on the ground below the center of the points.
#[derive(Clone, Debug)]
struct InitialBody {
    vehicle_from_object: Rigid3,
    points: Vec<Point3<f64>>,
    /// True if the motion determines the heading; otherwise x is the direction of the largest spread of the points.
    has_heading: bool,
    /// Length, width and height of the points.
    size: Vector3<f64>,
    /// Extents forward, backward, to the left and to the right.
    reach: [f64; 4],
}

impl InitialBody {
    fn of(subject: &Subject) -> Option<Self> {
        let views = Views::new(subject.background, subject.object, subject.planes, subject.options).views;
        let up = views.iter().map(|view| view.normal_in_object).sum::<Vector3<f64>>();
        let up = Unit::try_new(up, f64::EPSILON)?;
        let points = solid_points(subject.object, &subject.options.joint.contact);
        let middle = centroid(&points);
        let ratio = subject.trajectory.scale.ratio;
        // Intersection of the plane of a view with the vertical through the center.
        let below = |view: &View| -(view.camera_height / ratio + view.offset(&middle)) / view.normal_in_object.dot(&up);
        let ground = median(views.iter().map(below).filter(|z| z.is_finite()).collect())?;
        let axis = forward_axis(&subject.trajectory.poses).filter(|_| has_moved(subject, &points, &middle));
        let moved = axis.and_then(|axis| across(&axis, &up));
        let has_heading = moved.is_some();
        let forward = moved.or_else(|| longest(&points, &middle, &up))?;
        let left = up.cross(&forward);
        let rows = Matrix3::from_rows(&[forward.transpose(), left.transpose(), up.transpose()]);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows));
        let vehicle_from_object = Rigid3::new(rotation, -(rotation * (middle + up.scale(ground)).coords));
        let points: Vec<_> = points.iter().map(|p| vehicle_from_object * *p).collect();
        let spread = |k: usize| quantile_range(&mut points.iter().map(|p| p[k]).collect::<Vec<_>>(), 0.02);
        let ([x0, x1], [y0, y1], [_, top]) = (spread(0)?, spread(1)?, spread(2)?);
        // The roof is slightly above the 98 % quantile of the points.
        let (size, reach) = (Vector3::new(x1 - x0, y1 - y0, 1.025 * top), [x1, -x0, y1, -y0]);
        (top > 0.0 && size.iter().all(|s| s.is_finite())).then_some(Self {
            vehicle_from_object,
            points,
            has_heading,
            size,
            reach,
        })
    }

    /// The same with front and rear exchanged.
    fn turned(&self) -> Self {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
        let turn = Rigid3::new(turn, Vector3::zeros());
        let [front, rear, left, right] = self.reach;
        Self {
            vehicle_from_object: turn * self.vehicle_from_object,
            points: self.points.iter().map(|p| turn * *p).collect(),
            reach: [rear, front, right, left],
            ..*self
        }
    }

    /// Prior on the body, before the outlines are used.
    fn expected(&self, outline_views: &[OutlineView]) -> Expected {
        let height = self.size.z;
        // Points of one end or side do not show the opposite one: a car is 4.4 m long, 1.8 m wide and 1.5 m high.
        let (length, width) = (self.size.x.max(2.9 * height), self.size.y.max(1.2 * height));
        let yaw = if self.has_heading { 0.03 } else { 0.2 };
        let directions: Vec<Vector3<f64>> = outline_views.iter().map(OutlineView::direction).collect();
        let reach = |k: usize| {
            let (axis, side) = (k / 2, if k.is_multiple_of(2) { 1.0 } else { -1.0 });
            // Minimum cosine between the line of sight and the normal of an end whose points are visible.
            let facing = directions.iter().filter(|d| -side * d[axis] > 0.35).count();
            let is_visible = facing >= MIN_VIEWS.max(directions.len() / 10);
            // A visible end is slightly beyond the 98 % quantile of the points.
            let [at, std] = [self.reach[k] + 0.04 * height, 0.08 * height];
            Reach { axis, side, at, std, is_visible }
        };
        Expected {
            value: Unknowns::from([length.ln(), width.ln(), height.ln(), 0.0, 0.0, 0.0, 0.0]),
            // On real cars the highest points are 15 to 25 % below the roof (glass, roofs without texture), on rendered
            // ones hardly any.
            std: Unknowns::from([0.5, 0.4, 0.15, 0.5 * length, 0.5 * width, yaw, 0.015 * height]),
            reaches: (0..4).map(reach).collect(),
            proportions: Vec::new(),
        }
    }

    /// Outlines of at most 60 frames, evenly spaced.
    fn outline_views(&self, subject: &Subject) -> Vec<OutlineView> {
        let images = subject.object.images.iter();
        let seen: Vec<_> =
            images.filter_map(|(id, image)| Some((image, subject.silhouettes.get(&id.frame())?))).collect();
        // Maximum number of frames used.
        let step = seen.len().div_ceil(60).max(1);
        let outline_view = |(image, outline): &(&Image, &Silhouette)| {
            let camera = subject.object.projecting_camera(image)?;
            let cam_from_vehicle = image.cam_from_world * self.vehicle_from_object.inverse();
            OutlineView::new(camera, cam_from_vehicle, outline, &self.points)
        };
        seen.iter().step_by(step).filter_map(outline_view).collect()
    }
}

/// Returns true if the object moved farther than its size: the direction of shorter displacements is noise.
fn has_moved(subject: &Subject, points: &[Point3<f64>], middle: &Point3<f64>) -> bool {
    let poses = &subject.trajectory.poses;
    let farthest = poses.iter().filter_map(|pose| Some(pose.distance_to(poses.first()?))).fold(0.0, f64::max);
    let size = points.iter().map(|p| (p - middle).norm()).fold(0.0, f64::max);
    farthest > subject.trajectory.scale.ratio * size
}

/// Component of a direction perpendicular to another, normalized; `None` where they are nearly parallel.
fn across(axis: &Unit<Vector3<f64>>, up: &Unit<Vector3<f64>>) -> Option<Vector3<f64>> {
    (axis.into_inner() - up.scale(axis.dot(up))).try_normalize(0.1)
}

/// Direction perpendicular to `up` of the largest spread of points.
fn longest(points: &[Point3<f64>], middle: &Point3<f64>, up: &Unit<Vector3<f64>>) -> Option<Vector3<f64>> {
    let scatter = points.iter().map(|p| {
        let d = p - middle;
        let flat = d - up.scale(d.dot(up));
        flat * flat.transpose()
    });
    let eigen = symmetric_eigen(scatter.sum::<Matrix3<f64>>())?;
    let axis = Unit::try_new(eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned(), f64::EPSILON)?;
    across(&axis, up)
}

/// Number of distinct viewing directions.
fn num_views(outline_views: &[OutlineView]) -> usize {
    let mut distinct: Vec<Vector3<f64>> = Vec::new();
    for direction in outline_views.iter().map(OutlineView::direction) {
        // Closer ones are not independent.
        if distinct.iter().all(|other| other.angle(&direction) > 0.1) {
            distinct.push(direction);
        }
    }
    distinct.len().max(1)
}

/// Body fitted to the outlines of one map, and the vehicle's frame in the object's.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlacedFit {
    fit: Fit,
    object_from_vehicle: Rigid3,
}

impl PlacedFit {
    /// Best fit of a body; shape and size are those of `known` where given.
    ///
    /// `None` where the motion does not determine the heading, or too few frames show the object.
    pub(super) fn of(subject: &Subject, body: Body, known: Option<&Self>) -> Option<Self> {
        let start = InitialBody::of(subject).filter(|start| start.has_heading)?;
        let (fits, _) = fits(subject, &start, body, known)?;
        fits.into_iter().min_by(|a, b| a.fit.misfit.total_cmp(&b.fit.misfit))
    }

    /// Standard deviation of the length, relative to it.
    pub(super) fn length_std(&self) -> f64 {
        self.fit.covariance[(0, 0)].sqrt()
    }

    /// Transform from the body's frame (x forward, y left, z up, origin on the ground below its center) to the map's.
    pub(super) fn object_from_body(&self) -> Rigid3 {
        let (value, axis) = (&self.fit.value, Vector3::z_axis());
        let turned = UnitQuaternion::from_axis_angle(&axis, value[5]);
        self.object_from_vehicle * Rigid3::new(turned, Vector3::new(value[3], value[4], 0.0))
    }

    /// Center of the body in the object's frame, and its covariance.
    fn center(&self) -> (Point3<f64>, Matrix3<f64>) {
        let Fit { value, covariance, .. } = &self.fit;
        let size = [0, 1, 2].map(|k| value[k].exp());
        let mut by_unknowns = SMatrix::<f64, 3, NUM>::zeros();
        for (row, unknown) in [(0, 3), (1, 4), (2, 6)] {
            by_unknowns[(row, unknown)] = 1.0;
        }
        by_unknowns[(2, 2)] = 0.5 * size[2];
        // The error of an end moves the center by half of it.
        let of_shape = Vector3::from_fn(|k, _| (0.5 * SHAPE_STD[k] * size[k]).powi(2));
        let in_vehicle = by_unknowns * covariance * by_unknowns.transpose() + Matrix3::from_diagonal(&of_shape);
        let rotation = self.object_from_vehicle.rotation.to_rotation_matrix();
        let center = Point3::new(value[3], value[4], value[6] + 0.5 * size[2]);
        (self.object_from_vehicle * center, rotation * in_vehicle * rotation.transpose())
    }
}

/// Bodies of all shapes, weighted by their misfit.
struct Weighted {
    fits: Vec<PlacedFit>,
    /// Normalized to a sum of one.
    weights: Vec<f64>,
}

impl Weighted {
    fn of(fits: Vec<PlacedFit>, independent: f64) -> Option<Self> {
        let best = fits.iter().map(|found| found.fit.misfit).min_by(f64::total_cmp)?.max(1e-3);
        let weight = |found: &PlacedFit| (-0.5 * independent * (found.fit.misfit / best - 1.0)).exp();
        let weights: Vec<f64> = fits.iter().map(weight).collect();
        let total: f64 = weights.iter().sum();
        Some(Self { weights: weights.into_iter().map(|weight| weight / total).collect(), fits })
    }

    fn mean(&self, of: impl Fn(&Fit) -> f64) -> f64 {
        self.fits.iter().zip(&self.weights).map(|(found, weight)| weight * of(&found.fit)).sum()
    }

    fn center(&self) -> Option<BodyCenter> {
        let found: Vec<_> = self.fits.iter().map(PlacedFit::center).zip(&self.weights).collect();
        let mean: Vector3<f64> = found.iter().map(|((center, _), weight)| center.coords * **weight).sum();
        let covariance: Matrix3<f64> = found
            .iter()
            .map(|((center, covariance), weight)| {
                let off = center.coords - mean;
                (covariance + off * off.transpose()) * **weight
            })
            .sum();
        let is_finite = mean.iter().chain(&covariance).all(|x| x.is_finite());
        let rows = std::array::from_fn(|j| std::array::from_fn(|k| covariance[(j, k)]));
        is_finite.then(|| BodyCenter { in_object: mean.into(), covariance: rows })
    }
}

/// Logarithms of length, width and height, in units of the object.
#[derive(Clone, Copy, Debug)]
struct Logs {
    value: [f64; 3],
    std: [f64; 3],
}

impl Logs {
    /// Mean over all shapes, with a standard deviation that includes their spread.
    fn of(fits: &Weighted) -> Option<Self> {
        let (mut value, mut std) = ([0.0; 3], [0.0; 3]);
        for k in 0..3 {
            value[k] = fits.mean(|fit| fit.value[k]);
            let spread = fits.mean(|fit| (fit.value[k] - value[k]).powi(2));
            let noise = fits.mean(|fit| fit.covariance[(k, k)]);
            std[k] = (spread + noise + SHAPE_STD[k].powi(2)).sqrt();
        }
        value.iter().chain(&std).all(|x| x.is_finite()).then_some(Self { value, std })
    }

    /// Estimate in units of the background; `None` where its uncertainty shows that it was not visible.
    fn estimate(&self, k: usize, ratio: f64, scale_std: f64) -> Option<Estimate> {
        let Estimate { value, std } = self.within(k, 0.1)?;
        let (value, std) = (ratio * value, ratio * std.hypot(value * scale_std));
        (value.is_finite() && std.is_finite()).then_some(Estimate { value, std })
    }

    /// Estimate in units of the object; `None` where its relative standard deviation exceeds a limit.
    fn within(&self, k: usize, limit: f64) -> Option<Estimate> {
        let value = self.value[k].exp();
        (self.std[k] < limit).then_some(Estimate { value, std: value * self.std[k] })
    }

    /// Assignment of length and width without a heading: the longer side is the length, if the difference is clear.
    fn longer_first(&self, all: Extents) -> Extents {
        let difference = self.value[0] - self.value[1];
        // Extents that differ by more standard deviations are not equal.
        let is_clear = difference.abs() > 2.0 * self.std[0].hypot(self.std[1]);
        match (is_clear, difference > 0.0) {
            (true, true) => all,
            (true, false) => Extents { length: all.width, width: all.length, ..all },
            (false, _) => Extents { length: None, width: None, ..all },
        }
    }
}
