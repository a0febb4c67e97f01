//! A comparison as a table for a terminal: a row per figure, a column per reconstruction.

use std::fmt;

use super::{
    Against, Basis, Camera, CameraDifferences, Comparison, Coverage, IntrinsicsPair, LIMITS_DEG, LengthUnit, Subject,
};
use crate::math::rounding::counted;

/// Images that the table lists.
const WORST: usize = 5;
/// Names of images that a line lists.
const NAMES: usize = 5;

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let rows = self.table();
        let columns = rows.iter().map(|(_, cells)| cells.len()).max().unwrap_or(0);
        let width = |texts: &mut dyn Iterator<Item = &String>| texts.map(|t| t.chars().count()).max().unwrap_or(0);
        let first = width(&mut rows.iter().map(|(label, _)| label));
        let widths: Vec<_> =
            (0..columns).map(|k| width(&mut rows.iter().filter_map(|(_, cells)| cells.get(k)))).collect();
        for (label, cells) in &rows {
            write!(f, "{label:first$}")?;
            for (cell, width) in cells.iter().zip(&widths) {
                write!(f, "  {cell:>width$}")?;
            }
            writeln!(f)?;
        }
        self.others.iter().try_for_each(|other| self.details(f, other))
    }
}

impl Comparison {
    /// Label and cells of each line, the reference's cell first; lines that nobody has anything for are left out.
    pub fn table(&self) -> Vec<(String, Vec<String>)> {
        let subjects: Vec<&Subject> =
            std::iter::once(&self.reference).chain(self.others.iter().map(|o| &o.subject)).collect();
        let of_all = |label: &str, cell: &dyn Fn(&Subject) -> Option<String>| {
            (label.to_owned(), subjects.iter().map(|s| cell(s).unwrap_or_else(|| "–".into())).collect::<Vec<_>>())
        };
        let of_others = |label: &str, cell: &dyn Fn(&Against) -> Option<String>| {
            let cells = self.others.iter().map(|o| cell(o).unwrap_or_else(|| "–".into()));
            (label.to_owned(), std::iter::once(String::new()).chain(cells).collect::<Vec<_>>())
        };
        let px = |value: Option<f64>| value.map(|v| format!("{v:.4}"));
        let cameras = |o: &Against| o.cameras.as_ref().ok().cloned();
        let length = match self.unit {
            LengthUnit::Metre => "m",
            LengthUnit::Reference => "units of the first",
        };
        let mut rows = vec![
            of_all("", &|s| Some(s.name.clone())),
            of_all("images", &|s| Some(s.figures.num_images.to_string())),
            of_all("points", &|s| Some(s.figures.num_points.to_string())),
            of_all("observations", &|s| Some(s.figures.num_observations.to_string())),
            of_all("mean track length", &|s| s.figures.mean_track_length.map(|v| format!("{v:.2}"))),
            of_all("mean error, px per observation", &|s| px(s.figures.reprojection.map(|r| r.mean_px))),
            of_all("mean error, px per point", &|s| px(s.figures.reprojection.map(|r| r.mean_per_point_px))),
            of_all("CPU s", &|s| s.cost.map(|c| format!("{:.1}", c.cpu_s))),
            of_all("peak MiB", &|s| s.cost.map(|c| format!("{:.0}", c.peak_rss_mib))),
            of_others("registered in both", &|o| Some(o.num_common.to_string())),
            of_others("only in the first", &|o| Some(o.only_in_reference.len().to_string())),
            of_others("not in the first", &|o| Some(o.only_in_other.len().to_string())),
            of_others("lost cameras", &|o| o.alignment.as_ref().ok().map(|a| a.lost.len().to_string())),
            of_others("scale", &|o| o.alignment.as_ref().ok().map(|a| figure(a.reference_from_other.scale))),
            of_others(&format!("centers, RMSE, {length}"), &|o| cameras(o).map(|c| figure(c.center_rmse))),
            of_others("  including lost cameras", &|o| with_lost(o).map(|c| figure(c.center_rmse_of_all))),
            of_others("  relative to the extent", &|o| cameras(o).map(|c| percent(c.center_share_of_extent))),
            of_others("  largest", &|o| cameras(o).map(|c| figure(c.center_max))),
            of_others("  within 1, 2, 3 std", &|o| o.coverage.as_ref().ok().map(shares)),
            of_others("rotations, mean", &|o| cameras(o).map(|c| format!("{:.4}°", c.rotation_mean_deg))),
            of_others("  largest", &|o| cameras(o).map(|c| format!("{:.4}°", c.rotation_max_deg))),
            of_others("focal length", &|o| {
                o.intrinsics.first().map(|i| format!("{:+.3} %", 100.0 * i.focal_difference))
            }),
        ];
        for (k, limit) in LIMITS_DEG.iter().enumerate() {
            let area = |o: &Against| o.relative.as_ref().ok().map(|r| format!("{:.4}", r.auc[k]));
            rows.push(of_others(&format!("relative poses, AUC at {limit}°"), &area));
        }
        rows.retain(|(_, cells)| cells.iter().any(|cell| !cell.is_empty() && cell != "–"));
        rows
    }

