//! Summary sentence of the results and their uncertainty.

use super::data::{Data, Object};
use super::verdict::{Verdict, relative_std};
use super::words::{capitalised, count, name, percent, thousands, with_unit};

/// The summary sentence.
pub(super) fn sentence(data: &Data) -> String {
    let frames = data.frames.len();
    let registered = data.background.reconstruction.images.len();
    if registered == 0 {
        return format!("Nothing reconstructed: the camera path was not found in {}.", count(frames, "frame"));
    }
    // Without translation of the camera points have no depth.
    let camera = match data.background.reconstruction.points.is_empty() {
        true => "the camera's viewing direction",
        false => "the camera path",
    };
    let camera = if registered >= frames {
        format!("{camera} in all {}", count(frames, "frame"))
    } else {
        format!("{camera} in {registered} of {}", count(frames, "frame"))
    };
    if data.is_sfm {
        return models_in_words(data);
    }
    let found = data.objects.iter().filter(|o| o.trajectory.is_some()).count();
    if data.objects.is_empty() {
        return format!("Reconstructed: {camera}. No vehicle detected.");
    }
    let seen = data.objects.len();
    let ground = data.objects.iter().filter(|o| o.ground_track.is_some()).count();
    let on_ground = if ground == 0 { String::new() } else { format!(" Ground tracks without a 3D model: {ground}.") };
    match (found, ground) {
        (0, 0) => return format!("Reconstructed: {camera}; no trajectory of {}.", count(seen, "vehicle")),
        (0, _) => {
            let of_all = format!("ground tracks of {ground} of {}", count(seen, "vehicle"));
            return format!("Reconstructed: {camera}, and {of_all}, without 3D models.");
        }
        _ => {}
    }
    let vehicles = match (found, seen) {
        (1, 1) => "the 3D trajectory of the vehicle".to_owned(),
        (f, s) if f == s => format!("the 3D trajectories of all {s} vehicles"),
        (f, s) => format!("the 3D trajectories of {f} of {s} vehicles"),
    };
    format!("Reconstructed: {camera}, and {vehicles}. {}{on_ground}", sureness(data))
}

/// Result of `tractrix sfm`.
fn models_in_words(data: &Data) -> String {
    let background = data.background.reconstruction;
    let images = match (background.images.len(), data.frames.len()) {
        (registered, all) if registered >= all => format!("all {}", count(all, "image")),
        (registered, all) => format!("{registered} of {}", count(all, "image")),
    };
    let points = format!("{} points", thousands(background.points.len()));
    let error =
        background.mean_reprojection_error_px().map(|error| format!(", mean residual {}", with_unit(error, 2, "px")));
    let found = data.objects.iter().filter(|object| object.model.is_some()).count();
    let vehicles = match data.objects.len() {
        0 => String::new(),
        all => format!(" Models of vehicles, each in its own unit: {found} of {all}."),
    };
    format!("Reconstructed: {images} registered, {points}{}.{vehicles}", error.unwrap_or_default())
}

/// Scale uncertainties and verdicts in one sentence.
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
            "estimated error of size and distance: {} ±{}{better} (1σ)",
            names_of(&known),
            percent(worst)
        ));
    }
    for verdict in [Verdict::Doubtful, Verdict::Rejected] {
        let objects = of(&[verdict]);
        if !objects.is_empty() {
            parts.push(format!("{}: {}", verdict.label(), names_of(&objects)));
        }
    }
    capitalised(&format!("{}.", parts.join("; ")))
}

/// "Car 1", "Car 1 and Van 2", "5 vehicles".
fn names_of(objects: &[&Object]) -> String {
    match objects {
        [one] => name(one),
        [one, two] => format!("{} and {}", name(one), name(two)),
        many => count(many.len(), "vehicle"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::testing;
    use crate::scene::{self, Trust};

    #[test]
    fn models_alone_have_a_sentence_without_trajectories() {
        let world = testing::world();
        let said = sentence(&Data { is_sfm: true, ..world.data() });
        assert!(said.contains("images registered, ") && said.contains("mean residual"), "{said}");
        assert!(said.ends_with("Models of vehicles, each in its own unit: 1 of 2."), "{said}");
    }

    #[test]
    fn a_camera_that_does_not_translate_has_no_path() {
        let mut world = testing::world();
        assert!(sentence(&world.data()).starts_with("Reconstructed: the camera path in "));
        world.background.points = Default::default();
        assert!(sentence(&world.data()).starts_with("Reconstructed: the camera's viewing direction in "));
    }

    #[test]
    fn sentence_names_the_vehicles_and_their_uncertainty() {
        let mut world = testing::world();
        world.trajectory.scale.std = Some(0.02 * world.trajectory.scale.ratio);
        assert!(
            sentence(&world.data()).ends_with(
                "3D trajectories of 1 of 2 vehicles. Estimated error of size and distance: Car 1 ±2.0 % (1σ)."
            )
        );
        world.trajectory.scale.degenerate = true;
        world.trajectory.verdict = Some(scene::Verdict { state: Trust::Rejected, reasons: Vec::new() });
        assert!(sentence(&world.data()).ends_with("Rejected: Car 1."));
    }
}
