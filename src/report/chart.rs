//! Line charts and frame bars as numbers for the template, which draws them as SVG.
//!
//! The plotting area is a box of 1000 × 1000 stretched to the page; tick labels are text of the page, positioned in
//! per cent, which keeps their size on a phone.

use serde::Serialize;

use super::ticks::{Tick, number, ticks};
use super::timeline::Timeline;
use super::view::quantile;
use super::words::count;

/// Side of the plotting area in its own units.
const SIDE: f64 = 1000.0;
/// Maximum number of points per line; more are averaged in groups.
const MAX_POINTS: usize = 500;

/// One line.
#[derive(Clone, Debug, Default)]
pub(super) struct Line {
    pub label: String,
    /// A CSS color.
    pub colour: String,
    /// (time, value), ascending in time.
    pub points: Vec<(f64, f64)>,
    /// Dots instead of a line: for values independent of their neighbors.
    pub dots: bool,
    /// (time, low, high) of a band around the line; empty without one.
    pub band: Vec<(f64, f64, f64)>,
    /// Raw data of the line, drawn thin behind it; may be empty.
    pub raw: Vec<(f64, f64)>,
}

/// A horizontal mark across the chart.
#[derive(Clone, Debug)]
pub(super) struct Level {
    pub value: f64,
    /// Half width of the band around it.
    pub std: Option<f64>,
    pub colour: String,
}

/// A chart over time.
#[derive(Clone, Debug, Default)]
pub(super) struct Chart {
    pub title: String,
    pub caption: String,
    pub unit: String,
    pub lines: Vec<Line>,
    pub levels: Vec<Level>,
    /// True if the value axis starts at zero.
    pub from_zero: bool,
}

/// A chart in the form that the template draws.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Drawing {
    title: String,
    caption: String,
    unit: String,
    summary: String,
    lines: Vec<DrawnLine>,
    levels: Vec<DrawnLevel>,
    x_ticks: Vec<Tick>,
    y_ticks: Vec<Tick>,
    note: Option<String>,
    /// Decimals of a reading: one more than the ticks have.
    decimals: usize,
}

#[derive(Clone, Debug, Serialize)]
struct DrawnLine {
    label: String,
    colour: String,
    dots: bool,
    path: String,
    band: String,
    raw: String,
    range: String,
    /// Time and value, for the reading at the current time.
    samples: Vec<[f64; 2]>,
}

#[derive(Clone, Debug, Serialize)]
struct DrawnLevel {
    y: f64,
    band: Option<[f64; 2]>,
    colour: String,
}

impl Chart {
    /// The chart over the time of a run; `None` if no line has a point.
    pub fn draw(&self, timeline: &Timeline) -> Option<Drawing> {
        self.draw_over(timeline.span(), timeline.ticks())
    }

    /// The chart over any axis; `None` if no line has a point.
    pub fn draw_over(&self, span: (f64, f64), x_ticks: Vec<Tick>) -> Option<Drawing> {
        let lines = self.thinned()?;
        let range = self.range(&lines);
        Some(self.drawn(&lines, span, x_ticks, range))
    }

    /// The same with every value in range, including outliers.
    pub fn draw_whole(&self, span: (f64, f64), x_ticks: Vec<Tick>) -> Option<Drawing> {
        let lines = self.thinned()?;
        let values = || lines.iter().flat_map(|l| l.points.iter().map(|p| p.1));
        let low = if self.from_zero { 0.0 } else { values().fold(f64::INFINITY, f64::min) };
        let high = values().fold(f64::NEG_INFINITY, f64::max);
        let range = (low, high + (0.04 * (high - low)).max(1e-9));
        Some(self.drawn(&lines, span, x_ticks, range))
    }

    /// Lines thinned to the drawn number of points; `None` if none has a point.
    fn thinned(&self) -> Option<Vec<Line>> {
        let lines: Vec<Line> = self.lines.iter().map(thinned).filter(|l| !l.points.is_empty()).collect();
        (!lines.is_empty()).then_some(lines)
    }

