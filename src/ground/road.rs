//! Road surface along the trajectory of a vehicle-mounted camera, as planes below other vehicles.
//!
//! Every camera position, lowered by the camera's height over the road, is a point of the road. A vehicle ahead drives
//! where the camera passes later: there the road is known without any road point, even beyond hills (eq. 18 and 19 of
//! `docs/maths/ground.md`). Suspension motion averages out over the positions near the vehicle.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point2, Point3, Vector3};

use super::camera_mount::Mount;
use super::local::contact_point;
use crate::math::symmetric_eigen;
use crate::scene::{FrameId, GroundPlane, Image, PlaneBasis, Reconstruction};

/// Standard deviation of the difference in cross slope between lanes: a quarter of the usual crossfall of a
/// carriageway, whose lanes mostly have equal slopes.
const CROSSFALL: f64 = 0.005;
/// Standard deviation of a vehicle's inclination by suspension motion, radians.
const SPRING_TILT: f64 = 0.005;
/// Maximum distance of an object, and its distance if its lowest ray does not meet the road, in camera heights.
const FAR: f64 = 60.0;

/// Road points and normals along the camera's trajectory.
pub(super) struct Road<'a> {
    background: &'a Reconstruction,
    mount: &'a Mount,
    /// Road point below the camera and the normal there, by frame.
    positions: BTreeMap<FrameId, (Point3<f64>, Vector3<f64>)>,
    /// RMS change of the road's slope per length.
    bend: f64,
}

impl<'a> Road<'a> {
    pub(super) fn new(background: &'a Reconstruction, mount: &'a Mount) -> Self {
        let below = |image: &Image| {
            let normal = image.cam_from_world.rotation.inverse() * mount.normal_in_cam;
            (image.cam_from_world.center() - normal * mount.height, normal)
        };
        let positions: BTreeMap<_, _> =
            background.images.iter().map(|(id, image)| (id.frame(), below(image))).collect();
        // A typical change of slope: a radius of 1.9 km for a camera height of 1.3 m.
        let bend = hypot([bend_of(&positions, 10.0 * mount.height), 0.0007 / mount.height]);
        Self { background, mount, positions, bend }
    }

    /// Road plane below an object with observations at `pixels`; `None` for a frame that is not registered.
    pub(super) fn plane_below(&self, frame: FrameId, image: &Image, pixels: &[Point2<f64>]) -> Option<GroundPlane> {
        let (own, own_normal) = *self.positions.get(&frame)?;
        let far = FAR * self.mount.height;
        let ahead = |contact: &Point3<f64>| (contact - own).norm() <= far;
        let contact = contact_point(self.background, image, pixels, (&own_normal, self.mount.height)).filter(ahead);
        let contact = match contact {
            Some(contact) => contact,
            None => self.farthest_point(image, pixels, own, own_normal)?,
        };
        let section = self.section_near(&contact);
        let plane = section.plane(self.mount)?;
        // The contact point is on the camera's own plane; where the road rises or falls, it is elsewhere on this plane.
        Some(self.with_stds(plane, &contact, &section))
    }

