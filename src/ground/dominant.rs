//! Ground without labels: the dominant plane below the camera.
//!
//! It replaces missing labels, and the result is marked accordingly
//! ([`GroundSource::Geometric`](crate::scene::GroundSource)). Of all planes through many background points, the cameras
//! distinguish the ground from façades and roofs: they are above it, they are not rolled relative to it, and hardly any
//! point is below it (eq. 9 to 11 of `docs/maths/ground.md`). The pitch of the camera is free: level, oblique and nadir
//! views all occur.
//!
//! Region growing extends the ground from that plane over slopes and hills: a point joins if it is on the plane through
//! its nearest ground points, and this plane is not steep (eq. 12).
//!
//! Limits: streets without texture between textured façades, forests without visible ground, and frontal views of a
//! façade give no ground, or a wrong one.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::Options;
use super::plane::{Candidate, Plane, PlaneFailure, fit_plane, least_squares_plane};
use crate::math::{Neighbors, is_finite, seeded_rng, upper_median};
use crate::scene::{Point3dId, Reconstruction};

/// Reason why no ground was found.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum GroundError {
    /// Too few stable points.
    #[error("only {found} background points have {min_observations} or more observations; at least {needed} needed")]
    TooFewPoints {
        /// Number of stable points.
        found: usize,
        /// Minimum number of observations of a stable point.
        min_observations: usize,
        /// Minimum number of stable points.
        needed: usize,
    },
    /// No plane qualifies as the ground.
    #[error("no plane below the cameras can be the ground: {0}")]
    NoPlane(#[from] PlaneFailure),
}

/// Ground found without labels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DominantPlane {
    /// Ground points, on the plane or added by region growing, ascending.
    pub point_ids: Vec<Point3dId>,
    /// Unit normal of the dominant plane, towards the cameras.
    pub normal: Vector3<f64>,
    /// Point on the dominant plane.
    pub point: Point3<f64>,
    /// Share of the stable points that are ground, 0 to 1.
    pub share: f64,
    /// Number of points on the dominant plane itself; region growing added the rest of `point_ids`.
    pub num_on_plane: usize,
}

impl DominantPlane {
    /// RMS distance of all ground points from the plane, units of the background: the unevenness of the ground.
    pub fn spread(&self, background: &Reconstruction) -> f64 {
        let points = self.point_ids.iter().filter_map(|id| background.points.get(id));
        let squares: Vec<f64> = points
            .map(|point| self.normal.dot(&(point.position - self.point)).powi(2))
            .filter(|d| d.is_finite())
            .collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    }
}

/// Finds the dominant plane below the cameras, with its points and those of the ground that continues it.
///
/// # Errors
/// [`GroundError`] when there are too few points or no plane qualifies.
pub fn dominant_plane_points(
    background: &Reconstruction,
    options: &Options,
    seed: u64,
) -> Result<DominantPlane, GroundError> {
    let (ids, candidates) = stable_points(background, options);
    let needed = options.min_points.max(3);
    if ids.len() < needed || background.images.is_empty() {
        let min_observations = options.min_observations;
        return Err(GroundError::TooFewPoints { found: ids.len(), min_observations, needed });
    }
    let cameras = Cameras::new(background);
    let score = |plane: &Plane, support: f64| {
        let below = num_below(&candidates, plane, cameras.side(plane));
        cameras.plausibility(plane, options.max_roll_deg) * (support - 0.5 * below as f64)
    };
    // Ground may be a small part of a scene: the maximum number of samples is that for an inlier
    // ratio of one tenth.
    let max_samples = 10 * options.max_samples;
    let rng = &mut seeded_rng(seed, 0x6772_6f75_6e64);
    let plane = fit_plane(&candidates, needed, max_samples, score, rng)?;
    let mut is_ground: Vec<bool> =
        candidates.iter().map(|c| plane.distance(&c.position).abs() <= c.tolerance).collect();
    let num_on_plane = is_ground.iter().filter(|&&g| g).count();
    grow(&candidates, &mut is_ground, &plane.normal, options.max_slope_deg);
    let point_ids: Vec<_> = ids.into_iter().zip(&is_ground).filter(|(_, ground)| **ground).map(|(id, _)| id).collect();
    Ok(DominantPlane {
        share: point_ids.len() as f64 / candidates.len() as f64,
        point_ids,
        normal: plane.normal * cameras.side(&plane),
        point: plane.point,
        num_on_plane,
    })
}

