//! Metric scale of a result for the reader: the unit of lengths, its source, and conflicting evidence.

use minijinja::{Value, context};

use super::words::{LENGTH_UNIT, figure, percent, round_figure};
use crate::scene::{Metric, MetricContradiction, MetricFrame, MetricShare, MetricVerdict, sources_in_words};

/// Unit of lengths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ruler {
    /// Lengths of the background are multiplied by this.
    pub factor: f64,
    /// The unit's name.
    pub unit: &'static str,
}

impl Ruler {
    /// Meters, where they are known.
    pub fn of(metric: Option<&Metric>) -> Self {
        match metric.and_then(frame) {
            Some(frame) => Self { factor: frame.scale, unit: "m" },
            None => Self { factor: 1.0, unit: LENGTH_UNIT },
        }
    }

    /// Label of a round length in the ruler's own unit, next to a bar.
    pub fn round_length(&self, length: f64) -> String {
        let unit = if length == 1.0 { self.unit.trim_end_matches('s') } else { self.unit };
        format!("{} {unit}", round_figure(length))
    }
}

/// The transform, where meters are known and are numbers.
pub(super) fn frame(metric: &Metric) -> Option<&MetricFrame> {
    metric.frame.as_ref().filter(|frame| frame.scale.is_finite() && frame.scale > 0.0)
}

/// Remedy for missing meters.
const CURE: &str = "give --camera-height or --telemetry for meters";

/// Source and uncertainty of meters in a sentence, or the reason for their absence.
pub fn metres_in_words(metric: Option<&Metric>) -> String {
    let Some(metric) = metric else { return format!("Lengths are not in meters: {CURE}.") };
    let Some(frame) = frame(metric) else {
        let why = metric.reason.as_deref().unwrap_or("no source of scale").trim_end_matches('.');
        // A reason that names options includes the remedy.
        let cure = if why.contains("--") { String::new() } else { format!("; {CURE}") };
        return format!("Scale in meters unknown: {why}{cure}.");
    };
    let source = match metric.verdict {
        MetricVerdict::Unknown => "Scale of unknown origin".to_owned(),
        _ => format!("Scale from {}", sources_in_words(&metric.shares)),
    };
    let sure = format!("{source}: ±{} (1σ), the same factor for every length", percent(frame.log_scale_std()));
    match metric.contradictions.first() {
        Some(first) => format!("{sure}; contradicted by {}.", first.source),
        None => format!("{sure}."),
    }
}

/// Metric scale on the page.
pub(super) fn on_page(metric: Option<&Metric>) -> Value {
    let share = |share: &MetricShare| {
        context! {
            source => share.source,
            scale => figure(share.scale, 4),
            std => percent(share.std / share.scale),
            share => percent(share.share),
        }
    };
    let shares = metric.iter().flat_map(|metric| &metric.shares).map(share);
    let contradictions = metric.iter().flat_map(|metric| &metric.contradictions).map(contradiction);
    context! {
        known => metric.and_then(frame).is_some(),
        sentence => metres_in_words(metric),
        shares => shares.collect::<Vec<_>>(),
        contradictions => contradictions.collect::<Vec<_>>(),
    }
}

fn contradiction(found: &MetricContradiction) -> String {
    let MetricContradiction { source, ratio, deviations } = found;
    format!(
        "{source} gives {} times the meters per unit of the others ({} standard deviations)",
        figure(*ratio, 3),
        figure(*deviations, 2)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::showcase::showcase;

    #[test]
    fn metres_are_said_in_words() {
        let mut metric = showcase(4, 1).metric;
        assert_eq!(
            metres_in_words(Some(&metric)),
            "Scale from fixes of the receiver (92 %) and sizes of 2 vehicles (8 %): ±2.0 % (1σ), the same factor for \
             every length."
        );
        metric.verdict = MetricVerdict::PriorOnly;
        metric.shares.truncate(1);
        metric.shares[0].source = "typical vehicle sizes".to_owned();
        let source = "the height of the camera".to_owned();
        metric.contradictions.push(MetricContradiction { source, ratio: 1.4, deviations: 6.1 });
        assert_eq!(
            metres_in_words(Some(&metric)),
            "Scale from typical vehicle sizes: ±2.0 % (1σ), the same factor for every length; contradicted by the \
             height of the camera."
        );
        metric.frame = None;
        metric.reason = Some("no vehicle has a size".into());
        let said = metres_in_words(Some(&metric));
        assert_eq!(
            said,
            "Scale in meters unknown: no vehicle has a size; give --camera-height or --telemetry for meters."
        );
        assert_eq!(Ruler::of(Some(&metric)).round_length(1.0), "1 unit");
        assert!(metres_in_words(None).contains("--telemetry"));
    }
}
