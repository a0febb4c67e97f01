//! Stage `scale`: the scale ratio of every object, its trajectory or else its ground track, and its motion state by
//! points and trajectory.

pub(super) mod ground_tracks;
mod movement;

use std::collections::BTreeMap;

use nalgebra::Matrix3;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::background::ModelReport;
use super::background::{self, point_cloud};
use super::metric::Size;
use super::track;
use super::track::movement::PointFindings;
use super::{ground, objects};
use crate::ground::HoveringGround;
use crate::math::rounding::ranges;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::{Result, Stage};
use crate::scene::{
    BodyCenter, Frame, FrameId, Ground, GroundPlane, Movement, MovementFinding, ObjectId, ObjectTrajectory,
    Reconstruction, ScaleMethod, StationaryVehicles, Topic, TrackedObject, Trajectories, Unit, Verdict,
};
use crate::trajectory::{
    self, Adjustment, BodyOnGround, Candidate, Evidence, Extents, ModelOrigin, ObjectDescription, Outlines,
    PlacedObject, Silhouette, Subject, extents,
};
use movement::TrajectoryEvidence;

/// File name of the trajectories of this stage, in units of the background.
const IN_UNITS: &str = "scale-trajectories.json";

/// File name of the other results for later stages.
const RESULTS: &str = "scale-results.json";

pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    Ok(json!({ "options": run.options.scale }))
}

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    let background = run.workspace.read_background()?;
    let reports = objects::reports(run)?;
    clear(run, &reports)?;
    outcome.outputs.push(point_cloud::background(run, &background)?);
    let mut tracked = run.workspace.read_tracked()?;
    let scene = Scene::read(run, &background, &reports, &tracked)?;
    let mut found = ScaleContext::default();
    for tracked in &mut tracked {
        tracked.movement = scene.by_points(tracked);
        if let Some(report) = reports.get(&tracked.id) {
            scene.place(tracked, report, &mut found, outcome)?;
        }
    }
    outcome.figure("num_trajectories", found.placed.len());
    let focal_changes = background::background_report(run)?.focal_changes;
    let judge = |placed: &[PlacedVehicle]| {
        let candidates: Vec<Candidate> = placed.iter().map(|placed| placed.candidate(&background)).collect();
        trajectory::verdicts(&candidates, run.info().time_base(), &focal_changes)
    };
    let mut verdicts = judge(&found.placed);
    if scene.withdraw_motion(&mut found.placed, &verdicts, &mut tracked) {
        verdicts = judge(&found.placed);
    }
    outcome.figure("num_moving", tracked.iter().filter(|object| object.movement.state == Movement::Moving).count());
    run.workspace.put_file(&run.workspace.tracked(), |fresh| crate::io::tracks::write(fresh, &tracked))?;
    let objects = with_verdicts(found.placed, verdicts, outcome);
    let failures = &found.results.failures;
    let placed = ground_tracks::Placed { tracked: &tracked, objects: &objects, reports: &reports, failures };
    let (ground_tracks, without) = ground_tracks::find(&scene, &placed, &mut found.results.bodies);
    if !without.is_empty() {
        outcome.figure("without_ground_track", json!(without));
    }
    for (id, reason) in without {
        let no_model = || reports.get(&id).and_then(|report| report.failure.clone()).unwrap_or_default();
        let failure = found.results.failures.entry(id).or_insert_with(no_model);
        *failure += &format!("; no ground track: {reason}");
    }
    let mut all = Trajectories { unit: Unit::Background, metric: None, objects, ground_tracks };
    let path = run.workspace.trajectories();
    crate::io::trajectories::write(&run.workspace.state(IN_UNITS), &all)?;
    all.ground_tracks = ground_tracks::decided(all.ground_tracks, &all.objects);
    outcome.figure("num_ground_tracks", all.ground_tracks.len());
    run.workspace.put_file(&path, |fresh| crate::io::trajectories::write(fresh, &all))?;
    run.keep(RESULTS, &found.results, outcome)?;
    outcome.outputs.extend([run.workspace.state(IN_UNITS), path]);
    Ok(())
}

