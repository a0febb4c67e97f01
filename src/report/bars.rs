//! Grouped bar charts as SVG files, arranged like the paper's two: a group per trajectory, a color per vehicle, a
//! filling per estimator.
//!
//! A failed bar is a cross on the axis; a bar that exceeds the chart is clipped and labeled with its value. A bar may
//! have a published value (a ring) and the value of a perfect estimator (a line across it).

use plotters::prelude::*;

use super::svg::{self, Area, DrawResult, FONT};

/// Size of a chart, pixels.
const SIZE: (u32, u32) = (1200, 450);

/// Height of one of several stacked charts, pixels.
const PANEL_PX: u32 = 230;

/// Colors of the clusters, distinguished also by the color-blind (after Okabe and Ito).
const COLORS: [RGBColor; 7] = [
    RGBColor(0x00, 0x72, 0xb2),
    RGBColor(0xe6, 0x9f, 0x00),
    RGBColor(0x00, 0x9e, 0x73),
    RGBColor(0xcc, 0x79, 0xa7),
    RGBColor(0xd5, 0x5e, 0x00),
    RGBColor(0x56, 0xb4, 0xe9),
    RGBColor(0x77, 0x77, 0x77),
];

/// Filling of a bar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Filling {
    /// The outline only.
    Outline,
    /// A light tint.
    Pale,
    /// The full color.
    Solid,
}

/// The height of a bar.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Height {
    /// No bar.
    Absent,
    /// Failed bar.
    Failed,
    /// Value undetermined by the data.
    Undetermined,
    /// Height of the bar.
    Value(f64),
}

/// One bar.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Bar {
    pub height: Height,
    /// A published value for comparison.
    pub published: Option<f64>,
    /// The value of a perfect estimator.
    pub floor: Option<f64>,
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

/// Stacked charts as one SVG file.
///
/// # Errors
/// [`ReportError::Chart`](super::ReportError::Chart) if it cannot be laid out.
pub(super) fn panels_svg(charts: &[BarChart]) -> Result<String, super::ReportError> {
    let count = charts.len().max(1);
    let height = PANEL_PX.saturating_mul(u32::try_from(count).unwrap_or(u32::MAX));
    svg::drawn((SIZE.0, height), |area| {
        charts.iter().zip(area.split_evenly((count, 1))).try_for_each(|(chart, part)| chart.draw(&part))
    })
}

impl BarChart {
    /// The chart as an SVG file.
    ///
    /// # Errors
    /// [`ReportError::Chart`](super::ReportError::Chart) if it cannot be laid out.
    pub fn svg(&self) -> Result<String, super::ReportError> {
        svg::drawn(SIZE, |area| self.draw(area))
    }

    fn draw(&self, area: &Area<'_>) -> DrawResult {
        let (plot, legend) = area.split_horizontally(SIZE.0 as i32 - 190);
        self.draw_legend(&legend)?;
        let top = self.top();
        let mut chart = ChartBuilder::on(&plot)
            .caption(svg::text(&self.title), (FONT, 16))
            .margin(8)
            .x_label_area_size(28)
            .y_label_area_size(64)
            .build_cartesian_2d(0.0..self.groups.len().max(1) as f64, 0.0..top)?;
        // Ten minor grid lines per interval would be most of the file.
        let mut mesh = chart.configure_mesh();
        mesh.disable_x_mesh().disable_x_axis().max_light_lines(1).y_desc(svg::text(&self.y_label)).draw()?;
        let plot = chart.plotting_area();
        for (group, (name, clusters)) in self.groups.iter().zip(&self.bars).enumerate() {
            plot.draw(&Text::new(svg::text(name), (group as f64 + 0.3, -0.02 * top), (FONT, 12)))?;
            for (cluster, bars) in clusters.iter().enumerate() {
                for (filling, bar) in bars.iter().enumerate() {
                    self.draw_bar(plot, bar, [group, cluster, filling], top)?;
                }
            }
        }
        Ok(())
    }

    /// Upper end of the value axis.
    fn top(&self) -> f64 {
        let bars = self.bars.iter().flatten().flatten();
        let of = |bar: &Bar| [value(bar), bar.published, bar.floor];
        let mut values: Vec<f64> = bars.flat_map(of).flatten().filter(|v| v.is_finite() && *v > 0.0).collect();
        values.sort_by(f64::total_cmp);
        let Some(&largest) = values.last() else { return 1.0 };
        // Values above three times their 85 % quantile are cut, so that a few do not flatten the rest.
        let usual = values[((values.len() - 1) as f64 * 0.85) as usize];
        1.08 * largest.min(3.0 * usual)
    }

    /// Left and right end of a bar.
    fn span(&self, [group, cluster, filling]: [usize; 3]) -> [f64; 2] {
        // Shares of the width of a group and of a cluster that are left empty.
        let (group_gap, cluster_gap) = (0.10, 0.16);
        let cluster_width = (1.0 - group_gap) / self.clusters.len().max(1) as f64;
        let width = cluster_width * (1.0 - cluster_gap) / self.fillings.len().max(1) as f64;
        let cluster_left = group as f64 + 0.5 * group_gap + (cluster as f64 + 0.5 * cluster_gap) * cluster_width;
        [cluster_left + filling as f64 * width, cluster_left + (filling as f64 + 0.96) * width]
    }

