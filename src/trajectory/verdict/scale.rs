//! Determinacy and accuracy of the scale ratio, and agreement of other methods.

use super::{HALF, SMALL, percent};
use crate::scene::ReasonKind::{Agreement, Determined, Deviation};
use crate::scene::{Reason, ScaleEstimate, ScaleMethod};
use crate::trajectory::estimators::std_in_verdict;
use crate::trajectory::{Options, Views};

/// A relative standard deviation of the scale ratio beyond which it is called weak.
const WEAK_STD: f64 = 0.10;
/// Relative standard deviation of a method that gives nothing but its ratio.
const UNKNOWN_STD: f64 = 0.15;

/// Ratio by another method than the one in use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OtherEstimate {
    /// Which one.
    pub(super) method: ScaleMethod,
    /// Its ratio.
    pub(super) ratio: f64,
    /// Its own relative standard deviation.
    pub(super) std: f64,
}

pub(super) fn reasons(scale: &ScaleEstimate, views: &Views, options: &Options) -> Vec<Reason> {
    [deviation(scale)].into_iter().chain(agreement(scale, &answers(scale, views, options))).collect()
}

/// Standard deviation of the ratio as a fraction of it.
fn relative_std(scale: &ScaleEstimate) -> Option<f64> {
    scale.std.map(|std| std / scale.ratio).filter(|std| std.is_finite() && *std >= 0.0)
}

pub(super) fn deviation(scale: &ScaleEstimate) -> Reason {
    let focal = match scale.shares {
        Some(shares) if shares.focal > shares.given_focal() => ", mostly from the estimated focal length",
        _ => "",
    };
    let said = |std: f64| format!("scale uncertainty ±{} (1σ){focal}", percent(std));
    let beyond = |std: f64, limit: f64| format!("{}; limit ±{}", said(std), percent(limit));
    match relative_std(scale) {
        _ if scale.degenerate => {
            let why = scale.reason.as_deref().unwrap_or("no reason recorded");
            Reason::refutes(Determined, format!("scale undetermined: {why}"))
        }
        Some(std) if std > WEAK_STD => Reason::doubts(Deviation, 1.0, beyond(std, WEAK_STD)),
        // Up to 3 % it counts as well determined.
        Some(std) if std > 0.03 => Reason::doubts(Deviation, SMALL, said(std)),
        Some(std) => Reason::supports(Deviation, said(std)),
        None => {
            Reason::doubts(Deviation, 1.0, format!("scale uncertainty unknown: {} reports none", scale.method.name()))
        }
    }
}

/// Ratios by the other methods for the unchanged model, with the standard deviation of each by its own residuals.
fn answers(scale: &ScaleEstimate, views: &Views, options: &Options) -> Vec<OtherEstimate> {
    let others = scale.alternatives.iter().filter(|(method, _)| **method != scale.method);
    let others = others.filter(|(_, ratio)| ratio.is_finite() && **ratio > 0.0);
    let answer = |(&method, &ratio): (&ScaleMethod, &f64)| {
        let std = std_in_verdict(method, ratio, views, options).unwrap_or(UNKNOWN_STD);
        OtherEstimate { method, ratio, std: if std.is_finite() { std } else { f64::INFINITY } }
    };
    others.map(answer).collect()
}

/// Holds the other methods' answers against the one in use.
///
/// One that contradicts it counts half; two make it doubtful, or refute it where both do by far.
pub(super) fn agreement(scale: &ScaleEstimate, answers: &[OtherEstimate]) -> Option<Reason> {
    // All methods share the focal length, and its error.
    let own = scale.shares.map(|shares| shares.given_focal()).or_else(|| relative_std(scale)).unwrap_or(UNKNOWN_STD);
    let away = |answer: &OtherEstimate| (answer.ratio / scale.ratio).ln().abs() / answer.std.hypot(own);
    // One that is less sure has nothing to say.
    let telling: Vec<&OtherEstimate> = answers.iter().filter(|answer| answer.std < 0.5).collect();
    let beyond = |limit: f64| telling.iter().filter(|answer| away(answer) > limit).count();
    let said: Vec<String> = telling.iter().map(|answer| said(answer, scale.ratio)).collect();
    let said = said.join(", ");
    // Beyond three standard deviations two answers contradict one another, beyond six by far.
    match (beyond(3.0), beyond(6.0)) {
        _ if telling.is_empty() => None,
        (0, _) => {
            let finding = format!("other methods agree within their uncertainties and ±{}: {said}", percent(own));
            Some(Reason::supports(Agreement, finding))
        }
        (1, _) => Some(Reason::doubts(Agreement, HALF, format!("another method contradicts the scale: {said}"))),
        (_, 0..2) => Some(Reason::doubts(Agreement, 1.0, format!("the methods contradict one another: {said}"))),
        _ => Some(Reason::refutes(Agreement, format!("the methods contradict one another by far: {said}"))),
    }
}

/// "least-squares −32 %".
fn said(answer: &OtherEstimate, ratio: f64) -> String {
    let off = answer.ratio / ratio - 1.0;
    let sign = if off < 0.0 { "−" } else { "+" };
    format!("{} {sign}{} (±{})", answer.method.name(), percent(off.abs()), percent(answer.std))
}
