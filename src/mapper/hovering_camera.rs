//! A camera that does not translate: rotations, and what straight lines show of the ground and the focal length.

use super::Intrinsics;
use super::rotating_camera::{RotatingCamera, rotating_camera};
use super::vanishing_points::{LineNormal, ViewSegments, horizon};
use crate::camera::{Camera, GUESSED_FOCAL_STD};
use crate::features::lines::ImageLines;
use crate::features::tracks::TrackTable;

/// A camera that does not translate.
pub struct HoveringCamera {
    /// Its rotations.
    pub rotations: RotatingCamera,
    /// The camera, with the focal length by straight lines.
    pub camera: Camera,
    /// Standard deviation of the focal length's logarithm.
    pub focal_std: f64,
    /// The ground's normal; `None` where straight lines show none.
    pub by_lines: Option<LineNormal>,
}

/// Error of a turn between views by a wrong focal length that no line shows, radians.
const SMALL_TURN: f64 = 0.002;

/// The camera of views that rotations explain; `None` for others.
///
/// * `lines` – of some of the views.
/// * `focal_std` – prior standard deviation of the focal length's logarithm; 0 holds it.
pub fn hovering_camera(
    table: &TrackTable,
    camera: &Camera,
    focal_std: f64,
    lines: &[ImageLines],
) -> Option<HoveringCamera> {
    let rotations = rotating_camera(table, camera)?;
    let posed = rotated(lines, table, &rotations);
    let Some((mut normal, mut log_focal)) = horizon(&posed, camera, focal_std) else {
        let focal_std = if focal_std == Intrinsics::GUESSED.focal { GUESSED_FOCAL_STD } else { focal_std };
        return Some(HoveringCamera { rotations, camera: *camera, focal_std, by_lines: None });
    };
    let rotations = rotating_camera(table, &camera.zoomed(log_focal[0].exp()))?;
    // Turns between the views depend on the focal length.
    let turn = posed.iter().map(|(pose, _)| pose.angle_to(&posed[0].0)).fold(0.0, f64::max);
    if turn * log_focal[0].abs() > SMALL_TURN {
        let posed = rotated(lines, table, &rotations);
        (normal, log_focal) = horizon(&posed, camera, focal_std).unwrap_or((normal, log_focal));
    }
    let camera = camera.zoomed(log_focal[0].exp());
    Some(HoveringCamera { rotations, camera, focal_std: log_focal[1], by_lines: Some(normal) })
}

/// The segments of views that have a rotation.
fn rotated<'a>(lines: &'a [ImageLines], table: &TrackTable, rotations: &RotatingCamera) -> Vec<ViewSegments<'a>> {
    let with_rotation = |lines: &'a ImageLines| {
        let mut views = table.views.iter().zip(&rotations.poses);
        let pose = views.find_map(|(view, pose)| pose.filter(|_| view.image == lines.image))?;
        Some((pose.rotation, lines.segments.as_slice()))
    };
    lines.iter().filter_map(with_rotation).collect()
}