    fn drawn(&self, lines: &[Line], span: (f64, f64), x_ticks: Vec<Tick>, range: (f64, f64)) -> Drawing {
        let (y_ticks, decimals) = ticks(range);
        let clipped = lines.iter().flat_map(|l| &l.points).filter(|(_, v)| *v < range.0 || *v > range.1).count();
        let place = |t: f64, v: f64| {
            let x = (t - span.0) / (span.1 - span.0).max(1e-9) * SIDE;
            (x, (1.0 - (v - range.0) / (range.1 - range.0)).clamp(0.0, 1.0) * SIDE)
        };
        let level = |l: &Level| {
            let y = |v: f64| place(0.0, v).1;
            let band = l.std.filter(|s| s.is_finite()).map(|s| [y(l.value + s), y(l.value - s)]);
            DrawnLevel { y: y(l.value), band, colour: l.colour.clone() }
        };
        let drawn: Vec<DrawnLine> = lines.iter().map(|l| drawn_line(l, place, decimals)).collect();
        let summary = drawn.iter().map(|l| format!("{}: {}", l.label, l.range)).collect::<Vec<_>>().join("; ");
        Drawing {
            title: self.title.clone(),
            caption: self.caption.clone(),
            unit: self.unit.clone(),
            summary,
            lines: drawn,
            levels: self.levels.iter().filter(|l| l.value >= range.0 && l.value <= range.1).map(level).collect(),
            x_ticks,
            y_ticks,
            note: (clipped > 0)
                .then(|| format!("{} outside the shown range, drawn at its edge.", count(clipped, "value"))),
            decimals: decimals + 1,
        }
    }

    /// Low and high end of the value axis: nearly all values, so that an outlier does not flatten the rest.
    fn range(&self, lines: &[Line]) -> (f64, f64) {
        let mut values: Vec<f64> = lines.iter().flat_map(|l| l.points.iter().map(|p| p.1)).collect();
        values.extend(lines.iter().flat_map(|l| l.band.iter().flat_map(|(_, low, high)| [*low, *high])));
        let (q1, q3) = (quantile(&mut values, 0.05), quantile(&mut values, 0.95));
        let slack = (q3 - q1).max(1e-12);
        let inside: Vec<f64> = values.iter().copied().filter(|v| *v >= q1 - slack && *v <= q3 + slack).collect();
        let fold = |f: fn(f64, f64) -> f64, start| inside.iter().copied().fold(start, f);
        let (mut low, mut high) = (fold(f64::min, f64::INFINITY), fold(f64::max, f64::NEG_INFINITY));
        for level in &self.levels {
            let wide = 4.0 * (high - low) + 0.2 * level.value.abs();
            if level.value > low - wide && level.value < high + wide {
                (low, high) = (low.min(level.value), high.max(level.value));
            }
        }
        if self.from_zero {
            low = low.min(0.0);
        }
        // A constant value must not appear to vary.
        let least = (0.02 * low.abs().max(high.abs())).max(1e-9);
        let pad = (0.08 * (high - low)).max(least);
        (if self.from_zero && low >= 0.0 { 0.0 } else { low - pad }, high + pad)
    }
}

fn thinned(line: &Line) -> Line {
    let usable: Vec<_> = line.points.iter().copied().filter(|(t, v)| t.is_finite() && v.is_finite()).collect();
    let run = usable.len().div_ceil(MAX_POINTS).max(1);
    let mean = |part: &[(f64, f64)]| {
        let n = part.len() as f64;
        (part.iter().map(|p| p.0).sum::<f64>() / n, part.iter().map(|p| p.1).sum::<f64>() / n)
    };
    let is_finite = |values: &[f64]| values.iter().all(|v| v.is_finite());
    let raw = line.raw.iter().step_by(run).copied().filter(|(t, v)| is_finite(&[*t, *v])).collect();
    let band = line.band.iter().step_by(run).copied().filter(|(t, a, b)| is_finite(&[*t, *a, *b])).collect();
    Line { points: usable.chunks(run).map(mean).collect(), raw, band, ..line.clone() }
}

