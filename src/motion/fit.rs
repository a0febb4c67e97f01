//! The standing point that explains a track best (eq. 1 to 4 of `docs/maths/motion.md`).

use nalgebra::{Matrix2x3, Matrix3, Point2, Vector2, Vector3};

use super::{PointTrack, Surroundings, View};

/// A standing point as one track sees it.
pub(super) struct StaticFit {
    /// Frame in whose camera the point is given.
    pub reference: u32,
    /// The point is (x, y, 1) / inverse depth in that camera.
    pub ray: Vector3<f64>,
    /// Inverse depth; negative for what would lie behind the camera.
    pub inverse_depth: f64,
    /// Standard deviation of the inverse depth at a noise of one pixel.
    pub inverse_depth_per_px: f64,
    /// Maximum shift of the track's positions by a unit of inverse depth, pixels.
    pub shift_px: f64,
    /// Root mean square residual per degree of freedom, pixels.
    pub rms_px: f64,
    /// Largest residual, pixels.
    pub max_px: f64,
}

/// One observation: how its camera stands to the reference, and where the point is seen on the plane z = 1.
struct ViewObservation {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
    seen: Vector2<f64>,
    focal: f64,
}

/// A track needs as many registered frames: four give five equations to spare.
const MIN_VIEWS: usize = 4;
/// Frames of a track that are looked at, evenly spread over its life.
const MAX_VIEWS: usize = 24;

/// Fits a standing point to a track in the frames whose cameras are known, with an inverse depth of at most
/// `max_inverse_depth`. `None` if there are too few.
pub(super) fn fit_static(track: &PointTrack, surroundings: &Surroundings, max_inverse_depth: f64) -> Option<StaticFit> {
    let frames = sampled(track, surroundings);
    if frames.len() < MIN_VIEWS {
        return None;
    }
    let reference = frames[frames.len() / 2];
    let sights = sights(track, surroundings, &frames, reference)?;
    let start = undistorted(surroundings.view(reference)?, track.at(reference)?);
    let limit = |inverse_depth: f64| inverse_depth.clamp(-max_inverse_depth, max_inverse_depth);
    let mut point = Vector3::new(start.x, start.y, limit(linear_inverse_depth(&sights, start)));
    let mut normal = Matrix3::zeros();
    for _ in 0..6 {
        let (hessian, gradient) = normal_equations(&sights, &point)?;
        normal = hessian;
        let step = damped(&hessian).try_inverse()? * -gradient;
        point += step;
        point.z = limit(point.z);
        if step.norm() < 1e-10 {
            break;
        }
    }
    summary(&sights, point, &normal, reference)
}

/// Registered frames of a track, evenly thinned out, first and last included.
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

fn sights(
    track: &PointTrack,
    surroundings: &Surroundings,
    frames: &[u32],
    reference: u32,
) -> Option<Vec<ViewObservation>> {
    let world_from_reference = surroundings.view(reference)?.cam_from_world.inverse();
    let sight = |&frame: &u32| {
        let view = surroundings.view(frame)?;
        let relative = view.cam_from_world * world_from_reference;
        Some(ViewObservation {
            rotation: *relative.rotation.to_rotation_matrix().matrix(),
            translation: relative.translation,
            seen: undistorted(view, track.at(frame)?),
            focal: view.camera.mean_focal(),
        })
    };
    frames.iter().map(sight).collect()
}

/// The inverse depth of a ray that serves all sights best, by linear least squares (eq. 2).
fn linear_inverse_depth(sights: &[ViewObservation], ray: Vector2<f64>) -> f64 {
    let (mut product, mut square) = (0.0, 0.0);
    for sight in sights {
        let turned = sight.rotation * Vector3::new(ray.x, ray.y, 1.0);
        let constant = turned.xy() - sight.seen * turned.z;
        let slope = sight.translation.xy() - sight.seen * sight.translation.z;
        product += constant.dot(&slope);
        square += slope.norm_squared();
    }
    if square > 0.0 { -product / square } else { 0.0 }
}

/// Residual in pixels and its derivatives by x, y and inverse depth; `None` behind the camera.
fn residual(sight: &ViewObservation, point: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
    let seen = sight.rotation * Vector3::new(point.x, point.y, 1.0) + sight.translation * point.z;
    if seen.z < 1e-3 {
        return None;
    }
    let normalized = seen.xy() / seen.z;
    let by_seen = Matrix2x3::new(1.0, 0.0, -normalized.x, 0.0, 1.0, -normalized.y) * (sight.focal / seen.z);
    let columns =
        Matrix3::from_columns(&[sight.rotation.column(0).into(), sight.rotation.column(1).into(), sight.translation]);
    Some(((normalized - sight.seen) * sight.focal, by_seen * columns))
}

fn normal_equations(sights: &[ViewObservation], point: &Vector3<f64>) -> Option<(Matrix3<f64>, Vector3<f64>)> {
    let (mut hessian, mut gradient) = (Matrix3::zeros(), Vector3::zeros());
    for sight in sights {
        let (residual, jacobian) = residual(sight, point)?;
        hessian += jacobian.transpose() * jacobian;
        gradient += jacobian.transpose() * residual;
    }
    Some((hessian, gradient))
}

/// A camera that does not move says nothing of the depth, which then stays where it is.
fn damped(hessian: &Matrix3<f64>) -> Matrix3<f64> {
    let mut damped = *hessian;
    damped[(2, 2)] += 1e-9 * hessian[(2, 2)] + 1e-9;
    damped
}

fn summary(
    sights: &[ViewObservation],
    point: Vector3<f64>,
    normal: &Matrix3<f64>,
    reference: u32,
) -> Option<StaticFit> {
    let (mut sum, mut max_sq, mut shift_px) = (0.0, 0.0f64, 0.0f64);
    for sight in sights {
        let (residual, jacobian) = residual(sight, &point)?;
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
        rms_px: (sum / (2 * sights.len() - 3) as f64).sqrt(),
        max_px: max_sq.sqrt(),
    })
}
