//! Grouped bar charts as SVG files, drawn like the paper's two: a group per trajectory, a colour per vehicle, a filling
//! per estimator.
//!
//! A bar that failed is a cross on the axis, one that is higher than the chart is cut and carries its value. Next to a
//! bar may stand a published value (a ring) and the value that a perfect estimator would have reached (a line across
//! it).

use std::fmt::Write;

use super::chart::ticks;

/// Size of the picture and of the margins round its plotting area, pixels.
const WIDTH: f64 = 1200.0;
const HEIGHT: f64 = 450.0;
const LEFT: f64 = 66.0;
const RIGHT: f64 = 12.0;
const TOP: f64 = 112.0;
const BOTTOM: f64 = 34.0;

/// Share of a group's and of a cluster's width that is left empty.
const GROUP_GAP: f64 = 0.10;
const CLUSTER_GAP: f64 = 0.16;

/// Values above this multiple of their 85 % quantile are cut, so that a few do not flatten the rest.
const WILD: f64 = 3.0;
const QUANTILE: f64 = 0.85;

/// Fill colours of the clusters, distinguished also by the colour-blind (after Okabe and Ito).
const COLOURS: [&str; 7] = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9", "#777777"];

/// Filling of a bar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Filling {
    /// Lines across white.
    Hatched,
    /// A light tint.
    Pale,
    /// The full colour.
    Solid,
}

/// The height of a bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Height {
    /// There is no such bar.
    Absent,
    /// There should be one.
    Failed,
    /// There is one.
    Value(f64),
}

/// One bar.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Bar {
    pub height: Height,
    /// A published value to compare with.
    pub published: Option<f64>,
    /// The best that could be reached.
    pub floor: Option<f64>,
    /// Shown when the pointer rests on it.
    pub title: String,
}

/// A chart: `bars[group][cluster][filling]`.
#[derive(Clone, Debug)]
pub(super) struct BarChart {
    pub title: String,
    pub y_label: String,
    pub groups: Vec<String>,
    pub clusters: Vec<String>,
    pub fillings: Vec<(Filling, String)>,
    pub bars: Vec<Vec<Vec<Bar>>>,
}

impl BarChart {
    /// The chart as an SVG file.
    pub fn svg(&self) -> String {
        let top = self.top();
        let mut out = String::new();
        let _ = writeln!(
            out,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" \
             height=\"{HEIGHT}\" font-family=\"system-ui, sans-serif\" font-size=\"12\">\n<title>{}</title>\n\
             <rect width=\"100%\" height=\"100%\" fill=\"#fff\"/>",
            escaped(&self.title)
        );
        self.hatches(&mut out);
        self.legend(&mut out);
        self.axis(&mut out, top);
        let group_width = (WIDTH - LEFT - RIGHT) / self.groups.len().max(1) as f64;
        for (k, (name, clusters)) in self.groups.iter().zip(&self.bars).enumerate() {
            let x = LEFT + k as f64 * group_width;
            let middle = x + group_width / 2.0;
            let y = HEIGHT - BOTTOM + 20.0;
            let _ = writeln!(out, "<text x=\"{middle:.1}\" y=\"{y}\" text-anchor=\"middle\">{}</text>", escaped(name));
            if k > 0 {
                line(&mut out, [x, TOP, x, HEIGHT - BOTTOM], "#ddd", 1.0);
            }
            let inner = group_width * (1.0 - GROUP_GAP);
            let cluster_width = inner / self.clusters.len().max(1) as f64;
            for (c, bars) in clusters.iter().enumerate() {
                let x = x + (group_width - inner) / 2.0 + c as f64 * cluster_width;
                let bar_width = cluster_width * (1.0 - CLUSTER_GAP) / self.fillings.len().max(1) as f64;
                for (f, bar) in bars.iter().enumerate() {
                    let x = x + cluster_width * CLUSTER_GAP / 2.0 + f as f64 * bar_width;
                    draw(&mut out, bar, self.fill(c, f), COLOURS[c % COLOURS.len()], x, bar_width, top);
                }
            }
        }
        line(&mut out, [LEFT, HEIGHT - BOTTOM, WIDTH - RIGHT, HEIGHT - BOTTOM], "#333", 1.0);
        out + "</svg>\n"
    }

    /// Upper end of the value axis.
    fn top(&self) -> f64 {
        let bars = self.bars.iter().flatten().flatten();
        let of = |bar: &Bar| [height(bar), bar.published, bar.floor];
        let mut values: Vec<f64> = bars.flat_map(of).flatten().filter(|v| v.is_finite() && *v > 0.0).collect();
        values.sort_by(f64::total_cmp);
        let Some(&largest) = values.last() else { return 1.0 };
        let usual = values[((values.len() - 1) as f64 * QUANTILE) as usize];
        1.08 * largest.min(WILD * usual)
    }

