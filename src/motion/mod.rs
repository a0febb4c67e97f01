//! Moving objects: points all over the image, tested against the background's cameras and the ground.
//!
//! [`PointFollower`] follows points through all frames. [`classify`] asks of each whether a point that stands still
//! could have been seen so: if none leaves residuals within the noise of the picture's other points, it moves; if the
//! one that does would lie behind the ground, it moves, too. [`movers`] joins points that move together, near one
//! another and for some time, to boxes. [`judge`] says of one object whose points are known whether it moved. The
//! equations are in `docs/maths/motion.md`. Before a camera that does not translate [`DifferenceDetector`] finds
//! what has too few points.
//!
//! All but the follower and the differences is arithmetic on values.

mod classify;
mod contact;
mod differences;
mod fit;
mod follower;
mod ground;
mod groups;
mod judge;
mod movers;
mod noise;
mod stationary;
#[cfg(test)]
mod tests;

pub use self::classify::{Evidence, GROUND_TOLERANCE, StaticPoint, TrackLabel, Verdict, classify};
pub use self::differences::{DifferenceDetector, MovingObject};
pub use self::follower::{PointFollower, PointTrack, alive};
pub use self::ground::GroundModel;
pub use self::judge::{
    CLEAR_ODDS, Judgement, MovementReason, PointOnObject, judge, judge_pieces, with_travel, without_sway,
};
pub use self::movers::{Mover, movers};
use crate::camera::Camera;
use crate::math::Rigid3;
pub use contact::ContactDepth;
pub use stationary::shows_standing;

/// Camera of one frame, from the background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Intrinsics, for pixels of the whole frame.
    pub camera: Camera,
    /// Pose in the background's frame.
    pub cam_from_world: Rigid3,
}

/// Scene of the frames. Frames are counted as the follower counts them, from 0.
#[derive(Clone, Copy)]
pub struct Surroundings<'a> {
    /// Width and height of the frames, pixels.
    pub size: (u32, u32),
    /// Time of each frame, seconds, ascending.
    pub times_s: &'a [f64],
    /// Camera of each frame; `None` where the background has none.
    pub views: &'a [Option<View>],
    /// The ground, if it was found.
    pub ground: Option<&'a GroundModel>,
}

impl<'a> Surroundings<'a> {
    /// Camera of a frame.
    fn view(&self, frame: u32) -> Option<&'a View> {
        self.views.get(frame as usize)?.as_ref()
    }
}
