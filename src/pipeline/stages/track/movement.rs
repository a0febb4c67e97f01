//! Motion states of the tracked objects, from the points of the stage `motion` on their masks.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::kept_masks::KeptMasks;
use crate::math::rounding::with_std;
use crate::motion::{
    CLEAR_ODDS, ContactDepth, Judgement, MovementReason, PointOnObject, StaticPoint, alive, judge_pieces, with_travel,
    without_sway,
};
use crate::pipeline::Result;
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::stages::background;
use crate::pipeline::stages::motion::{self, Points, World};
use crate::scene::{
    DetectionCounts, Frame, FrameId, Mask, Movement, MovementFinding, ObjectId, Reconstruction, Rect, TRUNCATION_PX,
    TrackedObject,
};
use crate::tracking::MaskEvidence;
use crate::trajectory::motion_by_shaking;

/// Finding without evidence.
pub(super) fn unknown() -> MovementFinding {
    MovementFinding { state: Movement::Undetermined, reason: "unordered images show no motion".to_owned() }
}

/// Movement finding of an object by its points, before there is a reconstruction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(in crate::pipeline) struct PointFinding {
    /// The finding.
    pub(in crate::pipeline) finding: MovementFinding,
    /// Its evidence; `None` where no points were examined.
    pub(in crate::pipeline) reason: Option<MovementReason>,
}

impl PointFinding {
    /// Returns true if points leave the lines of stationary ones, or if masks change their position.
    ///
    /// Points that leave them in part of the frames suffice.
    pub(in crate::pipeline) fn points_move(&self) -> bool {
        use MovementReason::{MovesForATime, PointsMove, Travels};
        matches!(self.reason, Some(PointsMove | MovesForATime | Travels))
    }

    /// Finds an object stationary by the shaking of the camera; `None` where points move or the camera is too steady.
    ///
    /// * `object` – triangulated from the background's cameras.
    pub(in crate::pipeline) fn at_rest_by_shaking(
        &self,
        object: &Reconstruction,
        frames: &[Frame],
    ) -> Option<MovementFinding> {
        let motion = motion_by_shaking(object, frames).filter(|_| !self.points_move())?;
        let odds = motion.odds_of_motion(0.0);
        let reason = format!(
            "seen by the shaking of the camera at {} times the inverse of the distance that it has if stationary (odds \
             of motion {odds:.2}:1)",
            with_std(motion.slope, motion.std)
        );
        (odds <= 1.0 / CLEAR_ODDS).then_some(MovementFinding { state: Movement::Stationary, reason })
    }
}

/// Findings by points of all objects.
pub(in crate::pipeline) type PointFindings = BTreeMap<ObjectId, PointFinding>;

/// File of the findings in the stage's state.
const FINDINGS: &str = "track-movement.json";

/// The findings by points; the stage `track` must be done.
pub(in crate::pipeline) fn by_points(run: &Run) -> Result<PointFindings> {
    run.workspace.read_state(FINDINGS)
}

/// Determines the motion state of every object; returns the evidence of its masks.
///
/// Without examined points the states stay as they are.
pub(super) fn judge_all(
    run: &Run,
    masks: &KeptMasks,
    objects: &mut [TrackedObject],
    outcome: &mut Outcome,
) -> Result<BTreeMap<ObjectId, MaskEvidence>> {
    let points = motion::points(run)?;
    let on = if points.frames.is_empty() { BTreeMap::new() } else { on_objects(run, masks, objects, &points)? };
    let (second, hovers) = (frames_per_second(run.frames()?), background::hovers(run));
    let none = OnObject::default();
    let (mut evidence, mut findings) = (BTreeMap::new(), PointFindings::new());
    for object in objects {
        let on_it = on.get(&object.id).unwrap_or(&none);
        let mut pieces = vec![Vec::new(); object.gaps.len() + 1];
        for (&track, &count) in &on_it.counts {
            let contact = on_it.contacts.get(&track).copied();
            let (track, label) = (&points.tracks[track], &points.labels[track]);
            let first = points.frames.get(track.first as usize);
            let piece = object.gaps.iter().filter(|gap| first.is_some_and(|first| *first >= gap.first)).count();
            let inside = count as f64 / track.pixels.len().max(1) as f64;
            pieces[piece].push(PointOnObject { track, label, inside, contact });
        }
        let mut judged = judge_pieces(&pieces, second);
        if hovers {
            judged = without_sway(judged, &pieces.concat(), on_it.mean_size_px());
            judged = with_travel(judged, &on_it.directions, on_it.mean_size_px() / on_it.focal_px);
        }
        let is_examined = !points.frames.is_empty();
        if is_examined {
            object.movement = finding(object, &judged);
        }
        let reason = is_examined.then_some(judged.reason);
        findings.insert(object.id, PointFinding { finding: object.movement.clone(), reason });
        let (num_frames, movement) = (object.frames.len(), object.movement.state);
        let (mean_share, is_flat) = (on_it.mean_share(run.size()), judged.is_flat);
        evidence.insert(object.id, MaskEvidence { num_frames, mean_share, movement, is_flat });
    }
    run.keep(FINDINGS, &findings, outcome)?;
    Ok(evidence)
}

