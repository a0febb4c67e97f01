//! Where the method breaks down: error and stated deviation over what is swept, one chart each, as SVG.

use std::fmt::Write;

use crate::eval::calibration::{Calibration, Case};
use crate::math::median;

/// Size of a chart, and its margins left, right, top, bottom, pixels.
const SIZE: [f64; 2] = [640.0, 340.0];
const MARGINS: [f64; 4] = [62.0, 16.0, 36.0, 48.0];
/// Errors that are drawn, as shares: what is smaller or larger stands at the edge.
const ERRORS: [f64; 2] = [0.0005, 1.0];
/// Colours of error and stated deviation.
const ERROR: &str = "#b3261e";
const STATED: &str = "#1b62b5";

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

/// Name and chart of everything that was swept over at least two levels.
pub fn breakdown_charts(calibration: &Calibration) -> Vec<(&'static str, String)> {
    let chart = |sweep: &Sweep| {
        let (kind, title, axis, of) = *sweep;
        let cases: Vec<(f64, &Case)> = calibration
            .cases
            .iter()
            .filter(|case| case.kind == kind)
            .filter_map(|case| Some((of(case)?, case)))
            .collect();
        let mut levels: Vec<f64> = cases.iter().map(|(_, case)| case.level).collect();
        levels.sort_by(f64::total_cmp);
        levels.dedup();
        (levels.len() > 1).then(|| (kind, Chart::new(title, axis, &cases).svg(&cases, &levels)))
    };
    SWEEPS.iter().filter_map(chart).collect()
}

/// A chart: x linear, or logarithmic where it spans more than a decade; y logarithmic.
struct Chart {
    title: &'static str,
    axis: &'static str,
    range: [f64; 2],
    is_log: bool,
}

impl Chart {
    fn new(title: &'static str, axis: &'static str, cases: &[(f64, &Case)]) -> Self {
        let least = cases.iter().map(|(x, _)| *x).fold(f64::INFINITY, f64::min);
        let most = cases.iter().map(|(x, _)| *x).fold(f64::NEG_INFINITY, f64::max);
        let is_log = least > 0.0 && most / least > 4.0;
        let room = if is_log { (most / least).powf(0.05) } else { 0.05 * (most - least).max(1e-9) };
        let range = if is_log { [least / room, most * room] } else { [least - room, most + room] };
        Self { title, axis, range, is_log }
    }

    fn x(&self, value: f64) -> f64 {
        let [left, right, ..] = MARGINS;
        let along = |v: f64| if self.is_log { v.ln() } else { v };
        let [least, most] = self.range.map(along);
        left + (along(value) - least) / (most - least) * (SIZE[0] - left - right)
    }

    fn y(value: f64) -> f64 {
        let [.., top, bottom] = MARGINS;
        let [least, most] = ERRORS.map(f64::ln);
        let share = (value.clamp(ERRORS[0], ERRORS[1]).ln() - least) / (most - least);
        SIZE[1] - bottom - share * (SIZE[1] - top - bottom)
    }

    fn svg(&self, cases: &[(f64, &Case)], levels: &[f64]) -> String {
        let mut svg = self.frame();
        for (x, case) in cases {
            let x = self.x(*x);
            let name = format!("{}, {}", case.sequence, case.variant);
            match case.error {
                Some(error) => dot(&mut svg, x, error.abs(), ERROR, &name),
                None => cross(&mut svg, x, &name),
            }
            if let Some(std) = case.relative_std {
                dot(&mut svg, x + 3.0, std, STATED, &name);
            }
        }
        // The level of a window is where it begins, which is not what its chart shows.
        let levels = if cases.iter().any(|(_, case)| case.kind == "window") { &[] } else { levels };
        self.line(&mut svg, cases, levels, ERROR, |case| case.error.map(f64::abs));
        self.line(&mut svg, cases, levels, STATED, |case| case.relative_std);
        svg + "</svg>\n"
    }

