//! Stage `motion`: what moves against the background.
//!
//! Points are followed all over the picture and held against the background's cameras and the ground. Following needs
//! pictures alone, so that the stage `features` does it where it goes through them all
//! ([`point_tracks`]). What this stage leaves are boxes of what moves, frame by frame, and what is known
//! of each point: the next stage asks whether the objects moved whose masks it has.

pub(in crate::pipeline) mod point_tracks;
pub(in crate::pipeline) mod stationary_boxes;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nalgebra::Point3;
use serde_json::{Value, json};

use super::background;
use super::segment::detections::FrameFolder;
use super::segment::schedule::Schedule;
use crate::ground::dominant_plane_points;
use crate::motion::{
    DifferenceDetector, GroundModel, MovingObject, PointTrack, Surroundings, TrackLabel, View, classify, movers,
};
use crate::networks::PerceptionError;
use crate::pipeline::driver::intermediate;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::images;
use crate::pipeline::{Instances, MotionChoice, Result, Stage};
use crate::scene::{BoxDetection, DetectionSource, Frame, FrameId, ImageId, Reconstruction, Topic};
use point_tracks::Followed;

const LABELS: &str = "labels.bin";

/// The points of a run and what is known of each.
#[derive(Debug, Default)]
pub(in crate::pipeline) struct Points {
    /// The frames that tracks count, from 0: those that could be decoded.
    pub(in crate::pipeline) frames: Vec<FrameId>,
    pub(in crate::pipeline) tracks: Vec<PointTrack>,
    pub(in crate::pipeline) labels: Vec<TrackLabel>,
}

pub(in crate::pipeline) fn cache_key(run: &Run) -> Result<Value> {
    if !point_tracks::is_wanted(run)? {
        return Ok(json!("none"));
    }
    Ok(json!({
        "finds": finds(run),
        "ground": run.options.ground,
        "seed": run.options.seed,
    }))
}

/// Returns true if motion detects vehicles, besides deciding which of them move.
fn finds(run: &Run) -> bool {
    run.options.instances == Instances::Vehicles && run.options.vehicles.motion == MotionChoice::On
}

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    if !point_tracks::is_wanted(run)? {
        return Ok(());
    }
    let folder = run.workspace.intermediate(Stage::Motion, &outcome.fingerprint)?;
    let Followed { frames, tracks } = point_tracks::points(run)?;
    // Of a long video the background takes as much room as what comes now.
    let world = World::new(run, &run.workspace.read_background()?, &frames, outcome);
    let labels = classify(&tracks, &world.surroundings(run));
    let found: Vec<MovingObject> = match () {
        () if !finds(run) => Vec::new(),
        () if background::hovers(run) => differences(run, &world, &frames, outcome)?,
        () => {
            let by_points = movers(&tracks, &labels, &world.surroundings(run));
            by_points.into_iter().map(MovingObject::from).collect()
        }
    };
    outcome.figure("num_points", tracks.len());
    outcome.figure("num_movers", found.len());
    if finds(run) {
        stationary_boxes::write(run, &folder, &frames, &tracks, &labels)?;
    }
    write_boxes(&folder, &frames, &found)?;
    intermediate::write(&folder.join(LABELS), &labels)?;
    outcome.outputs.push(folder);
    Ok(())
}

/// Moving objects before a camera that does not translate. Compared are the frames in which the detector looks.
fn differences(run: &Run, world: &World, frames: &[Frame], outcome: &mut Outcome) -> Result<Vec<MovingObject>> {
    let schedule = Schedule::of(run)?;
    let looks = (0u32..).zip(frames).filter(|(k, _)| schedule.is_detected(*k as usize));
    let indices: BTreeMap<FrameId, u32> = looks.map(|(k, frame)| (frame.id, k)).collect();
    let mut detector = DifferenceDetector::new(world.surroundings(run));
    let chosen = indices.keys().copied().collect();
    images::for_each(run, Stage::Motion, chosen, outcome, |frame, picture| {
        let Some(&index) = indices.get(&frame.id) else { return Ok(()) };
        Ok(detector.push(index, &picture).map_err(PerceptionError::from)?)
    })?;
    Ok(detector.finish().map_err(PerceptionError::from)?)
}

