//! The figures of an evaluation, in the shape of `evaluation.json`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::cameras::CameraErrors;
use super::outcome::Outcome;
use super::reference::ReferenceScale;
use super::registration::Registration;
use super::trajectory::TrajectoryError;
use crate::scene::{ModelState, ObjectId, ScaleMethod};

/// All figures of one run. Lengths are metres of the true world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Evaluation {
    /// Version of this format.
    pub version: u32,
    /// Name of the sequence.
    pub sequence: String,
    /// Type of the target vehicle, if known.
    pub vehicle: Option<String>,
    /// Numbers of frames with a pose.
    pub registered: RegisteredFrames,
    /// Background reconstruction to true world.
    pub registration: Outcome<Registration>,
    /// Errors of the background cameras.
    pub cameras: Outcome<CameraErrors>,
    /// Which of the run's objects is the target.
    pub target: Outcome<Target>,
    /// The run's other objects.
    pub others: Vec<Target>,
    /// The run's scale ratio.
    pub scale: Outcome<ScaleFigures>,
    /// The ratio that a perfect estimator would find.
    pub reference_scale: Outcome<ReferenceScale>,
    /// Trajectory error of the run.
    pub trajectory: Outcome<TrajectoryError>,
    /// Trajectory error at the reference ratio: what the two reconstructions alone cost.
    pub trajectory_at_reference: Outcome<TrajectoryError>,
    /// Results of every estimator of the run on the models that the trajectory refers to (`objects/<id>`).
    pub alternatives: BTreeMap<ScaleMethod, Alternative>,
    /// The same on the target as structure from motion left it (`as-reconstructed/<id>`); `None` where nothing was
    /// adjusted after that.
    pub as_reconstructed: Option<Outcome<AsReconstructedFigures>>,
    /// Results of the reference methods on the target as structure from motion left it; empty unless the run computed
    /// them.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub references: BTreeMap<ScaleMethod, ReferenceFigures>,
}

/// Result of a reference method.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReferenceFigures {
    /// Its scale ratio with the errors; `None` where it has none.
    pub found: Option<Alternative>,
    /// Standard deviation of the ratio.
    pub std: Option<f64>,
    /// Reason why the ratio is undetermined; `None` if it is determined.
    pub undetermined: Option<String>,
}

/// Figures of the target's reconstruction before its adjustment with the ground.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct AsReconstructedFigures {
    /// The ratio that a perfect estimator would find.
    pub reference_ratio: f64,
    /// Mean trajectory error at that ratio, metres.
    pub error_at_reference_m: f64,
    /// Results of every estimator.
    pub alternatives: BTreeMap<ScaleMethod, Alternative>,
}

/// Numbers of frames with a pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RegisteredFrames {
    /// Frames of the sequence.
    pub num_frames: usize,
    /// Those with a background camera.
    pub num_background: usize,
    /// `num_background / num_frames`.
    pub background_fraction: Option<f64>,
    /// Frames in which the target is seen.
    pub num_visible: usize,
    /// Those of `num_visible` with a camera in the target's model.
    pub num_object: usize,
    /// `num_object / num_visible`.
    pub object_fraction: Option<f64>,
    /// Frames in which [`CLEAR_SHARE`](super::CLEAR_SHARE) of the target or more is seen; `None` where the sequence
    /// does not say how much is.
    #[serde(default)]
    pub num_clear: Option<usize>,
    /// Those of `num_clear` with a camera in the target's model.
    #[serde(default)]
    pub num_object_clear: Option<usize>,
    /// Those of `num_clear` with a position in the target's trajectory.
    #[serde(default)]
    pub num_placed_clear: Option<usize>,
    /// Those of `num_visible` with both cameras.
    pub num_both: usize,
    /// Background images that are no frame of the sequence.
    pub unmatched: Vec<String>,
}

/// An object of the run: the target, or another one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Target {
    /// Its id.
    pub object: ObjectId,
    /// Overlap of its masks with the target's, over all frames; `None` if there were none to compare.
    pub iou: Option<f64>,
}

/// The run's scale ratio.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScaleFigures {
    /// Scale ratio r: units of the background per unit of the object.
    pub ratio: f64,
    /// Its standard deviation, if the method gives one.
    pub std: Option<f64>,
    /// The method that gave it.
    pub method: ScaleMethod,
    /// True if the run marks the ratio as undetermined.
    pub degenerate: bool,
    /// Why it cannot.
    pub reason: Option<String>,
    /// |r − r_ref| / r_ref; `None` without a reference.
    pub deviation: Option<f64>,
}

impl Evaluation {
    /// Which of the target's models [`Evaluation::alternatives`] speak of.
    pub fn model(&self) -> ModelState {
        match self.as_reconstructed {
            Some(_) => ModelState::Adjusted,
            None => ModelState::AsReconstructed,
        }
    }
}

/// Result of one estimator.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Alternative {
    /// Its scale ratio.
    pub ratio: f64,
    /// |r − r_ref| / r_ref; `None` without a reference.
    pub deviation: Option<f64>,
    /// Mean trajectory error at this ratio, metres; `None` where none can be computed.
    pub trajectory_error_m: Option<f64>,
}