    fn draw_bar(&self, plot: &svg::Plot<'_>, bar: &Bar, place: [usize; 3], top: f64) -> DrawResult {
        let [left, right] = self.span(place);
        let middle = 0.5 * (left + right);
        match bar.height {
            Height::Absent => {}
            Height::Undetermined => plot.draw(&Text::new("?", (left, 0.09 * top), (FONT, 11)))?,
            Height::Failed => plot.draw(&Cross::new((middle, 0.02 * top), 4, RED.stroke_width(2)))?,
            Height::Value(value) => {
                let filling = self.fillings.get(place[2]).map_or(Filling::Solid, |(filling, _)| *filling);
                let corners = [(left, 0.0), (right, value.clamp(0.0, top))];
                plot.draw(&Rectangle::new(corners, style(place[1], filling)))?;
                if value > top {
                    plot.draw(&Text::new(format!("{value:.2}"), (left, top), (FONT, 10)))?;
                }
            }
        }
        if let Some(floor) = bar.floor.filter(|floor| *floor <= top) {
            plot.draw(&PathElement::new([(left, floor), (right, floor)], BLACK.stroke_width(2)))?;
        }
        if let Some(published) = bar.published {
            plot.draw(&Circle::new((middle, published.clamp(0.0, top)), 3, BLACK.stroke_width(1)))?;
        }
        Ok(())
    }

    fn draw_legend(&self, area: &Area<'_>) -> DrawResult {
        let mut y = 40;
        let mut entry = |name: &str| {
            y += 20;
            area.draw(&Text::new(svg::text(name), (24, y), (FONT, 12))).map(|()| y)
        };
        let swatch = |y: i32, style| Rectangle::new([(6, y), (18, y + 11)], style);
        for (cluster, name) in self.clusters.iter().enumerate() {
            area.draw(&swatch(entry(name)?, style(cluster, Filling::Solid)))?;
        }
        for (filling, name) in self.fillings.iter().filter(|_| self.fillings.len() > 1) {
            area.draw(&swatch(entry(name)?, style(0, *filling)))?;
        }
        let any = |is: fn(&Bar) -> bool| self.bars.iter().flatten().flatten().any(is);
        if any(|bar| bar.published.is_some()) {
            area.draw(&Circle::new((12, entry("published by the paper")? + 6), 3, BLACK.stroke_width(1)))?;
        }
        if any(|bar| bar.floor.is_some()) {
            let y = entry("at the reference ratio")? + 6;
            area.draw(&PathElement::new([(6, y), (18, y)], BLACK.stroke_width(2)))?;
        }
        if any(|bar| bar.height == Height::Undetermined) {
            area.draw(&Text::new("?", (9, entry("undetermined")?), (FONT, 11)))?;
        }
        if any(|bar| bar.height == Height::Failed) {
            area.draw(&Cross::new((12, entry("failed")? + 6), 4, RED.stroke_width(2)))?;
        }
        Ok(())
    }
}

fn value(bar: &Bar) -> Option<f64> {
    match bar.height {
        Height::Value(value) => Some(value),
        _ => None,
    }
}

fn style(cluster: usize, filling: Filling) -> ShapeStyle {
    let color = COLORS[cluster % COLORS.len()];
    match filling {
        Filling::Outline => color.stroke_width(1),
        Filling::Pale => color.mix(0.35).filled(),
        Filling::Solid => color.filled(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chart(heights: &[Height]) -> BarChart {
        let bar = |height: &Height| Bar { height: *height, published: None, floor: None };
        BarChart {
            title: "<b> & \"c\"\u{7}".into(),
            y_label: "metres".into(),
            groups: vec!["left".into(), "right".into()],
            clusters: vec!["van".into()],
            fillings: heights.iter().map(|_| (Filling::Solid, "x".into())).collect(),
            bars: vec![vec![heights.iter().map(bar).collect()]; 2],
        }
    }

    #[test]
    fn bars_are_drawn_to_scale() {
        let svg = chart(&[Height::Value(1.0), Height::Value(0.5), Height::Absent]).svg().unwrap();
        let bar_heights: Vec<f64> = svg
            .lines()
            .filter(|line| line.starts_with("<rect") && line.contains("#0072B2"))
            .map(|line| line.split("height=\"").nth(1).unwrap().split('"').next().unwrap().parse().unwrap())
            .filter(|height| *height > 20.0)
            .collect();
        assert_eq!(bar_heights.len(), 4, "{svg}");
        assert!((bar_heights[0] / bar_heights[1] - 2.0).abs() < 2e-2, "{bar_heights:?}");
    }

    #[test]
    fn failed_bars_are_crosses_and_extreme_ones_carry_their_value() {
        let mut heights = vec![Height::Value(1.0); 9];
        heights.extend([Height::Value(50.0), Height::Failed]);
        let svg = chart(&heights).svg().unwrap();
        assert_eq!(svg.matches("50.00").count(), 2);
        assert!(svg.contains("failed") && !svg.contains("published"));
    }

    #[test]
    fn charts_above_one_another_are_one_file() {
        let (open, drawn) = (chart(&[Height::Undetermined]), chart(&[Height::Value(1.0)]));
        let svg = panels_svg(&[drawn.clone(), open, drawn]).unwrap();
        assert!(svg.contains(&format!("height=\"{}\"", 3 * PANEL_PX)), "{svg}");
        assert_eq!(svg.matches("\nundetermined\n").count(), 1, "{svg}");
        assert!(svg.matches("\nleft\n").count() == 3 && !svg.contains("\nx\n"), "{svg}");
        assert!(panels_svg(&[]).is_ok());
    }

    #[test]
    fn names_are_text_and_never_markup() {
        let svg = chart(&[Height::Value(1.0)]).svg().unwrap();
        assert!(svg.contains("&lt;b&gt; &amp;") && !svg.contains("<b>") && !svg.contains('\u{7}'));
    }
}
