//! What structure from motion found, in a few lines.

use std::fmt::Write;

use serde_json::Value;

use crate::pipeline::{Stage, StageRecord};

/// The background's model, its camera, and the model of every vehicle; empty before the background is reconstructed.
pub(super) fn as_text(stages: &[StageRecord]) -> String {
    let figure = |stage: Stage, name: &str| {
        stages.iter().find(|record| record.stage == stage).and_then(|record| record.marker.figures.get(name))
    };
    let mut text = String::new();
    let Some(registered) = figure(Stage::Background, "num_registered").and_then(Value::as_u64) else { return text };
    let frames = figure(Stage::Frames, "num_frames").and_then(Value::as_u64).unwrap_or(registered);
    let points = figure(Stage::Background, "num_points");
    let error = figure(Stage::Background, "mean_error_px");
    // Writing to a string cannot fail.
    let _ = writeln!(text, "background: {}", model(registered, frames, points, error));
    let numbers = figure(Stage::Background, "intrinsics").and_then(Value::as_array);
    let numbers: Option<Vec<f64>> = numbers.map(|values| values.iter().filter_map(Value::as_f64).collect());
    if let Some(&[fx, fy, cx, cy, k1, k2]) = numbers.as_deref().filter(|_| registered > 0) {
        let focal = if fx == fy { format!("{fx:.2}") } else { format!("{fx:.2} {fy:.2}") };
        let _ = writeln!(text, "camera: focal length {focal}, centre {cx:.2} {cy:.2}, distortion {k1:.4} {k2:.4}");
    }
    let objects = stages.iter().find(|record| record.stage == Stage::Objects);
    for (name, found) in objects.into_iter().flat_map(|record| &record.marker.figures) {
        let Some(id) = name.strip_prefix("object_") else { continue };
        let count = |key: &str| found.get(key).and_then(Value::as_u64).unwrap_or(0);
        let summary =
            model(count("num_registered"), count("num_visible"), found.get("num_points"), found.get("mean_error_px"));
        let _ = writeln!(text, "vehicle {id}: {summary}");
    }
    text
}

fn model(registered: u64, frames: u64, points: Option<&Value>, error: Option<&Value>) -> String {
    let points = points.and_then(Value::as_u64).unwrap_or(0);
    let error =
        error.and_then(Value::as_f64).map(|e| format!(", mean reprojection error {e:.2} px")).unwrap_or_default();
    format!("{registered} of {frames} frames, {points} points{error}")
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn the_summary_names_frames_points_camera_and_vehicles() {
        let record = |stage: Stage, figures: Value| {
            let marker = json!({ "fingerprint": "", "wall_s": 1.0, "cpu_s": 1.0, "peak_rss_mib": 1.0, "warnings": [],
                                 "figures": figures, "outputs": [] });
            StageRecord { stage, marker: serde_json::from_value(marker).unwrap(), reused: false }
        };
        let background = json!({ "num_registered": 11, "num_points": 6271, "mean_error_px": 0.0784,
                                 "intrinsics": [1379.046, 1379.046, 759.501, 502.852, -0.0001, 0.0021] });
        let vehicle = json!({ "num_visible": 8, "num_registered": 7, "num_points": 90, "mean_error_px": null });
        let stages = [
            record(Stage::Frames, json!({ "num_frames": 12 })),
            record(Stage::Background, background),
            record(Stage::Objects, json!({ "object_3": vehicle })),
        ];
        assert_eq!(
            as_text(&stages),
            "background: 11 of 12 frames, 6271 points, mean reprojection error 0.08 px\n\
             camera: focal length 1379.05, centre 759.50 502.85, distortion -0.0001 0.0021\n\
             vehicle 3: 7 of 8 frames, 90 points\n"
        );
        assert_eq!(as_text(&stages[..1]), "");
    }
}
