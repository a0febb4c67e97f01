//! The object that `run --json` and its parts print.

use std::collections::BTreeMap;
use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::{Map, Value, json};

use super::output::{ErrorOutput, Failure};
use super::run::has_page;
use super::summary::why_not;
use crate::io::RunFolder;
use crate::pipeline::{Cost, Stage, StageRecord, Summary, Vehicle};
use crate::scene::{
    Estimate, FrameId, GroundTrack, GroundTrackMethod, GroundTrackVerdict, Movement, NoContact, ObjectId,
    ObjectTrajectory, Reason, ScaleEstimate, Trajectories, Travel, Trust, Verdict,
};

/// Result of `tractrix run --json` and of the commands that do a part of it (docs/formats.md).
#[derive(Serialize, JsonSchema)]
pub(super) struct RunOutput {
    /// The output folder.
    output: PathBuf,
    /// The page; null after a part without one.
    report: Option<PathBuf>,
    /// Vehicles with a trajectory; null before the stage `scale`.
    objects: Option<Vec<Object>>,
    /// Vehicles that are followed on the ground; null before the stage `scale`.
    ground_tracks: Option<Vec<Track>>,
    /// Vehicles without a trajectory; null before the stage `scale`.
    missing: Option<Vec<Missing>>,
    /// Finished stages by name, in order.
    #[schemars(with = "BTreeMap<String, FinishedStage>")]
    stages: Map<String, Value>,
    /// Warnings in order, each with its section of docs/troubleshooting.md.
    warnings: Vec<String>,
    /// Why there is no background.
    failure: Option<String>,
    /// Present where the exit code is not 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<ErrorOutput>,
}

/// A finished stage.
#[derive(Serialize, JsonSchema)]
struct FinishedStage<'a> {
    /// Its cost.
    cost: Cost,
    /// True if cost and figures are those of an earlier run.
    reused: bool,
    /// Its figures.
    figures: &'a BTreeMap<String, Value>,
}

/// A vehicle with a trajectory.
#[derive(Serialize, JsonSchema)]
struct Object {
    /// Its id.
    id: ObjectId,
    /// Its class.
    class: String,
    /// Motion state.
    movement: Option<Movement>,
    /// Number of its positions.
    frames: usize,
    /// Number of frames in which it is visible.
    visible: Option<usize>,
    /// Frame of the first position.
    first_frame: Option<FrameId>,
    /// Frame of the last position.
    last_frame: Option<FrameId>,
    /// Trust; null where not judged.
    verdict: Option<Trust>,
    /// Reasons of the verdict.
    reasons: Option<Vec<Reason>>,
    #[serde(flatten)]
    way: Way,
    /// Between its ends.
    length_m: Option<Estimate>,
    /// Between its sides.
    width_m: Option<Estimate>,
    /// Above the ground.
    height_m: Option<Estimate>,
    /// Scale ratio.
    scale: ScaleEstimate,
    /// Old key, until the next minor version: value of `path_units`.
    path_length: Option<f64>,
    /// Old key, until the next minor version: verdict with reasons.
    judged: Option<Verdict>,
}

/// Travel, with null for unknown values.
#[derive(Serialize, JsonSchema)]
struct Way {
    /// Path length, units of the background.
    path_units: Option<Estimate>,
    /// Path length, meters.
    path_m: Option<Estimate>,
    /// Straight line from the first to the last position.
    displacement_m: Option<Estimate>,
    /// Path length over time.
    mean_speed_m_s: Option<Estimate>,
    /// Greatest speed.
    max_speed_m_s: Option<Estimate>,
}

/// A vehicle that is followed on the ground.
#[derive(Serialize, JsonSchema)]
struct Track {
    /// Its id.
    id: ObjectId,
    /// Its class.
    class: String,
    /// Method.
    method: GroundTrackMethod,
    /// Number of its positions.
    frames: usize,
    /// Frame of the first position.
    first_frame: Option<FrameId>,
    /// Frame of the last position.
    last_frame: Option<FrameId>,
    /// Frames with a mask but without a position, by reason.
    omitted: BTreeMap<NoContact, usize>,
    /// Why its 3D model cannot be used.
    reason: String,
    /// Verdict.
    verdict: Option<GroundTrackVerdict>,
    #[serde(flatten)]
    way: Way,
}

