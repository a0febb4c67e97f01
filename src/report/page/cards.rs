//! The vehicles' cards.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use minijinja::{Value, context};
use serde::Serialize;

use super::gaps::NO_REASON;
use crate::math::rounding::with_std;
use crate::report::data::{Data, Fact, Object};
use crate::report::motion;
use crate::report::overlay::{css_colour, object_colour};
use crate::report::plan::Plan;
use crate::report::timeline::Timeline;
use crate::report::travel::{ground_track_facts, travel_facts};
use crate::report::verdict::{self, relative_std, said};
use crate::report::view::View;
use crate::report::words::{UNKNOWN, figure, percent, plain, thousands, with_unit};
use crate::scene::{
    Finding, GroundTrack, MovementFinding, ObjectTrajectory, Outline, Reason, ScaleEstimate, ScaleMethod,
    TrackedObject, Verdict,
};

/// A vehicle's card.
#[derive(Debug, Serialize)]
pub(super) struct Card {
    id: u32,
    name: String,
    colour: String,
    /// JPEG file in base64.
    portrait: Option<String>,
    verdict: verdict::Verdict,
    badge: &'static str,
    /// True if the ground track is the reported result.
    is_on_ground: bool,
    /// Rank by trust, the best first; a ground track comes before a rejected trajectory.
    trust: usize,
    /// Rank in the table: by trust, then by the number of positions, the most first.
    order: i64,
    /// Size for the table.
    size: Option<String>,
    /// Meaning of the verdict for this vehicle.
    meaning: String,
    /// Reason for a missing trajectory.
    reason: Option<String>,
    /// Evidence against the trajectory, the strongest first.
    against: Vec<String>,
    /// Evidence for it.
    in_favour: Vec<String>,
    facts: Vec<Fact>,
    /// Scale ratios by all methods.
    alternatives: Vec<Value>,
    plan: Option<Plan>,
    /// The ground track: state, meaning, facts and plan.
    ground: Option<Value>,
}

/// One card per vehicle.
pub(super) fn cards(data: &Data, timeline: &Timeline, names: &[String], view: Option<&View>) -> Vec<Card> {
    data.objects.iter().zip(names).map(|(object, name)| card(data, object, timeline, name, view)).collect()
}

fn card(data: &Data, object: &Object, timeline: &Timeline, name: &str, view: Option<&View>) -> Card {
    let verdict = verdict::Verdict::of(object.trajectory);
    let is_on_ground = object.answering_track().is_some();
    Card {
        id: object.id.0,
        name: name.to_owned(),
        colour: css_colour(object_colour(object.id)),
        portrait: data.pictures.portraits.get(&object.id).map(|jpeg| STANDARD.encode(jpeg)),
        verdict,
        badge: if is_on_ground { "ground track" } else { verdict.label() },
        is_on_ground,
        trust: trust(verdict, object),
        order: order(verdict, object),
        size: size_in_brief(object),
        meaning: verdict.sentence(object.trajectory),
        reason: reason(object).map(|reason| plain(&reason)),
        against: judged(object).flat_map(Verdict::complaints).map(said).collect(),
        in_favour: judged(object).flat_map(supports).map(said).collect(),
        facts: facts(data, object, timeline),
        alternatives: object.trajectory.map(|t| alternatives(&t.scale)).unwrap_or_default(),
        plan: view.and_then(|v| Plan::object(data, object, v)),
        ground: object.ground_track.map(|track| {
            context! {
                state => track.verdict.as_ref().map_or(UNKNOWN, |verdict| verdict.state.name()),
                says => track.verdict.as_ref().map(|verdict| plain(&verdict.says)).unwrap_or_default(),
                facts => ground_facts(object, track, timeline),
                plan => view.and_then(|v| Plan::ground_track(data, track, v)),
            }
        }),
    }
}

/// Size of a vehicle by its ground track, where that is the reported result, or by its trajectory.
fn size_in_brief(object: &Object) -> Option<String> {
    let of_trajectory = || object.trajectory.map(|trajectory| (trajectory.dimensions, trajectory.is_ruled_out()));
    let (size, is_ruled_out) = match object.answering_track() {
        Some(track) => (track.dimensions, false),
        None => of_trajectory()?,
    };
    motion::size_in_brief(size?, is_ruled_out)
}

