//! Contact of the vehicle with the ground, and its constancy.

use super::{Measures, graded, percent};
use crate::scene::Reason;
use crate::scene::ReasonKind::Ground;

pub(super) fn reasons(measures: &Measures) -> Vec<Reason> {
    let Some(height) = measures.height else {
        return vec![Reason::doubts(Ground, 1.0, "no ground plane below it in any frame")];
    };
    // Up to two standard deviations of the ground's height are not significant: below a drone at 100 m, where the
    // ground is known to a meter, a vehicle of 1.5 m may appear to float by its own height.
    let tolerance = 2.0 * measures.ground_std;
    if !(height > 0.0) {
        let says = "all of its points are below the ground";
        let is_refuted = !(height > -tolerance);
        return vec![if is_refuted { Reason::refutes(Ground, says) } else { Reason::doubts(Ground, 1.0, says) }];
    }
    let contact = measures.bottom.and_then(|bottom| contact(bottom / height, tolerance / height));
    let constancy = spread(&measures.center_heights).and_then(|spread| constancy(spread / height));
    [contact, constancy].into_iter().flatten().collect()
}

/// Checks the height of the vehicle's lowest points above the ground.
///
/// * `bottom` – height of the lowest points, in heights of the top.
/// * `tolerance` – two standard deviations of that height.
fn contact(bottom: f64, tolerance: f64) -> Option<Reason> {
    let floats = || format!("floats: lowest points {} of its height above the ground", percent(bottom));
    let sinks = || format!("sinks: lowest points {} of its height below the ground", percent(-bottom));
    let contact = || format!("on the ground: lowest points at {} of its height", percent(bottom));
    // The value nearest to the ground within the tolerance.
    let nearest = bottom.signum() * (bottom.abs() - tolerance).max(0.0);
    // A third of a vehicle that is visible only above its sills is missing.
    let off = graded(Ground, nearest, [0.6, 0.75], floats).or_else(|| graded(Ground, -nearest, [0.25, 0.6], sinks));
    nearest.is_finite().then(|| off.unwrap_or_else(|| Reason::supports(Ground, contact())))
}

/// Checks the constancy of the vehicle's height above the ground.
///
/// * `spread` – standard deviation of the height along the path, in heights of the top.
fn constancy(spread: f64) -> Option<Reason> {
    let text = || format!("height above ground varies by {} of its height (standard deviation)", percent(spread));
    graded(Ground, spread, [0.08, 0.5], text)
}

/// Standard deviation; `None` for fewer than three values.
fn spread(values: &[f64]) -> Option<f64> {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean) * (value - mean)).sum::<f64>() / count;
    (values.len() >= 3).then(|| variance.sqrt()).filter(|spread| spread.is_finite())
}
