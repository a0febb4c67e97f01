//! The road that a camera fixed to a vehicle has gone and will go, as planes below other vehicles.
//!
//! Every place of the camera, lowered by its height over the road, lies on the road. A vehicle ahead drives where the
//! camera comes by later: there the road is known without any point of it, whatever hills lie between (eq. 18 and 19 of
//! `docs/maths/ground.md`). Springs average out over the places near the vehicle.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point2, Point3, Vector3};

use super::camera_mount::Mount;
use super::local::lowest_foot;
use crate::math::symmetric_eigen;
use crate::scene::{FrameId, GroundPlane, Image, PlaneBasis, Reconstruction};

/// Differences of lanes in their cross slope: a quarter of the usual crossfall of a carriageway, whose lanes are mostly
/// inclined alike.
const CROSSFALL: f64 = 0.005;
/// Standard deviation of a vehicle's inclination on its springs, radians.
const SPRING_TILT: f64 = 0.005;
/// Maximum distance of an object whose lowest ray does not meet the road, in heights of the camera.
const FAR: f64 = 60.0;

/// The camera's way over the road.
pub(super) struct Road<'a> {
    background: &'a Reconstruction,
    mount: &'a Mount,
    /// By frame: a place of the road and the normal there.
    places: BTreeMap<FrameId, (Point3<f64>, Vector3<f64>)>,
    /// Change of the road's slope per length, the root of its mean square.
    bend: f64,
}

impl<'a> Road<'a> {
    pub(super) fn new(background: &'a Reconstruction, mount: &'a Mount) -> Self {
        let below = |image: &Image| {
            let normal = image.cam_from_world.rotation.inverse() * mount.normal_in_cam;
            (image.cam_from_world.center() - normal * mount.height, normal)
        };
        let places: BTreeMap<_, _> = background.images.iter().map(|(id, image)| (id.frame(), below(image))).collect();
        // A change of slope that is usual: a radius of 1.9 km for a camera at 1.3 m.
        let bend = hypot([bend_of(&places, 10.0 * mount.height), 0.0007 / mount.height]);
        Self { background, mount, places, bend }
    }

    /// The road below an object that a frame sees at `pixels`; `None` for a frame that is not registered.
    pub(super) fn plane_below(&self, frame: FrameId, image: &Image, pixels: &[Point2<f64>]) -> Option<GroundPlane> {
        let (own, own_normal) = *self.places.get(&frame)?;
        let far = FAR * self.mount.height;
        let ahead = |foot: &Point3<f64>| (foot - own).norm() <= far;
        let foot = lowest_foot(self.background, image, pixels, (&own_normal, self.mount.height)).filter(ahead);
        let foot = match foot {
            Some(foot) => foot,
            None => self.far_ahead(image, pixels, own, own_normal)?,
        };
        let near = self.near(&foot);
        let plane = near.plane(self.mount)?;
        // The foot was found on the camera's own plane; where the road rises or falls it is elsewhere on this one.
        Some(self.with_deviations(plane, &foot, &near))
    }

    /// A place on the plane at the greatest distance that counts, in the object's direction.
    fn far_ahead(
        &self,
        image: &Image,
        pixels: &[Point2<f64>],
        own: Point3<f64>,
        normal: Vector3<f64>,
    ) -> Option<Point3<f64>> {
        let camera = self.background.camera_of(image);
        let turned = image.cam_from_world.rotation.inverse();
        let rays = pixels.iter().map(|pixel| turned * camera.ray_from_pixel(*pixel));
        let sum: Vector3<f64> = rays.sum();
        let level = (sum - normal * normal.dot(&sum)).try_normalize(f64::EPSILON)?;
        Some(own + level * (FAR * self.mount.height))
    }

    /// The places of the way nearest to a foot.
    fn near(&self, foot: &Point3<f64>) -> Near {
        let distance = |place: &Point3<f64>| (place - foot).norm();
        let nearest = self.places.values().map(|(place, _)| *place);
        let middle = nearest.min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(*foot);
        let gap = distance(&middle);
        // Reach of the places that are averaged, in heights of the camera.
        let reach = (5.0 * self.mount.height).max(0.5 * gap);
        let weighted = self.places.values().map(|(place, normal)| {
            let away = (place - middle).norm() / reach;
            ((-0.5 * away * away).exp(), *place, *normal)
        });
        Near(weighted.filter(|(weight, ..)| *weight > 1e-3).collect())
    }