fn trust(verdict: verdict::Verdict, object: &Object) -> usize {
    let place = |verdict| verdict::Verdict::ALL.iter().position(|other| *other == verdict).unwrap_or_default();
    match object.ground_track {
        Some(_) => place(verdict).min(place(verdict::Verdict::Rejected)),
        None if verdict == verdict::Verdict::Missing => place(verdict) + 1,
        None => place(verdict),
    }
}

fn order(verdict: verdict::Verdict, object: &Object) -> i64 {
    let of_track = || object.ground_track.map_or(0, |track| track.positions.len());
    let positions = object.trajectory.map_or_else(of_track, |trajectory| trajectory.poses.len());
    // More positions than any clip has.
    (1 << 32) * trust(verdict, object) as i64 - positions as i64
}

/// Frames, path length, displacement and speeds of a ground track.
fn ground_facts(object: &Object, track: &GroundTrack, timeline: &Timeline) -> Vec<Fact> {
    let frames =
        Fact::new("frames on the ground", format!("{} of {} visible", track.positions.len(), object.visible.len()));
    let frames = match track.omissions() {
        Some(omitted) => frames.with_note(omitted),
        None => frames,
    };
    let apparent = || {
        let [width, height] = track.apparent_size_m?;
        let said = format!("{} × {} m", with_std(width.value, width.std), with_std(height.value, height.std));
        Some(Fact::new("apparent width and height", said))
    };
    let size = track.dimensions.map(|size| motion::size(size, false)).or_else(apparent);
    [frames].into_iter().chain(ground_track_facts(track, timeline.base)).chain(size).collect()
}

fn reason(object: &Object) -> Option<String> {
    match object.trajectory {
        Some(trajectory) if trajectory.verdict.is_some() || !trajectory.scale.degenerate => None,
        Some(trajectory) => trajectory.scale.reason.clone().or(Some(NO_REASON.to_owned())),
        None => object.failure.clone(),
    }
}

fn judged<'a>(object: &Object<'a>) -> impl Iterator<Item = &'a Verdict> {
    object.trajectory.and_then(|trajectory| trajectory.verdict.as_ref()).into_iter()
}

fn supports(verdict: &Verdict) -> impl Iterator<Item = &Reason> {
    verdict.reasons.iter().filter(|reason| reason.finding == Finding::Supports)
}

fn facts(data: &Data, object: &Object, timeline: &Timeline) -> Vec<Fact> {
    let mut facts = vec![frames(object)];
    if let Some(trajectory) = object.trajectory {
        facts.extend(travel(trajectory, timeline));
        facts.extend(motion::facts(data, object));
        facts.push(scale_ratio(&trajectory.scale));
    }
    facts.extend(points(object));
    facts.extend(object.tracked.into_iter().flat_map(tracked));
    facts.push(Fact::new("detection confidence", confidence(object.confidence)));
    facts
}

/// Motion state and sources of its detections.
fn tracked(object: &TrackedObject) -> [Fact; 2] {
    let MovementFinding { state, reason } = &object.movement;
    let masks = match object.outline {
        Outline::Given | Outline::Network => "frames".to_owned(),
        Outline::Coarse => "frames; coarse masks, by color only".to_owned(),
    };
    [
        Fact::new("movement", state.name()).with_note(reason.clone()),
        Fact::new("found by", object.found_in.to_string()).with_note(masks),
    ]
}

fn frames(object: &Object) -> Fact {
    let placed = object.trajectory.map_or(0, |t| t.poses.len());
    let found = object.model.as_ref().map_or(0, |m| m.reconstruction.images.len());
    Fact::new("frames with a 3D position", format!("{placed} of {} visible", object.visible.len()))
        .with_note(format!("registered in {found}"))
}