/// Removes the results that depend on the replaced trajectories.
fn clear(run: &Run, reports: &BTreeMap<ObjectId, ModelReport>) -> Result<()> {
    // The file of trajectories is rewritten without metres, which the stage `metric` adds.
    run.workspace.clear_marker(Stage::Metric)?;
    run.workspace.remove(&run.workspace.evaluation())?;
    run.workspace.remove(&run.workspace.exports())?;
    run.workspace.remove(&run.workspace.point_clouds())?;
    let has_model = |id| reports.get(&id).is_some_and(|report| report.failure.is_none());
    run.workspace.keep_objects(&run.workspace.objects(), has_model)
}

/// Context of the objects' trajectories.
struct Scene<'a, 'r> {
    run: &'a Run<'r>,
    background: &'a Reconstruction,
    ground: Ground,
    sources: ground::GroundResults,
    frames: &'a [Frame],
    /// Relative standard deviation of the focal length; `None` if positions do not depend on it.
    focal_std: Option<f64>,
    /// Outlines of all objects that may get a position.
    outlines: Outlines,
    by_points: PointFindings,
}

/// Outcomes of the objects.
#[derive(Default)]
struct ScaleContext {
    placed: Vec<PlacedVehicle>,
    results: ScaleResults,
}

/// Results for later stages besides the trajectories, in units of the background.
#[derive(Default, Serialize, Deserialize)]
pub(in crate::pipeline) struct ScaleResults {
    pub(in crate::pipeline) sizes: BTreeMap<ObjectId, Size>,
    /// Ground bodies of the vehicles with a ground track.
    pub(in crate::pipeline) bodies: BTreeMap<ObjectId, BodyOnGround>,
    pub(in crate::pipeline) pose_covariances: PoseCovariances,
    /// Reasons why objects with a model have no trajectory, or vehicles no ground track.
    pub(in crate::pipeline) failures: BTreeMap<ObjectId, String>,
}

/// Covariances of positions in single frames, in the frame and unit of the background, without those of the ratios.
pub(in crate::pipeline) type PoseCovariances = BTreeMap<ObjectId, BTreeMap<FrameId, Matrix3<f64>>>;

impl<'a, 'r> Scene<'a, 'r> {
    fn read(
        run: &'a Run<'r>,
        background: &'a Reconstruction,
        reports: &BTreeMap<ObjectId, ModelReport>,
        tracked: &[TrackedObject],
    ) -> Result<Self> {
        let frames = run.frames()?;
        let has_model = |id| reports.get(&id).is_some_and(|report| report.failure.is_none());
        let wanted = tracked.iter().filter(|object| object.left_out.is_none() || has_model(object.id));
        let sources = ground::sources(run)?;
        let is_mapped = sources.hovering.as_ref().is_some_and(HoveringGround::is_mapped);
        Ok(Self {
            run,
            background,
            ground: run.workspace.read_ground()?,
            sources,
            frames,
            focal_std: background::focal_deviation(run)?.filter(|_| !is_mapped),
            outlines: outlines(run, frames, wanted.cloned().collect())?,
            by_points: track::movement::by_points(run)?,
        })
    }

    /// Motion finding by points alone. An earlier run of this stage may have revised that of `tracked`.
    fn by_points(&self, tracked: &TrackedObject) -> MovementFinding {
        match self.run.options.scale.stationary {
            StationaryVehicles::All => {
                MovementFinding { state: Movement::Stationary, reason: "stated to be stationary".to_owned() }
            }
            StationaryVehicles::None | StationaryVehicles::Found => {
                self.by_points.get(&tracked.id).map_or_else(|| tracked.movement.clone(), |found| found.finding.clone())
            }
        }
    }

    /// Withdraws motion that only a trajectory shows, if the model's shape contradicts its scale; returns true if there
    /// was any.
    fn withdraw_motion(
        &self,
        placed: &mut [PlacedVehicle],
        verdicts: &[Verdict],
        tracked: &mut [TrackedObject],
    ) -> bool {
        let mut is_withdrawn = false;
        for (placed, verdict) in placed.iter_mut().zip(verdicts) {
            let by_points = self.by_points(&placed.tracked);
            let by_trajectory =
                placed.tracked.movement.state == Movement::Moving && by_points.state != Movement::Moving;
            if !by_trajectory || !movement::contradicts_scale(verdict) {
                continue;
            }
            for tracked in tracked.iter_mut().filter(|tracked| tracked.id == placed.tracked.id) {
                tracked.movement = by_points.clone();
            }
            placed.tracked.movement = by_points;
            is_withdrawn = true;
        }
        is_withdrawn
    }

