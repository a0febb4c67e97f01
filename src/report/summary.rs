//! Figures and sentences: what was found, and how sure it is.

use serde::Serialize;

use super::data::{Data, Object};
use crate::scene::{Image, ObjectPose, ObjectTrajectory, Observation, Reconstruction, ScaleEstimate, Unit};

/// A relative standard deviation of the scale ratio up to which it counts as well determined.
const GOOD_STD: f64 = 0.03;
/// A relative standard deviation, or disagreement between methods, beyond which the scale is called weak.
const WEAK_STD: f64 = 0.10;

/// How far a trajectory can be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Verdict {
    /// The scale is known to better than [`GOOD_STD`].
    Good,
    /// Between the two bounds.
    Fair,
    /// Worse than [`WEAK_STD`], or the methods contradict each other.
    Weak,
    /// No standard deviation is known, and nothing contradicts the scale.
    Unrated,
    /// The motion leaves the scale undetermined.
    Degenerate,
    /// No trajectory.
    Missing,
}

impl Verdict {
    /// Of an object's result.
    pub fn of(object: &Object) -> Self {
        let Some(trajectory) = object.trajectory else { return Self::Missing };
        let scale = &trajectory.scale;
        let contradicted = disagreement(scale).is_some_and(|d| d > WEAK_STD);
        match relative_std(scale) {
            _ if scale.degenerate => Self::Degenerate,
            Some(std) if std > WEAK_STD => Self::Weak,
            Some(std) if std > GOOD_STD => Self::Fair,
            Some(_) => Self::Good,
            None if contradicted => Self::Weak,
            None => Self::Unrated,
        }
    }

    /// What the badge says.
    pub fn label(self) -> &'static str {
        match self {
            Self::Good => "scale well determined",
            Self::Fair => "scale fairly determined",
            Self::Weak => "scale weakly determined",
            Self::Unrated => "scale without error estimate",
            Self::Degenerate => "scale undetermined",
            Self::Missing => "no trajectory",
        }
    }
}

/// Standard deviation of the ratio as a fraction of it.
pub(super) fn relative_std(scale: &ScaleEstimate) -> Option<f64> {
    scale.std.map(|s| s / scale.ratio).filter(|s| s.is_finite() && *s >= 0.0)
}

/// The largest deviation of another method's ratio, as a fraction.
pub(super) fn disagreement(scale: &ScaleEstimate) -> Option<f64> {
    let others = scale.alternatives.iter().filter(|(method, _)| **method != scale.method);
    others.map(|(_, r)| (r / scale.ratio - 1.0).abs()).filter(|d| d.is_finite()).reduce(f64::max)
}

/// The one sentence that says what was reconstructed, and how sure it is.
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
        data.objects.iter().filter(|o| wanted.contains(&Verdict::of(o))).collect()
    };
    let known = of(&[Verdict::Good, Verdict::Fair]);
    let worst = known.iter().filter_map(|o| relative_std(&o.trajectory?.scale)).reduce(f64::max);
    let mut parts = Vec::new();
    if let Some(worst) = worst {
        let better = if known.len() > 1 { " or better" } else { "" };
        parts.push(format!("the scale of {} is known to ±{}{better}", who(&known), percent(worst)));
    }
    for (verdict, what) in [
        (Verdict::Unrated, "has no error estimate"),
        (Verdict::Weak, "is only weakly determined"),
        (Verdict::Degenerate, "is undetermined: don't measure with it"),
    ] {
        let objects = of(&[verdict]);
        if !objects.is_empty() {
            parts.push(format!("the scale of {} {what}", who(&objects)));
        }
    }
    capitalised(&format!("{}.", parts.join("; ")))
}

/// "Car 1", "Car 1 and Van 2", "5 vehicles".
fn who(objects: &[&Object]) -> String {
    match objects {
        [one] => name(one),
        [one, two] => format!("{} and {}", name(one), name(two)),
        many => count(many.len(), "vehicle"),
    }
}

/// "Car 2".
pub(super) fn name(object: &Object) -> String {
    let class = if object.class.is_empty() { "object" } else { &object.class };
    format!("{} {}", capitalised(class), object.id)
}

