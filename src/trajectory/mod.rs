//! Scale ratio between the reconstructions of an object and of the background, and the trajectories that follow.
//!
//! Structure from motion determines each of the two up to a scale of its own. In the background's frame, at the time of
//! frame i, a point o_j of the object is at
//!
//! ```text
//! o_ji = c_i + r v_ji,    v_ji = R_i(b)ᵀ R_i(o) (o_j − c_i(o))        (eq. object_to_background_coordinates)
//! ```
//!
//! for one unknown ratio r. The contact of vehicles with the ground determines r:
//!
//! * [`constant_distance`] and [`intersection`] are the paper's two estimators, unchanged.
//! * [`least_squares`] uses all frames at once and reports how well the motion determines r.
//! * [`joint`] adjusts the object's reconstruction together with the ground.
//! * [`estimate()`] runs one estimator, including reference methods of the literature, but not [`joint`];
//!   [`estimate_scale`] runs several and reports whether the ratio is determined.
//!
//! [`assemble`] computes the object's poses, [`extents()`] its size, and [`smooth`] its motion in meters. [`verdicts`]
//! judges the trajectories of a run. A vehicle whose model cannot be used gets a [`ground_track()`]. The derivations
//! are in `docs/maths/scale.md`.
//!
//! The estimators use [`Views`] only. [`place`] is the complete chain from reconstructions, planes and outlines to a
//! trajectory.
//!
//! ```
//! use tractrix::synthetic::drive;
//! use tractrix::trajectory::{LeastSquaresOptions, Options, Views, least_squares};
//!
//! // A vehicle drives past a moving camera; background and object each have a unit of their own.
//! let world = drive::drive(&drive::Options::default(), 1);
//! let views = Views::new(&world.background, &world.object, &world.planes, &Options::default());
//! let found = least_squares(&views, &LeastSquaresOptions::default())?;
//! assert!((found.ratio / world.ratio - 1.0).abs() < 1e-9);
//! # Ok::<(), tractrix::trajectory::ScaleError>(())
//! ```

mod assemble;
mod body;
mod constant_distance;
mod contact;
mod error;
mod estimate;
mod estimators;
mod extents;
mod ground_constrained_poses;
mod ground_track;
mod heading;
mod intersection;
mod joint;
mod least_squares;
mod place;
mod pose_error;
mod relative_motion;
mod smoother;
mod stationary;
mod verdict;
mod views;

pub use assemble::{ObjectDescription, assemble, object_center};
pub use body::Body;
pub use constant_distance::{ConstantDistance, constant_distance};
pub use contact::{Contact, ContactOptions, Silhouette, contact};
pub use error::ScaleError;
pub use estimate::{Options, estimate_scale, ratios_of};
pub use estimators::{Estimate, estimate};
pub use extents::{BodyOnGround, Extents, Subject, extents};
pub use ground_constrained_poses::ground_constrained_poses;
pub use ground_track::{ContactEvidence, Contacts, FocalError, Outlines, contacts, ground_track, outline_pixels};
pub use heading::{forward_axis, headings};
pub use intersection::{Intersection, intersection};
pub use joint::{Joint, JointOptions, joint};
pub use least_squares::{LeastSquares, LeastSquaresOptions, least_squares};
pub use place::{Adjustment, AdjustmentFigures, DroppedFrames, Evidence, ModelOrigin, PlacedObject, place};
pub use relative_motion::{RelativeMotion, motion_by_shaking};
pub use smoother::{CommonStd, PositionError, PositionMeasurement, Smoothed, smooth};
pub use stationary::place_stationary;
pub use verdict::{Candidate, verdicts, with_reason};
pub use views::{View, Views};
