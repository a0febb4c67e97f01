//! Motion state of a vehicle by its points and its trajectory together.
//!
//! Points that leave their epipolar lines show motion by themselves. A vehicle that moves along the camera's path
//! leaves no such trace: only its scale, and so the ground, distinguishes it from a stationary one. The trajectory
//! determines the scale better than points that are tracked for a second or two ([`RelativeMotion`]).

use crate::math::rounding::with_std;
use crate::motion::{CLEAR_ODDS, MovementReason};
use crate::pipeline::stages::track::movement::PointFinding;
use crate::scene::{
    FrameId, Gap, Movement, MovementFinding, ObjectTrajectory, ReasonKind, Reconstruction, ScaleMethod, Verdict,
};
use crate::trajectory::RelativeMotion;

/// Evidence of a trajectory: relative motion overall, and the largest odds of motion of a segment between gaps.
#[derive(Clone, Copy, Debug)]
pub(super) struct TrajectoryEvidence {
    /// Relative motion of the whole trajectory.
    pub(super) whole: RelativeMotion,
    /// Relative motion of the segment with the largest odds of motion.
    piece: RelativeMotion,
    ratio_std: f64,
}

impl TrajectoryEvidence {
    /// `None` if the scale ratio has no standard deviation, the trajectory has too few positions, or no outline shows
    /// the contact with the ground: the lowest points of an occluded vehicle are not near it.
    ///
    /// * `gaps` – gaps of the track: across them it may have switched to another vehicle.
    pub(super) fn of(trajectory: &ObjectTrajectory, gaps: &[Gap], background: &Reconstruction) -> Option<Self> {
        // Where the focal length is uncertain, the camera moves forward, and its error changes ratio and model
        // inversely: depths, and so the motion along the line of sight, are unaffected.
        let scale = &trajectory.scale;
        let is_without_contact = scale.support.as_ref().is_some_and(|support| support.frames_with_outline == 0);
        if is_without_contact && scale.method == ScaleMethod::Joint {
            return None;
        }
        let ratio_std = scale.shares.map_or(scale.std? / scale.ratio, |shares| shares.given_focal());
        let whole = RelativeMotion::of(&trajectory.poses, background)?;
        let piece_of = |frame: FrameId| gaps.iter().filter(|gap| frame >= gap.first).count();
        let pieces = trajectory.poses.chunk_by(|a, b| piece_of(a.frame) == piece_of(b.frame));
        let found = pieces.filter_map(|poses| RelativeMotion::of(poses, background)).chain([whole]);
        let odds = |motion: &RelativeMotion| motion.odds_of_motion(ratio_std);
        let piece = found.max_by(|a, b| odds(a).total_cmp(&odds(b)))?;
        ratio_std.is_finite().then_some(Self { whole, piece, ratio_std })
    }

    /// Odds of motion: of the moving segment, or else of the whole trajectory.
    fn odds(&self) -> (f64, &RelativeMotion) {
        let [piece, whole] = [&self.piece, &self.whole].map(|motion| motion.odds_of_motion(self.ratio_std));
        if piece > 1.0 { (piece, &self.piece) } else { (whole, &self.whole) }
    }
}

/// Revises the finding by points with the trajectory.
///
/// * Points that move relative to the background decide; so do clear odds of the trajectory.
/// * If points and trajectory contradict one another, or if the odds of the trajectory favor motion but points are
///   stationary, the state is undetermined.
pub(super) fn revised(by_points: &PointFinding, evidence: Option<&TrajectoryEvidence>) -> MovementFinding {
    let before = &by_points.finding;
    let Some(evidence) = evidence else { return before.clone() };
    let (odds, motion) = evidence.odds();
    let state = match (by_points.reason, before.state) {
        _ if by_points.points_move() => before.state,
        (_, Movement::Stationary) if odds > 1.0 => Movement::Undetermined,
        (_, Movement::Moving) if odds <= 1.0 / CLEAR_ODDS => Movement::Undetermined,
        _ if odds >= CLEAR_ODDS => Movement::Moving,
        (Some(MovementReason::Divided), _) => before.state,
        _ if odds <= 1.0 / CLEAR_ODDS => Movement::Stationary,
        _ => before.state,
    };
    if state == before.state {
        return before.clone();
    }
    let slope = with_std(motion.slope, motion.std.hypot(evidence.ratio_std));
    let reason = match state {
        Movement::Undetermined => format!("points and trajectory contradict one another: {}", before.reason),
        _ => "the trajectory decides".to_owned(),
    };
    let reason = format!(
        "{reason}; displacement relative to the camera {slope} times the camera's own (1 if stationary, odds of motion \
         {odds:.2}:1)"
    );
    MovementFinding { state, reason }
}

/// Returns true if the shape of the model contradicts the scale of a trajectory. Its motion relative to the camera is
/// then no evidence: a wrong ratio makes a parked vehicle move with the camera.
pub(super) fn contradicts_scale(verdict: &Verdict) -> bool {
    verdict.against().any(|reason| reason.kind == ReasonKind::Shape)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evidence(slope: f64, piece: f64) -> TrajectoryEvidence {
        let motion = |slope| RelativeMotion { slope, std: 0.02 };
        TrajectoryEvidence { whole: motion(slope), piece: motion(piece), ratio_std: 0.06 }
    }

    fn points(state: Movement, reason: MovementReason) -> PointFinding {
        PointFinding { finding: MovementFinding { state, reason: "points".into() }, reason: Some(reason) }
    }

    #[test]
    fn the_trajectory_decides_what_points_leave_open() {
        let open = points(Movement::Undetermined, MovementReason::AlongCameraPath);
        for (slope, state) in [
            (1.03, Movement::Stationary),
            (0.78, Movement::Undetermined),
            (1.9, Movement::Moving),
            (0.1, Movement::Moving),
            (-0.3, Movement::Moving),
        ] {
            assert_eq!(revised(&open, Some(&evidence(slope, slope))).state, state, "{slope}");
        }
        assert_eq!(revised(&open, None), open.finding);
        // A track that switches from an oncoming car to a parked one.
        assert_eq!(revised(&open, Some(&evidence(1.0, 2.0))).state, Movement::Moving);
    }

    #[test]
    fn a_contradiction_leaves_the_state_open() {
        let standing = points(Movement::Stationary, MovementReason::PointsStand);
        assert_eq!(revised(&standing, Some(&evidence(2.0, 2.0))).state, Movement::Undetermined);
        assert_eq!(revised(&standing, Some(&evidence(1.02, 1.02))), standing.finding);
        let floats = points(Movement::Moving, MovementReason::FootFloats);
        assert_eq!(revised(&floats, Some(&evidence(1.02, 1.02))).state, Movement::Undetermined);
        let moves = points(Movement::Moving, MovementReason::PointsMove);
        assert_eq!(revised(&moves, Some(&evidence(1.02, 1.02))), moves.finding);
        let divided = points(Movement::Undetermined, MovementReason::Divided);
        assert_eq!(revised(&divided, Some(&evidence(1.02, 1.02))).state, Movement::Undetermined);
    }

    #[test]
    fn a_contradicted_scale_is_no_evidence_of_motion() {
        use crate::scene::{Reason, Trust};
        let doubted = |kind| Verdict { state: Trust::Doubtful, reasons: vec![Reason::doubts(kind, 1.0, "odd")] };
        assert!(contradicts_scale(&doubted(ReasonKind::Shape)));
        assert!(!contradicts_scale(&doubted(ReasonKind::Pixels)));
    }
}
