//! Path of a vehicle over the ground, from approximate planes.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use serde::Serialize;

use crate::math::{centroid, is_finite, median, quantile_range};
use crate::scene::{FrameId, GroundPlane, Image, Reconstruction};

/// Position of the vehicle in one frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct VehiclePosition {
    pub frame: FrameId,
    /// Point on the ground below the centroid of its model's points.
    pub ground_point: Point3<f64>,
    /// Unit normal of the ground, to the camera's side.
    pub up: Vector3<f64>,
    /// Direction of the path, a unit vector parallel to the ground; `None` where the vehicle hardly moves.
    pub along: Option<Vector3<f64>>,
    /// Height of the camera over the ground.
    pub camera_height: f64,
    /// Size of a pixel at the vehicle, in units of the background.
    pub pixel: f64,
}

/// Assumptions about a vehicle's shape (`scale.joint.contact`).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BodyShape {
    /// Ground clearance of a vehicle's lowest points, as a share of the range of heights of its points.
    pub clearance: f64,
    /// Median absolute deviations from the median beyond which a point is an outlier.
    pub max_deviation: f64,
}

#[cfg(test)]
pub(super) const SHAPE: BodyShape = BodyShape { clearance: 0.17, max_deviation: 6.0 };

/// Positions of a vehicle in the background's frame, with its width and height.
#[derive(Clone, Debug)]
pub(super) struct VehicleTrajectory {
    /// Positions, ascending by frame.
    pub positions: Vec<VehiclePosition>,
    /// Lateral range that the vehicle covers to the left of its path, minimum and maximum, in units of the background.
    pub band: [f64; 2],
    /// Height of the vehicle, in units of the background.
    pub height: f64,
}

impl VehicleTrajectory {
    /// Path of an object over the given planes.
    ///
    /// `None` if it does not move by more than about its own length, or if its model has too few points.
    pub(super) fn of(
        background: &Reconstruction,
        model: &Reconstruction,
        planes: &BTreeMap<FrameId, GroundPlane>,
        min_track: usize,
        shape: &BodyShape,
    ) -> Option<Self> {
        let paired = background.paired_images(model).into_iter();
        let frames: Vec<SharedFrame> = paired
            .filter_map(|(frame, image, own)| Some(SharedFrame { frame, image, own, plane: planes.get(&frame)? }))
            .collect();
        let up = frames.iter().map(SharedFrame::up_in_model).sum::<Vector3<f64>>().try_normalize(1e-9)?;
        let body = Body::of(model, up, min_track, shape)?;
        let ratios = frames.iter().map(|shared| shared.ratio(&body));
        let ratio = median(ratios.filter(|r| r.is_finite() && *r > 0.0).collect())?;
        let height = ratio * body.height;
        let ground_point = body.ground_point();
        let mut positions: Vec<VehiclePosition> =
            frames.iter().map(|shared| shared.position(background, &ground_point, ratio)).collect();
        let ground_points: Vec<Point3<f64>> = positions.iter().map(|position| position.ground_point).collect();
        for (k, position) in positions.iter_mut().enumerate() {
            // Over two vehicle heights in both directions.
            position.along = direction(&ground_points, k, 2.0 * height).and_then(|d| level(&d, &position.up));
        }
        // Minimum width of the band, in heights of the vehicle.
        let band = at_least_as_wide(lateral_range(&frames, &positions, &body, ratio)?, 0.6 * height);
        let is_known = height.is_finite() && ground_points.iter().all(is_finite);
        is_known.then_some(Self { positions, band, height })
    }

    /// Returns true if the vehicle passes over a point near one of its positions, within `reach` along the path.
    pub(super) fn covers(&self, position: &VehiclePosition, point: &Point3<f64>, reach: f64) -> bool {
        let (Some(along), Some(left)) = (position.along, position.left()) else { return false };
        let offset = point - position.ground_point;
        let is_level = position.up.dot(&offset).abs() <= self.height;
        (self.band[0]..=self.band[1]).contains(&left.dot(&offset)) && along.dot(&offset).abs() <= reach && is_level
    }
}

impl VehiclePosition {
    /// Unit vector parallel to the ground, to the left of the path.
    pub(super) fn left(&self) -> Option<Vector3<f64>> {
        Some(self.up.cross(&self.along?))
    }
}

/// Frame that is registered in both models, with its plane.
#[derive(Clone, Copy)]
struct SharedFrame<'a> {
    frame: FrameId,
    /// Image of the background.
    image: &'a Image,
    /// Image of the vehicle's model.
    own: &'a Image,
    plane: &'a GroundPlane,
}

