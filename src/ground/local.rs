//! Local ground planes: one per frame, around the object.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Point2, Point3, Vector3};
use rayon::prelude::*;
use thiserror::Error;

use super::Options;
use super::plane::{Candidate, PlaneFailure, UNEVENNESS, fit_plane};
use crate::math::{Neighbors, seeded_rng};
use crate::scene::{FrameId, GroundPlane, Image, ObjectId, PlaneBasis, Point3dId, Reconstruction};

/// Reason why a frame has no plane.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SkipReason {
    /// The object's model has no observations in the frame.
    #[error("no point of the object's model is observed")]
    NoObjectObservations,
    /// Too few ground points are observed.
    #[error("only {found} ground points observed; at least {needed} needed")]
    TooFewGroundPoints {
        /// Number of ground points observed in the frame.
        found: usize,
        /// Minimum number of points of a plane.
        needed: usize,
    },
    /// The points do not determine a plane.
    #[error(transparent)]
    NoPlane(#[from] PlaneFailure),
    /// The camera is on the plane, so the plane has no camera side.
    #[error("the camera is on the plane of the ground points, so this is not the ground below it")]
    CameraOnPlane,
}

/// A frame without a plane.
#[derive(Clone, Debug, PartialEq)]
pub struct SkippedFrame {
    /// The frame.
    pub frame: FrameId,
    /// Reason why it has none.
    pub reason: SkipReason,
}

/// Local planes of one object.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LocalPlanes {
    /// By frame, in the background's frame and unit.
    pub planes: BTreeMap<FrameId, GroundPlane>,
    /// Frames registered in both models that have no plane, ascending.
    pub skipped: Vec<SkippedFrame>,
}

impl FromIterator<(FrameId, Result<GroundPlane, SkipReason>)> for LocalPlanes {
    fn from_iter<I: IntoIterator<Item = (FrameId, Result<GroundPlane, SkipReason>)>>(results: I) -> Self {
        let mut found = Self::default();
        for (frame, plane) in results {
            match plane {
                Ok(plane) => drop(found.planes.insert(frame, plane)),
                Err(reason) => found.skipped.push(SkippedFrame { frame, reason }),
            }
        }
        found
    }
}

/// Pixels at which an image observes points of its object's model.
pub(super) fn object_pixels(in_object: &Image) -> Vec<Point2<f64>> {
    let observed = in_object.observations.iter().filter(|o| o.point.is_some()).map(|o| o.pixel);
    observed.filter(|pixel| pixel.coords.iter().all(|x| x.is_finite())).collect()
}

/// Fits the ground plane around one object, in every frame that is registered in both models.
///
/// Ground points are selected in the image, as in the paper: for each object observation the nearest ground
/// observation, then for each the next nearest, until there are [`Options::num_neighbors`] distinct points (eq. 3 of
/// `docs/maths/ground.md`). Every round is completed, so the points are evenly spread around the object. RANSAC and
/// least squares follow (eq. 4 to 8). The normal points to the camera's side. `ground_points` must be ascending.
///
/// The same seed gives the same planes, on any number of threads.
pub fn local_planes(
    background: &Reconstruction,
    ground_points: &[Point3dId],
    object: ObjectId,
    object_model: &Reconstruction,
    options: &Options,
    seed: u64,
) -> LocalPlanes {
    let results: Vec<_> = background
        .paired_images(object_model)
        .into_par_iter()
        .map(|(frame, in_background, in_object)| {
            let ground = ground_observations(background, ground_points, in_background);
            let stream = u64::from(object.0) << 32 | u64::from(frame.0);
            let plane = plane_of_frame(background, in_background, &ground, in_object, options, (seed, stream));
            (frame, plane)
        })
        .collect();
    results.into_iter().collect()
}

/// Pixel positions of the ground points that an image observes.
fn ground_observations(
    background: &Reconstruction,
    ground_points: &[Point3dId],
    image: &Image,
) -> Vec<(Point2<f64>, Point3dId)> {
    image
        .observations
        .iter()
        .filter_map(|o| Some((o.pixel, o.point?)))
        .filter(|(pixel, id)| {
            // The tree accepts NaN, but then its queries are wrong.
            let is_finite = pixel.coords.iter().all(|x| x.is_finite());
            is_finite && ground_points.binary_search(id).is_ok() && background.points.contains_key(id)
        })
        .collect()
}

