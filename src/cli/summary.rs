//! The result of a run in its last lines, vehicle by vehicle.

use std::fmt::Write;

use crate::math::rounding::counted;
use crate::pipeline::{Summary, Vehicle};
use crate::report::{Fact, Verdict, estimate, ground_track_facts, travel_facts};
use crate::scene::{Dimensions, GroundTrack, Movement, ObjectTrajectory, TimeBase, Trajectories};

/// One paragraph per vehicle; where a run ends before the trajectories, nothing.
pub(super) fn as_text(summary: &Summary, trajectories: &Trajectories) -> String {
    let num_on_ground = trajectories.ground_tracks.len();
    let mut text = headline(summary.vehicles.len(), trajectories.objects.len(), num_on_ground);
    text += &ground_track_count(num_on_ground);
    text += "\n";
    for (&id, vehicle) in &summary.vehicles {
        // Writing to a string cannot fail.
        let _ = match trajectories.objects.iter().find(|trajectory| trajectory.id == id) {
            Some(found) => write!(text, "{}", placed(found, vehicle, summary.time_base)),
            None => {
                let name = trajectories.class_of(id).unwrap_or(&vehicle.class);
                writeln!(text, "  {id}: {}, no trajectory: {}", class(name, vehicle), why_not(vehicle))
            }
        };
        text += &trajectories.ground_track(id).map(|track| on_ground(track, summary.time_base)).unwrap_or_default();
    }
    let said = trajectories.metric.as_ref().and_then(|metric| metric.reason.as_ref());
    let is_empty = trajectories.objects.is_empty() && trajectories.ground_tracks.is_empty();
    if let Some(reason) = said.filter(|_| !is_empty) {
        let _ = writeln!(text, "  {reason}");
    }
    text
}

fn headline(num_vehicles: usize, num_placed: usize, num_on_ground: usize) -> String {
    let vehicles = counted(num_vehicles, "vehicle");
    match num_placed {
        _ if num_vehicles == 0 => "no vehicle".to_owned(),
        0 if num_on_ground > 0 => vehicles,
        0 if num_vehicles == 1 => format!("{vehicles}, no trajectory"),
        0 => format!("{vehicles}, no trajectories"),
        all if all == num_vehicles => {
            format!("{vehicles} with {}", if all == 1 { "a trajectory" } else { "trajectories" })
        }
        some => format!("{vehicles}, {some} with a trajectory"),
    }
}

/// Number of ground tracks, behind that of trajectories.
fn ground_track_count(number: usize) -> String {
    if number == 0 { String::new() } else { format!("; {} without a 3D model", counted(number, "ground track")) }
}

/// Lines on a ground track.
fn on_ground(track: &GroundTrack, times: TimeBase) -> String {
    let verdict = track.verdict.as_ref();
    let said = verdict.map(|verdict| format!(": {}. {}", verdict.state.name(), verdict.says)).unwrap_or_default();
    let mut text = format!("     ground track in {}{said}\n", counted(track.positions.len(), "frame"));
    if let Some(travel) = in_words(&ground_track_facts(track, times)) {
        text += &format!("     on the ground: {travel}\n");
    }
    if let Some(size) = track.dimensions.and_then(|size| size_in_words(size, false)) {
        text += &format!("     size: {size}\n");
    }
    if let Some(omitted) = track.omissions() {
        text += &format!("     no contact with the ground in {omitted}\n");
    }
    text
}

fn placed(found: &ObjectTrajectory, vehicle: &Vehicle, times: TimeBase) -> String {
    let (id, class) = (found.id, class(&found.class, vehicle));
    let (placed, visible) = (found.poses.len(), vehicle.model.num_visible);
    let mut text =
        format!("  {id}: {class}, 3D position in {placed} of {}{}\n", counted(visible, "frame"), span(found, times));
    // Writing to a string cannot fail.
    let _ = writeln!(text, "     {}", sureness(found));
    if let Some(travel) = in_words(&travel_facts(found, times)) {
        let _ = writeln!(text, "     {travel}");
    }
    if let Some(size) = found.dimensions.and_then(|size| size_in_words(size, found.is_ruled_out())) {
        let _ = writeln!(text, "     size: {size}");
    }
    for reason in doubts(found) {
        let _ = writeln!(text, "     - {reason}");
    }
    if let Some(reason) = vehicle.model.unregistered.values().next().filter(|_| placed < visible) {
        let _ = writeln!(text, "     no position in {}: {reason}", counted(visible.saturating_sub(placed), "frame"));
    }
    text
}