/// Path length, displacement and speeds, or the reason for their absence.
fn travel(trajectory: &ObjectTrajectory, timeline: &Timeline) -> Vec<Fact> {
    let poses = &trajectory.poses;
    let when = match (poses.first(), poses.last()) {
        (Some(first), Some(last)) => timeline.range(first.frame, last.frame),
        _ => "in no frame".to_owned(),
    };
    let mut facts = travel_facts(trajectory, timeline.base);
    match facts.first_mut() {
        Some(path) => path.note = Some(when),
        None => facts.push(Fact::new("path length", UNKNOWN).with_note(format!("too few positions, {when}"))),
    }
    facts
}

fn scale_ratio(scale: &ScaleEstimate) -> Fact {
    let method = scale.method.name();
    let note = match (scale.std, relative_std(scale)) {
        (Some(_), Some(relative)) => format!("±{} (1σ), method: {method}", percent(relative)),
        _ => format!("method: {method}"),
    };
    let ratio = scale.std.map_or_else(|| figure(scale.ratio, 3), |std| with_std(scale.ratio, std));
    Fact::new("scale ratio r", ratio).with_note(note)
}

fn points(object: &Object) -> Option<Fact> {
    let model = object.model.as_ref()?.reconstruction;
    let fact = Fact::new("points", thousands(model.points.len()));
    Some(match model.mean_reprojection_error_px() {
        Some(error) => fact.with_note(format!("reprojection error {}", with_unit(error, 2, "px"))),
        None => fact,
    })
}

fn confidence(score: f64) -> String {
    if score.is_finite() { format!("{:.0} %", score * 100.0) } else { UNKNOWN.to_owned() }
}

/// Ratios by all methods, if there are several.
fn alternatives(scale: &ScaleEstimate) -> Vec<Value> {
    if scale.alternatives.keys().all(|method| *method == scale.method) {
        return Vec::new();
    }
    let entry = |(method, ratio): (&ScaleMethod, &f64)| {
        context! {
            method => method.name(),
            ratio => figure(*ratio, 4),
            deviation => deviation(ratio / scale.ratio - 1.0),
            chosen => *method == scale.method,
        }
    };
    scale.alternatives.iter().map(entry).collect()
}

/// "+2.7 %".
fn deviation(fraction: f64) -> String {
    let sign = match fraction {
        f if !f.is_finite() => "",
        f if f < 0.0 => "−",
        _ => "+",
    };
    format!("{sign}{}", percent(fraction.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;
    use crate::scene::{ReasonKind, TimeBase, Trust};

    fn first_card(world: &testing::World) -> Card {
        let data = world.data();
        card(&data, &data.objects[0], &Timeline::new(&data), "Car 1", None)
    }

    #[test]
    fn speeds_are_said_only_where_time_is_known() {
        let mut world = testing::world();
        let has_speed = |card: &Card| card.facts.iter().any(|f| f.label.ends_with("speed"));
        assert!(has_speed(&first_card(&world)));
        world.time_base = TimeBase::Frames;
        let card = first_card(&world);
        assert!(!has_speed(&card));
        assert!(card.facts.iter().any(|f| f.note.as_deref().is_some_and(|n| n.contains("frames "))), "{card:?}");
    }

    #[test]
    fn no_card_says_nan() {
        let mut world = testing::world();
        let scale = &mut world.trajectory.scale;
        (scale.ratio, scale.std) = (f64::NAN, Some(f64::INFINITY));
        scale.alternatives.insert(ScaleMethod::Intersection, f64::NAN);
        (scale.degenerate, scale.reason) = (true, Some("the ratio is NaN ± inf".into()));
        let verdict = Verdict { state: Trust::Doubtful, reasons: vec![Reason::doubts(ReasonKind::Size, 1.0, "NaN")] };
        let mut judged = world.trajectory.clone();
        judged.verdict = Some(verdict);
        world.trajectory.verdict = None;
        world.trajectory.poses.iter_mut().for_each(|pose| pose.position = [f64::NAN; 3]);
        let card = serde_json::to_string(&first_card(&world)).unwrap();
        assert!(!card.contains("NaN") && !card.contains("inf"), "{card}");
        assert!(card.contains("the ratio is unknown ± unlimited"), "{card}");
        world.trajectory = judged;
        let card = serde_json::to_string(&first_card(&world)).unwrap();
        assert!(!card.contains("NaN"), "{card}");
    }
}
