//! Robust triangulation of a point from many views.

use nalgebra::{Matrix3, Point2, Point3, Vector3};

use crate::bundle::Whitening;
use crate::camera::Camera;
use crate::math::{Rigid3, widest_angle};

/// One observation of the point, with the camera and pose of its view.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// Intrinsics.
    pub camera: &'a Camera,
    /// World to camera.
    pub cam_from_world: &'a Rigid3,
    /// Observed position, pixels.
    pub pixel: Point2<f64>,
    /// Whitening of its error.
    pub whitening: Whitening,
}

impl View<'_> {
    fn ray_in_world(&self) -> Vector3<f64> {
        self.cam_from_world.rotation.inverse() * self.camera.ray_from_pixel(self.pixel)
    }

    /// Squared reprojection error, whitened; infinite behind the camera.
    pub fn error_sq(&self, point: Point3<f64>) -> f64 {
        match self.camera.pixel_from_cam(*self.cam_from_world * point) {
            Some(pixel) => self.whitening.norm_sq(pixel - self.pixel),
            None => f64::INFINITY,
        }
    }
}

/// A triangulated point.
#[derive(Clone, Debug, PartialEq)]
pub struct Triangulated {
    /// Position in the world.
    pub position: Point3<f64>,
    /// True for each view whose error is within the threshold.
    pub inliers: Vec<bool>,
}

/// Thresholds of a valid triangulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest reprojection error of an inlier, pixels.
    pub max_error_px: f64,
    /// Smallest angle between the rays of two inliers, radians: below it the depth is not determined.
    pub min_angle: f64,
}

/// Triangulates a point from pairs of views with a wide angle, and refines the one with most inliers.
///
/// `None` if fewer than two views are inliers or their rays are too nearly parallel.
pub fn triangulate(views: &[View<'_>], limits: &Limits) -> Option<Triangulated> {
    let rays: Vec<_> = views.iter().map(|v| (v.cam_from_world.center(), v.ray_in_world())).collect();
    let max_sq = limits.max_error_px * limits.max_error_px;
    let mut best: Option<(f64, Point3<f64>)> = None;
    for (i, j) in candidate_pairs(views.len()) {
        if rays[i].1.angle(&rays[j].1) < limits.min_angle {
            continue;
        }
        let Some(point) = closest_point([rays[i], rays[j]].into_iter()) else { continue };
        let score: f64 = views.iter().map(|v| v.error_sq(point).min(max_sq)).sum();
        if best.is_none_or(|(s, _)| score < s) {
            best = Some((score, point));
        }
    }
    let mut point = best?.1;
    let mut inliers = inliers_of(views, point, max_sq);
    for _ in 0..2 {
        let supporting = rays.iter().zip(&inliers).filter(|(_, inlier)| **inlier).map(|(ray, _)| *ray);
        let Some(refined) = closest_point(supporting) else { break };
        let refined_inliers = inliers_of(views, refined, max_sq);
        if count(&refined_inliers) < count(&inliers) {
            break;
        }
        (point, inliers) = (refined, refined_inliers);
    }
    let centers = || rays.iter().zip(&inliers).filter(|(_, inlier)| **inlier).map(|((center, _), _)| *center);
    let enough = count(&inliers) >= 2 && widest_angle(point, centers()) >= limits.min_angle;
    enough.then_some(Triangulated { position: point, inliers })
}

fn count(flags: &[bool]) -> usize {
    flags.iter().filter(|&&f| f).count()
}

fn inliers_of(views: &[View<'_>], point: Point3<f64>, max_sq: f64) -> Vec<bool> {
    views.iter().map(|v| v.error_sq(point) <= max_sq).collect()
}

/// Pairs of views to try: all for few views; for many, evenly spread views, each with the one half the list away.
///
/// In a video such a pair is far apart in time, and thus has a wide angle.
fn candidate_pairs(n: usize) -> Vec<(usize, usize)> {
    // Ten pairs, about as many as are tried for longer tracks.
    if n <= 5 {
        return (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))).collect();
    }
    let mut pairs = vec![(0, n - 1)];
    let half = n / 2;
    // About eight pairs of views half a track apart, spread over the track.
    let step = (half / 8).max(1);
    pairs.extend((0..n - half).step_by(step).map(|i| (i, i + half)));
    pairs
}

/// The point with the least summed squared distance to rays (origin, unit direction); `None` for parallel rays.
fn closest_point(rays: impl Iterator<Item = (Point3<f64>, Vector3<f64>)>) -> Option<Point3<f64>> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for (origin, direction) in rays {
        let across = Matrix3::identity() - direction * direction.transpose();
        normal += across;
        right += across * origin.coords;
    }
    let solution = normal.cholesky()?.solve(&right);
    solution.iter().all(|v| v.is_finite()).then(|| Point3::from(solution))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    const LIMITS: Limits = Limits { max_error_px: 2.0, min_angle: 0.02 };

    fn poses(n: u32) -> Vec<Rigid3> {
        let center = |i: u32| Point3::new(f64::from(i) * 0.5, 0.1 * f64::from(i % 3), 0.0);
        (0..n).map(|i| Rigid3::from_rotation_and_center(UnitQuaternion::identity(), center(i))).collect()
    }

    fn views<'a>(camera: &'a Camera, poses: &'a [Rigid3], point: Point3<f64>) -> Vec<View<'a>> {
        let see = |pose: &Rigid3| camera.pixel_from_cam(*pose * point).unwrap();
        poses
            .iter()
            .map(|p| View { camera, cam_from_world: p, pixel: see(p), whitening: Whitening::IDENTITY })
            .collect()
    }

    #[test]
    fn exact_views_give_the_point_and_wrong_ones_are_left_out() {
        let camera = Camera::with_focal(960, 540, 800.0);
        let truth = Point3::new(1.0, -0.5, 12.0);
        let poses = poses(9);
        let mut views = views(&camera, &poses, truth);
        views[2].pixel.x += 40.0;
        views[8].pixel.y -= 25.0;
        let found = triangulate(&views, &LIMITS).unwrap();
        assert!((found.position - truth).norm() < 1e-6);
        assert_eq!(found.inliers.iter().filter(|&&f| !f).count(), 2);
    }

    #[test]
    fn a_point_too_far_for_the_baseline_is_refused() {
        let camera = Camera::with_focal(960, 540, 800.0);
        let poses = poses(2);
        assert!(triangulate(&views(&camera, &poses, Point3::new(0.0, 0.0, 500.0)), &LIMITS).is_none());
        assert!(triangulate(&views(&camera, &poses, Point3::new(0.0, 0.0, 5.0)), &LIMITS).is_some());
        assert!(triangulate(&[], &LIMITS).is_none());
    }
}
