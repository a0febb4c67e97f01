//! Power of the test for stationary points against the path of a trajectory.
//!
//! An object that moves parallel to the camera, at a constant ratio of speeds, is seen as a stationary one at another
//! distance, so that points that look stationary contradict a path only if that path would have shown. Per second of
//! the path, the static point that explains it best is fitted: with the middle line of sight as the axis, m_i the
//! direction to the object in view i, and t_i the camera's displacement over the object's distance,
//!
//! ```text
//! e_i = (x, y) − m_i − k (t_xy − m_i t_z),
//! ```
//!
//! linear in (x, y, k), where k is the inverse depth of the static point over the object's. The path shows if residuals
//! e are visible, or if k is too far from 1 for a point on the ground.

use nalgebra::{Matrix2x3, Matrix3, Point3, Rotation3, Unit, Vector2, Vector3};

use super::Candidate;
use crate::scene::{GroundPlane, ImageId, ObjectPose};

/// Fewest places in a piece of the path.
const PIECE_PLACES: usize = 4;

/// A place of the object and the camera that saw it.
struct PathView {
    time_s: f64,
    place: Point3<f64>,
    center: Point3<f64>,
    focal: f64,
    /// Height of the camera over the local plane, if there is one.
    height: Option<f64>,
}

/// Returns true if points on the object would have shown for at least half of the time that it moves as its trajectory
/// says.
pub(super) fn shows(candidate: &Candidate) -> bool {
    let sights = sights(candidate);
    let mut pieces: Vec<&[PathView]> = Vec::new();
    let mut rest = sights.as_slice();
    while let Some(first) = rest.first() {
        // As long as a point is typically followed: a second.
        let long = rest.iter().position(|sight| sight.time_s - first.time_s >= 1.0).unwrap_or(rest.len());
        let (piece, next) = rest.split_at(long.max(PIECE_PLACES).min(rest.len()));
        pieces.extend((piece.len() >= PIECE_PLACES).then_some(piece));
        rest = next;
    }
    let num_shown = pieces.iter().filter(|piece| piece_shows(piece)).count();
    num_shown > 0 && 2 * num_shown >= pieces.len()
}

fn sights(candidate: &Candidate) -> Vec<PathView> {
    let sight = |pose: &ObjectPose| {
        let image = candidate.background.images.get(&ImageId::from(pose.frame))?;
        let center = image.cam_from_world.center();
        let height = |plane: &GroundPlane| plane.signed_distance(center).abs();
        Some(PathView {
            time_s: pose.time_s,
            place: Point3::from(pose.position),
            center,
            focal: candidate.background.camera_of(image).mean_focal(),
            height: candidate.planes.get(&pose.frame).map(height).filter(|height| *height > 0.0),
        })
    };
    candidate.trajectory.poses.iter().filter_map(sight).collect()
}

fn piece_shows(piece: &[PathView]) -> bool {
    let middle = &piece[piece.len() / 2];
    let sight = middle.place - middle.center;
    let distance = sight.norm();
    let Some(axis) = Unit::try_new(sight, 1e-12) else { return false };
    let Some(turn) = Rotation3::rotation_between(&axis.into_inner(), &Vector3::z()) else { return false };
    // Directions to the object, and the derivative of the direction to a static point by k.
    let seen: Vec<(Vector2<f64>, Vector2<f64>)> = piece
        .iter()
        .filter_map(|one| {
            let ray = turn * (one.place - one.center);
            let direction = (ray.z > 0.1 * ray.norm()).then(|| ray.xy() / ray.z)?;
            let step = turn * (one.center - middle.center) / distance;
            Some((direction, direction * step.z - step.xy()))
        })
        .collect();
    let (mut normal, mut right) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros());
    let row = |slope: &Vector2<f64>| Matrix2x3::new(1.0, 0.0, slope.x, 0.0, 1.0, slope.y);
    for (direction, slope) in &seen {
        normal += row(slope).transpose() * row(slope);
        right += row(slope).transpose() * direction;
    }
    // Without a baseline the depth stays that of the object.
    let weak = 1e-9;
    normal[(2, 2)] += weak;
    right.z += weak;
    let Some(found) = normal.try_inverse().map(|inverse| inverse * right) else { return false };
    let residual = |(direction, slope): &(Vector2<f64>, Vector2<f64>)| (row(slope) * found - direction).norm_squared();
    let rms = (seen.iter().map(residual).sum::<f64>() / seen.len().max(1) as f64).sqrt();
    let shift = seen.iter().map(|(_, slope)| slope.norm()).fold(0.0, f64::max);
    // Share of the ground's inverse depth by which it may be wrong, and its least inverse depth, as in `motion`.
    let tolerance = middle.height.map_or(f64::INFINITY, |height| 0.15 + distance / (40.0 * height));
    let beyond = ((found.z - 1.0).abs() - tolerance).max(0.0);
    // Four times the noise of points that are followed to 0.5 to 0.75 px.
    middle.focal * rms.max(beyond * shift) >= 3.0
}