/// A vehicle without a trajectory.
#[derive(Serialize, JsonSchema)]
struct Missing {
    /// Its id.
    id: ObjectId,
    /// Its class.
    class: String,
    /// Motion state.
    movement: Option<Movement>,
    /// Reason.
    reason: String,
}

impl RunOutput {
    /// Of a run up to `goal`.
    pub(super) fn new(
        summary: &Summary,
        goal: Stage,
        trajectories: Option<&Trajectories>,
        failure: Option<&Failure>,
    ) -> Self {
        let stage = |record: &StageRecord| {
            let marker = &record.marker;
            let stage = FinishedStage { cost: marker.cost, reused: record.reused, figures: &marker.figures };
            (record.stage.name().to_owned(), json!(stage))
        };
        let tracks = |found: &Trajectories| found.ground_tracks.iter().map(Track::new).collect();
        Self {
            output: summary.output.clone(),
            report: has_page(goal).then(|| RunFolder::at(&summary.output).report()),
            objects: trajectories.map(|found| objects(summary, found)),
            ground_tracks: trajectories.map(tracks),
            missing: trajectories.map(|found| missing(summary, found)),
            stages: summary.stages.iter().map(stage).collect(),
            warnings: summary.warnings.clone(),
            failure: summary.failure(),
            error: failure.map(Failure::output),
        }
    }
}

fn objects(summary: &Summary, trajectories: &Trajectories) -> Vec<Object> {
    let object = |found: &ObjectTrajectory| {
        let vehicle = summary.vehicles.get(&found.id);
        let size = found.dimensions.unwrap_or_default();
        Object {
            id: found.id,
            class: found.class.clone(),
            movement: vehicle.and_then(|vehicle| vehicle.movement),
            frames: found.poses.len(),
            visible: vehicle.map(|vehicle| vehicle.model.num_visible),
            first_frame: found.poses.first().map(|pose| pose.frame),
            last_frame: found.poses.last().map(|pose| pose.frame),
            verdict: found.verdict.as_ref().map(|verdict| verdict.state),
            reasons: found.verdict.as_ref().map(|verdict| verdict.reasons.clone()),
            way: Way::of(found.travel),
            length_m: size.length_m,
            width_m: size.width_m,
            height_m: size.height_m,
            scale: found.scale.clone(),
            path_length: found.travel.map(|travel| travel.path_units.value),
            judged: found.verdict.clone(),
        }
    };
    trajectories.objects.iter().map(object).collect()
}

impl Way {
    fn of(travel: Option<Travel>) -> Self {
        Self {
            path_units: travel.map(|travel| travel.path_units),
            path_m: travel.and_then(|travel| travel.path_m),
            displacement_m: travel.and_then(|travel| travel.displacement_m),
            mean_speed_m_s: travel.and_then(|travel| travel.mean_speed_m_s),
            max_speed_m_s: travel.and_then(|travel| travel.max_speed_m_s),
        }
    }
}

impl Track {
    fn new(track: &GroundTrack) -> Self {
        Self {
            id: track.id,
            class: track.class.clone(),
            method: track.method,
            frames: track.positions.len(),
            first_frame: track.positions.first().map(|at| at.frame),
            last_frame: track.positions.last().map(|at| at.frame),
            omitted: track.omitted.clone(),
            reason: track.reason.clone(),
            verdict: track.verdict.clone(),
            way: Way::of(track.travel),
        }
    }
}

/// The vehicles without a trajectory, with the reason.
fn missing(summary: &Summary, trajectories: &Trajectories) -> Vec<Missing> {
    let is_placed = |id: &ObjectId| trajectories.objects.iter().any(|found| found.id == *id);
    let one = |(id, vehicle): (&ObjectId, &Vehicle)| Missing {
        id: *id,
        class: vehicle.class.clone(),
        movement: vehicle.movement,
        reason: why_not(vehicle).to_owned(),
    };
    summary.vehicles.iter().filter(|(id, _)| !is_placed(id)).map(one).collect()
}

/// The vehicles with a trajectory as JSON, for tests of what is printed.
#[cfg(test)]
pub(super) fn objects_as_json(summary: &Summary, trajectories: &Trajectories) -> Value {
    json!(objects(summary, trajectories))
}
