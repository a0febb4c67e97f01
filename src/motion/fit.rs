//! Fit of a static point to a track (eq. 1 to 4 of `docs/maths/motion.md`).

use nalgebra::{Matrix2x3, Matrix3, Point2, Vector2, Vector3};

use super::{PointTrack, Surroundings, View};

/// Static point that explains a track best.
pub(super) struct StaticFit {
    /// Frame in whose camera the point is given.
    pub reference: u32,
    /// The point is (x, y, 1) / inverse depth in that camera.
    pub ray: Vector3<f64>,
    /// Inverse depth; negative for a point behind the camera.
    pub inverse_depth: f64,
    /// Standard deviation of the inverse depth for a noise of one pixel.
    pub inverse_depth_per_px: f64,
    /// Maximum image displacement by a unit of inverse depth, pixels.
    pub shift_px: f64,
    /// RMS residual per degree of freedom, pixels.
    pub rms_px: f64,
    /// Maximum residual, pixels.
    pub max_px: f64,
}

/// Observation: pose of its camera relative to the reference, and the point on the plane z = 1.
struct ViewObservation {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
    point: Vector2<f64>,
    focal: f64,
}

/// Minimum number of registered frames of a track: four give five redundant equations.
const MIN_VIEWS: usize = 4;
/// Maximum number of frames of a track that are used, evenly spaced over its life.
const MAX_VIEWS: usize = 24;

/// Fits a static point to a track, with an inverse depth of at most `max_inverse_depth`.
///
/// Only frames with known cameras are used; `None` if there are too few.
pub(super) fn fit_static(track: &PointTrack, surroundings: &Surroundings, max_inverse_depth: f64) -> Option<StaticFit> {
    let frames = sampled(track, surroundings);
    if frames.len() < MIN_VIEWS {
        return None;
    }
    let reference = frames[frames.len() / 2];
    let observations = relative_observations(track, surroundings, &frames, reference)?;
    let start = undistorted(surroundings.view(reference)?, track.at(reference)?);
    let limit = |inverse_depth: f64| inverse_depth.clamp(-max_inverse_depth, max_inverse_depth);
    let mut point = Vector3::new(start.x, start.y, limit(linear_inverse_depth(&observations, start)));
    let mut normal = Matrix3::zeros();
    for _ in 0..6 {
        let (hessian, gradient) = normal_equations(&observations, &point)?;
        normal = hessian;
        let step = damped(&hessian).try_inverse()? * -gradient;
        point += step;
        point.z = limit(point.z);
        if step.norm() < 1e-10 {
            break;
        }
    }
    summary(&observations, point, &normal, reference)
}

/// Registered frames of a track, evenly subsampled, including the first and last.
fn sampled(track: &PointTrack, surroundings: &Surroundings) -> Vec<u32> {
    let registered: Vec<u32> = (track.first..track.end()).filter(|&f| surroundings.view(f).is_some()).collect();
    if registered.len() <= MAX_VIEWS {
        return registered;
    }
    let last = registered.len() - 1;
    (0..MAX_VIEWS).map(|k| registered[k * last / (MAX_VIEWS - 1)]).collect()
}

fn undistorted(view: &View, pixel: [f64; 2]) -> Vector2<f64> {
    view.camera.normalized_from_pixel(Point2::from(pixel))
}

fn relative_observations(
    track: &PointTrack,
    surroundings: &Surroundings,
    frames: &[u32],
    reference: u32,
) -> Option<Vec<ViewObservation>> {
    let world_from_reference = surroundings.view(reference)?.cam_from_world.inverse();
    let observation = |&frame: &u32| {
        let view = surroundings.view(frame)?;
        let relative = view.cam_from_world * world_from_reference;
        Some(ViewObservation {
            rotation: *relative.rotation.to_rotation_matrix().matrix(),
            translation: relative.translation,
            point: undistorted(view, track.at(frame)?),
            focal: view.camera.mean_focal(),
        })
    };
    frames.iter().map(observation).collect()
}

/// Inverse depth along a ray by linear least squares over all observations (eq. 2).
fn linear_inverse_depth(observations: &[ViewObservation], ray: Vector2<f64>) -> f64 {
    let (mut product, mut square) = (0.0, 0.0);
    for observation in observations {
        let turned = observation.rotation * Vector3::new(ray.x, ray.y, 1.0);
        let constant = turned.xy() - observation.point * turned.z;
        let slope = observation.translation.xy() - observation.point * observation.translation.z;
        product += constant.dot(&slope);
        square += slope.norm_squared();
    }
    if square > 0.0 { -product / square } else { 0.0 }
}

/// Residual in pixels and its derivatives by x, y and inverse depth; `None` behind the camera.
fn residual(observation: &ViewObservation, point: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
    let in_view = observation.rotation * Vector3::new(point.x, point.y, 1.0) + observation.translation * point.z;
    if in_view.z < 1e-3 {
        return None;
    }
    let normalized = in_view.xy() / in_view.z;
    let by_in_view = Matrix2x3::new(1.0, 0.0, -normalized.x, 0.0, 1.0, -normalized.y) * (observation.focal / in_view.z);
    let columns = Matrix3::from_columns(&[
        observation.rotation.column(0).into(),
        observation.rotation.column(1).into(),
        observation.translation,
    ]);
    Some(((normalized - observation.point) * observation.focal, by_in_view * columns))
}

fn normal_equations(observations: &[ViewObservation], point: &Vector3<f64>) -> Option<(Matrix3<f64>, Vector3<f64>)> {
    let (mut hessian, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
    for observation in observations {
        let (residual, jacobian) = residual(observation, point)?;
        hessian += jacobian.transpose() * jacobian;
        gradient += jacobian.transpose() * residual;
    }
    Some((hessian, gradient))
}

/// Damps the depth, which a camera without translation does not determine: it then keeps its value.
fn damped(hessian: &Matrix3<f64>) -> Matrix3<f64> {
    let mut damped = *hessian;
    damped[(2, 2)] += 1e-9 * hessian[(2, 2)] + 1e-9;
    damped
}

fn summary(
    observations: &[ViewObservation],
    point: Vector3<f64>,
    normal: &Matrix3<f64>,
    reference: u32,
) -> Option<StaticFit> {
    let (mut sum, mut max_sq, mut shift_px) = (0.0, 0.0f64, 0.0f64);
    for observation in observations {
        let (residual, jacobian) = residual(observation, &point)?;
        sum += residual.norm_squared();
        max_sq = max_sq.max(residual.norm_squared());
        shift_px = shift_px.max(jacobian.column(2).norm());
    }
    let variance = damped(normal).try_inverse()?[(2, 2)];
    Some(StaticFit {
        reference,
        ray: Vector3::new(point.x, point.y, 1.0),
        inverse_depth: point.z,
        inverse_depth_per_px: variance.max(0.0).sqrt(),
        shift_px,
        rms_px: (sum / (2 * observations.len() - 3) as f64).sqrt(),
        max_px: max_sq.sqrt(),
    })
}