fn plane_of_frame(
    background: &Reconstruction,
    image: &Image,
    ground: &[(Point2<f64>, Point3dId)],
    in_object: &Image,
    options: &Options,
    (seed, stream): (u64, u64),
) -> Result<GroundPlane, SkipReason> {
    let object_pixels = object_pixels(in_object);
    if object_pixels.is_empty() {
        return Err(SkipReason::NoObjectObservations);
    }
    let near = points_around(&object_pixels, ground, options.num_neighbors);
    if near.len() < options.min_points {
        return Err(SkipReason::TooFewGroundPoints { found: near.len(), needed: options.min_points });
    }
    let length_per_depth = options.max_error_px / background.camera_of(image).mean_focal();
    let candidates: Vec<Candidate> = near
        .iter()
        .map(|id| background.points[id].position)
        .filter_map(|position| {
            let depth = (image.cam_from_world * position).z;
            (depth > 0.0).then_some(Candidate { position, tolerance: length_per_depth * depth })
        })
        .collect();
    let rng = &mut seeded_rng(seed, stream);
    let plane = fit_plane(&candidates, options.min_points, options.max_samples, |_, support| support, rng)?;
    let height = plane.distance(&image.cam_from_world.center());
    let tolerance = candidates.iter().map(|c| c.tolerance).fold(f64::INFINITY, f64::min);
    if height.abs() <= tolerance {
        return Err(SkipReason::CameraOnPlane);
    }
    let normal = plane.normal * height.signum();
    let contact = contact_point(background, image, &object_pixels, (&normal, height.abs()));
    let std_at_contact = plane.height_std_at(&contact.unwrap_or(plane.point));
    Ok(GroundPlane {
        normal,
        point: plane.point,
        num_points: near.len(),
        num_inliers: plane.num_inliers,
        rms: plane.rms,
        basis: PlaneBasis::Points,
        height_std: std_at_contact.hypot(UNEVENNESS * plane.rms),
        common_height_std: UNEVENNESS * plane.rms,
        tilt_std: plane.tilt_std(),
    })
}

/// Intersection of the lowest of the rays through the given pixels with a plane: the contact point of an object.
///
/// The plane is given by its normal and the height of the camera over it. `None` where all rays are above its horizon.
pub(super) fn contact_point(
    background: &Reconstruction,
    image: &Image,
    pixels: &[Point2<f64>],
    (normal, height): (&Vector3<f64>, f64),
) -> Option<Point3<f64>> {
    let camera = background.camera_of(image);
    let world_from_cam = image.cam_from_world.rotation.inverse();
    let rays = pixels.iter().map(|pixel| world_from_cam * camera.normalized_from_pixel(*pixel).push(1.0));
    let lowest = rays.min_by(|a, b| normal.dot(a).total_cmp(&normal.dot(b)))?;
    let descent = -normal.dot(&lowest);
    (descent > 0.0).then(|| image.cam_from_world.center() + lowest * (height / descent))
}

