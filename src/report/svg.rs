//! SVG files of `plotters`.

use plotters::coord::Shift;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

use super::ReportError;

pub(super) const FONT: &str = "sans-serif";

/// Drawing area of a file.
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// The plotting area of a chart with two linear axes.
pub(super) type Plot<'a> = DrawingArea<SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
pub(super) type DrawResult = Result<(), Box<dyn std::error::Error>>;

/// An SVG file of a size in pixels, drawn by `draw`.
///
/// # Errors
/// [`ReportError::Chart`] if the chart cannot be laid out.
pub(super) fn drawn(size: (u32, u32), draw: impl FnOnce(&Area<'_>) -> DrawResult) -> Result<String, ReportError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, size).into_drawing_area();
        let all = || {
            area.fill(&WHITE)?;
            draw(&area)?;
            Ok(area.present()?)
        };
        all().map_err(|error: Box<dyn std::error::Error>| ReportError::Chart(error.to_string()))?;
    }
    Ok(svg)
}

/// Text without control characters, most of which XML forbids: names come from users' files.
pub(super) fn text(name: &str) -> String {
    name.replace(char::is_control, " ")
}