/// Mean rate of the frames, Hz.
fn frames_per_second(frames: &[Frame]) -> f64 {
    let (Some(first), Some(last)) = (frames.first(), frames.last()) else { return 1.0 };
    let duration = last.time_s - first.time_s;
    if duration > 0.0 { (frames.len() - 1) as f64 / duration } else { 1.0 }
}

/// Points on an object's masks.
#[derive(Default)]
struct OnObject {
    /// Per track of a point the number of frames in which it is on a mask of the object.
    counts: BTreeMap<usize, usize>,
    /// Per track the object's contact point below its point.
    contacts: BTreeMap<usize, ContactDepth>,
    /// Direction to the center of each mask, in the background's frame.
    directions: Vec<Vector3<f64>>,
    /// Focal length in the last of them, pixels.
    focal_px: f64,
    /// Pixels of all masks.
    area: usize,
    /// Number of masks.
    num_masks: usize,
}

impl OnObject {
    /// Side of a square as large as the mean mask, pixels.
    fn mean_size_px(&self) -> f64 {
        (self.area as f64 / self.num_masks.max(1) as f64).sqrt()
    }

    /// Mean share of the image that the masks cover.
    fn mean_share(&self, (width, height): (u32, u32)) -> f64 {
        let all = f64::from(width) * f64::from(height) * self.num_masks.max(1) as f64;
        self.area as f64 / all.max(1.0)
    }
}

/// Movement finding of an object by its points.
///
/// If the contact point of a stationary object would float above the ground, a vehicle is approaching; anything else
/// may be a tree, a sign or a balcony.
fn finding(object: &TrackedObject, judged: &Judgement) -> MovementFinding {
    let DetectionCounts { given, .. } = object.found_in;
    let is_vehicle = given > 0 || object.found_in.by_detector() > object.found_in.motion;
    if judged.reason == MovementReason::FootFloats && !is_vehicle {
        let reason = "it approaches, or it is tall: a stationary object would float above the ground";
        return MovementFinding { state: Movement::Undetermined, reason: reason.to_owned() };
    }
    MovementFinding { state: judged.movement, reason: judged.to_string() }
}

/// Points on the masks of each object.
fn on_objects(
    run: &Run,
    masks: &KeptMasks,
    objects: &[TrackedObject],
    points: &Points,
) -> Result<BTreeMap<ObjectId, OnObject>> {
    let names: BTreeMap<FrameId, &Frame> = run.frames()?.iter().map(|frame| (frame.id, frame)).collect();
    let seen: Vec<Frame> = points.frames.iter().filter_map(|id| Some((*names.get(id)?).clone())).collect();
    // If a frame is missing, the world's frames are not those that tracks count.
    let world = if seen.len() == points.frames.len() { motion::world(run, &seen)? } else { None };
    let mut found: BTreeMap<ObjectId, OnObject> = BTreeMap::new();
    for ((index, id), live) in (0u32..).zip(&points.frames).zip(alive(&points.tracks)) {
        let Some(frame) = names.get(id) else { continue };
        for (object, mask) in masks.read(objects, frame)? {
            let on_it = found.entry(object).or_default();
            on_it.area += mask.area_px2();
            on_it.num_masks += 1;
            let view = world.as_ref().and_then(|world| world.views[index as usize].as_ref());
            if let Some((view, bounds)) = view.zip(mask.bounding_box()) {
                let in_cam = view.camera.ray_from_pixel(Rect::from(bounds).center().into());
                on_it.directions.push(view.cam_from_world.rotation.inverse() * in_cam.normalize());
                on_it.focal_px = view.camera.mean_focal();
            }
            for &k in &live {
                let Some(pixel) = points.tracks[k].at(index).filter(|[x, y]| mask.contains(*x, *y)) else { continue };
                *on_it.counts.entry(k).or_default() += 1;
                let point = points.labels[k].static_point.filter(|point| point.frame == index);
                if let Some((world, point)) = world.as_ref().zip(point) {
                    let contact = contact_depth(world, &mask, pixel, &point);
                    on_it.contacts.extend(contact.map(|contact| (k, contact)));
                }
            }
        }
    }
    Ok(found)
}

/// Contact point of an object below one of its points: the end of its mask in the point's column.
fn contact_depth(world: &World, mask: &Mask, [x, y]: [f64; 2], point: &StaticPoint) -> Option<ContactDepth> {
    let view = world.views.get(point.frame as usize)?.as_ref()?;
    let (column, first) = (x.floor() as i64, y.floor() as i64);
    let last = (first..i64::from(mask.height())).rev().find(|&row| mask.get(column, row))?;
    let is_cut = last + i64::from(TRUNCATION_PX) >= i64::from(mask.height());
    world.ground.as_ref()?.contact_depth(view, [x, (last + 1) as f64], is_cut, point)
}