/// Points with enough observations, with the tolerance at their median depth (eq. 1).
fn stable_points(background: &Reconstruction, options: &Options) -> (Vec<Point3dId>, Vec<Candidate>) {
    background
        .points
        .iter()
        .filter(|(_, point)| point.track.len() >= options.min_observations && is_finite(&point.position))
        .filter_map(|(id, point)| {
            let widths = point
                .track
                .iter()
                .filter_map(|element| background.images.get(&element.image))
                .map(|image| (image.cam_from_world * point.position).z / background.camera_of(image).mean_focal())
                .filter(|width| *width > 0.0)
                .collect();
            let tolerance = options.max_error_px * upper_median(widths)?;
            Some((*id, Candidate { position: point.position, tolerance }))
        })
        .unzip()
}

/// Centers and axes of all cameras, in the background's frame.
struct Cameras {
    centers: Vec<Point3<f64>>,
    right: Vec<Vector3<f64>>,
    up: Vec<Vector3<f64>>,
}

impl Cameras {
    fn new(background: &Reconstruction) -> Self {
        let poses: Vec<_> = background.images.values().map(|image| image.cam_from_world).collect();
        let axis = |axis: Vector3<f64>| poses.iter().map(|pose| pose.rotation.inverse() * axis).collect();
        Self {
            centers: poses.iter().map(|pose| pose.center()).collect(),
            right: axis(Vector3::x()),
            up: axis(-Vector3::y()),
        }
    }

    /// +1 if the normal points to the side of most cameras, otherwise −1.
    fn side(&self, plane: &Plane) -> f64 {
        let num_positive = self.centers.iter().filter(|c| plane.distance(c) > 0.0).count();
        if 2 * num_positive >= self.centers.len() { 1.0 } else { -1.0 }
    }

    /// Plausibility of a plane as the ground below the cameras, 0 to 1 (eq. 9 and 10).
    ///
    /// It is 0 if more than one camera in ten is below the plane, if the cameras are rolled relative to it by more than
    /// the limit, or if they are upside down. Otherwise it increases with the component of the image's up direction
    /// along the normal. For a level camera the ground has 1 and the façade in front of it the minimum. In a nadir view
    /// the ground has the minimum as well, but no competitor.
    fn plausibility(&self, plane: &Plane, max_roll_deg: f64) -> f64 {
        let count = self.centers.len() as f64;
        let normal = plane.normal * self.side(plane);
        let num_above = self.centers.iter().filter(|c| normal.dot(&(*c - plane.point)) > 0.0).count() as f64;
        let mean =
            |axes: &[Vector3<f64>], f: fn(f64) -> f64| axes.iter().map(|a| f(normal.dot(a))).sum::<f64>() / count;
        let (roll, up) = (mean(&self.right, f64::abs), mean(&self.up, |x| x));
        let limit = max_roll_deg.to_radians().sin();
        if num_above < 0.9 * count || roll > limit || up < -limit {
            return 0.0;
        }
        0.25 + 0.75 * up.max(0.0)
    }
}

/// Number of points more than three tolerances beyond the plane, seen from the cameras (b of eq. 11).
fn num_below(candidates: &[Candidate], plane: &Plane, side: f64) -> usize {
    candidates.iter().filter(|c| side * plane.distance(&c.position) < -3.0 * c.tolerance).count()
}

/// Region growing: adds points that continue the ground, in rounds, until a round adds less than one in 200.
fn grow(candidates: &[Candidate], is_ground: &mut [bool], normal: &Vector3<f64>, max_slope_deg: f64) {
    let min_cos = max_slope_deg.to_radians().cos();
    for _ in 0..20 {
        let ground: Vec<usize> = (0..candidates.len()).filter(|&k| is_ground[k]).collect();
        let positions: Vec<[f64; 3]> = ground.iter().map(|&k| candidates[k].position.coords.into()).collect();
        let Some(tree) = Neighbors::new(&positions) else { return };
        let continues = |candidate: &Candidate| {
            // Number of nearest ground points through which the local plane is fitted.
            let nearest = tree.nearest(&candidate.position.coords.into(), 16);
            let nearest: Vec<Candidate> = nearest.into_iter().map(|k| candidates[ground[k]]).collect();
            continues_ground(candidate, &nearest, normal, min_cos)
        };
        let joining: Vec<usize> =
            (0..candidates.len()).filter(|&k| !is_ground[k] && continues(&candidates[k])).collect();
        for &k in &joining {
            is_ground[k] = true;
        }
        if 200 * joining.len() < ground.len() {
            return;
        }
    }
}

