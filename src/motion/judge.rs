//! Motion state of one object, by the point tracks on it (eq. 13 to 16 of `docs/maths/motion.md`).

use std::collections::BTreeMap;
use std::fmt;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::contact::ContactEvidence;
use super::{ContactDepth, Evidence, PointTrack, TrackLabel, Verdict};
use crate::math::upper_median;
use crate::scene::Movement;

/// Track on an object.
#[derive(Clone, Copy, Debug)]
pub struct PointOnObject<'a> {
    /// The track.
    pub track: &'a PointTrack,
    /// Label of the track.
    pub label: &'a TrackLabel,
    /// Share of its frames in which it is on the object.
    pub inside: f64,
    /// Contact depth of the object below it; `None` without a static point, or without ground below.
    pub contact: Option<ContactDepth>,
}

/// Reason for the motion state.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum MovementReason {
    /// Fewer than three points have a known state.
    TooFewPoints,
    /// Half of the points or more leave their epipolar lines.
    PointsMove,
    /// Half of the visible points leave their epipolar lines for a second or more: the object stops or starts.
    MovesForATime,
    /// A stationary object would float above the ground: it approaches.
    FootFloats,
    /// A stationary object would be behind the ground: it moves ahead of the camera.
    FootBehindGround,
    /// Its points are static, and its contact depth is evidence for a stationary object.
    PointsStand,
    /// Points leave their epipolar lines by no more than the sway of a hovering camera explains.
    Sway,
    /// Its mask moves across the background, and the camera does not translate.
    Travels,
    /// Moving and static points contradict each other.
    Divided,
    /// It may be stationary, or move along the camera's path.
    AlongCameraPath,
}

/// Motion state of an object, with the reason.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Judgement {
    /// Motion state.
    pub movement: Movement,
    /// Reason for it.
    pub reason: MovementReason,
    /// Likelihood ratio of motion along the camera's path over a stationary object, by the contact depth; 1 if unknown.
    pub odds: f64,
    /// Number of points that leave their epipolar lines.
    pub num_moving: usize,
    /// Number of points that a static point explains.
    pub num_standing: usize,
    /// True if it looks like a patch of ground: its points are not above the ground.
    pub is_flat: bool,
}

impl fmt::Display for Judgement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (moving, standing) = (self.num_moving, self.num_standing);
        let all = moving + standing;
        let [for_motion, for_rest] = [self.odds, 1.0 / self.odds].map(odds);
        match self.reason {
            MovementReason::TooFewPoints => write!(f, "too few points to decide whether it moves"),
            MovementReason::PointsMove => write!(f, "{moving} of {all} points move against the background"),
            MovementReason::MovesForATime => write!(f, "{moving} of {all} points move in part of the frames"),
            MovementReason::FootFloats => {
                write!(f, "it approaches: a stationary object would float above the ground ({for_motion})")
            }
            MovementReason::FootBehindGround => {
                write!(f, "it moves ahead of the camera: a stationary object would be behind the ground ({for_motion})")
            }
            MovementReason::PointsStand => {
                write!(
                    f,
                    "{standing} of {all} points are stationary, and the contact line is on the ground ({for_rest})"
                )
            }
            MovementReason::Sway => {
                write!(f, "{moving} of {all} points move, by no more than tall objects do as a hovering camera sways")
            }
            MovementReason::Travels => write!(f, "its mask moves across the background by more than twice its size"),
            MovementReason::Divided => write!(f, "{moving} of {all} points move: inconclusive"),
            MovementReason::AlongCameraPath => {
                let odds = self.odds;
                write!(f, "stationary, or moving along the camera's path: the points do not decide (odds {odds:.2}:1)")
            }
        }
    }
}

/// Odds as text, capped at 1000.
fn odds(odds: f64) -> String {
    if odds < 1000.0 { format!("odds {odds:.0}:1") } else { "odds over 1000:1".to_owned() }
}

/// Minimum share of a point's frames in which it is on the object.
const MIN_INSIDE: f64 = 0.8;
/// Minimum number of points for a decision.
const MIN_POINTS: usize = 3;
/// Minimum share of moving points of a moving object.
const MIN_SHARE_MOVING: f64 = 0.5;
/// Maximum share of moving points of an object that may be stationary: points on reflections and along outlines move on
/// a parked car, too.
const MAX_SHARE_STATIONARY: f64 = 0.25;
/// Minimum time for which most points of an object must move where it is stationary for longer, seconds: the minimum
/// life of a mover (`MIN_LIFE_S` of `groups.rs`).
const MIN_MOVE_S: f64 = 1.0;
/// Minimum frame rate that turns this time into a number of frames, Hz.
const MIN_RATE_HZ: f64 = 10.0;
/// Odds for one hypothesis over the other from which it is accepted: between substantial and strong evidence, 3.2 and
/// 10 (H. Jeffreys, *Theory of Probability*, 1961, app. B).
pub const CLEAR_ODDS: f64 = 5.0;