    fn details(&self, f: &mut fmt::Formatter<'_>, other: &Against) -> fmt::Result {
        writeln!(f, "\n{}", other.subject.name)?;
        if let Err(reason) = other.alignment.as_ref() {
            return writeln!(f, "  cannot be aligned: {reason}");
        }
        if let Ok(alignment) = other.alignment.as_ref() {
            let basis = match alignment.basis {
                Basis::Centers => "camera centers",
                Basis::CentersAndDirections => "camera centers and directions, since the centers are collinear",
            };
            writeln!(f, "  aligned by {} of {} {basis}", alignment.num_kept, other.num_common)?;
            names(f, "lost, excluded from the alignment", &alignment.lost)?;
        }
        names(f, "only in the first", &other.only_in_reference)?;
        names(f, "not in the first", &other.only_in_other)?;
        for pair in &other.intrinsics {
            writeln!(f, "  {}", intrinsics(pair))?;
        }
        for image in other.images.iter().take(WORST) {
            let (Some(center), Some(angle)) = (image.center, image.rotation_deg) else { continue };
            let lost = if image.lost { ", lost" } else { "" };
            writeln!(f, "  {}: center error {}, rotation error {angle:.4}°{lost}", image.name, figure(center))?;
        }
        let rest = other.images.len().saturating_sub(WORST);
        if rest > 0 {
            writeln!(f, "  … and {rest} more, each with less; all are in the JSON and on the page")
        } else {
            Ok(())
        }
    }
}

fn with_lost(other: &Against) -> Option<&CameraDifferences> {
    let has_lost = other.alignment.as_ref().is_ok_and(|a| !a.lost.is_empty());
    other.cameras.as_ref().ok().filter(|_| has_lost)
}

fn names(f: &mut fmt::Formatter<'_>, what: &str, names: &[String]) -> fmt::Result {
    if names.is_empty() {
        return Ok(());
    }
    let rest = names.len().saturating_sub(NAMES);
    let more = if rest > 0 { format!(" and {rest} more") } else { String::new() };
    writeln!(f, "  {what}: {}{more}", names[..names.len() - rest].join(", "))
}

fn intrinsics(pair: &IntrinsicsPair) -> String {
    let [reference, other] = pair.in_figures();
    let images = counted(pair.num_images, "image");
    format!("intrinsics of {images}: {reference}, here {other}")
}

impl IntrinsicsPair {
    /// The reference's and the other's, as text: size, focal lengths, principal point, distortion.
    pub fn in_figures(&self) -> [String; 2] {
        [&self.reference, &self.other].map(intrinsics_in_figures)
    }
}

/// Size and intrinsics of a camera in one line, pixels.
pub fn intrinsics_in_figures(camera: &Camera) -> String {
    let ([fx, fy], [cx, cy], [k1, k2]) = (camera.focal, camera.principal, camera.radial);
    let (width, height, more) = (camera.width, camera.height, camera.higher.in_figures());
    format!("{width} × {height}, f {fx:.2} {fy:.2}, c {cx:.2} {cy:.2}, k {k1:.5} {k2:.5}{more}")
}

/// Six significant digits.
fn figure(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e6).contains(&value.abs()) { format!("{value:.5e}") } else { format!("{value:.6}") }
}

fn shares(coverage: &Coverage) -> String {
    let [one, two, three] = coverage.within.map(|share| 100.0 * share);
    format!("{one:.0}, {two:.0}, {three:.0} %")
}

fn percent(share: f64) -> String {
    format!("{:.4} %", 100.0 * share)
}
