//! The figures as a table for a terminal.

use std::fmt;

use super::figures::{Alternative, AsReconstructedFigures, Evaluation};
use super::outcome::Outcome;
use super::trajectory::TrajectoryError;

impl fmt::Display for Evaluation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rows = self.rows();
        let width = rows.iter().map(|(label, _)| label.chars().count()).max().unwrap_or(0);
        rows.iter().try_for_each(|(label, value)| writeln!(f, "{label:width$}  {value}"))
    }
}

impl Evaluation {
    /// Label and value of each line.
    fn rows(&self) -> Vec<(String, String)> {
        let mut rows = Vec::new();
        let mut row = |label: &str, value: String| rows.push((label.to_string(), value));
        row("sequence", self.sequence.clone());
        let registered = &self.registered;
        row("background frames", fraction(registered.num_background, registered.num_frames));
        row("object frames", fraction(registered.num_object, registered.num_visible));
        if let (Some(num), Some(of)) = (registered.num_object_clear, registered.num_clear) {
            row("  at least 30 % of it visible", fraction(num, of));
            if let Some(num) = registered.num_placed_clear {
                row("    with a position", fraction(num, of));
            }
        }
        row(
            "target",
            text(&self.target, |t| match t.iou {
                Some(iou) => format!("object {} (mask overlap {iou:.3})", t.object),
                None => format!("object {} (no masks to compare)", t.object),
            }),
        );
        row("camera centers", text(&self.cameras, |c| format!("{} (RMSE)", length(c.center_rmse_m))));
        row(
            "camera rotations",
            text(&self.cameras, |c| format!("{:.4}° mean, {:.4}° maximum", c.rotation_mean_deg, c.rotation_max_deg)),
        );
        row("trajectory error", text(&self.trajectory, trajectory));
        row("  at the reference ratio", text(&self.trajectory_at_reference, |t| length(t.mean_m)));
        row(
            "scale ratio",
            text(&self.scale, |s| {
                let degenerate = if s.degenerate { ", degenerate" } else { "" };
                format!("{:.6} ({}{degenerate}{})", s.ratio, s.method.name(), deviation(s.deviation))
            }),
        );
        row("  reference", text(&self.reference_scale, |r| format!("{:.6}", r.ratio)));
        for (method, answer) in &self.alternatives {
            row(&format!("  {}", method.name()), alternative(answer));
        }
        if let Some(before) = &self.as_reconstructed {
            let reference = |b: &AsReconstructedFigures| {
                format!("{:.6}, error {}", b.reference_ratio, length(b.error_at_reference_m))
            };
            row("as reconstructed: reference", text(before, reference));
            for (method, answer) in before.as_ref().ok().iter().flat_map(|before| &before.alternatives) {
                row(&format!("  {}", method.name()), alternative(answer));
            }
        }
        for (method, answer) in &self.references {
            let found = answer.found.as_ref().filter(|_| answer.undetermined.is_none());
            let undetermined = || answer.undetermined.clone().unwrap_or_default();
            row(&format!("  {}", method.name()), found.map_or_else(undetermined, alternative));
        }
        rows
    }
}

fn trajectory(error: &TrajectoryError) -> String {
    let share = error.mean_share_of_distance;
    let share =
        share.map_or(String::new(), |share| format!(", {:.2} % of the distance from the camera", 100.0 * share));
    format!("{} (mean){share}", length(error.mean_m))
}

fn alternative(answer: &Alternative) -> String {
    let error = answer.trajectory_error_m.map_or(String::new(), |m| format!(", error {}", length(m)));
    format!("{:.6}{}{error}", answer.ratio, deviation(answer.deviation))
}

fn text<T>(outcome: &Outcome<T>, show: impl FnOnce(&T) -> String) -> String {
    outcome.as_ref().map_or_else(|reason| format!("– ({reason})"), show)
}

fn fraction(count: usize, of: usize) -> String {
    if of == 0 { "0 of 0".into() } else { format!("{count} of {of} ({:.1} %)", 100.0 * count as f64 / of as f64) }
}

fn deviation(deviation: Option<f64>) -> String {
    deviation.map_or(String::new(), |d| format!(", error {:.2} %", 100.0 * d))
}

/// Metres, or millimetres where that is easier to read.
fn length(metres: f64) -> String {
    if metres < 0.01 { format!("{:.2} mm", 1000.0 * metres) } else { format!("{metres:.3} m") }
}
