//! What a run found, as its last lines say it: vehicle by vehicle, in words that need no manual.

use std::fmt::Write;

use serde_json::{Value, json};

use crate::pipeline::{Summary, Vehicle};
use crate::report::Verdict;
use crate::scene::{Dimensions, Movement, ObjectId, ObjectTrajectory, TimeBase, Trajectories, Unit};

/// One paragraph per vehicle; where a run ends before the trajectories, nothing.
pub(super) fn as_text(summary: &Summary, trajectories: &Trajectories) -> String {
    let mut text = headline(summary.vehicles.len(), trajectories.objects.len()) + "\n";
    for (&id, vehicle) in &summary.vehicles {
        // Writing to a string cannot fail.
        let _ = match trajectories.objects.iter().find(|trajectory| trajectory.id == id) {
            Some(found) => write!(text, "{}", placed(found, vehicle, metres(trajectories), summary.time_base)),
            None => writeln!(text, "  {id}: {}, no trajectory: {}", class(vehicle), why_not(vehicle)),
        };
    }
    let said = trajectories.metric.as_ref().and_then(|metric| metric.reason.as_ref());
    if let Some(reason) = said.filter(|_| !trajectories.objects.is_empty()) {
        let _ = writeln!(text, "  {reason}");
    }
    text
}

/// Metres in the unit of the positions.
#[derive(Clone, Copy)]
struct Metres {
    per_unit: f64,
    /// Standard deviation as a share; 0 where the unit is the metre.
    std: f64,
}

fn metres(trajectories: &Trajectories) -> Option<Metres> {
    let frame = trajectories.metric.as_ref().and_then(|metric| metric.frame.as_ref());
    match trajectories.unit {
        Unit::Metre => Some(Metres { per_unit: 1.0, std: 0.0 }),
        Unit::Background => frame.map(|frame| Metres { per_unit: frame.scale, std: frame.log_scale_std() }),
    }
}

fn headline(num_vehicles: usize, num_placed: usize) -> String {
    let vehicles = count(num_vehicles, "vehicle");
    match num_placed {
        _ if num_vehicles == 0 => "no vehicle".to_owned(),
        0 if num_vehicles == 1 => format!("{vehicles}, without a trajectory"),
        0 => format!("{vehicles}, none with a trajectory"),
        all if all == num_vehicles => {
            format!("{vehicles} with {}", if all == 1 { "a trajectory" } else { "trajectories" })
        }
        some => format!("{vehicles}, {some} of them with a trajectory"),
    }
}

fn placed(found: &ObjectTrajectory, vehicle: &Vehicle, metres: Option<Metres>, times: TimeBase) -> String {
    let (id, class) = (found.id, class(vehicle));
    let (placed, visible) = (found.poses.len(), vehicle.model.num_visible);
    let mut text =
        format!("  {id}: {class}, placed in {placed} of {}{}\n", count(visible, "frame"), span(found, times));
    // Writing to a string cannot fail.
    let _ = writeln!(text, "     path: {}{}", length(found.path_length(), metres), speed(found, metres, times));
    if let Some(size) = found.dimensions.as_ref().and_then(size) {
        let _ = writeln!(text, "     size: {size}");
    }
    let _ = writeln!(text, "     {}", sureness(found));
    for reason in doubts(found) {
        let _ = writeln!(text, "     - {reason}");
    }
    if let Some(reason) = vehicle.model.unregistered.values().next().filter(|_| placed < visible) {
        let _ = writeln!(text, "     not in {}: {reason}", count(visible.saturating_sub(placed), "frame"));
    }
    text
}

/// From when to when.
fn span(found: &ObjectTrajectory, times: TimeBase) -> String {
    let (Some(first), Some(last)) = (found.poses.first(), found.poses.last()) else { return String::new() };
    match times {
        TimeBase::Seconds => format!(", from {:.1} s to {:.1} s", first.time_s, last.time_s),
        TimeBase::Frames => format!(", from frame {} to frame {}", first.frame.0, last.frame.0),
    }
}

/// How far the path can be trusted.
fn sureness(found: &ObjectTrajectory) -> String {
    let verdict = Verdict::of(Some(found));
    format!("{}. {}", verdict.label(), verdict.sentence(Some(found)))
}

/// What else speaks against the path, besides what the verdict's sentence says already.
fn doubts(found: &ObjectTrajectory) -> Vec<&str> {
    let against = found.verdict.iter().flat_map(|verdict| verdict.against());
    let is_said = matches!(Verdict::of(Some(found)), Verdict::Doubtful | Verdict::Refuted | Verdict::Weak);
    against.skip(usize::from(is_said)).map(|reason| reason.says.as_str()).collect()
}