    /// The medians of every level, joined.
    fn line(
        &self,
        svg: &mut String,
        cases: &[(f64, &Case)],
        levels: &[f64],
        colour: &str,
        of: impl Fn(&Case) -> Option<f64>,
    ) {
        let point = |level: &f64| {
            let here = || cases.iter().filter(|(_, case)| case.level == *level);
            let x = median(here().map(|(x, _)| *x).collect())?;
            let y = median(here().filter_map(|(_, case)| of(case)).collect())?;
            Some((x, y))
        };
        let mut points: Vec<(f64, f64)> = levels.iter().filter_map(point).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let path: Vec<String> = points.iter().map(|(x, y)| format!("{:.1},{:.1}", self.x(*x), Self::y(*y))).collect();
        let _ =
            write!(svg, r#"<polyline points="{}" fill="none" stroke="{colour}" stroke-width="2"/>"#, path.join(" "));
    }

    fn frame(&self) -> String {
        let [width, height] = SIZE;
        let [left, right, top, bottom] = MARGINS;
        let (right, bottom) = (width - right, height - bottom);
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
             font-size=\"12\" fill=\"#333\"><rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>"
        );
        text(&mut svg, [left, 20.0], "start", "font-size=\"14\" font-weight=\"bold\"", self.title);
        text(&mut svg, [right - 110.0, 20.0], "end", &format!("fill=\"{ERROR}\""), "error of r");
        text(&mut svg, [right, 20.0], "end", &format!("fill=\"{STATED}\""), "reported std");
        for share in [0.001, 0.01, 0.1, 1.0] {
            let y = Self::y(share);
            rule(&mut svg, [left, right], [y, y]);
            text(&mut svg, [left - 6.0, y + 4.0], "end", "", &format!("{} %", 100.0 * share));
        }
        for value in self.ticks() {
            let x = self.x(value);
            rule(&mut svg, [x, x], [top, bottom]);
            text(&mut svg, [x, bottom + 16.0], "middle", "", &value.to_string());
        }
        text(&mut svg, [0.5 * (left + right), height - 10.0], "middle", "", self.axis);
        svg
    }

    /// Round numbers within the range.
    fn ticks(&self) -> Vec<f64> {
        let [least, most] = self.range;
        let steps: Vec<f64> = match self.is_log {
            true => (-3..6).flat_map(|power| [1.0, 2.0, 5.0].map(|digit| digit * 10f64.powi(power))).collect(),
            false => {
                let rough = (most - least) / 6.0;
                let power = 10f64.powf(rough.log10().floor());
                let step = [1.0, 2.0, 5.0, 10.0].map(|d| d * power).into_iter().find(|s| *s >= rough).unwrap_or(rough);
                (0..60).map(|k| (least / step).floor() * step + f64::from(k) * step).collect()
            }
        };
        let rounded = |v: f64| (v * 1e6).round() / 1e6;
        steps.into_iter().map(rounded).filter(|v| (least..=most).contains(v)).collect()
    }
}

fn dot(svg: &mut String, x: f64, value: f64, colour: &str, name: &str) {
    let (y, name, percent) = (Chart::y(value), escaped(name), 100.0 * value);
    // Writing to a string cannot fail.
    let _ = write!(
        svg,
        "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"2.6\" fill=\"{colour}\" fill-opacity=\"0.5\">\
         <title>{name}: {percent:.2} %</title></circle>"
    );
}

/// Where there is no ratio.
fn cross(svg: &mut String, x: f64, name: &str) {
    let (y, name) = (MARGINS[2] + 8.0, escaped(name));
    let _ = write!(
        svg,
        "<text x=\"{x:.1}\" y=\"{y:.1}\" fill=\"{ERROR}\" text-anchor=\"middle\">×\
         <title>{name}: no ratio</title></text>"
    );
}

fn text(svg: &mut String, [x, y]: [f64; 2], anchor: &str, style: &str, said: &str) {
    let said = escaped(said);
    let _ = write!(svg, "<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" {style}>{said}</text>");
}

fn rule(svg: &mut String, [x1, x2]: [f64; 2], [y1, y2]: [f64; 2]) {
    let _ = write!(svg, "<path d=\"M{x1:.1} {y1:.1}L{x2:.1} {y2:.1}\" stroke=\"#ddd\"/>");
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn case(level: f64, error: Option<f64>) -> Case {
        let kind = "noise".to_owned();
        Case { sequence: "a<b".into(), kind, level, error, relative_std: Some(0.01), ..Case::default() }
    }

    #[test]
    fn what_is_swept_has_a_chart_and_what_failed_a_cross() {
        let cases = vec![case(4.0, Some(0.01)), case(8.0, Some(-0.3)), case(32.0, None)];
        let one = Calibration {
            version: 1,
            program: String::new(),
            arguments: vec![],
            cases: cases[..1].to_vec(),
            spreads: vec![],
        };
        assert!(breakdown_charts(&one).is_empty());
        let charts = breakdown_charts(&Calibration { cases, ..one });
        assert_eq!((charts.len(), charts[0].0), (1, "noise"));
        let svg = &charts[0].1;
        assert_eq!(svg.matches("<circle").count(), 5);
        assert!(svg.contains("no ratio") && svg.contains("a&lt;b") && !svg.contains("NaN") && !svg.contains("inf"));
    }
}