    fn with_deviations(&self, plane: GroundPlane, foot: &Point3<f64>, near: &Near) -> GroundPlane {
        let mount = self.mount;
        let away = foot - plane.point;
        // Where the camera stands the plane is as inclined as its own, and the way not known.
        let (along, across, slope) = match near.way(mount) {
            Some(way) => (away.dot(&way).abs(), away.cross(&way).norm(), 0.0),
            None => (away.norm(), 0.0, mount.pitch_std),
        };
        let unknown =
            hypot([mount.height_std, mount.drift * mount.height, across * mount.roll_std, across * CROSSFALL]);
        // Beyond the last place the road goes on as it was, and bends as much as it did (eq. 19).
        let guessed = 0.5 * self.bend * along * along;
        let half = guessed / 2.0_f64.sqrt();
        let springs = hypot([0.01 * mount.height, SPRING_TILT * along]) / near.count().sqrt().max(1.0);
        let common = hypot([unknown, along * slope, half]);
        GroundPlane {
            height_std: hypot([common, half, springs]),
            common_height_std: common,
            tilt_std: hypot([mount.roll_std, mount.pitch_std, CROSSFALL, SPRING_TILT, self.bend * along]),
            ..plane
        }
    }
}

/// The root of the mean square of the change of slope along the places of a road, from each and the first ones at least
/// `span` before and behind it; 0 for a road that is too short to tell.
fn bend_of(places: &BTreeMap<FrameId, (Point3<f64>, Vector3<f64>)>, span: f64) -> f64 {
    let road: Vec<&(Point3<f64>, Vector3<f64>)> = places.values().collect();
    let bend_at = |k: usize| {
        let (place, normal) = road[k];
        let before = road[..k].iter().rev().map(|(other, _)| place - other).find(|away| away.norm() >= span)?;
        let behind = road[k + 1..].iter().map(|(other, _)| other - place).find(|away| away.norm() >= span)?;
        let slope = |away: Vector3<f64>| normal.dot(&away) / away.norm();
        Some(2.0 * (slope(behind) - slope(before)) / (behind.norm() + before.norm()))
    };
    let bends: Vec<f64> = (0..road.len()).filter_map(bend_at).collect();
    let mean_square = bends.iter().map(|bend| bend * bend).sum::<f64>() / bends.len().max(1) as f64;
    mean_square.sqrt()
}

fn hypot<const N: usize>(parts: [f64; N]) -> f64 {
    parts.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// Places of the road with their weights and normals.
struct Near(Vec<(f64, Point3<f64>, Vector3<f64>)>);

impl Near {
    /// As how many equal places they count.
    fn count(&self) -> f64 {
        let (sum, squares) = self.0.iter().fold((0.0, 0.0), |(a, b), (w, ..)| (a + w, b + w * w));
        if squares > 0.0 { sum * sum / squares } else { 0.0 }
    }

    fn total(&self) -> f64 {
        self.0.iter().map(|(weight, ..)| weight).sum()
    }

    fn middle(&self) -> Option<Point3<f64>> {
        let sum: Vector3<f64> = self.0.iter().map(|(weight, place, _)| place.coords * *weight).sum();
        Some(self.total()).filter(|total| *total > 0.0).map(|total| Point3::from(sum / total))
    }

    /// The direction in which the places follow one another; `None` where the camera stands.
    fn way(&self, mount: &Mount) -> Option<Vector3<f64>> {
        let middle = self.middle()?;
        let scatter =
            |(weight, place, _): &(f64, Point3<f64>, _)| (place - middle) * (place - middle).transpose() * *weight;
        let eigen = symmetric_eigen(self.0.iter().map(scatter).sum::<Matrix3<f64>>())?;
        let largest = eigen.eigenvalues.imax();
        let moves = eigen.eigenvalues[largest] > self.total() * (0.3 * mount.height).powi(2);
        moves.then(|| eigen.eigenvectors.column(largest).into_owned())
    }

    /// The plane through the middle, along the way, as level across it as the mean of the normals.
    fn plane(&self, mount: &Mount) -> Option<GroundPlane> {
        let point = self.middle()?;
        let mean: Vector3<f64> = self.0.iter().map(|(weight, _, normal)| *normal * *weight).sum();
        let across = self.way(mount).map_or(mean, |way| mean - way * way.dot(&mean));
        let normal = across.try_normalize(f64::EPSILON)?;
        let distances = self.0.iter().map(|(weight, place, _)| weight * normal.dot(&(place - point)).powi(2));
        let rms = (distances.sum::<f64>() / self.total()).sqrt();
        let is_finite = normal.iter().chain(point.iter()).chain([&rms]).all(|x| x.is_finite());
        is_finite.then_some(GroundPlane {
            normal,
            point,
            num_points: mount.num_points,
            num_inliers: mount.num_points,
            rms,
            basis: PlaneBasis::Mount,
            height_std: 0.0,
            common_height_std: 0.0,
            tilt_std: 0.0,
        })
    }
}