fn capitalised(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// "1 frame", "3 frames".
pub(super) fn count(n: usize, noun: &str) -> String {
    if n == 1 { format!("1 {noun}") } else { format!("{n} {noun}s") }
}

/// A fraction as per cent with two significant digits.
pub(super) fn percent(fraction: f64) -> String {
    format!("{} %", figure(fraction * 100.0, 2))
}

/// A number with so many significant digits, never in exponents, with a true minus sign.
pub(super) fn figure(v: f64, digits: i32) -> String {
    if !v.is_finite() {
        return "–".to_owned();
    }
    if v == 0.0 {
        return "0".to_owned();
    }
    let decimals = (digits - 1 - v.abs().log10().floor() as i32).clamp(0, 12) as usize;
    format!("{v:.decimals$}").replacen('-', "−", 1)
}

/// A length with its unit.
pub(super) fn length(v: f64, unit: Unit) -> String {
    match unit {
        Unit::Metre => format!("{} m", figure(v, 3)),
        Unit::Background => format!("{} units", figure(v, 3)),
    }
}

/// Length of the way between the first and the last pose, gaps bridged by straight lines.
pub(super) fn path_length(trajectory: &ObjectTrajectory) -> f64 {
    let distance = |a: &ObjectPose, b: &ObjectPose| {
        a.position.iter().zip(&b.position).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
    };
    trajectory.poses.windows(2).map(|w| distance(&w[0], &w[1])).filter(|d| d.is_finite()).sum()
}

/// Speed over time, in units of length per second: the trajectory's own where it has one, else the distance between
/// the neighbours of a pose over the time between them.
pub(super) fn speeds(trajectory: &ObjectTrajectory) -> Vec<(f64, f64)> {
    let poses = &trajectory.poses;
    if poses.iter().any(|p| p.speed.is_some()) {
        return poses.iter().filter_map(|p| Some((p.time_s, p.speed?))).collect();
    }
    let between = |w: &[ObjectPose]| {
        let (a, b) = (&w[0], &w[2]);
        let distance = (0..3).map(|k| (a.position[k] - b.position[k]).powi(2)).sum::<f64>().sqrt();
        let elapsed = b.time_s - a.time_s;
        (elapsed > 0.0).then(|| (w[1].time_s, distance / elapsed))
    };
    poses.windows(3).filter_map(between).collect()
}

/// Mean reprojection error of a model's image, pixels; `None` where nothing is observed.
pub(super) fn reprojection_error(model: &Reconstruction, image: &Image) -> Option<f64> {
    let camera = model.cameras.get(&image.camera)?;
    let error = |o: &Observation| {
        let point = model.points.get(&o.point?)?;
        let seen = camera.pixel_from_cam(image.cam_from_world * point.position)?;
        Some((seen - o.pixel).norm()).filter(|e| e.is_finite())
    };
    let errors: Vec<f64> = image.observations.iter().filter_map(error).collect();
    (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::ScaleMethod;

    fn scale(ratio: f64, std: Option<f64>, other: Option<f64>) -> ScaleEstimate {
        let alternatives = other.map(|r| (ScaleMethod::Intersection, r)).into_iter().collect();
        let method = ScaleMethod::ConstantDistance;
        ScaleEstimate { ratio, std, method, degenerate: false, reason: None, alternatives, as_reconstructed: None }
    }

    #[test]
    fn uncertainty_is_relative_and_other_methods_are_heard() {
        assert_eq!(relative_std(&scale(2.0, Some(0.1), None)), Some(0.05));
        assert_eq!(relative_std(&scale(2.0, None, None)), None);
        assert_eq!(disagreement(&scale(2.0, None, Some(2.5))), Some(0.25));
        assert_eq!(disagreement(&scale(2.0, None, None)), None);
    }

    #[test]
    fn figures_keep_their_digits() {
        assert_eq!(figure(0.012_345, 3), "0.0123");
        assert_eq!(figure(1234.5, 3), "1234");
        assert_eq!(figure(-2.0, 2), "−2.0");
        assert_eq!(figure(f64::NAN, 2), "–");
        assert_eq!(percent(0.0123), "1.2 %");
        assert_eq!(count(1, "frame"), "1 frame");
    }
}
