//! Whether one object moved, by the points on it (eq. 13 of `docs/maths/motion.md`).

use std::fmt;

use serde::{Deserialize, Serialize};

use super::{PointTrack, TrackLabel, Verdict};
use crate::scene::Movement;

/// What the judgement rests on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MovementReason {
    /// Fewer than three points say anything.
    TooFewPoints,
    /// Most points leave the lines on which standing points stay, or would lie behind the ground.
    PointsMove,
    /// Its lowest points, if they stood, would float over the ground: it comes nearer.
    FootFloats,
    /// Most points stand where the ground and the cameras let a standing object be seen.
    PointsStand,
    /// Points contradict one another.
    Divided,
}

/// Whether an object moves, how surely, and why.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Judgement {
    /// Whether it moves.
    pub movement: Movement,
    /// 0 to 1.
    pub confidence: f64,
    /// Why.
    pub reason: MovementReason,
    /// Points that say it moves.
    pub num_moving: usize,
    /// Points that say it stands.
    pub num_standing: usize,
    /// Whether it is a piece of the ground as far as its points tell: none of them rises over it.
    pub is_flat: bool,
}

impl fmt::Display for Judgement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (moving, all) = (self.num_moving, self.num_moving + self.num_standing);
        match self.reason {
            MovementReason::TooFewPoints => write!(f, "too few points on it say whether it moves"),
            MovementReason::PointsMove => write!(f, "{moving} of {all} points on it move against the background"),
            MovementReason::FootFloats => {
                write!(f, "its lowest points would float over the ground if it stood: it comes nearer")
            }
            MovementReason::PointsStand => write!(f, "{} of {all} points on it stand", self.num_standing),
            MovementReason::Divided => write!(f, "{moving} of {all} points on it move, which is neither few nor many"),
        }
    }
}

/// Judges an object by the tracks that lie on it, each with the share of its frames in which it does.
///
/// Points that lie on it in less than four fifths of their frames, or that are undetermined, say nothing; long ones say
/// more than short ones. A part of the life that moves is enough: the labels are those of whole tracks.
pub fn judge(points: &[(&PointTrack, &TrackLabel, f64)]) -> Judgement {
    const LEAST_INSIDE: f64 = 0.8;
    let on_it: Vec<_> = points.iter().filter(|(_, _, inside)| *inside >= LEAST_INSIDE).collect();
    let weight = |is: &dyn Fn(&TrackLabel) -> bool| {
        on_it.iter().filter(|(_, label, _)| is(label)).map(|(track, _, _)| track.pixels.len() as f64).sum::<f64>()
    };
    let count = |is: &dyn Fn(&TrackLabel) -> bool| on_it.iter().filter(|(_, label, _)| is(label)).count();
    let moves = |label: &TrackLabel| label.is_moving();
    let stands = |label: &TrackLabel| matches!(label.verdict, Verdict::Standing | Verdict::Floating);
    let (num_moving, num_standing) = (count(&moves), count(&stands));
    let (moving, standing) = (weight(&moves), weight(&stands));
    let share = moving / (moving + standing).max(1e-9);
    let floats = foot_floats(&on_it.iter().map(|(track, label, _)| (*track, *label)).collect::<Vec<_>>());
    let (movement, reason, certainty) = if num_moving + num_standing < 3 {
        (Movement::Undetermined, MovementReason::TooFewPoints, 1.0)
    } else if share >= 0.5 {
        (Movement::Moving, MovementReason::PointsMove, 2.0 * share - 1.0)
    } else if floats {
        (Movement::Moving, MovementReason::FootFloats, 0.5)
    } else if share <= 0.25 {
        (Movement::Standing, MovementReason::PointsStand, 1.0 - 4.0 * share)
    } else {
        (Movement::Undetermined, MovementReason::Divided, 1.0)
    };
    let grown = 1.0 - (-((num_moving + num_standing) as f64) / 4.0).exp();
    let confidence = if movement == Movement::Undetermined { 0.0 } else { (0.3 + 0.7 * certainty) * grown };
    let is_flat = lies_flat(on_it.iter().map(|(_, label, _)| *label));
    Judgement { movement, confidence, reason, num_moving, num_standing, is_flat }
}

/// Whether hardly any point of which a height is known rises over the ground.
fn lies_flat<'a>(labels: impl Iterator<Item = &'a TrackLabel>) -> bool {
    const LEAST_POINTS: usize = 8;
    const MOST_HEIGHT: f64 = 0.03;
    const LEAST_FLAT: f64 = 0.8;
    let heights: Vec<f64> = labels.filter_map(|label| label.relative_height).collect();
    let low = heights.iter().filter(|height| height.abs() <= MOST_HEIGHT).count();
    heights.len() >= LEAST_POINTS && low as f64 >= LEAST_FLAT * heights.len() as f64
}

/// Whether the lowest points, if they stood, would float over the ground by a good part of the camera's height.
fn foot_floats(points: &[(&PointTrack, &TrackLabel)]) -> bool {
    const LEAST_HEIGHT: f64 = 0.15;
    let mut heights: Vec<(f64, f64)> = points
        .iter()
        .filter(|(_, label)| matches!(label.verdict, Verdict::Standing | Verdict::Floating))
        .filter_map(|(track, label)| Some((lowest(track), label.relative_height?)))
        .collect();
    if heights.len() < 5 {
        return false;
    }
    heights.sort_by(|a, b| b.0.total_cmp(&a.0));
    let foot = &heights[..(heights.len() / 4).max(3)];
    let floating = foot.iter().filter(|(_, height)| *height >= LEAST_HEIGHT).count();
    4 * floating >= 3 * foot.len()
}

/// Mean row of a track.
fn lowest(track: &PointTrack) -> f64 {
    track.pixels.iter().map(|p| f64::from(p[1])).sum::<f64>() / track.pixels.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether points at these heights, each on the object for a share of its frames, are a piece of the ground.
    fn is_flat(heights: &[Option<f64>], inside: f64) -> bool {
        let track = PointTrack { first: 0, pixels: vec![[0.0, 0.0]; 10] };
        let label = |relative_height: &Option<f64>| TrackLabel {
            verdict: Verdict::Standing,
            strength: 0.0,
            deviation_px: 0.0,
            relative_height: *relative_height,
        };
        let labels: Vec<TrackLabel> = heights.iter().map(label).collect();
        judge(&labels.iter().map(|label| (&track, label, inside)).collect::<Vec<_>>()).is_flat
    }

    #[test]
    fn a_patch_of_road_lies_flat_and_a_parked_car_does_not() {
        let road = [0.0, 0.01, -0.02, 0.0, 0.01, 0.02, 0.0, 0.01, 0.2].map(Some);
        assert!(is_flat(&road, 1.0));
        assert!(!is_flat(&[0.0, 0.1, 0.15, 0.12, 0.01, 0.2, 0.18, 0.01, 0.2].map(Some), 1.0));
        assert!(!is_flat(&[Some(0.0); 5], 1.0) && !is_flat(&[None; 20], 1.0));
        // Points of the road that a car's mask passes over say nothing about the car.
        assert!(!is_flat(&road, 0.5));
    }
}
