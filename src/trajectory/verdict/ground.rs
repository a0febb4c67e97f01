//! Contact of the vehicle with the ground, and its constancy.

use super::{Measures, graded, percent};
use crate::scene::Reason;
use crate::scene::ReasonKind::Ground;

pub(super) fn reasons(measures: &Measures) -> Vec<Reason> {
    let Some(height) = measures.height else {
        return vec![Reason::doubts(Ground, 1.0, "no ground plane below it in any frame")];
    };
    // Two standard deviations of the ground's height are no finding: a vehicle of 1.5 m below a drone at 100 m, whose
    // ground is known to a meter, may seem to float by as much as it is high.
    let unsure = 2.0 * measures.ground_std;
    if !(height > 0.0) {
        let says = "all of its points are below the ground";
        let is_refuted = !(height > -unsure);
        return vec![if is_refuted { Reason::refutes(Ground, says) } else { Reason::doubts(Ground, 1.0, says) }];
    }
    let stands = measures.bottom.and_then(|bottom| stands(bottom / height, unsure / height));
    let stays = spread(&measures.middles).and_then(|spread| stays(spread / height));
    [stands, stays].into_iter().flatten().collect()
}

/// * `bottom` – height of its lowest points, in heights of its top.
/// * `unsure` – by how much that may be otherwise.
fn stands(bottom: f64, unsure: f64) -> Option<Reason> {
    let floats = || format!("floats: lowest points {} of its height above the ground", percent(bottom));
    let sinks = || format!("sinks: lowest points {} of its height below the ground", percent(-bottom));
    let stands = || format!("on the ground: lowest points at {} of its height", percent(bottom));
    // As far towards the ground as it may be.
    let nearest = bottom.signum() * (bottom.abs() - unsure).max(0.0);
    // Of a vehicle that is seen above its sills alone a third is missing.
    let off = graded(Ground, nearest, [0.6, 0.75], floats).or_else(|| graded(Ground, -nearest, [0.25, 0.6], sinks));
    nearest.is_finite().then(|| off.unwrap_or_else(|| Reason::supports(Ground, stands())))
}

/// * `spread` – of its height over the ground along the path, in heights of its top.
fn stays(spread: f64) -> Option<Reason> {
    let said = || format!("height above ground varies by {} of its height (standard deviation)", percent(spread));
    graded(Ground, spread, [0.08, 0.5], said)
}

/// Standard deviation; `None` for fewer than three.
fn spread(values: &[f64]) -> Option<f64> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / count;
    (values.len() >= 3).then(|| variance.sqrt()).filter(|spread| spread.is_finite())
}