/// Facts in a line; `None` where there are none.
fn in_words(facts: &[Fact]) -> Option<String> {
    let said: Vec<String> = facts.iter().map(|fact| format!("{}: {}", fact.label, fact.value)).collect();
    (!said.is_empty()).then(|| said.join(", "))
}

/// From when to when.
fn span(found: &ObjectTrajectory, times: TimeBase) -> String {
    let (Some(first), Some(last)) = (found.poses.first(), found.poses.last()) else { return String::new() };
    match times {
        TimeBase::Seconds => format!(", from {:.1} s to {:.1} s", first.time_s, last.time_s),
        TimeBase::Frames => format!(", from frame {} to frame {}", first.frame.0, last.frame.0),
    }
}

/// Trust in the trajectory.
fn sureness(found: &ObjectTrajectory) -> String {
    let verdict = Verdict::of(Some(found));
    format!("{}. {}", verdict.label(), verdict.sentence(Some(found)))
}

/// Complaints besides the one in the verdict's sentence.
fn doubts(found: &ObjectTrajectory) -> Vec<&str> {
    let complaints = found.verdict.iter().flat_map(|verdict| verdict.complaints());
    let is_said = matches!(Verdict::of(Some(found)), Verdict::Doubtful | Verdict::Rejected);
    complaints.skip(usize::from(is_said)).map(|reason| reason.says.as_str()).collect()
}

pub(super) fn why_not(vehicle: &Vehicle) -> &str {
    let reason = vehicle.not_placed.as_deref().or(vehicle.model.failure.as_deref());
    reason.unwrap_or("reason unknown")
}

/// "car, moving".
fn class(name: &str, vehicle: &Vehicle) -> String {
    let class = if name.is_empty() { "vehicle" } else { name };
    match vehicle.movement {
        Some(state @ (Movement::Moving | Movement::Stationary)) => format!("{class}, {}", state.name()),
        Some(Movement::Undetermined) | None => class.to_owned(),
    }
}

/// Length, width and height, as far as they were seen.
fn size_in_words(Dimensions { length_m, width_m, height_m }: Dimensions, is_ruled_out: bool) -> Option<String> {
    let parts = [("long", length_m), ("wide", width_m), ("high", height_m)];
    let said =
        parts.into_iter().filter_map(|(what, size)| Some(format!("{} {what}", estimate(is_ruled_out, size?, "m"))));
    let said: Vec<String> = said.collect();
    (!said.is_empty()).then(|| said.join(", "))
}

#[cfg(test)]
mod tests {
    use super::super::run_output::objects_as_json;
    use super::*;
    use crate::math::Sim3;
    use crate::pipeline::ModelReport;
    use crate::scene::{
        self, Estimate, FrameId, ObjectId, ObjectPose, Reason, ReasonKind, ScaleEstimate, ScaleMethod, Travel, Trust,
        Unit,
    };