/// Maximum residual of points that the sway of a hovering camera explains, as a share of the object's size: a sway of a
/// tenth of the distance, for an object as high as it is wide. A moving vehicle exceeds it within half a meter.
const SWAY: f64 = 0.1;
/// Minimum displacement of a moving mask from the mean of the first to that of the last quarter of its frames, as a
/// multiple of its size: a smaller one may be growth, a shadow or a switch to a neighbor at the curb.
const MIN_TRAVEL: f64 = 2.0;

/// Revises the motion state of an object in the view of a hovering camera.
///
/// The poses of a hovering camera share one center, so points on tall stationary objects, such as houses, leave their
/// epipolar lines as the camera sways.
///
/// * `size_px` – size of the object in the image.
pub fn without_sway(judged: Judgement, points: &[PointOnObject], size_px: f64) -> Judgement {
    let on_it = points.iter().filter(|point| point.inside >= MIN_INSIDE);
    let moving = on_it.filter(|point| point.label.verdict == Verdict::Moving(Evidence::OffItsLine));
    let deviation_px = upper_median(moving.map(|point| point.label.deviation_px).collect());
    let is_sway = deviation_px.is_some_and(|deviation_px| deviation_px <= SWAY * size_px);
    match judged.reason {
        MovementReason::PointsMove | MovementReason::MovesForATime if is_sway => {
            Judgement { movement: Movement::Undetermined, reason: MovementReason::Sway, ..judged }
        }
        _ => judged,
    }
}

/// Revises an undetermined motion state in the view of a camera that does not translate.
///
/// Without parallax, a mask that moves across the background is that of a moving object.
///
/// * `directions` – direction to the center of its mask in each frame, in the background's frame, in order of time.
/// * `size` – angular size of the mask, radians.
pub fn with_travel(judged: Judgement, directions: &[Vector3<f64>], size: f64) -> Judgement {
    let quarter = directions.len() / 4;
    let mean = |part: &[Vector3<f64>]| part.iter().sum::<Vector3<f64>>() / part.len() as f64;
    let displacement = || (mean(&directions[directions.len() - quarter..]) - mean(&directions[..quarter])).norm();
    match judged.movement == Movement::Undetermined && quarter > 0 && displacement() > MIN_TRAVEL * size {
        true => Judgement { movement: Movement::Moving, reason: MovementReason::Travels, ..judged },
        false => judged,
    }
}

/// Decides the motion state of an object by the tracks on it.
///
/// * `second` – number of frames per second.
///
/// Points that are on it in less than four fifths of their frames, or undetermined, are ignored. Points are weighted by
/// the lengths of their tracks. Motion in a part of the life suffices, since the labels are those of whole tracks.
pub fn judge(points: &[PointOnObject], second: f64) -> Judgement {
    let on_it: Vec<&PointOnObject> = points.iter().filter(|point| point.inside >= MIN_INSIDE).collect();
    let leaves_line = |label: &TrackLabel| label.verdict == Verdict::Moving(Evidence::OffItsLine);
    let is_quiet = |label: &TrackLabel| {
        matches!(label.verdict, Verdict::Stationary | Verdict::Floating | Verdict::Moving(Evidence::BehindGround))
    };
    let of = |is: &dyn Fn(&TrackLabel) -> bool| {
        let lengths = on_it.iter().filter(|point| is(point.label)).map(|point| point.track.pixels.len());
        lengths.fold((0, 0.0), |(count, length), l| (count + 1, length + l as f64))
    };
    let ((num_moving, moving), (num_standing, quiet)) = (of(&leaves_line), of(&is_quiet));
    let (num_behind, _) = of(&|label| label.verdict == Verdict::Moving(Evidence::BehindGround));
    let share = moving / (moving + quiet).max(1e-9);
    let contacts: Vec<ContactDepth> = on_it.iter().filter_map(|point| point.contact).collect();
    let heights = on_it.iter().filter(|point| point.contact.is_some()).filter_map(|point| point.label.relative_height);
    let contact_evidence = ContactEvidence::of(&contacts, heights.collect());
    let odds = contact_evidence.map_or(1.0, |contact_evidence| contact_evidence.odds_of_motion());
    let (movement, reason) = match () {
        () if num_moving + num_standing.max(contacts.len()) < MIN_POINTS => {
            (Movement::Undetermined, MovementReason::TooFewPoints)
        }
        () if share >= MIN_SHARE_MOVING => (Movement::Moving, MovementReason::PointsMove),
        () if num_frames_moving(&on_it, &leaves_line, &is_quiet) as f64 >= MIN_MOVE_S * second.max(MIN_RATE_HZ) => {
            (Movement::Moving, MovementReason::MovesForATime)
        }
        () if odds >= CLEAR_ODDS && contact_evidence.is_some_and(|contact_evidence| contact_evidence.floats()) => {
            (Movement::Moving, MovementReason::FootFloats)
        }
        // A mask may end nearer than its points. But no stationary object has points that are behind the ground
        // themselves.
        () if odds >= CLEAR_ODDS && num_behind >= MIN_POINTS => (Movement::Moving, MovementReason::FootBehindGround),
        () if share > MAX_SHARE_STATIONARY => (Movement::Undetermined, MovementReason::Divided),
        () if odds <= 1.0 / CLEAR_ODDS && num_standing >= MIN_POINTS => {
            (Movement::Stationary, MovementReason::PointsStand)
        }
        () => (Movement::Undetermined, MovementReason::AlongCameraPath),
    };
    let is_flat = is_ground_patch(on_it.iter().map(|point| point.label));
    Judgement { movement, reason, odds, num_moving, num_standing, is_flat }
}

