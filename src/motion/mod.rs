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
#[cfg(test)]
mod world;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

pub use self::classify::{Evidence, StaticPoint, TrackLabel, Verdict, classify};
pub use self::differences::{DifferenceDetector, MovingObject};
pub use self::follower::{PointFollower, PointTrack};
pub use self::ground::GroundModel;
pub use self::judge::{CLEAR_ODDS, Judgement, MovementReason, PointOnObject, judge, judge_pieces, without_sway};
pub use self::movers::{Mover, movers};
use crate::camera::Camera;
use crate::checks::{Checked, under, within};
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

/// Options of the detection of movers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MotionOptions {
    /// Tracking of points.
    pub follower: FollowerOptions,
    /// Classification of points as moving.
    pub evidence: EvidenceOptions,
    /// Grouping of points into vehicles.
    pub movers: MoverOptions,
}

impl MotionOptions {
    /// Rejects what cannot be worked with.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        under("follower", self.follower.check())?;
        under("evidence", self.evidence.check())?;
        under("movers", self.movers.check())
    }
}

/// Options of point tracking all over the image.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FollowerOptions {
    /// Longer side at which pictures are looked at; larger ones are shrunk.
    pub max_side_px: u32,
    /// Side of the grid's cells, each of which starts a point when it has none: a vehicle of 30 pixels has some eight.
    pub spacing_px: u32,
    /// Points followed at a time, at the most.
    #[schemars(extend("unit" = "points"))]
    pub max_points: usize,
    /// Smallest corner strength of a new point, relative to that which one cell in ten exceeds.
    #[schemars(extend("unit" = "share"))]
    pub quality: f32,
    /// Half the side of the window that is followed.
    pub window_radius_px: i32,
    /// Levels of the pyramid above the picture.
    #[schemars(extend("unit" = "levels"))]
    pub pyramid_levels: i32,
    /// Largest distance between a point and where following it back leads.
    pub max_round_trip_px: f32,
    /// Largest mean difference between the windows of two successive frames, in grey levels.
    #[schemars(extend("unit" = "grey levels"))]
    pub max_difference: f32,
    /// Shortest track that is kept.
    #[schemars(extend("unit" = "frames"))]
    pub min_track_length: usize,
}

impl Default for FollowerOptions {
    fn default() -> Self {
        Self {
            max_side_px: 1280,
            spacing_px: 10,
            max_points: 8000,
            quality: 0.01,
            window_radius_px: 5,
            pyramid_levels: 3,
            max_round_trip_px: 0.6,
            max_difference: 20.0,
            min_track_length: 4,
        }
    }
}

impl FollowerOptions {
    /// Rejects what cannot be worked with. Upper limits keep points and pyramids within memory.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("max_side_px", self.max_side_px, 64..=8192)?;
        within("spacing_px", self.spacing_px, 3..=200)?;
        within("max_points", self.max_points, 1..=100_000)?;
        within("quality", self.quality, 0.0..=1.0)?;
        within("window_radius_px", self.window_radius_px, 2..=30)?;
        within("pyramid_levels", self.pyramid_levels, 0..=8)?;
        within("max_round_trip_px", self.max_round_trip_px, 0.0..=1000.0)?;
        within("max_difference", self.max_difference, 0.0..=255.0)?;
        within("min_track_length", self.min_track_length, 3..=1_000_000)
    }
}

/// Options of the classification of points as moving.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EvidenceOptions {
    /// Minimum residual of a moving point, in times the noise of the image's own points.
    #[schemars(extend("unit" = "times the noise"))]
    pub min_strength: f64,
    /// Smallest deviation from what a standing point would show.
    pub min_deviation_px: f64,
    /// Tolerance of the ground: share of the distance at which a ray meets it.
    #[schemars(extend("unit" = "share"))]
    pub ground_tolerance: f64,
    /// Frames of a track that are looked at, evenly spread over its life.
    #[schemars(extend("unit" = "frames"))]
    pub max_views: usize,
    /// Smallest noise of a followed point.
    pub min_noise_px: f64,
}

impl Default for EvidenceOptions {
    fn default() -> Self {
        Self { min_strength: 4.0, min_deviation_px: 1.5, ground_tolerance: 0.15, max_views: 24, min_noise_px: 0.1 }
    }
}

impl EvidenceOptions {
    /// Rejects what cannot be worked with.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("min_strength", self.min_strength, 0.1..=1000.0)?;
        within("min_deviation_px", self.min_deviation_px, 0.0..=1000.0)?;
        within("ground_tolerance", self.ground_tolerance, 0.0..=0.9)?;
        within("max_views", self.max_views, 4..=1000)?;
        within("min_noise_px", self.min_noise_px, 0.001..=100.0)
    }
}

/// Options of the grouping of moving points into vehicles.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MoverOptions {
    /// Fewest points that make a vehicle.
    #[schemars(extend("unit" = "points"))]
    pub min_points: usize,
    /// Shortest time that they move together. Of a shorter clip, two thirds of it.
    #[schemars(extend("unit" = "s"))]
    pub min_life_s: f64,
    /// Largest distance of neighbours, in cells of the follower's grid.
    #[schemars(extend("unit" = "cells"))]
    pub reach: f64,
    /// Maximum change of the offset of two neighbors in a second, relative to its length.
    #[schemars(extend("unit" = "share"))]
    pub max_change: f64,
    /// Radius round a point in which other moving points support it, in cells of the follower's grid.
    #[schemars(extend("unit" = "cells"))]
    pub company_cells: f64,
    /// Smallest part of the points round one that moves which move, too.
    #[schemars(extend("unit" = "share"))]
    pub min_company: f64,
    /// Smallest part of the points in the middle of a box which belong to the mover.
    #[schemars(extend("unit" = "share"))]
    pub min_purity: f64,
    /// Minimum residual of its points against static ones, relative to its size: foliage in the wind and points that
    /// slide along an edge stay below.
    #[schemars(extend("unit" = "share"))]
    pub min_deviation: f64,
    /// Smallest side of a box.
    pub min_side_px: f64,
    /// Smallest confidence, 0 to 1.
    #[schemars(extend("unit" = "share"))]
    pub min_confidence: f64,
}

impl Default for MoverOptions {
    fn default() -> Self {
        Self {
            min_points: 4,
            min_life_s: 1.0,
            reach: 3.5,
            max_change: 0.3,
            company_cells: 2.0,
            min_company: 0.4,
            min_purity: 0.75,
            min_deviation: 0.25,
            min_side_px: 8.0,
            min_confidence: 0.5,
        }
    }
}

impl MoverOptions {
    /// Rejects what cannot be worked with.
    ///
    /// # Errors
    /// [`OptionError`](crate::checks::OptionError) names the option.
    pub fn check(&self) -> Checked {
        within("min_points", self.min_points, 3..=100_000)?;
        within("min_life_s", self.min_life_s, 0.0..=1000.0)?;
        within("reach", self.reach, 1.0..=20.0)?;
        within("max_change", self.max_change, 0.0..=10.0)?;
        within("company_cells", self.company_cells, 0.5..=20.0)?;
        within("min_company", self.min_company, 0.0..=1.0)?;
        within("min_purity", self.min_purity, 0.0..=1.0)?;
        within("min_deviation", self.min_deviation, 0.0..=100.0)?;
        within("min_side_px", self.min_side_px, 0.0..=10_000.0)?;
        within("min_confidence", self.min_confidence, 0.0..=1.0)
    }
}