fn drawn_line(line: &Line, place: impl Fn(f64, f64) -> (f64, f64), decimals: usize) -> DrawnLine {
    let mut steps: Vec<f64> = line.points.windows(2).map(|w| w[1].0 - w[0].0).collect();
    // Minimum gap that breaks a line, in typical steps.
    let gap = quantile(&mut steps, 0.5) * 1.6;
    let mut path = String::new();
    let mut last = f64::NEG_INFINITY;
    for &(t, v) in &line.points {
        let (x, y) = place(t, v);
        let alone = line.dots || t - last > gap;
        path += &format!("{}{x:.1} {y:.1}", if alone { "M" } else { "L" });
        // A line of no length with round caps is a dot.
        path += if alone { "h0" } else { "" };
        last = t;
    }
    let corner = |(t, v): (f64, f64)| {
        let (x, y) = place(t, v);
        format!("{x:.1} {y:.1}")
    };
    let raw = joined(line.raw.iter().copied().map(corner), "");
    let around = line.band.iter().map(|b| (b.0, b.2)).chain(line.band.iter().rev().map(|b| (b.0, b.1)));
    let band = joined(around.map(corner), "Z");
    let (low, high) = line.points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| (l.min(p.1), h.max(p.1)));
    DrawnLine {
        label: line.label.clone(),
        colour: line.colour.clone(),
        dots: line.dots,
        path,
        band,
        raw,
        range: format!("{} to {}", number(low, decimals + 1), number(high, decimals + 1)),
        samples: line.points.iter().map(|&(t, v)| [significant(t, 7), significant(v, 5)]).collect(),
    }
}

/// SVG path through the points; empty without any.
fn joined(corners: impl Iterator<Item = String>, end: &str) -> String {
    let corners: Vec<String> = corners.collect();
    if corners.is_empty() { String::new() } else { format!("M{}{end}", corners.join("L")) }
}

/// Rounded to a number of significant digits.
pub(super) fn significant(v: f64, digits: i32) -> f64 {
    if v == 0.0 || !v.is_finite() {
        return v;
    }
    let factor = 10f64.powi(digits - 1 - v.abs().log10().floor() as i32);
    let rounded = (v * factor).round() / factor;
    if rounded.is_finite() { rounded } else { v }
}

/// State of a frame in a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FrameState {
    /// Not in the image.
    Absent,
    /// In the image, camera not registered.
    Missing,
    /// Camera registered.
    Registered,
}

/// A row of frame bars.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Bars {
    pub label: String,
    pub colour: String,
    pub registered: usize,
    pub visible: usize,
    runs: Vec<Run>,
}

/// Neighboring frames in one state.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Run {
    x: f64,
    width: f64,
    missing: bool,
    title: String,
}

impl Bars {
    /// Frame bars of one state per frame of the timeline.
    pub fn new(label: String, colour: String, states: &[FrameState], timeline: &Timeline) -> Self {
        let count = |state| states.iter().filter(|s| **s == state).count();
        let registered = count(FrameState::Registered);
        let visible = registered + count(FrameState::Missing);
        Self { label, colour, registered, visible, runs: runs(states, timeline) }
    }
}