/// P of eq. 3: the nearest ground points of all object observations.
///
/// Each round adds the next nearest of every observation, until there are `num_neighbors` distinct points or no more.
fn points_around(
    object_pixels: &[Point2<f64>],
    ground: &[(Point2<f64>, Point3dId)],
    num_neighbors: usize,
) -> BTreeSet<Point3dId> {
    let positions: Vec<[f64; 2]> = ground.iter().map(|(pixel, _)| [pixel.x, pixel.y]).collect();
    let Some(tree) = Neighbors::new(&positions) else { return BTreeSet::new() };
    let mut reach = 4.min(num_neighbors);
    loop {
        // A few rounds often suffice; a query of all fifty neighbors of every observation would be wasteful.
        let nearest: Vec<_> = object_pixels.iter().map(|pixel| tree.nearest(&[pixel.x, pixel.y], reach)).collect();
        let mut around = BTreeSet::new();
        for round in 0..reach {
            if around.len() >= num_neighbors {
                return around;
            }
            around.extend(nearest.iter().filter_map(|list| Some(ground[*list.get(round)?].1)));
        }
        if around.len() >= num_neighbors || reach == num_neighbors {
            return around;
        }
        reach = (4 * reach).min(num_neighbors);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{self, Drive, Noise, Terrain, drive};

    fn planes(world: &Drive, ground: &[Point3dId]) -> LocalPlanes {
        local_planes(&world.background, ground, ObjectId(1), &world.object, &Options::default(), 7)
    }

    /// Maximum tilt error (radians) and maximum height error below the vehicle (meters) over all frames.
    fn worst(world: &Drive, found: &LocalPlanes) -> (f64, f64) {
        let unit_m = 1.0 / world.background_from_metric.scale;
        found.planes.iter().fold((0.0_f64, 0.0_f64), |(tilt, height), (frame, plane)| {
            let truth = &world.planes[frame];
            let error = plane.signed_distance(truth.point) * unit_m;
            (tilt.max(plane.normal.angle(&truth.normal)), height.max(error.abs()))
        })
    }

    #[test]
    fn planes_of_exact_worlds_are_exact() {
        for terrain in [Terrain::Flat, Terrain::Slope { gradient: [0.1, -0.05] }] {
            let world = drive(&drive::Options { terrain, ..Default::default() }, 1);
            let found = planes(&world, &world.ground_points);
            assert_eq!((found.planes.len(), found.skipped.len()), (60, 0));
            let (tilt, height) = worst(&world, &found);
            assert!(tilt < 1e-6 && height < 1e-9, "{terrain:?}: {tilt} rad, {height} m");
            assert!(found.planes.values().all(|p| p.num_points >= 50 && p.num_inliers == p.num_points));
            assert_eq!(found, planes(&world, &world.ground_points));
        }
    }

    #[test]
    fn planes_are_robust_to_noise_and_wrong_labels() {
        let noise = Noise { pixel_px: 0.5, ..Noise::default() };
        let world = drive(&drive::Options { noise, ..Default::default() }, 2);
        // All points are labeled as ground.
        let all: Vec<Point3dId> = world.background.points.keys().copied().collect();
        let found = planes(&world, &all);
        assert!(found.planes.len() >= 58, "{:?}", found.skipped);
        let (tilt, height) = worst(&world, &found);
        // Half a pixel at 25 m and f = 900 px is 1.4 cm; façades and poles within the tolerance pull a little more.
        assert!(tilt.to_degrees() < 1.5 && height < 0.08, "{}°, {height} m", tilt.to_degrees());
    }

    #[test]
    fn frames_without_ground_are_skipped_with_the_reason() {
        let mut world = drive(&drive::Options { num_frames: 6, ..Default::default() }, 3);
        let few = planes(&world, &world.ground_points[..3]);
        assert!(few.planes.is_empty() && few.skipped.len() == 6);
        assert!(matches!(few.skipped[0].reason, SkipReason::TooFewGroundPoints { needed: 10, .. }));
        for image in world.object.images.values_mut() {
            image.observations.clear();
        }
        let none = planes(&world, &world.ground_points);
        assert!(none.skipped.iter().all(|s| s.reason == SkipReason::NoObjectObservations));
        assert_eq!(none.skipped.len(), 6);
    }

    #[test]
    fn selected_points_surround_the_object() {
        // Object observations on a small circle, ground on a grid: the points found surround the circle evenly.
        let object: Vec<_> = (0..24)
            .map(|k| {
                let (sin, cos) = (f64::from(k) * 15.0_f64.to_radians()).sin_cos();
                Point2::new(100.0 + 10.0 * cos, 100.0 + 10.0 * sin)
            })
            .collect();
        let ground: Vec<_> = (0..1600u32)
            .map(|k| {
                (Point2::new(f64::from(k % 40) * 5.0 + 2.0, f64::from(k / 40) * 5.0 + 1.0), Point3dId(u64::from(k)))
            })
            .filter(|(p, _)| (p - Point2::new(100.0, 100.0)).norm() > 12.0)
            .collect();
        let around = points_around(&object, &ground, 50);
        assert!(around.len() >= 50 && around.len() < 75);
        let position = |id: &Point3dId| ground.iter().find(|(_, other)| other == id).map(|(p, _)| *p);
        let mut quadrants = [0; 4];
        for p in around.iter().filter_map(position) {
            quadrants[usize::from(p.x > 100.0) + 2 * usize::from(p.y > 100.0)] += 1;
        }
        assert!(quadrants.iter().all(|&count| count >= 10), "{quadrants:?}");
        assert_eq!(points_around(&object, &ground[..7], 50).len(), 7);
        assert!(points_around(&object, &[], 50).is_empty());
    }
}
