//! Stage `motion`: detection of motion relative to the background.
//!
//! Points are tracked all over the image and tested against the background's cameras and the ground. Tracking needs
//! only images, so the stage `features` does it in its own pass over them ([`point_tracks`]). The results of this stage
//! are boxes of moving objects by frame, and a label of each point: the next stage uses them to decide whether the
//! objects with masks moved.

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
use point_tracks::TrackedPoints;

const LABELS: &str = "labels.bin";

/// The tracked points of a run and their labels.
#[derive(Debug, Default)]
pub(in crate::pipeline) struct Points {
    /// The frames that tracks index, from 0: those that could be decoded.
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

/// Returns true if motion detects vehicles, besides determining their motion states.
fn finds(run: &Run) -> bool {
    run.options.instances == Instances::Vehicles && run.options.vehicles.motion == MotionChoice::On
}

pub(in crate::pipeline) fn run_stage(run: &Run, outcome: &mut Outcome) -> Result<()> {
    if !point_tracks::is_wanted(run)? {
        return Ok(());
    }
    let folder = run.workspace.intermediate(Stage::Motion, &outcome.fingerprint)?;
    let TrackedPoints { frames, tracks } = point_tracks::points(run)?;
    // With a long video, the background needs as much memory as the data loaded next.
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

/// Moving objects before a camera that does not translate, by differences of the frames in which the detector runs.
fn differences(run: &Run, world: &World, frames: &[Frame], outcome: &mut Outcome) -> Result<Vec<MovingObject>> {
    let schedule = Schedule::of(run)?;
    let scheduled = (0u32..).zip(frames).filter(|(k, _)| schedule.is_detected(*k as usize));
    let indices: BTreeMap<FrameId, u32> = scheduled.map(|(k, frame)| (frame.id, k)).collect();
    let mut detector = DifferenceDetector::new(world.surroundings(run));
    let chosen = indices.keys().copied().collect();
    images::for_each(run, Stage::Motion, chosen, outcome, |frame, picture| {
        let Some(&index) = indices.get(&frame.id) else { return Ok(()) };
        Ok(detector.push(index, &picture).map_err(PerceptionError::from)?)
    })?;
    Ok(detector.finish().map_err(PerceptionError::from)?)
}

/// Camera poses and ground of the background, for tests of motion.
pub(in crate::pipeline) struct World {
    times_s: Vec<f64>,
    /// Camera of each frame, if it is registered.
    pub(in crate::pipeline) views: Vec<Option<View>>,
    /// The ground, if it was found.
    pub(in crate::pipeline) ground: Option<GroundModel>,
}

/// The background for later stages; `None` if frames are not in temporal order, or motion is not analyzed.
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

/// The dominant plane below the camera and the ground grown from it, independent of labels: these come later.
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

/// The boxes of moving objects; the stage must be done.
pub(in crate::pipeline) fn boxes(run: &Run) -> FrameFolder<BoxDetection> {
    FrameFolder::new(folder(run))
}

/// The points and their labels; none if motion was not analyzed. The stage must be done.
pub(in crate::pipeline) fn points(run: &Run) -> Result<Points> {
    if !point_tracks::is_wanted(run)? {
        return Ok(Points::default());
    }
    let TrackedPoints { frames, tracks } = point_tracks::points(run)?;
    let frames = frames.into_iter().map(|frame| frame.id).collect();
    Ok(Points { frames, tracks, labels: intermediate::read(&folder(run).join(LABELS))? })
}
