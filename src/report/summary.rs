//! The one sentence that says what was found, and how sure it is.

use super::data::{Data, Object};
use super::verdict::{Verdict, relative_std};
use super::words::{capitalised, count, name, percent};

/// The sentence.
pub(super) fn sentence(data: &Data) -> String {
    let frames = data.frames.len();
    let registered = data.background.reconstruction.images.len();
    if registered == 0 {
        return format!(
            "Nothing could be reconstructed: the camera's path was not found in {}.",
            count(frames, "frame")
        );
    }
    let camera = if registered >= frames {
        format!("the camera's path in all {}", count(frames, "frame"))
    } else {
        format!("the camera's path in {registered} of {}", count(frames, "frame"))
    };
    let found = data.objects.iter().filter(|o| o.trajectory.is_some()).count();
    if data.objects.is_empty() {
        return format!("Reconstructed: {camera}. No vehicle was found in the video.");
    }
    let seen = data.objects.len();
    if found == 0 {
        return format!("Reconstructed: {camera}, but the trajectory of none of {}.", count(seen, "vehicle"));
    }
    let vehicles = match (found, seen) {
        (1, 1) => "the 3D trajectory of the one vehicle".to_owned(),
        (f, s) if f == s => format!("the 3D trajectories of all {s} vehicles"),
        (f, s) => format!("the 3D trajectories of {f} of {s} vehicles"),
    };
    format!("Reconstructed: {camera}, and {vehicles}. {}", sureness(data))
}

/// How sure the scales of the trajectories are, in one sentence.
fn sureness(data: &Data) -> String {
    let of = |wanted: &[Verdict]| -> Vec<&Object> {
        data.objects.iter().filter(|o| wanted.contains(&Verdict::of(o.trajectory))).collect()
    };
    let known = of(&[Verdict::Good, Verdict::Fair]);
    let worst = known.iter().filter_map(|o| relative_std(&o.trajectory?.scale)).reduce(f64::max);
    let mut parts = Vec::new();
    if let Some(worst) = worst {
        let better = if known.len() > 1 { " or better" } else { "" };
        parts.push(format!(
            "by the run's own estimate, size and distance of {} are right to about {}{better}",
            paths_of(&known),
            percent(worst)
        ));
    }
    for (verdict, before, after) in [
        (Verdict::Unrated, "it is not known how exact size and distance of", "are"),
        (Verdict::Weak, "size and distance of", "are only weakly determined"),
        (Verdict::Degenerate, "size and distance of", "are undetermined: do not measure with them"),
        (Verdict::Doubtful, "", "may well be wrong"),
        (Verdict::Refuted, "", "cannot be right: do not measure with them"),
    ] {
        let objects = of(&[verdict]);
        if !objects.is_empty() {
            parts.push(format!("{before} {} {after}", paths_of(&objects)).trim_start().to_owned());
        }
    }
    capitalised(&format!("{}.", parts.join("; ")))
}

/// "the path of Car 1", "the paths of Car 1 and Van 2", "5 paths".
fn paths_of(objects: &[&Object]) -> String {
    match objects {
        [one] => format!("the path of {}", name(one)),
        [one, two] => format!("the paths of {} and {}", name(one), name(two)),
        many => count(many.len(), "path"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;
    use crate::scene::{self, Trust};

    #[test]
    fn the_sentence_names_the_vehicles_and_says_how_sure_each_is() {
        let mut world = testing::world();
        world.trajectory.scale.std = Some(0.02 * world.trajectory.scale.ratio);
        assert!(sentence(&world.data()).ends_with(
            "3D trajectories of 1 of 2 vehicles. By the run's own estimate, size and distance of the path of Car 1 are \
             right to about 2.0 %."
        ));
        world.trajectory.scale.degenerate = true;
        world.trajectory.verdict = Some(scene::Verdict { state: Trust::NotToBeTrusted, reasons: Vec::new() });
        assert!(sentence(&world.data()).ends_with("the path of Car 1 are undetermined: do not measure with them."));
    }
}
