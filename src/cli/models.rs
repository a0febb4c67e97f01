//! What structure from motion found, in a few lines.

use std::fmt::Write;

use crate::pipeline::{ModelReport, Summary};

/// The background's model, its camera, and the model of every vehicle; empty before the background is reconstructed.
pub(super) fn as_text(summary: &Summary) -> String {
    let mut text = String::new();
    let Some(background) = &summary.background else { return text };
    // Writing to a string cannot fail.
    let _ = writeln!(text, "background: {}", model(background, summary.num_frames));
    if let Some(camera) = background.camera.filter(|_| background.num_registered > 0) {
        let [fx, fy, cx, cy, k1, k2] = camera.intrinsics();
        let focal = if fx == fy { format!("{fx:.2}") } else { format!("{fx:.2} {fy:.2}") };
        let _ = writeln!(text, "camera: focal length {focal}, centre {cx:.2} {cy:.2}, distortion {k1:.4} {k2:.4}");
    }
    for (id, vehicle) in &summary.vehicles {
        let _ = writeln!(text, "vehicle {id}: {}", model(&vehicle.model, vehicle.model.num_visible));
    }
    text
}

fn model(report: &ModelReport, num_frames: usize) -> String {
    let error = report.mean_error_px.map(|e| format!(", mean reprojection error {e:.2} px")).unwrap_or_default();
    format!("{} of {num_frames} frames, {} points{error}", report.num_registered, report.num_points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use crate::pipeline::Vehicle;
    use crate::scene::{ObjectId, TimeBase};

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
             camera: focal length 1379.05, centre 759.50 502.85, distortion -0.0001 0.0021\n\
             vehicle 3: 7 of 8 frames, 90 points\n"
        );
        summary.background = None;
        assert_eq!(as_text(&summary), "");
    }
}
