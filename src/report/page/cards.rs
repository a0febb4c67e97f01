//! The vehicles' cards.

use serde::Serialize;

use super::figures::thousands;
use crate::report::data::{Data, Fact, Object};
use crate::report::overlay::{css_colour, object_colour};
use crate::report::plan::Plan;
use crate::report::summary::{self, Verdict, figure, length, percent};
use crate::report::view::{View, quantile};
use crate::scene::{ScaleMethod, Unit};

/// A vehicle's card.
#[derive(Debug, Serialize)]
pub(super) struct Card {
    id: u32,
    name: String,
    colour: String,
    verdict: Verdict,
    badge: &'static str,
    /// Why the scale is degenerate, or why there is no trajectory.
    reason: Option<String>,
    facts: Vec<Fact>,
    alternatives: Vec<Alternative>,
    plan: Option<Plan>,
}

/// What another method says of the scale ratio.
#[derive(Debug, Serialize)]
struct Alternative {
    method: String,
    ratio: String,
    deviation: String,
    chosen: bool,
}

pub(super) fn card(data: &Data, object: &Object, name: &str, view: Option<&View>, unit: &str) -> Card {
    let verdict = Verdict::of(object);
    let scale = object.trajectory.map(|t| &t.scale);
    let reason = match scale {
        Some(scale) if scale.degenerate => scale.reason.clone().or(Some("no reason was recorded".to_owned())),
        Some(_) => None,
        None => object.failure.clone(),
    };
    Card {
        id: object.id.0,
        name: name.to_owned(),
        colour: css_colour(object_colour(object.id)),
        verdict,
        badge: verdict.label(),
        reason,
        facts: facts(data, object),
        alternatives: alternatives(object),
        plan: view.and_then(|v| Plan::object(object, v, unit)),
    }
}

fn facts(data: &Data, object: &Object) -> Vec<Fact> {
    let registered = object.model.as_ref().map_or(0, |m| m.reconstruction.images.len());
    let placed = object.trajectory.map_or(0, |t| t.poses.len());
    let mut facts = vec![
        Fact::new("detection confidence", percent_whole(object.confidence)),
        Fact::new("frames placed / visible", format!("{placed} / {}", object.visible.len()))
            .with_note(format!("{registered} registered on the vehicle")),
    ];
    if let Some(model) = &object.model {
        let points = thousands(model.reconstruction.points.len());
        let error = model.reconstruction.mean_reprojection_error_px();
        let fact = Fact::new("points", points);
        facts.push(match error {
            Some(e) => fact.with_note(format!("{e:.2} px reprojection error")),
            None => fact,
        });
    }
    let Some(trajectory) = object.trajectory else { return facts };
    let scale = &trajectory.scale;
    let ratio = match (scale.std, summary::relative_std(scale)) {
        (Some(std), Some(relative)) => {
            format!("{} ± {} ({})", figure(scale.ratio, 4), figure(std, 2), percent(relative))
        }
        _ => figure(scale.ratio, 4),
    };
    facts.push(Fact::new("scale ratio r", ratio).with_note(scale.method.name()));
    facts.push(
        Fact::new("path length", length(summary::path_length(trajectory), data.unit)).with_note(duration(object)),
    );
    let mut speeds: Vec<f64> = summary::speeds(trajectory).into_iter().map(|(_, v)| v).collect();
    if data.unit == Unit::Metre && !speeds.is_empty() {
        let median = quantile(&mut speeds, 0.5);
        let top = quantile(&mut speeds, 0.95);
        let kmh = |v: f64| format!("{} km/h", figure(v * 3.6, 3));
        facts.push(
            Fact::new("speed, median", format!("{} m/s = {}", figure(median, 3), kmh(median)))
                .with_note(format!("95 % of the time below {}", kmh(top))),
        );
    }
    facts
}

fn percent_whole(fraction: f64) -> String {
    if fraction.is_finite() { format!("{:.0} %", fraction * 100.0) } else { "–".to_owned() }
}

fn duration(object: &Object) -> String {
    let poses = object.trajectory.map_or(&[][..], |t| &t.poses);
    match (poses.first(), poses.last()) {
        (Some(a), Some(b)) => format!("{:.2} s to {:.2} s", a.time_s, b.time_s),
        _ => "no frame".to_owned(),
    }
}

/// What every method says, if more than one does.
fn alternatives(object: &Object) -> Vec<Alternative> {
    let Some(trajectory) = object.trajectory else { return Vec::new() };
    let scale = &trajectory.scale;
    if scale.alternatives.keys().all(|method| *method == scale.method) {
        return Vec::new();
    }
    let entry = |(method, ratio): (&ScaleMethod, &f64)| {
        let difference = ratio / scale.ratio - 1.0;
        let sign = if difference < 0.0 { "−" } else { "+" };
        Alternative {
            method: method.name().to_owned(),
            ratio: figure(*ratio, 4),
            deviation: format!("{sign}{}", percent(difference.abs())),
            chosen: *method == scale.method,
        }
    };
    scale.alternatives.iter().map(entry).collect()
}