    /// Position on the plane at the maximum distance, in the object's direction.
    fn farthest_point(
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

    /// Weighted road points near the one nearest to a contact point.
    fn section_near(&self, contact: &Point3<f64>) -> RoadSection {
        let distance = |position: &Point3<f64>| (position - contact).norm();
        let positions = self.positions.values().map(|(position, _)| *position);
        let nearest = positions.min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(*contact);
        let gap = distance(&nearest);
        // Standard deviation of the Gaussian weights: five camera heights or half of the gap, whichever is larger.
        let reach = (5.0 * self.mount.height).max(0.5 * gap);
        let weighted = self.positions.values().map(|(position, normal)| {
            let offset = (position - nearest).norm() / reach;
            ((-0.5 * offset * offset).exp(), *position, *normal)
        });
        RoadSection(weighted.filter(|(weight, ..)| *weight > 1e-3).collect())
    }

    fn with_stds(&self, plane: GroundPlane, contact: &Point3<f64>, section: &RoadSection) -> GroundPlane {
        let mount = self.mount;
        let offset = contact - plane.point;
        // While the camera is stationary the direction of the road is unknown, and the slope is that of its own plane.
        let (along, across, slope) = match section.direction(mount) {
            Some(direction) => (offset.dot(&direction).abs(), offset.cross(&direction).norm(), 0.0),
            None => (offset.norm(), 0.0, mount.pitch_std),
        };
        let mount_error =
            hypot([mount.height_std, mount.drift * mount.height, across * mount.roll_std, across * CROSSFALL]);
        // Beyond the last position the road is extrapolated linearly, with the measured bend as its error (eq. 19).
        let bend_error = 0.5 * self.bend * along * along;
        let half = bend_error / 2.0_f64.sqrt();
        let suspension = hypot([0.01 * mount.height, SPRING_TILT * along]) / section.effective_count().sqrt().max(1.0);
        let common = hypot([mount_error, along * slope, half]);
        GroundPlane {
            height_std: hypot([common, half, suspension]),
            common_height_std: common,
            tilt_std: hypot([mount.roll_std, mount.pitch_std, CROSSFALL, SPRING_TILT, self.bend * along]),
            ..plane
        }
    }
}

/// RMS change of slope along the points of a road; 0 for a road that is too short.
///
/// The change at a point is that between the chords to the nearest points at least `span` before and behind it.
fn bend_of(positions: &BTreeMap<FrameId, (Point3<f64>, Vector3<f64>)>, span: f64) -> f64 {
    let road: Vec<&(Point3<f64>, Vector3<f64>)> = positions.values().collect();
    let bend_at = |k: usize| {
        let (position, normal) = road[k];
        let before = road[..k].iter().rev().map(|(other, _)| position - other).find(|offset| offset.norm() >= span)?;
        let behind = road[k + 1..].iter().map(|(other, _)| other - position).find(|offset| offset.norm() >= span)?;
        let slope = |offset: Vector3<f64>| normal.dot(&offset) / offset.norm();
        Some(2.0 * (slope(behind) - slope(before)) / (behind.norm() + before.norm()))
    };
    let bends: Vec<f64> = (0..road.len()).filter_map(bend_at).collect();
    let mean_square = bends.iter().map(|bend| bend * bend).sum::<f64>() / bends.len().max(1) as f64;
    mean_square.sqrt()
}

fn hypot<const N: usize>(parts: [f64; N]) -> f64 {
    parts.iter().map(|part| part * part).sum::<f64>().sqrt()
}

/// Road points with weights and normals.
struct RoadSection(Vec<(f64, Point3<f64>, Vector3<f64>)>);

impl RoadSection {
    /// Effective number of points.
    fn effective_count(&self) -> f64 {
        let (sum, squares) = self.0.iter().fold((0.0, 0.0), |(a, b), (w, ..)| (a + w, b + w * w));
        if squares > 0.0 { sum * sum / squares } else { 0.0 }
    }

    fn total(&self) -> f64 {
        self.0.iter().map(|(weight, ..)| weight).sum()
    }

    fn centroid(&self) -> Option<Point3<f64>> {
        let sum: Vector3<f64> = self.0.iter().map(|(weight, position, _)| position.coords * *weight).sum();
        Some(self.total()).filter(|total| *total > 0.0).map(|total| Point3::from(sum / total))
    }

    /// Principal direction of the points; `None` where the camera is stationary.
    fn direction(&self, mount: &Mount) -> Option<Vector3<f64>> {
        let centroid = self.centroid()?;
        let scatter = |(weight, position, _): &(f64, Point3<f64>, _)| {
            (position - centroid) * (position - centroid).transpose() * *weight
        };
        let eigen = symmetric_eigen(self.0.iter().map(scatter).sum::<Matrix3<f64>>())?;
        let largest = eigen.eigenvalues.imax();
        let moves = eigen.eigenvalues[largest] > self.total() * (0.3 * mount.height).powi(2);
        moves.then(|| eigen.eigenvectors.column(largest).into_owned())
    }

    /// Plane through the centroid and the principal direction, across it as level as the mean of the normals.
    fn plane(&self, mount: &Mount) -> Option<GroundPlane> {
        let point = self.centroid()?;
        let mean: Vector3<f64> = self.0.iter().map(|(weight, _, normal)| *normal * *weight).sum();
        let across = self.direction(mount).map_or(mean, |direction| mean - direction * direction.dot(&mean));
        let normal = across.try_normalize(f64::EPSILON)?;
        let distances = self.0.iter().map(|(weight, position, _)| weight * normal.dot(&(position - point)).powi(2));
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
