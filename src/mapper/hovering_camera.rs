//! Camera that does not translate: rotations, and the ground and the focal length from straight lines.

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
    /// Its intrinsics, with the focal length estimated from straight lines.
    pub camera: Camera,
    /// Standard deviation of the focal length's logarithm.
    pub focal_std: f64,
    /// The ground's normal; `None` if straight lines do not determine it.
    pub by_lines: Option<LineNormal>,
}

/// Maximum error of a rotation between views by a wrong focal length that lines do not show, radians.
const SMALL_ROTATION: f64 = 0.002;

/// Estimates the camera of views that only rotate; `None` where rotations do not explain them.
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
    // The rotations between the views depend on the focal length.
    let rotation = posed.iter().map(|(pose, _)| pose.angle_to(&posed[0].0)).fold(0.0, f64::max);
    if rotation * log_focal[0].abs() > SMALL_ROTATION {
        let posed = rotated(lines, table, &rotations);
        (normal, log_focal) = horizon(&posed, camera, focal_std).unwrap_or((normal, log_focal));
    }
    let camera = camera.zoomed(log_focal[0].exp());
    Some(HoveringCamera { rotations, camera, focal_std: log_focal[1], by_lines: Some(normal) })
}

/// Segments of the views that have a rotation.
fn rotated<'a>(lines: &'a [ImageLines], table: &TrackTable, rotations: &RotatingCamera) -> Vec<ViewSegments<'a>> {
    let with_rotation = |lines: &'a ImageLines| {
        let mut views = table.views.iter().zip(&rotations.poses);
        let pose = views.find_map(|(view, pose)| pose.filter(|_| view.image == lines.image))?;
        Some((pose.rotation, lines.segments.as_slice()))
    };
    lines.iter().filter_map(with_rotation).collect()
}
