//! The way a vehicle took over the ground, from planes that are nearly right.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use serde::Serialize;

use crate::math::{centroid, is_finite, median, quantile_range};
use crate::scene::{FrameId, GroundPlane, Image, Reconstruction};

/// A place of the vehicle.
#[derive(Clone, Copy, Debug)]
pub(super) struct VehiclePosition {
    pub frame: FrameId,
    /// The point on the ground below the middle of what is seen of it.
    pub foot: Point3<f64>,
    /// Unit normal of the ground, to the camera's side.
    pub up: Vector3<f64>,
    /// Where the path leads, a unit vector in the ground; `None` where the vehicle hardly moves.
    pub along: Option<Vector3<f64>>,
    /// Height of the camera over the ground.
    pub camera_height: f64,
    /// Size of a pixel at the vehicle, in units of the background.
    pub pixel: f64,
}

/// Assumptions on a vehicle's shape (`scale.joint.contact`).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BodyShape {
    /// Height of a vehicle's lowest points above the ground, as a share of the height over which its points spread.
    pub clearance: f64,
    /// Median absolute deviations from the median beyond which a point is an outlier.
    pub max_deviation: f64,
}

#[cfg(test)]
pub(super) const SHAPE: BodyShape = BodyShape { clearance: 0.17, max_deviation: 6.0 };

/// All places of a vehicle in the background's frame, and how broad it is.
#[derive(Clone, Debug)]
pub(super) struct VehicleTrajectory {
    /// In the order of the frames.
    pub places: Vec<VehiclePosition>,
    /// Lateral range that the vehicle covers to the left of its path, minimum and maximum, in units of the background.
    pub band: [f64; 2],
    /// Height of the vehicle, in units of the background.
    pub height: f64,
}

impl VehicleTrajectory {
    /// The path of an object with the given planes; `None` for one that does not move by more than about its own
    /// length, or of which too little is known.
    pub(super) fn of(
        background: &Reconstruction,
        model: &Reconstruction,
        planes: &BTreeMap<FrameId, GroundPlane>,
        min_track: usize,
        shape: &BodyShape,
    ) -> Option<Self> {
        let paired = background.paired_images(model).into_iter();
        let seen: Vec<SharedFrame> = paired
            .filter_map(|(frame, image, own)| Some(SharedFrame { frame, image, own, plane: planes.get(&frame)? }))
            .collect();
        let up = seen.iter().map(SharedFrame::up_in_model).sum::<Vector3<f64>>().try_normalize(1e-9)?;
        let body = Body::of(model, up, min_track, shape)?;
        let ratios = seen.iter().map(|seen| seen.ratio(&body));
        let ratio = median(ratios.filter(|r| r.is_finite() && *r > 0.0).collect())?;
        let height = ratio * body.height;
        let foot = body.foot();
        let mut places: Vec<VehiclePosition> = seen.iter().map(|seen| seen.place(background, &foot, ratio)).collect();
        let feet: Vec<Point3<f64>> = places.iter().map(|place| place.foot).collect();
        for (k, place) in places.iter_mut().enumerate() {
            // Over two heights of the vehicle to either side.
            place.along = direction(&feet, k, 2.0 * height).and_then(|d| level(&d, &place.up));
        }
        // The least width of what it covers, in heights of the vehicle.
        let band = at_least_as_wide(covered(&seen, &places, &body, ratio)?, 0.6 * height);
        let is_known = height.is_finite() && feet.iter().all(is_finite);
        is_known.then_some(Self { places, band, height })
    }

    /// Returns true if the vehicle, at the position nearest to a point, passes over it.
    pub(super) fn covers(&self, place: &VehiclePosition, point: &Point3<f64>, reach: f64) -> bool {
        let (Some(along), Some(left)) = (place.along, place.left()) else { return false };
        let away = point - place.foot;
        let is_level = place.up.dot(&away).abs() <= self.height;
        (self.band[0]..=self.band[1]).contains(&left.dot(&away)) && along.dot(&away).abs() <= reach && is_level
    }
}

impl VehiclePosition {
    /// Unit vector in the ground, to the left of the path.
    pub(super) fn left(&self) -> Option<Vector3<f64>> {
        Some(self.up.cross(&self.along?))
    }
}

/// A frame that both models have, with its plane.
#[derive(Clone, Copy)]
struct SharedFrame<'a> {
    frame: FrameId,
    /// In the background.
    image: &'a Image,
    /// In the vehicle's model.
    own: &'a Image,
    plane: &'a GroundPlane,
}