impl SharedFrame<'_> {
    /// Normal of the plane in the vehicle's frame.
    fn up_in_model(&self) -> Vector3<f64> {
        self.own.cam_from_world.rotation.inverse() * (self.image.cam_from_world.rotation * self.plane.normal)
    }

    fn camera_height(&self) -> f64 {
        self.plane.signed_distance(self.image.cam_from_world.center())
    }

    /// Scale of the model at which the camera heights over the model's ground and over the plane are equal.
    fn ratio(&self, body: &Body) -> f64 {
        self.camera_height() / (self.own.cam_from_world.center().coords.dot(&body.up) - body.ground)
    }

    /// Point of the vehicle at a scale, in the background's frame.
    fn in_background(&self, point: &Point3<f64>, ratio: f64) -> Point3<f64> {
        self.image.cam_from_world.inverse() * Point3::from((self.own.cam_from_world * *point).coords * ratio)
    }

    /// Position of the vehicle, without its direction.
    fn position(&self, background: &Reconstruction, ground_point: &Point3<f64>, ratio: f64) -> VehiclePosition {
        let ground_point = self.in_background(ground_point, ratio);
        let distance = (ground_point - self.image.cam_from_world.center()).norm();
        VehiclePosition {
            frame: self.frame,
            ground_point,
            up: self.plane.normal,
            along: None,
            camera_height: self.camera_height(),
            pixel: distance / background.camera_of(self.image).mean_focal(),
        }
    }
}

/// Lateral range that the vehicle covers to the left of its path; `None` where it hardly moves.
fn lateral_range(frames: &[SharedFrame], positions: &[VehiclePosition], body: &Body, ratio: f64) -> Option<[f64; 2]> {
    let moving: Vec<_> = frames
        .iter()
        .zip(positions)
        .filter_map(|(shared, position)| Some((shared, position.ground_point, position.left()?)))
        .collect();
    // Minimum number of positions in which the vehicle moves.
    if moving.len() < 5 {
        return None;
    }
    // The width is measured at up to about fifty of them.
    let measured = moving.iter().step_by(moving.len().div_ceil(50)).filter_map(|(shared, ground_point, left)| {
        let lateral = |point: &Point3<f64>| left.dot(&(shared.in_background(point, ratio) - ground_point));
        body.extent(lateral)
    });
    let (least, most): (Vec<f64>, Vec<f64>) = measured.unzip();
    Some([median(least)?, median(most)?])
}

/// Dimensions of a vehicle's model, in the model's frame.
struct Body {
    points: Vec<Point3<f64>>,
    up: Vector3<f64>,
    /// Approximate height of the ground along `up`.
    ground: f64,
    /// Height over the ground.
    height: f64,
}

impl Body {
    fn of(model: &Reconstruction, up: Vector3<f64>, min_track: usize, shape: &BodyShape) -> Option<Self> {
        let points = model.solid_points(min_track, shape.max_deviation);
        // Fewer points do not determine the shape.
        if points.len() < 10 {
            return None;
        }
        let mut heights: Vec<f64> = points.iter().map(|p| up.dot(&p.coords)).collect();
        let [low, high] = quantile_range(&mut heights, 0.01)?;
        let ground = low - shape.clearance * (high - low);
        (high > low).then_some(Self { points, up, ground, height: high - ground })
    }

    /// Point on the ground below the centroid of its points.
    fn ground_point(&self) -> Point3<f64> {
        let mean = centroid(&self.points).coords;
        Point3::from(mean - self.up * (self.up.dot(&mean) - self.ground))
    }

    /// Range of a coordinate over its points, without a twentieth at each end.
    fn extent(&self, of_point: impl Fn(&Point3<f64>) -> f64) -> Option<(f64, f64)> {
        quantile_range(&mut self.points.iter().map(of_point).collect::<Vec<_>>(), 0.05).map(Into::into)
    }
}

/// Displacement from the last point at least `step` behind to the first at least `step` ahead, shorter at the ends.
fn direction(ground_points: &[Point3<f64>], k: usize, step: f64) -> Option<Vector3<f64>> {
    let is_far = |ground_point: &&Point3<f64>| (**ground_point - ground_points[k]).norm() >= step;
    let ahead = ground_points[k..].iter().find(is_far).or(ground_points.last())?;
    let behind = ground_points[..=k].iter().rev().find(is_far).or(ground_points.first())?;
    Some(ahead - behind).filter(|displacement| displacement.norm() >= step)
}

/// Unit vector along a direction, projected on the ground.
fn level(direction: &Vector3<f64>, up: &Vector3<f64>) -> Option<Vector3<f64>> {
    (direction - up * up.dot(direction)).try_normalize(1e-12)
}

fn at_least_as_wide([least, most]: [f64; 2], width: f64) -> [f64; 2] {
    let missing = ((width - (most - least)) / 2.0).max(0.0);
    [least - missing, most + missing]
}
