//! Reprojection errors, and covariances of points.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector2};

use crate::math::{median, symmetric_eigen};
use crate::scene::{Image, Observation, Point3dId, Reconstruction};

/// Residuals of all image positions, pixels.
pub(super) fn residuals(model: &Reconstruction) -> impl Iterator<Item = Vector2<f64>> {
    model.images.values().flat_map(move |image| {
        let residual = move |(id, observation): (Point3dId, &Observation)| {
            let in_cam = image.cam_from_world * model.points[&id].position;
            Some(model.camera_of(image).pixel_from_cam(in_cam)? - observation.pixel)
        };
        points_of(model, image).filter_map(residual)
    })
}

/// Median length of the residuals, pixels.
pub(super) fn median_error_px(model: &Reconstruction) -> Option<f64> {
    median(residuals(model).map(|residual| residual.norm()).collect())
}

/// Covariance of every observed point's position for known poses, in squares of the model's unit.
///
/// `None` where the image positions do not determine the point. Otherwise it is (Σ JᵀJ)⁻¹ times the variance of the
/// point's own residuals, to which the typical one of all points is added as if it came from three more observations.
pub(super) fn point_covariances(model: &Reconstruction) -> BTreeMap<Point3dId, Option<Matrix3<f64>>> {
    // Number of observations with the typical residual that are added to those of a point.
    const PRIOR_OBSERVATIONS: f64 = 3.0;
    let Some(typical_px) = median_error_px(model) else { return BTreeMap::new() };
    let mut sums: BTreeMap<Point3dId, (Matrix3<f64>, f64, f64)> = BTreeMap::new();
    for image in model.images.values() {
        let camera = model.camera_of(image);
        let world_to_cam = image.cam_from_world.rotation.to_rotation_matrix().into_inner();
        for (id, observation) in points_of(model, image) {
            let projection = camera.project(image.cam_from_world * model.points[&id].position);
            let slope = projection.d_point * world_to_cam;
            let (information, squares, count) = sums.entry(id).or_insert((Matrix3::zeros(), 0.0, 0.0));
            *information += slope.transpose() * slope;
            *squares += (projection.pixel - observation.pixel).norm_squared();
            *count += 1.0;
        }
    }
    let covariance = |(information, squares, count): (Matrix3<f64>, f64, f64)| {
        let variance_px2 =
            (squares + PRIOR_OBSERVATIONS * typical_px * typical_px) / (2.0 * (count + PRIOR_OBSERVATIONS));
        let is_determined = symmetric_eigen(information).is_some_and(|eigen| eigen.eigenvalues.min() > 0.0);
        let inverse =
            information.try_inverse().filter(|inverse| is_determined && inverse.iter().all(|x| x.is_finite()));
        inverse.map(|inverse| inverse * variance_px2)
    };
    sums.into_iter().map(|(id, sum)| (id, covariance(sum))).collect()
}

/// Points with a standard deviation above `largest`, but at most a share of `1 - least_share` of all.
pub(super) fn uncertain_points(stds: &BTreeMap<Point3dId, f64>, largest: f64, least_share: f64) -> Vec<Point3dId> {
    let mut stds: Vec<(f64, Point3dId)> = stds.iter().map(|(id, std)| (*std, *id)).collect();
    stds.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let sure = stds.partition_point(|(std, _)| *std <= largest);
    let kept = sure.max((least_share * stds.len() as f64).ceil() as usize);
    stds.iter().skip(kept).map(|(_, id)| *id).collect()
}

/// Observations of points in an image.
fn points_of<'a>(model: &'a Reconstruction, image: &'a Image) -> impl Iterator<Item = (Point3dId, &'a Observation)> {
    let seen = image.observations.iter().filter_map(|observation| Some((observation.point?, observation)));
    seen.filter(|(id, _)| model.points.contains_key(id))
}
