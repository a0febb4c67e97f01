//! Comparison of a result with the ground truth, in figures for readers without knowledge of the methods.

use super::data::Fact;
use super::words::{UNKNOWN, count, figure, percent, with_unit};
use crate::eval::{Alternative, Evaluation, Outcome, RegisteredFrames, ScaleFigures};
use crate::scene::ObjectId;

/// The figures of the comparison; `name` returns the names of the run's vehicles.
pub(super) fn evaluation_facts(evaluation: &Evaluation, name: impl Fn(ObjectId) -> String) -> Vec<Fact> {
    let target = match evaluation.target.as_ref() {
        Ok(target) => name(target.object),
        Err(_) => "the vehicle".to_owned(),
    };
    let mut facts = vec![
        camera_path(evaluation),
        unit(evaluation),
        registered(&evaluation.registered, &target),
        vehicle_path(evaluation, &target),
        at_reference(evaluation),
        scale(evaluation),
    ];
    facts.extend(before_the_adjustment(evaluation));
    let chosen = evaluation.scale.as_ref().ok().map(|s| s.method);
    let others = evaluation.alternatives.iter().filter(|(method, _)| Some(**method) != chosen);
    facts.extend(others.map(|(method, answer)| other_method(method.name(), answer)));
    if !evaluation.others.is_empty() {
        let others: Vec<String> = evaluation.others.iter().map(|other| name(other.object)).collect();
        facts
            .push(Fact::new("not compared", others.join(", ")).with_note(format!("ground truth covers {target} only")));
    }
    facts
}

fn camera_path(evaluation: &Evaluation) -> Fact {
    outcome("camera path error", &evaluation.cameras, |c| {
        let note = format!(
            "RMSE of the camera centers after alignment with the truth; rotation error {}° on average, {}° maximum",
            figure(c.rotation_mean_deg, 2),
            figure(c.rotation_max_deg, 2)
        );
        (metres(c.center_rmse_m), note)
    })
}

fn unit(evaluation: &Evaluation) -> Fact {
    outcome("one unit of this result", &evaluation.registration, |r| {
        let note = format!("in the true world, from {}", count(r.num_cameras, "camera"));
        (metres(r.world_from_background.scale), note)
    })
}

fn registered(frames: &RegisteredFrames, target: &str) -> Fact {
    let note = format!(
        "registered frames of the background; {target} is registered in {} of the {} in which it is visible",
        frames.num_object,
        count(frames.num_visible, "frame")
    );
    Fact::new("registered frames", format!("{} of {}", frames.num_background, count(frames.num_frames, "frame")))
        .with_note(note)
}

fn vehicle_path(evaluation: &Evaluation, target: &str) -> Fact {
    outcome(&format!("trajectory error of {target}"), &evaluation.trajectory, |t| {
        let share = t
            .mean_share_of_distance
            .map_or(String::new(), |share| format!("; on average {} of its distance from the camera", percent(share)));
        let note = format!(
            "mean distance of its {} from its true surface, over {}; median {}{share}",
            count(t.num_points, "point"),
            count(t.num_frames, "frame"),
            metres(t.median_m)
        );
        (metres(t.mean_m), note)
    })
}

fn at_reference(evaluation: &Evaluation) -> Fact {
    outcome("at the true scale ratio", &evaluation.trajectory_at_reference, |t| {
        (metres(t.mean_m), "remaining trajectory error: that of the two reconstructions".to_owned())
    })
}

fn scale(evaluation: &Evaluation) -> Fact {
    outcome("scale ratio r", &evaluation.scale, |scale| {
        let reference = evaluation.reference_scale.as_ref();
        let value = match reference {
            Ok(reference) => format!("{}, true value {}", figure(scale.ratio, 4), figure(reference.ratio, 4)),
            Err(_) => figure(scale.ratio, 4),
        };
        let found = reference.map(|r| error_of_ratio(scale, r.ratio));
        (value, found.unwrap_or_else(|reason| format!("true ratio unknown: {reason}")))
    })
}