    /// Revises the motion state by the trajectory, and the scale ratio of a stationary vehicle by the camera
    /// trajectory.
    ///
    /// * `shares_cameras` – the model was triangulated from the background's cameras.
    fn revise(
        &self,
        tracked: &mut TrackedObject,
        placed: &mut PlacedObject,
        evidence: &Evidence,
        shares_cameras: bool,
    ) {
        let options = &self.run.options.scale;
        let by_points = self.by_points.get(&tracked.id).filter(|_| options.stationary != StationaryVehicles::All);
        if let Some(by_points) = by_points {
            let trajectory = placed.trajectory.as_ref().ok();
            let motion = trajectory.and_then(|found| TrajectoryEvidence::of(found, &tracked.gaps, self.background));
            let by_shaking = || by_points.at_rest_by_shaking(evidence.object, self.frames);
            let at_rest = shares_cameras.then(by_shaking).flatten();
            tracked.movement = at_rest.unwrap_or_else(|| movement::revised(by_points, motion.as_ref()));
        }
        let is_stationary = shares_cameras && tracked.movement.state == Movement::Stationary;
        let found = is_stationary.then(|| trajectory::place_stationary(evidence, placed, options.max_relative_std));
        if let Some(found) = found.flatten() {
            *placed = found;
        }
    }

    /// Computes the trajectory of one object that has a model.
    fn place(
        &self,
        tracked: &mut TrackedObject,
        report: &ModelReport,
        found: &mut ScaleContext,
        outcome: &mut Outcome,
    ) -> Result<()> {
        let run = self.run;
        let Some(object) = objects::as_reconstructed(run, tracked.id, report)? else { return Ok(()) };
        let planes = planes(&self.ground, tracked.id);
        let unseen = BTreeMap::new();
        let is_joint = run.options.scale.method == ScaleMethod::Joint;
        let silhouettes = self.outlines.get(&tracked.id).filter(|_| is_joint).unwrap_or(&unseen);
        let evidence = Evidence {
            description: description(tracked),
            origin: if report.given { ModelOrigin::Given } else { ModelOrigin::Reconstructed },
            background: self.background,
            object: &object,
            planes: &planes,
            silhouettes,
            frames: self.frames,
            focal_std: self.focal_std,
        };
        let mut placed = trajectory::place(&evidence, &run.options.scale);
        self.revise(tracked, &mut placed, &evidence, report.shares_cameras);
        background::store(run, &run.workspace.object(tracked.id), &placed.object)?;
        outcome.outputs.push(run.workspace.object(tracked.id));
        describe_adjustment(tracked.id, &placed.adjustment, outcome);
        match placed.trajectory {
            Ok(trajectory) => {
                outcome.outputs.push(point_cloud::object(run, &trajectory, &placed.object)?);
                warn_of_scale(&trajectory, outcome);
                let too_few = "standard deviation above the size of the vehicle, too few points visible";
                warn_of_dropped(tracked.id, &placed.dropped.uncertain, too_few, outcome);
                let elsewhere = "contradicted by the motion before and after; its mask may be on another object there";
                warn_of_dropped(tracked.id, &placed.dropped.contradicted, elsewhere, outcome);
                found.results.pose_covariances.insert(tracked.id, placed.pose_covariances);
                let subject = Subject {
                    trajectory: &trajectory,
                    object: &placed.object,
                    background: self.background,
                    planes: &planes,
                    silhouettes,
                    options: &run.options.scale,
                };
                let Extents { length, width, height, center } = extents(&subject);
                found.results.sizes.insert(tracked.id, [length, width, height]);
                let tracked = tracked.clone();
                found.placed.push(PlacedVehicle { trajectory, tracked, object: placed.object, planes, center });
            }
            Err(reason) => {
                outcome.warn(Topic::NoTrajectory.warning(format!("object {}: no trajectory: {reason}", tracked.id)));
                found.results.failures.insert(tracked.id, reason.to_string());
            }
        }
        Ok(())
    }
}