impl SharedFrame<'_> {
    /// The plane's normal in the vehicle's frame.
    fn up_in_model(&self) -> Vector3<f64> {
        self.own.cam_from_world.rotation.inverse() * (self.image.cam_from_world.rotation * self.plane.normal)
    }

    fn camera_height(&self) -> f64 {
        self.plane.signed_distance(self.image.cam_from_world.center())
    }

    /// The size with which the camera stands as high over the vehicle's ground as over the plane.
    fn ratio(&self, body: &Body) -> f64 {
        self.camera_height() / (self.own.cam_from_world.center().coords.dot(&body.up) - body.ground)
    }

    /// A point of the vehicle of that size, in the background.
    fn in_background(&self, point: &Point3<f64>, ratio: f64) -> Point3<f64> {
        self.image.cam_from_world.inverse() * Point3::from((self.own.cam_from_world * *point).coords * ratio)
    }

    /// Where the vehicle is, not yet where it goes.
    fn place(&self, background: &Reconstruction, foot: &Point3<f64>, ratio: f64) -> VehiclePosition {
        let foot = self.in_background(foot, ratio);
        let distance = (foot - self.image.cam_from_world.center()).norm();
        VehiclePosition {
            frame: self.frame,
            foot,
            up: self.plane.normal,
            along: None,
            camera_height: self.camera_height(),
            pixel: distance / background.camera_of(self.image).mean_focal(),
        }
    }
}

/// Lateral range that the vehicle covers to the left of its path; `None` where it hardly moves.
fn covered(seen: &[SharedFrame], places: &[VehiclePosition], body: &Body, ratio: f64) -> Option<[f64; 2]> {
    let moving: Vec<_> = seen.iter().zip(places).filter_map(|(seen, at)| Some((seen, at.foot, at.left()?))).collect();
    // Fewest places in which a vehicle moves.
    if moving.len() < 5 {
        return None;
    }
    // Places at which its width is measured.
    let measured = moving.iter().step_by(moving.len().div_ceil(50)).filter_map(|(seen, foot, left)| {
        let from_foot = |point: &Point3<f64>| left.dot(&(seen.in_background(point, ratio) - foot));
        body.extent(from_foot)
    });
    let (least, most): (Vec<f64>, Vec<f64>) = measured.unzip();
    Some([median(least)?, median(most)?])
}

/// Dimensions of a vehicle's model, in the model's frame.
struct Body {
    points: Vec<Point3<f64>>,
    up: Vector3<f64>,
    /// Height of the ground along `up`, about.
    ground: f64,
    /// Height over the ground.
    height: f64,
}

impl Body {
    fn of(model: &Reconstruction, up: Vector3<f64>, min_track: usize, shape: &BodyShape) -> Option<Self> {
        let points = model.solid_points(min_track, shape.max_deviation);
        // The shape of fewer points is not known.
        if points.len() < 10 {
            return None;
        }
        let mut heights: Vec<f64> = points.iter().map(|p| up.dot(&p.coords)).collect();
        let [low, high] = quantile_range(&mut heights, 0.01)?;
        let ground = low - shape.clearance * (high - low);
        (high > low).then_some(Self { points, up, ground, height: high - ground })
    }

    /// Below the mean of its points, on the ground.
    fn foot(&self) -> Point3<f64> {
        let mean = centroid(&self.points).coords;
        Point3::from(mean - self.up * (self.up.dot(&mean) - self.ground))
    }

    /// From where to where its points reach, but for a twentieth at each end.
    fn extent(&self, of_point: impl Fn(&Point3<f64>) -> f64) -> Option<(f64, f64)> {
        quantile_range(&mut self.points.iter().map(of_point).collect::<Vec<_>>(), 0.05).map(Into::into)
    }
}

/// From the last place at least `step` behind to the first at least `step` ahead; at the ends, what there is of it.
fn direction(feet: &[Point3<f64>], k: usize, step: f64) -> Option<Vector3<f64>> {
    let is_far = |foot: &&Point3<f64>| (**foot - feet[k]).norm() >= step;
    let ahead = feet[k..].iter().find(is_far).or(feet.last())?;
    let behind = feet[..=k].iter().rev().find(is_far).or(feet.first())?;
    Some(ahead - behind).filter(|way| way.norm() >= step)
}

/// The unit vector in the ground along a direction.
fn level(direction: &Vector3<f64>, up: &Vector3<f64>) -> Option<Vector3<f64>> {
    (direction - up * up.dot(direction)).try_normalize(1e-12)
}

fn at_least_as_wide([least, most]: [f64; 2], width: f64) -> [f64; 2] {
    let missing = ((width - (most - least)) / 2.0).max(0.0);
    [least - missing, most + missing]
}
