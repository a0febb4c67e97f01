//! The key figures of a run.

use crate::report::data::{Data, Fact};
use crate::report::metres;
use crate::report::timeline::Timeline;
use crate::report::words::{LENGTH_UNIT, count, percent, share, thousands, with_unit};
use crate::scene::{Ground, GroundSource, PlaneBasis};

/// The key figures, the most important first.
pub(super) fn key_figures(data: &Data, timeline: &Timeline) -> Vec<Fact> {
    let background = data.background.reconstruction;
    let with_trajectory = data.objects.iter().filter(|o| o.trajectory.is_some()).count();
    let with_model = data.objects.iter().filter(|o| o.model.is_some()).count();
    let vehicles = if data.is_sfm {
        let note = format!("with a model, of {} detected", data.objects.len());
        (!data.objects.is_empty()).then(|| Fact::new("vehicles", with_model.to_string()).with_note(note))
    } else {
        let on_ground = data.objects.iter().filter(|o| o.ground_track.is_some()).count();
        let detected = data.objects.len();
        let (number, note) = match (with_trajectory, on_ground) {
            (_, 0) => (with_trajectory, format!("with a trajectory, of {detected} detected")),
            (0, _) => (on_ground, format!("with a ground track, of {detected} detected")),
            _ => {
                let tracks = count(on_ground, "ground track");
                (with_trajectory, format!("with a trajectory, of {detected} detected; {tracks}"))
            }
        };
        Some(Fact::new("vehicles", number.to_string()).with_note(note))
    };
    let mut facts = vec![
        timeline.length(),
        Fact::new("camera registered", share(background.images.len(), data.frames.len())).with_note(format!(
            "in {} of {}",
            background.images.len(),
            count(data.frames.len(), "frame")
        )),
        Fact::new("points", thousands(background.points.len())).with_note("in the background"),
    ];
    if let Some(error) = background.mean_reprojection_error_px() {
        let note = "mean over the background points";
        facts.push(Fact::new("reprojection error", with_unit(error, 2, "px")).with_note(note));
    }
    facts.splice(2..2, vehicles);
    if !data.is_sfm {
        facts.push(ground(data));
        facts.push(unit(data));
    }
    facts
}

/// Unit of lengths, and its uncertainty.
fn unit(data: &Data) -> Fact {
    match data.metric.and_then(metres::frame) {
        Some(frame) => Fact::new("unit of length", "meter").with_note(format!("± {}", percent(frame.log_scale_std()))),
        None => {
            let note = format!("lengths are in {LENGTH_UNIT}, not in meters; give --camera-height or --telemetry");
            Fact::new("unit of length", "arbitrary").with_note(note)
        }
    }
}

fn ground(data: &Data) -> Fact {
    let source = data.ground.map(|g| match g.source {
        GroundSource::Masks => ("given", "by ground masks"),
        GroundSource::Model => ("segmented", "by a network"),
        GroundSource::Geometric => ("estimated", "without labels"),
    });
    let (value, note) = source.unwrap_or(("none", "no ground found"));
    let basis = data.ground.and_then(commonest_basis).map(|basis| format!("{note}: {}", basis.words()));
    Fact::new("ground", value).with_note(basis.unwrap_or_else(|| note.to_owned()))
}

/// Most common basis of the planes; the most reliable in a tie.
fn commonest_basis(ground: &Ground) -> Option<PlaneBasis> {
    let count = |basis: &PlaneBasis| ground.planes.values().filter(|plane| plane.basis == *basis).count();
    PlaneBasis::ALL.into_iter().rev().max_by_key(count).filter(|basis| count(basis) > 0)
}
