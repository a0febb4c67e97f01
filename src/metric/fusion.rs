//! Fusion of all sources of scale by inverse variances, with a test of each against the others.
//!
//! Each source is an estimate of the logarithm of metres per unit. Where they differ by more than their standard
//! deviations explain, the standard deviation of their mean grows by the ratio that R. T. Birge proposed (*The
//! calculation of errors by the method of least squares*, Physical Review 40, 1932); docs/maths/metric.md, eq. 7.

use serde::Serialize;

use crate::scene::{MetricContradiction, MetricShare, MetricVerdict};

/// Kind of evidence of a source.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Somebody measured: a camera's height, a vehicle's length, the scale itself.
    Surveyed,
    /// A receiver's fixes.
    Telemetry,
    /// Typical sizes of vehicles.
    Prior,
}

/// An estimate of the logarithm of metres per unit.
#[derive(Clone, Debug, PartialEq)]
pub struct Source {
    /// Its name, for people and in files: `telemetry`, `camera height`, …
    pub name: String,
    /// Kind of evidence.
    pub kind: Kind,
    /// Logarithm of metres per unit.
    pub log_scale: f64,
    /// Its standard deviation.
    pub std: f64,
}

/// Metres per unit from all sources.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Fused {
    /// Metres per unit.
    pub scale: f64,
    /// Standard deviation, metres per unit.
    pub std: f64,
    /// On what they rest.
    pub verdict: MetricVerdict,
    /// Contributions of the sources, in the order in which they were given.
    pub shares: Vec<MetricShare>,
    /// Sources that contradict the others, the worst first.
    pub contradictions: Vec<MetricContradiction>,
}

impl Fused {
    /// Meters per unit without sources that could contradict one another.
    pub fn of_scale(scale: f64, std: f64) -> Self {
        Self { scale, std, verdict: MetricVerdict::Unknown, shares: Vec::new(), contradictions: Vec::new() }
    }
}

/// Fuses all sources; `None` without any. Sources that are not finite are ignored.
pub fn fuse(sources: &[Source]) -> Option<Fused> {
    let is_usable = |source: &&Source| source.log_scale.is_finite() && source.std.is_finite() && source.std > 0.0;
    let sources: Vec<&Source> = sources.iter().filter(is_usable).collect();
    let (log_scale, std) = mean(&sources)?;
    let chi2: f64 = sources.iter().map(|source| ((source.log_scale - log_scale) / source.std).powi(2)).sum();
    let freedom = sources.len().saturating_sub(1).max(1) as f64;
    let std = std * (chi2 / freedom).sqrt().max(1.0);
    let total: f64 = sources.iter().map(|source| source.std.powi(-2)).sum();
    let shares = sources.iter().map(|source| MetricShare {
        source: source.name.clone(),
        scale: source.log_scale.exp(),
        std: source.log_scale.exp() * source.std,
        share: source.std.powi(-2) / total,
    });
    let scale = log_scale.exp();
    let fused = Fused {
        scale,
        std: scale * std,
        verdict: verdict(&sources, total),
        shares: shares.collect(),
        contradictions: contradictions(&sources),
    };
    (fused.scale.is_finite() && fused.scale > 0.0 && fused.std.is_finite()).then_some(fused)
}

/// Mean weighted by inverse variances, and its standard deviation.
fn mean(sources: &[&Source]) -> Option<(f64, f64)> {
    let weight: f64 = sources.iter().map(|source| source.std.powi(-2)).sum();
    let sum: f64 = sources.iter().map(|source| source.log_scale * source.std.powi(-2)).sum();
    (!sources.is_empty()).then(|| (sum / weight, weight.sqrt().recip()))
}

/// Kind of source with the most weight; of equal ones the stronger evidence.
fn verdict(sources: &[&Source], total: f64) -> MetricVerdict {
    let weight = |kind: Kind| -> f64 {
        sources.iter().filter(|source| source.kind == kind).map(|source| source.std.powi(-2) / total).sum()
    };
    let [surveyed, telemetry, prior] = [Kind::Surveyed, Kind::Telemetry, Kind::Prior].map(weight);
    if surveyed >= telemetry && surveyed >= prior {
        MetricVerdict::Surveyed
    } else if telemetry >= prior {
        MetricVerdict::Telemetry
    } else {
        MetricVerdict::PriorOnly
    }
}

/// Tests each source against the mean of the others.
fn contradictions(sources: &[&Source]) -> Vec<MetricContradiction> {
    let of = |i: usize| {
        let others: Vec<&Source> = (0..sources.len()).filter(|&j| j != i).map(|j| sources[j]).collect();
        let (log_scale, std) = mean(&others)?;
        let apart = sources[i].log_scale - log_scale;
        let deviations = apart.abs() / std.hypot(sources[i].std);
        // Sources further apart than this contradict each other.
        (deviations > 3.0).then(|| MetricContradiction {
            source: sources[i].name.clone(),
            ratio: apart.exp(),
            deviations,
        })
    };
    let mut found: Vec<MetricContradiction> = (0..sources.len()).filter_map(of).collect();
    found.sort_by(|a, b| b.deviations.total_cmp(&a.deviations));
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(name: &str, kind: Kind, scale: f64, share: f64) -> Source {
        Source { name: name.to_owned(), kind, log_scale: scale.ln(), std: share }
    }

    #[test]
    fn weights_are_inverse_variances() {
        let fused =
            fuse(&[source("tape", Kind::Surveyed, 2.0, 0.01), source("cars", Kind::Prior, 2.04, 0.02)]).unwrap();
        assert!((fused.shares[0].share - 0.8).abs() < 1e-12 && (fused.shares[1].share - 0.2).abs() < 1e-12);
        assert!((fused.scale.ln() - (0.8 * 2f64.ln() + 0.2 * 2.04f64.ln())).abs() < 1e-12);
        assert!((fused.std / fused.scale - 0.01 * 0.8f64.sqrt()).abs() < 1e-12);
        assert_eq!((fused.verdict, fused.contradictions.len()), (MetricVerdict::Surveyed, 0));
    }

    #[test]
    fn verdicts_name_the_main_source_of_scale() {
        let verdict = |sources: &[Source]| fuse(sources).map(|fused| fused.verdict);
        let cars = source("cars", Kind::Prior, 1.0, 0.06);
        let fixes = source("telemetry", Kind::Telemetry, 1.0, 0.02);
        assert_eq!(verdict(&[]), None);
        assert_eq!(verdict(std::slice::from_ref(&cars)), Some(MetricVerdict::PriorOnly));
        assert_eq!(verdict(&[cars.clone(), fixes.clone()]), Some(MetricVerdict::Telemetry));
        assert_eq!(verdict(&[cars, fixes, source("tape", Kind::Surveyed, 1.0, 0.01)]), Some(MetricVerdict::Surveyed));
        assert_eq!(verdict(&[source("broken", Kind::Surveyed, f64::NAN, 0.01)]), None);
    }

    #[test]
    fn the_contradicting_source_is_named_first_and_the_result_widens() {
        let sources = [
            source("telemetry", Kind::Telemetry, 1.0, 0.02),
            source("camera height", Kind::Surveyed, 1.5, 0.03),
            source("cars", Kind::Prior, 1.02, 0.05),
        ];
        let fused = fuse(&sources).unwrap();
        assert_eq!(fused.contradictions[0].source, "camera height");
        assert!((fused.contradictions[0].ratio - 1.5).abs() < 0.02 && fused.contradictions[0].deviations > 10.0);
        assert!(fused.std / fused.scale > 0.1, "{fused:?}");
    }
}
