//! Ticks of an axis.

use serde::Serialize;

/// A tick: its position in per cent and its label.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Tick {
    pub at: f64,
    pub label: String,
}

/// About five ticks at round numbers, and how many decimals they need.
pub(super) fn ticks(range: (f64, f64)) -> (Vec<Tick>, usize) {
    ticks_apart(range, 0.0)
}

/// About five ticks at whole numbers.
pub(super) fn whole_ticks(range: (f64, f64)) -> Vec<Tick> {
    ticks_apart(range, 1.0).0
}

/// Ticks with a minimum spacing.
fn ticks_apart((low, high): (f64, f64), least: f64) -> (Vec<Tick>, usize) {
    let span = high - low;
    if !(span > 0.0) || !span.is_finite() {
        return (Vec::new(), 0);
    }
    let rough = (span / 5.0).max(least);
    let power = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].map(|m| m * power).into_iter().find(|s| *s >= rough).unwrap_or(10.0 * power);
    let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    let first = (low / step - 1e-9).ceil() as i64;
    let at = |k: i64| k as f64 * step;
    let ticks = (first..first + 12).take_while(|&k| at(k) <= high + 1e-9 * span);
    let tick = |k| Tick { at: (at(k) - low) / span * 100.0, label: number(at(k), decimals) };
    (ticks.map(tick).collect(), decimals)
}

/// A number with a fixed number of decimals and a true minus sign.
pub(super) fn number(v: f64, decimals: usize) -> String {
    let text = format!("{v:.decimals$}");
    match text.strip_prefix('-') {
        Some(digits) if digits.chars().all(|c| "0.".contains(c)) => digits.to_owned(),
        Some(digits) => format!("−{digits}"),
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_numbers_inside_the_range() {
        let labels = |range| ticks(range).0.into_iter().map(|t| t.label).collect::<Vec<_>>();
        assert_eq!(labels((0.0, 10.0)), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels((-0.31, 0.32)), ["−0.2", "0.0", "0.2"]);
        assert_eq!(labels((1234.0, 1235.0)), ["1234.0", "1234.2", "1234.4", "1234.6", "1234.8", "1235.0"]);
        let whole: Vec<_> = whole_ticks((0.0, 2.0)).into_iter().map(|t| t.label).collect();
        assert_eq!(whole, ["0", "1", "2"]);
        assert!(ticks((1.0, 1.0)).0.is_empty());
        assert!(ticks((f64::NAN, 1.0)).0.is_empty());
    }
}