/// "0.58 % too small; the run itself gives or takes 0.82 %".
fn error_of_ratio(scale: &ScaleFigures, reference: f64) -> String {
    let side = if scale.ratio < reference { "too small" } else { "too large" };
    let error = format!("{} {side}", percent((scale.ratio / reference - 1.0).abs()));
    match scale.std {
        Some(std) => {
            format!("{error}; reported standard deviation {}", percent(std / scale.ratio))
        }
        None => format!("{error}; no reported standard deviation"),
    }
}

fn before_the_adjustment(evaluation: &Evaluation) -> Option<Fact> {
    let before = evaluation.as_reconstructed.as_ref()?;
    Some(outcome("before the adjustment with the ground", before, |b| {
        let note = "trajectory error at the true scale ratio without the adjustment";
        (metres(b.error_at_reference_m), note.to_owned())
    }))
}

fn other_method(method: &str, answer: &Alternative) -> Fact {
    let value = answer.trajectory_error_m.map_or_else(|| UNKNOWN.to_owned(), metres);
    let error = answer.deviation.map_or_else(String::new, |d| format!(", {} off", percent(d)));
    Fact::new(format!("at the ratio of {method}"), value)
        .with_note(format!("trajectory error; its ratio is {}{error}", figure(answer.ratio, 4)))
}

fn outcome<T>(label: &str, outcome: &Outcome<T>, said: impl FnOnce(&T) -> (String, String)) -> Fact {
    let (value, note) = outcome.as_ref().map_or_else(|reason| (UNKNOWN.to_owned(), reason.to_owned()), said);
    Fact::new(label, value).with_note(note)
}

/// A true length in the unit in which it is easiest to read.
fn metres(m: f64) -> String {
    match m.abs() {
        small if small < 0.01 => with_unit(1000.0 * m, 2, "mm"),
        small if small < 1.0 => with_unit(100.0 * m, 2, "cm"),
        _ => with_unit(m, 3, "m"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;

    fn facts(evaluation: &Evaluation) -> Vec<Fact> {
        evaluation_facts(evaluation, |id| format!("Car {id}"))
    }

    fn value<'a>(facts: &'a [Fact], label: &str) -> &'a Fact {
        facts.iter().find(|f| f.label == label).unwrap_or_else(|| panic!("{label} in {facts:?}"))
    }

    #[test]
    fn real_evaluation_is_reported_in_meters_and_per_cent() {
        let facts = facts(&testing::evaluation());
        assert_eq!(value(&facts, "camera path error").value, "1.3 mm");
        assert_eq!(value(&facts, "one unit of this result").value, "10.8 m");
        assert_eq!(value(&facts, "registered frames").value, "60 of 60 frames");
        assert_eq!(value(&facts, "trajectory error of Car 1").value, "9.0 cm");
        let ratio = value(&facts, "scale ratio r");
        assert_eq!(ratio.value, "0.8073, true value 0.8119");
        assert!(ratio.note.as_ref().unwrap().starts_with("0.58 % too small; reported standard deviation 0.82 %"));
        assert!(facts.iter().any(|f| f.label == "at the ratio of intersection"));
        assert!(!facts.iter().any(|f| f.label == "at the ratio of joint"), "it is the one in use");
    }

    #[test]
    fn failed_comparison_has_a_reason() {
        let mut evaluation = testing::evaluation();
        let unavailable = || "the target was not found".to_owned();
        evaluation.target = Outcome::Unavailable { reason: unavailable() };
        evaluation.trajectory = Outcome::Unavailable { reason: unavailable() };
        evaluation.others = vec![crate::eval::Target { object: ObjectId(3), iou: None }];
        let facts = facts(&evaluation);
        let path = value(&facts, "trajectory error of the vehicle");
        assert_eq!((path.value.as_str(), path.note.as_deref()), (UNKNOWN, Some("the target was not found")));
        assert_eq!(value(&facts, "not compared").value, "Car 3");
    }
}