fn why_not(vehicle: &Vehicle) -> &str {
    let reason = vehicle.model.failure.as_deref().or(vehicle.not_placed.as_deref());
    reason.unwrap_or("it is not known why")
}

/// "car, moving".
fn class(vehicle: &Vehicle) -> String {
    let class = if vehicle.class.is_empty() { "vehicle" } else { &vehicle.class };
    match vehicle.movement {
        Some(state @ (Movement::Moving | Movement::Standing)) => format!("{class}, {}", state.name()),
        Some(Movement::Undetermined) | None => class.to_owned(),
    }
}

/// `1 frame`, `2 frames`.
fn count(number: usize, noun: &str) -> String {
    let plural = if number == 1 { "" } else { "s" };
    format!("{number} {noun}{plural}")
}

fn length(length: f64, metres: Option<Metres>) -> String {
    match metres {
        Some(Metres { per_unit, std }) if std > 0.0 => format!("{:.1} m ± {:.1} %", per_unit * length, 100.0 * std),
        Some(Metres { per_unit, .. }) => format!("{:.1} m", per_unit * length),
        None => format!("{} units of the background", with_three_digits(length)),
    }
}

/// Units of the background are arbitrary: a path may be 0.00123 or 12300 of them long.
fn with_three_digits(value: f64) -> String {
    let magnitude = if value > 0.0 { value.log10().floor() as i32 } else { 0 };
    let decimals = (2 - magnitude).clamp(0, 9) as usize;
    format!("{value:.decimals$}")
}

/// Length, width and height, as far as they were seen.
fn size(size: &Dimensions) -> Option<String> {
    let parts = [("long", size.length_m), ("wide", size.width_m), ("high", size.height_m)];
    let said = parts.iter().filter_map(|(what, found)| Some((what, (*found)?)));
    let said: Vec<String> = said.map(|(what, e)| format!("{:.2} ± {:.2} m {what}", e.value, e.std)).collect();
    (!said.is_empty()).then(|| said.join(", "))
}

/// The mean speed, where it has a meaning.
fn speed(found: &ObjectTrajectory, metres: Option<Metres>, times: TimeBase) -> String {
    let (Some(first), Some(last)) = (found.poses.first(), found.poses.last()) else { return String::new() };
    let seconds = last.time_s - first.time_s;
    match (metres, times) {
        (Some(Metres { per_unit, .. }), TimeBase::Seconds) if seconds > 0.0 => {
            let speed = per_unit * found.path_length() / seconds;
            format!(", on average {speed:.1} m/s ({:.0} km/h)", 3.6 * speed)
        }
        _ => String::new(),
    }
}

/// The vehicles with a trajectory, for programs.
pub(super) fn placed_as_json(summary: &Summary, trajectories: &Trajectories) -> Vec<Value> {
    let value = |found: &ObjectTrajectory| {
        json!({
            "id": found.id,
            "class": found.class,
            "movement": summary.vehicles.get(&found.id).and_then(|vehicle| vehicle.movement),
            "frames": found.poses.len(),
            "visible": summary.vehicles.get(&found.id).map(|vehicle| vehicle.model.num_visible),
            "first_frame": found.poses.first().map(|pose| pose.frame),
            "last_frame": found.poses.last().map(|pose| pose.frame),
            "path_length": found.path_length(),
            "verdict": Verdict::of(Some(found)),
            "judged": found.verdict,
            "scale": found.scale,
        })
    };
    trajectories.objects.iter().map(value).collect()
}