/// Returns true if a candidate is on the plane through the nearest ground points, and close to them (eq. 12).
fn continues_ground(candidate: &Candidate, nearest: &[Candidate], normal: &Vector3<f64>, min_cos: f64) -> bool {
    let Some(local) = least_squares_plane(nearest) else { return false };
    let spread = nearest.iter().map(|c| (c.position - local.point).norm_squared()).sum::<f64>() / nearest.len() as f64;
    let is_near = (candidate.position - local.point).norm_squared() <= 4.0 * spread;
    is_near
        && local.normal.dot(normal).abs() >= min_cos
        && local.distance(&candidate.position).abs() <= candidate.tolerance
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{self, Drive, Noise, Terrain, drive};

    /// Recall over the stable ground points, and share of wrong points among those found.
    fn recall_and_error(world: &Drive) -> (f64, f64) {
        let found = dominant_plane_points(&world.background, &Options::default(), 5).unwrap();
        let is_stable = |id: &&Point3dId| world.background.points[id].track.len() >= 4;
        let num_stable = world.background.points.keys().filter(is_stable).count();
        assert!((found.share - found.point_ids.len() as f64 / num_stable as f64).abs() < 1e-12);
        let right = found.point_ids.iter().filter(|id| world.ground_points.binary_search(id).is_ok()).count() as f64;
        (
            right / world.ground_points.iter().filter(is_stable).count() as f64,
            1.0 - right / found.point_ids.len() as f64,
        )
    }

    fn world(terrain: Terrain, camera_height_m: f64, num_ground_points: usize) -> Drive {
        let noise = Noise { pixel_px: 0.5, ..Noise::default() };
        let options = drive::Options {
            terrain,
            camera_height_m,
            num_ground_points,
            num_other_points: 1000,
            noise,
            num_frames: 30,
            ..Default::default()
        };
        drive(&options, 3)
    }

    #[test]
    fn the_ground_is_found_from_oblique_and_steep_views() {
        for height in [6.0, 12.0, 21.0] {
            for terrain in [Terrain::Flat, Terrain::Slope { gradient: [0.12, 0.05] }] {
                let (recall, error) = recall_and_error(&world(terrain, height, 2000));
                // False positives are the lower ends of poles, within four pixels of the ground. False negatives are
                // points with a few observations from nearly one position, whose depth is therefore poor.
                assert!(recall > 0.9 && error < 0.05, "{terrain:?} from {height} m: {recall}, {error}");
            }
        }
    }

    #[test]
    fn a_facade_with_more_points_does_not_win() {
        // A third of the points is ground; half of the rest is on one façade, as many as on the ground.
        let (recall, error) = recall_and_error(&world(Terrain::Flat, 10.0, 500));
        assert!(recall > 0.97 && error < 0.15, "{recall}, {error}");
    }

    #[test]
    fn region_growing_covers_hills() {
        let terrain = Terrain::Hills { amplitude_m: 1.5, wavelength_m: 70.0 };
        let (recall, error) = recall_and_error(&world(terrain, 12.0, 3000));
        assert!(recall > 0.95 && error < 0.1, "{recall}, {error}");
    }

    #[test]
    fn scenes_without_a_plane_have_no_ground() {
        let few = dominant_plane_points(&Reconstruction::default(), &Options::default(), 1);
        assert!(matches!(few, Err(GroundError::TooFewPoints { found: 0, .. })));
        // A point cloud without a plane.
        let mut cloud = world(Terrain::Flat, 12.0, 300).background;
        for (point, k) in cloud.points.values_mut().zip(1u32..) {
            let t = f64::from(k);
            point.position += Vector3::new((t * 1.7).sin(), (t * 2.9).sin(), (t * 4.3).sin()) * 5.0;
        }
        match dominant_plane_points(&cloud, &Options::default(), 1) {
            Ok(found) => assert!(found.share < 0.2, "{}", found.share),
            Err(error) => assert!(matches!(error, GroundError::NoPlane(_))),
        }
    }
}