fn warn_of_dropped(id: ObjectId, dropped: &[FrameId], reason: &str, outcome: &mut Outcome) {
    if !dropped.is_empty() {
        let frames = ranges(dropped.iter().map(|frame| frame.0));
        let text = format!("object {id}: no position in {} frames ({frames}): {reason}", dropped.len());
        outcome.warn(Topic::FramesNotRegistered.warning(text));
    }
}

fn warn_of_scale(trajectory: &ObjectTrajectory, outcome: &mut Outcome) {
    if let Some(reason) = &trajectory.scale.reason {
        let text = format!("object {}: scale undetermined: {reason}", trajectory.id);
        outcome.warn(Topic::ScaleUndetermined.warning(text));
    }
}

/// An object that has a trajectory, until all of them are judged together.
struct PlacedVehicle {
    trajectory: ObjectTrajectory,
    tracked: TrackedObject,
    object: Reconstruction,
    planes: BTreeMap<FrameId, GroundPlane>,
    center: Option<BodyCenter>,
}

impl PlacedVehicle {
    fn candidate<'a>(&'a self, background: &'a Reconstruction) -> Candidate<'a> {
        let Self { trajectory, tracked, object, planes, .. } = self;
        Candidate { trajectory, tracked: Some(tracked), object, background, planes }
    }
}

/// The trajectories with the verdict on each.
fn with_verdicts(found: Vec<PlacedVehicle>, verdicts: Vec<Verdict>, outcome: &mut Outcome) -> Vec<ObjectTrajectory> {
    let judge = |(placed, verdict): (PlacedVehicle, Verdict)| {
        let id = placed.trajectory.id;
        let first = verdict.against().next().filter(|_| verdict.is_refuted() && !placed.trajectory.scale.degenerate);
        if let Some(reason) = first {
            outcome.warn(Topic::VehicleRejected.warning(format!("object {id}: rejected: {}", reason.says)));
        }
        outcome.figure(&format!("verdict_{id}"), json!(verdict.state));
        let mut trajectory = ObjectTrajectory { verdict: Some(verdict), ..placed.trajectory };
        placed.center.into_iter().for_each(|center| trajectory.refer_to(center));
        trajectory
    };
    found.into_iter().zip(verdicts).map(judge).collect()
}

fn description(tracked: &TrackedObject) -> ObjectDescription {
    ObjectDescription { id: tracked.id, class: tracked.class.clone(), confidence: tracked.confidence }
}

/// The local planes under one object.
pub(in crate::pipeline) fn planes(ground: &Ground, id: ObjectId) -> BTreeMap<FrameId, GroundPlane> {
    let planes = ground.planes.iter().filter(|((of, _), _)| *of == id);
    planes.map(|(&(_, frame), &plane)| (frame, plane)).collect()
}

fn describe_adjustment(id: ObjectId, adjustment: &Adjustment, outcome: &mut Outcome) {
    match adjustment {
        Adjustment::None => {}
        Adjustment::Failed(error) => {
            let text = format!("object {id}: not adjusted with the ground: {error}");
            outcome.warn(Topic::NotAdjustedWithGround.warning(text));
        }
        Adjustment::Done(found) => outcome.figure(
            &format!("object_{id}"),
            json!({
                "frames_with_outline": found.frames_with_outline,
                "median_error_px": found.error_px,
                "num_uncertain_points": found.num_uncertain,
            }),
        ),
    }
}

/// The trajectories in units of the background, without metres, and the ground tracks of all vehicles that may need
/// one; the stage must be done.
pub(in crate::pipeline) fn in_units(run: &Run) -> Result<Trajectories> {
    Ok(crate::io::trajectories::read(&run.workspace.state(IN_UNITS))?)
}

/// The other results; the stage must be done.
pub(in crate::pipeline) fn results(run: &Run) -> Result<ScaleResults> {
    run.workspace.read_state(RESULTS)
}

/// The outlines of objects.
fn outlines(run: &Run, frames: &[Frame], objects: Vec<TrackedObject>) -> Result<Outlines> {
    let mut found = Outlines::new();
    for frame in frames {
        for (id, mask) in track::masks_of(run, &objects, frame)? {
            if let Some(silhouette) = Silhouette::of(&mask) {
                found.entry(id).or_default().insert(frame.id, silhouette);
            }
        }
    }
    Ok(found)
}
