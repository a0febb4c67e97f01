//! Two-view geometry of matched images, as COLMAP stores it.
//!
//! Where both poses are known the essential matrix is `E = [t]ₓ R` of `cam2_from_cam1` with a unit translation, the
//! fundamental matrix `F = K₂⁻ᵀ E K₁⁻¹` (of pixels without distortion), and inliers are the matches within four pixels
//! of it by the Sampson distance. Otherwise `F` is estimated from the matches, which were verified when the tracks were
//! built: all are inliers. `H` is fitted to the inliers; if eight in ten of them are its inliers within four pixels,
//! the pair is planar or panoramic. Both limits are COLMAP's (`src/colmap/estimators/two_view_geometry.h`).

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector2, Vector3};

use super::View;
use crate::camera::Camera;
use crate::math::{Rigid3, fundamental_from_points, homography_from_points};
use crate::scene::{ImageId, Reconstruction};

/// Maximum error of an inlier, pixels: COLMAP's default (`TwoViewGeometryOptions`).
const MAX_ERROR_PX: f64 = 4.0;
/// Minimum inlier ratio of a homography for a planar or panoramic pair: COLMAP's default.
const PLANAR_SHARE: f64 = 0.8;

/// COLMAP's configuration of a pair, with its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Configuration {
    /// An essential matrix.
    Calibrated = 2,
    /// A fundamental matrix alone.
    Uncalibrated = 3,
    /// A homography explains the matches.
    PlanarOrPanoramic = 6,
}

/// Geometry of two images.
#[derive(Clone, Debug, PartialEq)]
pub struct TwoViewGeometry {
    pub configuration: Configuration,
    pub inliers: Vec<[u32; 2]>,
    pub fundamental: Option<Matrix3<f64>>,
    pub essential: Option<Matrix3<f64>>,
    pub homography: Option<Matrix3<f64>>,
    /// With a translation of unit length, or none.
    pub cam2_from_cam1: Option<Rigid3>,
}

/// Geometry of a pair; `None` if neither poses nor matches determine it.
pub fn of_pair(
    model: &Reconstruction,
    views: &BTreeMap<ImageId, &View>,
    pair: [ImageId; 2],
    matches: &[[u32; 2]],
) -> Option<TwoViewGeometry> {
    let sides = pair.map(|id| Side::of(model, views[&id]));
    let motion = relative(model, pair);
    let cameras = sides[0].camera.zip(sides[1].camera);
    let essential = motion.map(|motion| motion.translation.cross_matrix() * motion.rotation.to_rotation_matrix());
    let inliers = match (essential, cameras) {
        (Some(essential), Some(_)) => agreeing(&sides, &essential, matches),
        _ => matches.to_vec(),
    };
    let [first, second] = [0, 1].map(|k| inliers.iter().map(|m| sides[k].pixel(m[k])).collect::<Vec<_>>());
    let fundamental = match (essential, cameras) {
        (Some(essential), Some((a, b))) => {
            Some(b.matrix().try_inverse()?.transpose() * essential * a.matrix().try_inverse()?)
        }
        _ => fundamental_from_points(&first, &second),
    };
    let homography = homography_from_points(&first, &second);
    let is_planar = homography.is_some_and(|h| explained(&h, &first, &second) > PLANAR_SHARE);
    let configuration = match (essential, fundamental) {
        _ if is_planar => Configuration::PlanarOrPanoramic,
        (Some(_), _) => Configuration::Calibrated,
        (None, Some(_)) => Configuration::Uncalibrated,
        (None, None) => return None,
    };
    Some(TwoViewGeometry { configuration, inliers, fundamental, essential, homography, cam2_from_cam1: motion })
}

/// One image of a pair.
struct Side<'a> {
    view: &'a View,
    /// If anything can be projected with it.
    camera: Option<&'a Camera>,
}

impl<'a> Side<'a> {
    fn of(model: &'a Reconstruction, view: &'a View) -> Self {
        Self { view, camera: model.cameras.get(&view.camera).filter(|_| model.can_project(view.camera)) }
    }

    /// Point on the plane z = 1, without distortion; as stored if the intrinsics are unknown.
    fn normalized(&self, feature: u32) -> Vector2<f64> {
        let pixel = self.view.pixels[feature as usize];
        self.camera.map_or(pixel.coords, |camera| camera.normalized_from_pixel(pixel))
    }

    /// The pixel without distortion.
    fn pixel(&self, feature: u32) -> Vector2<f64> {
        let place = self.normalized(feature);
        let Some(camera) = self.camera else { return place };
        let [fx, fy] = camera.focal;
        let [cx, cy] = camera.principal;
        Vector2::new(fx * place.x + cx, fy * place.y + cy)
    }
}

/// Pose of the second camera relative to the first, translation of unit length; `None` if a pose is unknown.
fn relative(model: &Reconstruction, pair: [ImageId; 2]) -> Option<Rigid3> {
    let [first, second] = pair.map(|id| model.images.get(&id).map(|image| image.cam_from_world));
    let motion = second? * first?.inverse();
    let length = motion.translation.norm();
    let translation = if length > 0.0 { motion.translation / length } else { Vector3::zeros() };
    Some(Rigid3::new(motion.rotation, translation))
}

/// The matches within [`MAX_ERROR_PX`] of an essential matrix.
fn agreeing(sides: &[Side<'_>; 2], essential: &Matrix3<f64>, matches: &[[u32; 2]]) -> Vec<[u32; 2]> {
    let focal: f64 = sides.iter().filter_map(|side| Some(side.camera?.mean_focal())).sum::<f64>() / 2.0;
    let limit_sq = (MAX_ERROR_PX / focal).powi(2);
    let agrees = |m: &&[u32; 2]| {
        let [a, b] = [0, 1].map(|k| sides[k].normalized(m[k]).push(1.0));
        let (line_b, line_a) = (essential * a, essential.transpose() * b);
        let slope = line_a.xy().norm_squared() + line_b.xy().norm_squared();
        // A pure rotation has no epipolar lines.
        slope == 0.0 || b.dot(&line_b).powi(2) <= limit_sq * slope
    };
    matches.iter().filter(agrees).copied().collect()
}

/// Inlier ratio of a homography within [`MAX_ERROR_PX`].
fn explained(homography: &Matrix3<f64>, first: &[Vector2<f64>], second: &[Vector2<f64>]) -> f64 {
    let agrees = |(a, b): &(&Vector2<f64>, &Vector2<f64>)| {
        let moved = homography * a.push(1.0);
        (moved.xy() / moved.z - *b).norm() <= MAX_ERROR_PX
    };
    first.iter().zip(second).filter(agrees).count() as f64 / first.len().max(1) as f64
}
