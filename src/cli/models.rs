//! Summary of structure from motion, in a few lines.

use std::fmt::Write;

use crate::camera::{Camera, HigherTerms};
use crate::math::rounding::counted;
use crate::pipeline::{ModelReport, Summary};

/// The background's model, its camera, and the model of every vehicle; empty before the background is reconstructed.
pub(super) fn as_text(summary: &Summary) -> String {
    let mut text = String::new();
    let Some(background) = &summary.background else { return text };
    // Writing to a string cannot fail.
    let _ = writeln!(text, "background: {}", model(background, summary.num_frames));
    if background.cameras.len() > 1 {
        for of in &background.cameras {
            let (id, width, height) = (of.id.0, of.camera.width, of.camera.height);
            let images = counted(of.frames.len(), "image");
            let _ = writeln!(text, "camera {id} ({images} of {width}x{height}): {}", lens(&of.camera));
        }
    } else if let Some(camera) = background.camera.filter(|_| background.num_registered > 0) {
        let _ = writeln!(text, "camera: {}", lens(&camera));
    }
    for (id, vehicle) in &summary.vehicles {
        let _ = writeln!(text, "vehicle {id}: {}", model(&vehicle.model, vehicle.model.num_visible));
    }
    text
}

fn lens(camera: &Camera) -> String {
    let [fx, fy, cx, cy, k1, k2] = camera.intrinsics();
    let focal = if fx == fy { format!("{fx:.2}") } else { format!("{fx:.2} {fy:.2}") };
    let HigherTerms { k3, tangential: [p1, p2] } = camera.higher;
    let higher = match camera.higher.are_zero() {
        true => String::new(),
        false => format!(", third {k3:.4}, tangential {p1:.4} {p2:.4}"),
    };
    format!("focal length {focal}, center {cx:.2} {cy:.2}, distortion {k1:.4} {k2:.4}{higher}")
}

fn model(report: &ModelReport, num_frames: usize) -> String {
    let error = report.mean_error_px.map(|e| format!(", mean reprojection error {e:.2} px")).unwrap_or_default();
    format!("{} of {num_frames} frames, {} points{error}", report.num_registered, report.num_points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::{CameraReport, Vehicle};
    use crate::scene::{CameraId, FrameId, ObjectId, TimeBase};

    #[test]
    fn the_summary_names_frames_points_camera_and_vehicles() {
        let camera = Camera::prior(1536, 1024).with_intrinsics([1379.046, 1379.046, 759.501, 502.852, -0.0001, 0.0021]);
        let background = ModelReport {
            num_registered: 11,
            num_points: 6271,
            mean_error_px: Some(0.0784),
            camera: Some(camera),
            ..ModelReport::default()
        };
        let vehicle = ModelReport { num_visible: 8, num_registered: 7, num_points: 90, ..ModelReport::default() };
        let mut summary = Summary {
            output: "out".into(),
            stages: Vec::new(),
            num_frames: 12,
            time_base: TimeBase::Seconds,
            background: Some(background),
            vehicles: [(ObjectId(3), Vehicle { model: vehicle, ..Vehicle::default() })].into(),
            warnings: Vec::new(),
        };
        assert_eq!(
            as_text(&summary),
            "background: 11 of 12 frames, 6271 points, mean reprojection error 0.08 px\n\
             camera: focal length 1379.05, center 759.50 502.85, distortion -0.0001 0.0021\n\
             vehicle 3: 7 of 8 frames, 90 points\n"
        );
        let of = |id: u32, width: u32, frames: &[u32]| CameraReport {
            id: CameraId(id),
            camera: Camera::with_focal(width, 600, 700.0),
            focal_std_px: None,
            frames: frames.iter().copied().map(FrameId).collect(),
        };
        if let Some(background) = &mut summary.background {
            background.cameras = vec![of(1, 800, &[0, 2]), of(3, 400, &[5])];
        }
        let text = as_text(&summary);
        assert!(text.contains("camera 1 (2 images of 800x600): focal length 700.00, center 400.00 300.00"), "{text}");
        assert!(text.contains("camera 3 (1 image of 400x600): "), "{text}");
        summary.background = None;
        assert_eq!(as_text(&summary), "");
    }
}
