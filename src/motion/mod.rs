//! Moving objects: point tracks all over the image, tested against the background's cameras and the ground.
//!
//! [`PointFollower`] tracks points through all frames. [`classify`] fits a static point to each track: the point moves
//! if the residuals exceed the noise of the image's other tracks, or if the static point is behind the ground.
//! [`movers`] groups points that are close to one another and move together for some time into boxes. [`judge`] decides
//! for one object with known points whether it moves. With a camera that does not translate, [`DifferenceDetector`]
//! finds objects with too few points. The equations are in `docs/maths/motion.md`.
//!
//! All but the follower and the difference detector is arithmetic on values.

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
pub use stationary::shows_stationary;

/// Camera of one frame of the background.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// Intrinsics, for pixels of the full frame.
    pub camera: Camera,
    /// Pose in the background's frame.
    pub cam_from_world: Rigid3,
}

/// Cameras, times and ground of the frames; frame indices are those of the follower, from 0.
#[derive(Clone, Copy)]
pub struct Surroundings<'a> {
    /// Width and height of the frames, pixels.
    pub size: (u32, u32),
    /// Time of each frame, seconds, ascending.
    pub times_s: &'a [f64],
    /// Camera of each frame; `None` where the background has none.
    pub views: &'a [Option<View>],
    /// The ground, if known.
    pub ground: Option<&'a GroundModel>,
}

impl<'a> Surroundings<'a> {
    /// Camera of a frame, if it is known.
    fn view(&self, frame: u32) -> Option<&'a View> {
        self.views.get(frame as usize)?.as_ref()
    }
}
