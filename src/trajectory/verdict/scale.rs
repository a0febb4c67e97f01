//! Determinacy and accuracy of the scale ratio.

use super::{SMALL, percent};
use crate::scene::ReasonKind::{Determined, Deviation};
use crate::scene::{Reason, ScaleEstimate};

/// Relative standard deviation of the scale ratio beyond which it is a full doubt.
const WEAK_STD: f64 = 0.10;

/// Standard deviation of the ratio as a fraction of it.
fn relative_std(scale: &ScaleEstimate) -> Option<f64> {
    scale.std.map(|std| std / scale.ratio).filter(|std| std.is_finite() && *std >= 0.0)
}

pub(super) fn deviation(scale: &ScaleEstimate) -> Reason {
    let focal = match scale.shares {
        Some(shares) if shares.focal > shares.given_focal() => ", mostly from the estimated focal length",
        _ => "",
    };
    let text = |std: f64| format!("scale uncertainty ±{} (1σ){focal}", percent(std));
    let beyond = |std: f64, limit: f64| format!("{}; limit ±{}", text(std), percent(limit));
    match relative_std(scale) {
        _ if scale.degenerate => {
            let why = scale.reason.as_deref().unwrap_or("no reason recorded");
            Reason::refutes(Determined, format!("scale undetermined: {why}"))
        }
        Some(std) if std > WEAK_STD => Reason::doubts(Deviation, 1.0, beyond(std, WEAK_STD)),
        // Up to 3 % the ratio counts as well determined.
        Some(std) if std > 0.03 => Reason::doubts(Deviation, SMALL, text(std)),
        Some(std) => Reason::supports(Deviation, text(std)),
        None => {
            Reason::doubts(Deviation, 1.0, format!("scale uncertainty unknown: {} reports none", scale.method.name()))
        }
    }
}