    fn fill(&self, cluster: usize, filling: usize) -> String {
        let colour = COLOURS[cluster % COLOURS.len()];
        match self.fillings.get(filling).map(|f| f.0) {
            Some(Filling::Hatched) => format!("fill=\"url(#hatch{})\"", cluster % COLOURS.len()),
            Some(Filling::Pale) => format!("fill=\"{colour}\" fill-opacity=\"0.35\""),
            _ => format!("fill=\"{colour}\""),
        }
    }

    fn hatches(&self, out: &mut String) {
        out.push_str("<defs>\n");
        for (k, colour) in COLOURS.iter().enumerate().take(self.clusters.len().max(1)) {
            let _ = writeln!(
                out,
                "<pattern id=\"hatch{k}\" width=\"5\" height=\"5\" patternUnits=\"userSpaceOnUse\" \
                 patternTransform=\"rotate(45)\"><rect width=\"5\" height=\"5\" fill=\"#fff\"/><line x1=\"1\" y1=\"0\" \
                 x2=\"1\" y2=\"5\" stroke=\"{colour}\" stroke-width=\"2\"/></pattern>"
            );
        }
        out.push_str("</defs>\n");
    }

    fn legend(&self, out: &mut String) {
        let _ = writeln!(
            out,
            "<text x=\"{LEFT}\" y=\"22\" font-size=\"15\" font-weight=\"600\">{}</text>",
            escaped(&self.title)
        );
        let mut x = LEFT;
        for (c, name) in self.clusters.iter().enumerate() {
            let colour = COLOURS[c % COLOURS.len()];
            x = entry(out, x, 46.0, name, |out, x| swatch(out, x, 46.0, &format!("fill=\"{colour}\""), colour));
        }
        let mut x = LEFT;
        for (filling, name) in &self.fillings {
            let fill = match filling {
                Filling::Hatched => format!("fill=\"url(#hatch{})\"", 0),
                Filling::Pale => format!("fill=\"{}\" fill-opacity=\"0.35\"", COLOURS[0]),
                Filling::Solid => format!("fill=\"{}\"", COLOURS[0]),
            };
            x = entry(out, x, 70.0, name, |out, x| swatch(out, x, 70.0, &fill, COLOURS[0]));
        }
        let bars: Vec<&Bar> = self.bars.iter().flatten().flatten().collect();
        if bars.iter().any(|bar| bar.published.is_some()) {
            x = entry(out, x, 70.0, "published by the paper", |out, x| ring(out, x + 6.0, 66.0));
        }
        if bars.iter().any(|bar| bar.floor.is_some()) {
            let name = "at the reference ratio";
            x = entry(out, x, 70.0, name, |out, x| line(out, [x, 66.0, x + 12.0, 66.0], "#000", 2.0));
        }
        if bars.iter().any(|bar| bar.height == Height::Failed) {
            entry(out, x, 70.0, "failed", |out, x| cross(out, x + 6.0, 66.0));
        }
    }

    fn axis(&self, out: &mut String, top: f64) {
        let middle = (TOP + HEIGHT - BOTTOM) / 2.0;
        let _ = writeln!(
            out,
            "<text transform=\"translate(16 {middle}) rotate(-90)\" text-anchor=\"middle\">{}</text>",
            escaped(&self.y_label)
        );
        for tick in ticks((0.0, top)).0 {
            let y = HEIGHT - BOTTOM - tick.at / 100.0 * (HEIGHT - BOTTOM - TOP);
            line(out, [LEFT, y, WIDTH - RIGHT, y], "#e4e4e4", 1.0);
            let (x, y) = (LEFT - 8.0, y + 4.0);
            let _ = writeln!(out, "<text x=\"{x}\" y=\"{y:.1}\" text-anchor=\"end\">{}</text>", tick.label);
        }
    }
}

fn height(bar: &Bar) -> Option<f64> {
    match bar.height {
        Height::Value(value) => Some(value),
        _ => None,
    }
}