fn runs(states: &[FrameState], timeline: &Timeline) -> Vec<Run> {
    let times = timeline.times();
    let span = (times[times.len() - 1] - times[0]).max(1e-9);
    let x = |i: usize| ((times[i] - times[0]) / span * SIDE * 10.0).round() / 10.0;
    let mut runs = Vec::new();
    let mut start = 0;
    for chunk in states.chunk_by(|a, b| a == b) {
        let end = start + chunk.len();
        let name = match chunk[0] {
            FrameState::Absent => None,
            FrameState::Missing => Some("not registered"),
            FrameState::Registered => Some("registered"),
        };
        if let Some(name) = name {
            let title = format!("{name} in {}: {}", count(chunk.len(), "frame"), timeline.range_at(start, end - 1));
            let missing = chunk[0] == FrameState::Missing;
            runs.push(Run { x: x(start), width: x(end) - x(start), missing, title });
        }
        start = end;
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(points: Vec<(f64, f64)>) -> Line {
        Line { label: "a".into(), colour: "red".into(), points, ..Line::default() }
    }

    fn timeline(end: u32) -> Timeline {
        Timeline::of_frames(end)
    }

    fn chart(lines: Vec<Line>) -> Chart {
        let (title, caption, unit) = ("t".into(), "c".into(), "m".into());
        Chart { title, caption, unit, lines, ..Chart::default() }
    }

    #[test]
    fn bands_and_what_lines_are_made_from_are_drawn_behind_them() {
        let points: Vec<(f64, f64)> = (0..60).map(|k| (f64::from(k), 10.0)).collect();
        let band = points.iter().map(|(t, v)| (*t, v - 1.0, v + 1.0)).collect();
        let with_band = chart(vec![Line { raw: vec![(0.0, f64::NAN), (1.0, 9.0)], band, ..line(points) }]);
        let drawing = with_band.draw(&Timeline::of_frames(60)).unwrap();
        let drawn = &drawing.lines[0];
        assert!(drawn.band.ends_with('Z') && drawn.band.matches('L').count() == 119, "{}", drawn.band);
        assert!(drawn.raw.starts_with('M') && !drawn.raw.contains("NaN"), "{}", drawn.raw);
    }

    #[test]
    fn gap_breaks_the_line_and_an_outlier_does_not_flatten_it() {
        let mut points: Vec<_> =
            (0..30).filter(|i| !(10..14).contains(i)).map(|i| (f64::from(i), 5.0 + f64::from(i % 3))).collect();
        points[20].1 = 4000.0;
        let drawing = chart(vec![line(points)]).draw(&timeline(29)).unwrap();
        assert_eq!(drawing.lines[0].path.matches('M').count(), 2);
        assert!(drawing.y_ticks.iter().all(|t| t.label.len() <= 3), "{:?}", drawing.y_ticks);
        assert!(drawing.note.unwrap().starts_with("1 value outside"));
        assert!(chart(vec![line(vec![(0.0, f64::NAN)])]).draw(&timeline(1)).is_none());
    }

    #[test]
    fn long_lines_are_thinned() {
        let points = (0..10_000).map(|i| (f64::from(i), f64::from(i))).collect();
        let drawing = chart(vec![line(points)]).draw(&timeline(10_000)).unwrap();
        assert_eq!(drawing.lines[0].samples.len(), 500);
    }

    #[test]
    fn bars_follow_the_frames() {
        use FrameState::{Absent, Missing, Registered};
        let states = [Registered, Registered, Missing, Absent, Registered];
        let bars = Bars::new("b".into(), "red".into(), &states, &timeline(5));
        assert_eq!((bars.registered, bars.visible), (3, 4));
        let spans: Vec<_> = bars.runs.iter().map(|r| (r.x, r.width, r.missing)).collect();
        assert_eq!(bars.runs[0].title, "registered in 2 frames: frames 0 to 1");
        assert_eq!(spans, [(0.0, 400.0, false), (400.0, 200.0, true), (800.0, 200.0, false)]);
    }

    #[test]
    fn numbers_are_rounded_to_significant_digits() {
        assert_eq!(significant(0.001_234_56, 3), 0.001_23);
        assert_eq!(significant(-98_765.0, 2), -99_000.0);
        assert_eq!(significant(0.0, 3), 0.0);
    }
}
