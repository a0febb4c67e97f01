//! Breakdown charts: error and reported σ over each swept quantity, as SVG.

use std::ops::Range;

use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::prelude::*;

use crate::eval::calibration::{Calibration, Case};
use crate::math::median;
use crate::report::ReportError;
use crate::report::svg::{self, Area, DrawResult, FONT};

/// Range of drawn errors, as shares: smaller and larger ones are drawn at the edge.
const ERRORS: Range<f64> = 0.0005..1.0;
/// Colors of error and reported σ.
const ERROR: RGBColor = RGBColor(0xb3, 0x26, 0x1e);
const STATED: RGBColor = RGBColor(0x1b, 0x62, 0xb5);

/// Sweep: the kind of variant, the title, the axis.
type Sweep = (&'static str, &'static str, &'static str, fn(&Case) -> Option<f64>);

const SWEEPS: [Sweep; 8] = [
    ("scale", "Size of the vehicle in the image", "longer side of its mask, pixels", |case| case.object_px),
    ("hidden", "Frames in which the vehicle is occluded", "share of the frames, %", |case| Some(100.0 * case.level)),
    ("erosion", "Masks that are too small", "eroded on every side, pixels", |case| Some(case.level)),
    ("dilation", "Masks that are too large", "dilated on every side, pixels", |case| Some(case.level)),
    ("jitter", "Jittering masks", "standard deviation of their position, pixels", |case| Some(case.level)),
    ("window", "Change of camera height", "share of the mean height, %", |case| Some(100.0 * case.climb?)),
    ("frames", "Number of frames", "frames", |case| Some(case.level)),
    ("noise", "Image noise", "standard deviation, gray levels of 255", |case| Some(case.level)),
];

/// Name and chart of every quantity swept over at least two levels.
///
/// # Errors
/// [`ReportError::Chart`] if one cannot be laid out.
pub fn breakdown_charts(calibration: &Calibration) -> Result<Vec<(&'static str, String)>, ReportError> {
    let chart = |(kind, title, axis, of): &Sweep| {
        let cases = calibration.cases.iter().filter(|case| case.kind == *kind);
        let cases: Vec<(f64, &Case)> = cases.filter_map(|case| Some((of(case)?, case))).collect();
        let mut levels: Vec<f64> = cases.iter().map(|(_, case)| case.level).collect();
        levels.sort_by(f64::total_cmp);
        levels.dedup();
        let chart = Chart { title, axis, cases, levels };
        (chart.levels.len() > 1).then(|| Ok((*kind, svg::drawn((640, 340), |area| chart.draw(area))?)))
    };
    SWEEPS.iter().filter_map(chart).collect()
}

/// Quantity of a case, drawn over the swept one.
type Quantity<'a> = &'a dyn Fn(&Case) -> Option<f64>;

struct Chart<'a> {
    title: &'static str,
    axis: &'static str,
    cases: Vec<(f64, &'a Case)>,
    levels: Vec<f64>,
}

impl Chart<'_> {
    /// x linear, or logarithmic where it spans more than a factor of four; y logarithmic.
    fn draw(&self, area: &Area<'_>) -> DrawResult {
        let least = self.cases.iter().map(|(x, _)| *x).fold(f64::INFINITY, f64::min);
        let most = self.cases.iter().map(|(x, _)| *x).fold(f64::NEG_INFINITY, f64::max);
        if least > 0.0 && most / least > 4.0 {
            let margin = (most / least).powf(0.05);
            return self.draw_over(area, (least / margin..most * margin).log_scale());
        }
        let margin = 0.05 * (most - least).max(1e-9);
        self.draw_over(area, least - margin..most + margin)
    }

    fn draw_over<X>(&self, area: &Area<'_>, x: X) -> DrawResult
    where
        X: AsRangedCoord<Value = f64>,
        X::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
    {
        let mut chart = ChartBuilder::on(area)
            .caption(self.title, (FONT, 16))
            .margin(8)
            .x_label_area_size(36)
            .y_label_area_size(56)
            .build_cartesian_2d(x, ERRORS.log_scale())?;
        let percent = |share: &f64| format!("{} %", 100.0 * share);
        chart.configure_mesh().x_desc(self.axis).y_label_formatter(&percent).draw()?;
        let drawn = |value: f64| value.clamp(ERRORS.start, ERRORS.end);
        for (x, case) in &self.cases {
            match case.error {
                Some(error) => {
                    chart.plotting_area().draw(&Circle::new((*x, drawn(error.abs())), 3, ERROR.mix(0.5).filled()))?;
                }
                // No ratio.
                None => chart.plotting_area().draw(&Cross::new((*x, 0.9 * ERRORS.end), 4, ERROR))?,
            }
            if let Some(std) = case.relative_std {
                chart.plotting_area().draw(&Circle::new((*x, drawn(std)), 3, STATED.mix(0.5).filled()))?;
            }
        }
        let error = |case: &Case| case.error.map(f64::abs);
        let lines: [(&str, RGBColor, Quantity<'_>); 2] =
            [("error of r", ERROR, &error), ("reported std", STATED, &|case| case.relative_std)];
        for (name, color, of) in lines {
            let medians = self.medians(of).into_iter().map(|(x, y)| (x, drawn(y)));
            chart
                .draw_series(LineSeries::new(medians, color.stroke_width(2)))?
                .label(name)
                .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], color.stroke_width(2)));
        }
        chart.configure_series_labels().background_style(WHITE.mix(0.8)).draw()?;
        Ok(())
    }

    /// The medians of every level.
    fn medians(&self, of: Quantity<'_>) -> Vec<(f64, f64)> {
        // The level of a window is its start, which its chart does not show.
        if self.cases.iter().any(|(_, case)| case.kind == "window") {
            return Vec::new();
        }
        let point = |level: &f64| {
            let here = || self.cases.iter().filter(|(_, case)| case.level == *level);
            Some((
                median(here().map(|(x, _)| *x).collect())?,
                median(here().filter_map(|(_, case)| of(case)).collect())?,
            ))
        };
        let mut points: Vec<(f64, f64)> = self.levels.iter().filter_map(point).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(level: f64, error: Option<f64>) -> Case {
        let kind = "noise".to_owned();
        Case { sequence: "a<b".into(), kind, level, error, relative_std: Some(0.01), ..Case::default() }
    }

    #[test]
    fn swept_quantities_have_a_chart_and_failures_a_cross() {
        let cases = vec![case(4.0, Some(0.01)), case(8.0, Some(-0.3)), case(32.0, None)];
        let one = Calibration { cases: cases[..1].to_vec(), ..Calibration::default() };
        assert!(breakdown_charts(&one).unwrap().is_empty());
        let charts = breakdown_charts(&Calibration { cases, ..one }).unwrap();
        assert_eq!((charts.len(), charts[0].0), (1, "noise"));
        let svg = &charts[0].1;
        assert_eq!(svg.matches("<circle").count(), 5);
        assert!(svg.contains("reported std") && !svg.contains("NaN") && !svg.contains("inf"));
    }
}