fn draw(out: &mut String, bar: &Bar, fill: String, colour: &str, x: f64, width: f64, top: f64) {
    let (base, scale) = (HEIGHT - BOTTOM, (HEIGHT - BOTTOM - TOP) / top);
    let y = |value: f64| base - value.clamp(0.0, top) * scale;
    let middle = x + width / 2.0;
    let _ = writeln!(out, "<g><title>{}</title>", escaped(&bar.title));
    match bar.height {
        Height::Absent => {}
        Height::Failed => cross(out, middle, base - 6.0),
        Height::Value(value) => {
            let y = y(value);
            let (width, height) = (width - 0.8, base - y);
            let _ = writeln!(
                out,
                "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{height:.2}\" {fill} \
                 stroke=\"{colour}\" stroke-width=\"0.8\"/>"
            );
            if value > top {
                let _ = writeln!(
                    out,
                    "<text transform=\"translate({:.1} {:.1}) rotate(-90)\" font-size=\"10\">{value:.2}</text>",
                    middle + 3.5,
                    TOP - 3.0
                );
            }
        }
    }
    if let Some(floor) = bar.floor.filter(|floor| *floor <= top) {
        line(out, [x - 1.0, y(floor), x + width, y(floor)], "#000", 2.0);
    }
    if let Some(published) = bar.published {
        // Above the chart the ring sits on its edge; the pointer's text has the value.
        ring(out, middle, y(published));
    }
    out.push_str("</g>\n");
}

/// An entry of the legend; gives where the next one begins.
fn entry(out: &mut String, x: f64, y: f64, name: &str, symbol: impl FnOnce(&mut String, f64)) -> f64 {
    symbol(out, x);
    let _ = writeln!(out, "<text x=\"{:.1}\" y=\"{y}\">{}</text>", x + 18.0, escaped(name));
    x + 40.0 + 6.6 * name.chars().count() as f64
}

fn swatch(out: &mut String, x: f64, y: f64, fill: &str, colour: &str) {
    let y = y - 10.0;
    let _ = writeln!(out, "<rect x=\"{x:.1}\" y=\"{y}\" width=\"12\" height=\"12\" {fill} stroke=\"{colour}\"/>");
}

fn ring(out: &mut String, x: f64, y: f64) {
    let _ = writeln!(
        out,
        "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"#fff\" fill-opacity=\"0.8\" stroke=\"#000\" \
         stroke-width=\"1.2\"/>"
    );
}

fn cross(out: &mut String, x: f64, y: f64) {
    line(out, [x - 4.0, y - 4.0, x + 4.0, y + 4.0], "#c00", 2.0);
    line(out, [x - 4.0, y + 4.0, x + 4.0, y - 4.0], "#c00", 2.0);
}

fn line(out: &mut String, [x1, y1, x2, y2]: [f64; 4], colour: &str, width: f64) {
    let _ = writeln!(
        out,
        "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" stroke=\"{colour}\" \
         stroke-width=\"{width}\"/>"
    );
}

/// Text that cannot become markup: names come from other people's files.
fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            // XML has no way to write most control characters.
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bar(height: Height) -> Bar {
        Bar { height, published: None, floor: None, title: "t".into() }
    }

    fn chart(heights: &[Height]) -> BarChart {
        BarChart {
            title: "<b> & \"c\"\u{7}".into(),
            y_label: "metres".into(),
            groups: vec!["left".into(), "right".into()],
            clusters: vec!["van".into()],
            fillings: heights.iter().map(|_| (Filling::Solid, "x".into())).collect(),
            bars: vec![vec![heights.iter().map(|h| bar(*h)).collect()]; 2],
        }
    }

    #[test]
    fn bars_are_drawn_to_scale() {
        let svg = chart(&[Height::Value(1.0), Height::Value(0.5), Height::Absent]).svg();
        let heights: Vec<f64> = svg
            .lines()
            .filter(|line| line.starts_with("<rect x=") && line.contains("stroke-width"))
            .map(|line| line.split("height=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap())
            .collect();
        assert_eq!(heights.len(), 4);
        assert!((heights[0] / heights[1] - 2.0).abs() < 1e-2, "{heights:?}");
        assert!(heights[0] > 0.9 * (HEIGHT - TOP - BOTTOM) && heights[0] < HEIGHT - TOP - BOTTOM);
    }

    #[test]
    fn failed_bars_are_crosses_and_wild_ones_carry_their_value() {
        let mut heights = vec![Height::Value(1.0); 9];
        heights.extend([Height::Value(50.0), Height::Failed]);
        let svg = chart(&heights).svg();
        assert_eq!(svg.matches(">50.00</text>").count(), 2);
        assert_eq!(svg.matches("#c00").count(), 6, "two crosses and the legend's");
        assert!(svg.contains(">failed</text>") && !svg.contains("published"));
    }

    #[test]
    fn names_are_text_and_never_markup() {
        let svg = chart(&[Height::Value(1.0)]).svg();
        assert!(svg.contains("&lt;b&gt; &amp; &quot;c&quot; ") && !svg.contains("<b>"));
    }
}