/// The background as motion is held against it.
pub(in crate::pipeline) struct World {
    times_s: Vec<f64>,
    /// Per frame its camera, where the background has one.
    pub(in crate::pipeline) views: Vec<Option<View>>,
    /// The ground, if it was found.
    pub(in crate::pipeline) ground: Option<GroundModel>,
}

/// The background as later stages hold frames against it; `None` where frames do not follow one another in time, or
/// motion is not looked at.
pub(in crate::pipeline) fn world(run: &Run, frames: &[Frame]) -> Result<Option<World>> {
    if !point_tracks::is_wanted(run)? {
        return Ok(None);
    }
    let background = run.workspace.read_background()?;
    Ok(Some(World::new(run, &background, frames, &mut Outcome::default())))
}

impl World {
    fn new(run: &Run, background: &Reconstruction, frames: &[Frame], outcome: &mut Outcome) -> Self {
        let view = |frame: &Frame| {
            let image = background.images.get(&ImageId::from(frame.id))?;
            let camera = *background.cameras.get(&image.camera)?;
            Some(View { camera, cam_from_world: image.cam_from_world })
        };
        let times_s = frames.iter().map(|frame| frame.time_s).collect();
        Self { times_s, views: frames.iter().map(view).collect(), ground: ground(run, background, outcome) }
    }

    fn surroundings(&self, run: &Run) -> Surroundings<'_> {
        Surroundings { size: run.size(), times_s: &self.times_s, views: &self.views, ground: self.ground.as_ref() }
    }
}

/// The dominant plane below the camera and what was grown from it, whatever labels are given: they come later.
fn ground(run: &Run, background: &Reconstruction, outcome: &mut Outcome) -> Option<GroundModel> {
    if background.is_empty() {
        return None;
    }
    let plane = dominant_plane_points(background, &run.options.ground, run.options.seed);
    let text = |error| format!("motion detection without the ground: {error}");
    let plane = plane.map_err(|error| outcome.note(Topic::MotionWithoutGround.warning(text(error)))).ok()?;
    let position = |id| background.points.get(id).map(|point| point.position);
    let points: Vec<Point3<f64>> = plane.point_ids.iter().filter_map(position).collect();
    GroundModel::new(plane.normal, plane.point, &points)
}

fn write_boxes(folder: &Path, frames: &[Frame], found: &[MovingObject]) -> Result<()> {
    let store: FrameFolder<BoxDetection> = FrameFolder::new(folder.to_owned());
    let mut boxes: BTreeMap<u32, Vec<BoxDetection>> = BTreeMap::new();
    for object in found {
        for (&index, &rect) in &object.boxes {
            let (class, confidence, finder) = ("vehicle".to_owned(), object.confidence, DetectionSource::Motion);
            boxes.entry(index).or_default().push(BoxDetection { class, confidence, rect, finder });
        }
    }
    for (index, boxes) in boxes {
        if let Some(frame) = frames.get(index as usize) {
            store.write(frame, &boxes)?;
        }
    }
    Ok(())
}

pub(in crate::pipeline) fn folder(run: &Run) -> PathBuf {
    run.folder(Stage::Motion)
}

/// The boxes of what moves; the stage must be done.
pub(in crate::pipeline) fn boxes(run: &Run) -> FrameFolder<BoxDetection> {
    FrameFolder::new(folder(run))
}

/// The points and what is known of them; none where motion was not looked at. The stage must be done.
pub(in crate::pipeline) fn points(run: &Run) -> Result<Points> {
    if !point_tracks::is_wanted(run)? {
        return Ok(Points::default());
    }
    let Followed { frames, tracks } = point_tracks::points(run)?;
    let frames = frames.into_iter().map(|frame| frame.id).collect();
    Ok(Points { frames, tracks, labels: intermediate::read(&folder(run).join(LABELS))? })
}