/// Decides the motion state of an object whose track has gaps.
///
/// There may be an identity switch at each gap, so the object is stationary only if every piece is.
///
/// * `pieces` – points of each piece.
pub fn judge_pieces(pieces: &[Vec<PointOnObject>], second: f64) -> Judgement {
    let whole = judge(&pieces.concat(), second);
    if whole.movement != Movement::Stationary || pieces.len() < 2 {
        return whole;
    }
    let has_too_few_points = |piece: &Judgement| piece.reason == MovementReason::TooFewPoints;
    let mut judged = pieces.iter().map(|piece| judge(piece, second));
    match judged.find(|piece| piece.movement != Movement::Stationary && !has_too_few_points(piece)) {
        Some(piece) => Judgement { movement: Movement::Undetermined, ..piece },
        None => whole,
    }
}

/// Number of frames in which at least half of the visible points, and at least three, leave their epipolar lines.
fn num_frames_moving(
    on_it: &[&PointOnObject],
    leaves_line: &dyn Fn(&TrackLabel) -> bool,
    is_quiet: &dyn Fn(&TrackLabel) -> bool,
) -> usize {
    let mut seen: BTreeMap<u32, [usize; 2]> = BTreeMap::new();
    for point in on_it {
        let kind = [leaves_line(point.label), is_quiet(point.label)].iter().position(|is| *is);
        let frames = (point.track.first..point.track.end()).filter(|_| kind.is_some());
        frames.for_each(|frame| seen.entry(frame).or_default()[kind.unwrap_or(0)] += 1);
    }
    seen.values().filter(|[moving, quiet]| *moving >= MIN_POINTS && moving >= quiet).count()
}

/// Returns true if at most a fifth of the points with known heights is above the ground.
fn is_ground_patch<'a>(labels: impl Iterator<Item = &'a TrackLabel>) -> bool {
    let heights: Vec<f64> = labels.filter_map(|label| label.relative_height).collect();
    let low = heights.iter().filter(|height| **height <= 0.03).count();
    // Fewer than eight points are no evidence.
    heights.len() >= 8 && low as f64 >= 0.8 * heights.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns true if points at these heights, each on the object for a share of its frames, are a patch of ground.
    fn is_flat(heights: &[Option<f64>], inside: f64) -> bool {
        let track = PointTrack { first: 0, pixels: vec![[0.0, 0.0]; 10] };
        let label = |relative_height: &Option<f64>| TrackLabel {
            verdict: Verdict::Stationary,
            strength: 0.0,
            deviation_px: 0.0,
            relative_height: *relative_height,
            static_point: None,
        };
        let labels: Vec<TrackLabel> = heights.iter().map(label).collect();
        let point = |label| PointOnObject { track: &track, label, inside, contact: None };
        judge(&labels.iter().map(point).collect::<Vec<_>>(), 10.0).is_flat
    }

    #[test]
    fn objects_that_sway_with_a_hovering_camera_are_undetermined() {
        let track = PointTrack { first: 0, pixels: vec![[0.0, 0.0]; 30] };
        let label = TrackLabel {
            verdict: Verdict::Moving(Evidence::OffItsLine),
            strength: 9.0,
            deviation_px: 3.0,
            relative_height: None,
            static_point: None,
        };
        let points = [PointOnObject { track: &track, label: &label, inside: 1.0, contact: None }; 6];
        let judged = judge(&points, 10.0);
        assert_eq!(judged.reason, MovementReason::PointsMove);
        let house = without_sway(judged, &points, 100.0);
        assert_eq!((house.movement, house.reason), (Movement::Undetermined, MovementReason::Sway));
        assert_eq!(without_sway(judged, &points, 20.0), judged, "a car of 20 px that moved by 3");
    }

    #[test]
    fn a_patch_of_road_is_flat_and_a_parked_car_is_not() {
        let road = [0.0, 0.01, -0.02, 0.0, 0.01, 0.02, 0.0, 0.01, 0.2].map(Some);
        assert!(is_flat(&road, 1.0));
        assert!(!is_flat(&[0.0, 0.1, 0.15, 0.12, 0.01, 0.2, 0.18, 0.01, 0.2].map(Some), 1.0));
        assert!(!is_flat(&[Some(0.0); 5], 1.0) && !is_flat(&[None; 20], 1.0));
        // Road points that a car's mask passes over are no evidence about the car.
        assert!(!is_flat(&road, 0.5));
    }
}