/// The vehicles without, and why.
pub(super) fn missing_as_json(summary: &Summary, trajectories: &Trajectories) -> Vec<Value> {
    let is_placed = |id: &ObjectId| trajectories.objects.iter().any(|found| found.id == *id);
    let missing = summary.vehicles.iter().filter(|(id, _)| !is_placed(id));
    let value = |(id, vehicle): (&ObjectId, &Vehicle)| {
        let Vehicle { class, movement, .. } = vehicle;
        json!({ "id": id, "class": class, "movement": movement, "reason": why_not(vehicle) })
    };
    missing.map(value).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::Sim3;
    use crate::pipeline::ModelReport;
    use crate::scene::{self, Estimate, FrameId, ObjectPose, Reason, ReasonKind, ScaleEstimate, ScaleMethod, Trust};

    fn pose(frame: u32) -> ObjectPose {
        ObjectPose {
            frame: FrameId(frame),
            name: String::new(),
            time_s: f64::from(frame) * 0.1,
            position: [f64::from(frame) * 0.05, 0.0, 0.0],
            world_from_object: Sim3::identity(),
            speed: None,
            metric: None,
        }
    }

    fn judged(state: Trust, reasons: Vec<Reason>) -> scene::Verdict {
        scene::Verdict { state, reasons }
    }

    fn trajectory(id: u32) -> ObjectTrajectory {
        let scale = ScaleEstimate { std: Some(0.02), ..ScaleEstimate::new(2.0, ScaleMethod::Joint) };
        let poses = (3..=12).map(pose).collect();
        let verdict = Some(judged(Trust::Good, Vec::new()));
        let (class, ground) = ("car".into(), [].into());
        ObjectTrajectory { id: ObjectId(id), class, confidence: 1.0, scale, ground, verdict, dimensions: None, poses }
    }

    fn summary(vehicles: impl IntoIterator<Item = (u32, Vehicle)>, time_base: TimeBase) -> Summary {
        Summary {
            output: "out".into(),
            stages: Vec::new(),
            num_frames: 20,
            time_base,
            background: None,
            vehicles: vehicles.into_iter().map(|(id, vehicle)| (ObjectId(id), vehicle)).collect(),
            warnings: Vec::new(),
        }
    }

    fn vehicle(class: &str, num_visible: usize, failure: Option<&str>) -> Vehicle {
        let model = ModelReport { num_visible, failure: failure.map(str::to_owned), ..ModelReport::default() };
        Vehicle { class: class.to_owned(), movement: None, model, not_placed: None }
    }

    #[test]
    fn every_vehicle_is_told_in_words() {
        let vehicles = [(1, vehicle("car", 10, None)), (4, vehicle("truck", 2, Some("it is too small")))];
        let found = Trajectories { unit: Unit::Background, metric: None, objects: vec![trajectory(1)] };
        assert_eq!(
            as_text(&summary(vehicles.clone(), TimeBase::Seconds), &found),
            "2 vehicles, 1 of them with a trajectory\n  \
               1: car, placed in 10 of 10 frames, from 0.3 s to 1.2 s\n     \
                  path: 0.450 units of the background\n     \
                  scale well determined. Size and distance of this path are right to about 1.0 %, by the run's own \
                  estimate (one standard deviation).\n  \
               4: truck, no trajectory: it is too small\n"
        );
        let without_times = as_text(&summary(vehicles, TimeBase::Frames), &found);
        assert!(
            without_times.contains("from frame 3 to frame 12\n") && !without_times.contains(" s "),
            "{without_times}"
        );
    }

    #[test]
    fn metres_have_a_speed_and_one_vehicle_is_one() {
        let found = Trajectories { unit: Unit::Metre, metric: None, objects: vec![trajectory(1)] };
        let text = as_text(&summary([(1, vehicle("", 10, None))], TimeBase::Seconds), &found);
        assert!(text.starts_with("1 vehicle with a trajectory\n  1: vehicle, "), "{text}");
        assert!(text.contains("path: 0.5 m, on average 0.5 m/s (2 km/h)"), "{text}");
    }

    #[test]
    fn what_was_seen_of_a_size_is_said() {
        let length_m = Some(Estimate { value: 4.312, std: 0.118 });
        let seen = Dimensions { length_m, width_m: None, height_m: None };
        assert_eq!(size(&seen).as_deref(), Some("4.31 ± 0.12 m long"));
        assert_eq!(size(&Dimensions::default()), None);
    }

    #[test]
    fn what_is_not_sure_is_said() {
        let doubt = || Reason::doubts(ReasonKind::Pixels, 0.5, "it is small");
        let size = || Reason::refutes(ReasonKind::Size, "it is a tenth as large");
        let with = |state, reasons| ObjectTrajectory { verdict: Some(judged(state, reasons)), ..trajectory(1) };
        let fair = with(Trust::Fair, vec![doubt()]);
        assert!(sureness(&fair).contains("right to about 1.0 %") && doubts(&fair) == ["it is small"]);
        let refuted = with(Trust::NotToBeTrusted, vec![size(), doubt()]);
        assert!(sureness(&refuted).starts_with("not to be trusted. This path cannot be right: it is a tenth"));
        assert_eq!(doubts(&refuted), ["it is small"]);
        let unjudged = ObjectTrajectory { verdict: None, ..trajectory(1) };
        assert!(sureness(&unjudged).starts_with("not judged"));
        assert_eq!(headline(0, 0), "no vehicle");
        assert_eq!(
            (headline(2, 2).as_str(), headline(3, 0).as_str()),
            ("2 vehicles with trajectories", "3 vehicles, none with a trajectory")
        );
    }
}
