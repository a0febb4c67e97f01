//! Scale ratio from contact with the ground: the paper's baseline.
//!
//! Some reconstructed points (of the wheels) are on the ground. The ray from the camera to object point j intersects
//! the local plane of frame i at the parameter (eq. ray_plane_intersection_parameter; h, a as in [`View`](super::View))
//!
//! ```text
//! r_ji = (p_i − c_i) · n_i / (v_ji · n_i) = −h_i / a_ji.
//! ```
//!
//! The smallest of a frame (eq. r_per_image) puts the object on the plane; the median over frames (eq. r_median) is the
//! ratio. A ray that is parallel to the plane, or intersects it behind the camera (r_ji ≤ 0), is invalid; a frame
//! without a valid ray is skipped.
//!
//! Limits: r is too large by clearance / height when the lowest reconstructed point is above the ground, and too small
//! when an outlier is below the wheels. Neither appears in the spread over the frames, so that there is no standard
//! deviation.

use nalgebra::Point3;

use super::{ScaleError, View, Views};
use crate::math::median;
use crate::scene::FrameId;

/// Result of the baseline.
#[derive(Clone, Debug, PartialEq)]
pub struct Intersection {
    /// r > 0: the median of `per_frame`.
    pub ratio: f64,
    /// Ratio of each frame alone (eq. r_per_image), ascending by frame; without the frames in which no ray intersects
    /// the plane.
    pub per_frame: Vec<(FrameId, f64)>,
}

/// Median over the views of the smallest ray-plane intersection parameter.
///
/// # Errors
/// [`ScaleError`] without views, without points, or when no view is valid.
pub fn intersection(views: &Views) -> Result<Intersection, ScaleError> {
    views.require(1)?;
    let per_frame: Vec<(FrameId, f64)> =
        views.views.iter().filter_map(|view| Some((view.frame, smallest(view, &views.points)?))).collect();
    let ratios = per_frame.iter().map(|(_, ratio)| *ratio).collect();
    let ratio = median(ratios).ok_or(ScaleError::NoIntersection { num_views: views.views.len() })?;
    Ok(Intersection { ratio, per_frame })
}

/// Ratio that puts the object on the plane of one frame; `None` where no ray intersects it.
fn smallest(view: &View, points: &[Point3<f64>]) -> Option<f64> {
    let parameters = points.iter().map(|point| -view.camera_height / view.offset(point));
    parameters.filter(|r| r.is_finite() && *r > 0.0).min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::drive::{Drive, Noise, Options, Terrain, drive};

    fn solve(world: &Drive) -> Intersection {
        intersection(&Views::new(
            &world.background,
            &world.object,
            &world.planes,
            &crate::trajectory::Options::default(),
        ))
        .unwrap()
    }

    #[test]
    fn exact_worlds_give_the_exact_ratio() {
        // Contact does not need the camera to climb.
        for (terrain, camera_climb_m) in [
            (Terrain::Flat, 0.0),
            (Terrain::Slope { gradient: [0.1, -0.05] }, 5.0),
            (Terrain::Hills { amplitude_m: 1.0, wavelength_m: 60.0 }, 0.0),
        ] {
            let world = drive(&Options { terrain, camera_climb_m, ..Options::default() }, 2);
            let found = solve(&world);
            assert!((found.ratio / world.ratio - 1.0).abs() < 1e-9, "{terrain:?}");
            assert_eq!(found.per_frame.len(), 60);
        }
    }

    #[test]
    fn missing_wheels_raise_the_ratio_by_clearance_over_height() {
        let world = drive(&Options { has_wheels: false, camera_climb_m: 0.0, ..Options::default() }, 2);
        let too_large = solve(&world).ratio / world.ratio - 1.0;
        // 0.37 m under a camera at 12 m; the lowest of 200 random points is a few centimeters higher.
        assert!((0.03..0.04).contains(&too_large), "{too_large}");
    }

    /// The minimum over the points is biased towards small values; a few centimeters of 12 m are half a percent.
    #[test]
    fn noise_moves_the_ratio_by_little() {
        let noise = Noise { pixel_px: 0.5, plane_height_m: 0.03, plane_tilt_deg: 0.5, bad_planes: 0.1 };
        for seed in 0..6 {
            let world = drive(&Options { noise, ..Options::default() }, seed);
            let error = (solve(&world).ratio / world.ratio - 1.0).abs();
            assert!(error < 0.015, "seed {seed}: {error}");
        }
    }

    #[test]
    fn planes_above_the_camera_are_invalid_and_skipped() {
        let world = drive(&Options::default(), 4);
        let mut views =
            Views::new(&world.background, &world.object, &world.planes, &crate::trajectory::Options::default());
        for view in views.views.iter_mut().take(10) {
            view.camera_height = -view.camera_height;
        }
        let found = intersection(&views).unwrap();
        assert_eq!(found.per_frame.len(), 50);
        assert_eq!(found.per_frame[0].0, views.views[10].frame, "the frames that are left keep their own ratios");
        for view in &mut views.views {
            view.camera_height = -1.0;
        }
        assert_eq!(intersection(&views), Err(ScaleError::NoIntersection { num_views: 60 }));
    }
}