    fn pose(frame: u32) -> ObjectPose {
        ObjectPose {
            frame: FrameId(frame),
            name: String::new(),
            time_s: f64::from(frame) * 0.1,
            position: [f64::from(frame) * 0.05, 0.0, 0.0],
            world_from_object: Sim3::identity(),
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
        let path_units = Estimate { value: 0.45, std: 0.01 };
        let travel = Some(Travel {
            path_units,
            displacement_units: path_units,
            path_m: None,
            displacement_m: None,
            mean_speed_m_s: None,
            max_speed_m_s: None,
        });
        ObjectTrajectory { verdict, travel, poses, ..ObjectTrajectory::new(ObjectId(id), "car", 1.0, scale) }
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
        // Detected as a bus, of the size of a car.
        let vehicles = [(1, vehicle("bus", 10, None)), (4, vehicle("truck", 2, Some("it is too small")))];
        let found = Trajectories {
            unit: Unit::Background,
            metric: None,
            objects: vec![trajectory(1)],
            ground_tracks: Vec::new(),
        };
        assert_eq!(
            as_text(&summary(vehicles.clone(), TimeBase::Seconds), &found),
            "2 vehicles, 1 with a trajectory\n  \
               1: car, 3D position in 10 of 10 frames, from 0.3 s to 1.2 s\n     \
                  good. Estimated error of this vehicle's size and distance: ±1.0 % (1σ).\n     \
                  path length: 0.450 ± 0.010 units, displacement: 0.450 ± 0.010 units, mean speed: 0.500 ± 0.011 \
                  units/s\n  \
               4: truck, no trajectory: it is too small\n"
        );
        let without_times = as_text(&summary(vehicles, TimeBase::Frames), &found);
        assert!(
            without_times.contains("from frame 3 to frame 12\n") && !without_times.contains(" s "),
            "{without_times}"
        );
    }

    #[test]
    fn metres_have_speeds_and_sizes_and_one_vehicle_is_one() {
        let mut vehicle_1 = ObjectTrajectory { class: String::new(), ..trajectory(1) };
        let speed = |value| Some(Estimate { value, std: 0.04 * value });
        vehicle_1.travel = vehicle_1.travel.map(|travel| Travel {
            path_m: Some(travel.path_units.scaled(10.0)),
            displacement_m: Some(travel.path_units.scaled(10.0)),
            mean_speed_m_s: speed(5.0),
            max_speed_m_s: speed(6.0),
            ..travel
        });
        let length_m = Some(Estimate { value: 4.312, std: 0.118 });
        vehicle_1.dimensions = Some(Dimensions { length_m, width_m: None, height_m: None });
        let found =
            Trajectories { unit: Unit::Background, metric: None, objects: vec![vehicle_1], ground_tracks: Vec::new() };
        let summary = summary([(1, vehicle("", 10, None))], TimeBase::Seconds);
        let text = as_text(&summary, &found);
        assert!(text.starts_with("1 vehicle with a trajectory\n  1: vehicle, "), "{text}");
        let line = "path length: 4.50 ± 0.10 m, displacement: 4.50 ± 0.10 m, mean speed: 18.00 ± 0.72 km/h";
        assert!(text.contains(line) && text.contains("size: 4.31 ± 0.12 m long\n"), "{text}");
        let value = &objects_as_json(&summary, &found)[0];
        assert_eq!((&value["verdict"], &value["path_m"]["value"]), (&"good".into(), &4.5.into()));
        assert_eq!((&value["mean_speed_m_s"]["value"], &value["length_m"]["std"]), (&5.0.into(), &0.118.into()));
        assert_eq!((&value["path_length"], &value["judged"]["state"]), (&0.45.into(), &"good".into()), "old keys");
    }

    #[test]
    fn what_is_not_sure_is_said() {
        let doubt = || Reason::doubts(ReasonKind::Pixels, 0.5, "it is small");
        let size = || Reason::refutes(ReasonKind::Size, "it is a tenth as large");
        let with = |state, reasons| ObjectTrajectory { verdict: Some(judged(state, reasons)), ..trajectory(1) };
        let fair = with(Trust::Fair, vec![doubt()]);
        assert!(sureness(&fair).contains("±1.0 %") && doubts(&fair) == ["it is small"]);
        let refuted = with(Trust::Rejected, vec![size(), doubt()]);
        assert!(sureness(&refuted).starts_with("rejected. Do not use for measurement: it is a tenth"));
        assert_eq!(doubts(&refuted), ["it is small"]);
        let unjudged = ObjectTrajectory { verdict: None, ..trajectory(1) };
        assert!(sureness(&unjudged).starts_with("not judged"));
        assert_eq!((headline(0, 0, 0).as_str(), headline(3, 0, 2).as_str()), ("no vehicle", "3 vehicles"));
        assert_eq!(
            (headline(2, 2, 0).as_str(), headline(3, 0, 0).as_str()),
            ("2 vehicles with trajectories", "3 vehicles, no trajectories")
        );
    }
}
