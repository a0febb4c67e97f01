//! Positions of vehicles: contact points with the ground, provisional in the newest frame, final when it leaves the
//! window.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use ::image::RgbImage;
use nalgebra::{Matrix3, Point3};

use super::WINDOW_S;
use super::georeference::rounded;
use super::line::{GeoPosition, LengthUnit, MotionState, PositionMethod, State, VehicleLine};
use super::map::WorldMap;
use super::models::{Model, Request, Subject};
use super::perception::{Identity, Outlined};
use super::window::SPARE_S;
use crate::camera::Camera;
use crate::features::video_front_end::{VideoFrontEnd, VideoOptions};
use crate::image::Picture;
use crate::metric::{ObservedPoint, in_metres};
use crate::pipeline::{Options, PipelineError};
use crate::scene::{
    Frame, FrameId, GroundPosition, Image, ImageId, Motion, Movement, NoContact, ObjectId, Reconstruction, Rect,
};
use crate::tracking::TrackedMask;
use crate::tracking::merging::{Pair, identity_score};
use crate::trajectory::{
    CommonStd, ContactEvidence, Contacts, FocalError, Outlines, PositionError, PositionMeasurement, contacts, smooth,
};

/// Time span of the positions used for the velocity of a provisional one, seconds.
const PAST_S: f64 = 3.0;
/// Minimum time between two of these positions, seconds: errors of contact points are correlated in neighboring frames,
/// and the time of smoothing grows with their number.
const PAST_STEP_S: f64 = 0.28;
/// Speed of a walking person, m/s: a vehicle in traffic that is slower is stationary.
const WALKING_M_S: f64 = 1.4;
/// Standard deviations by which the speed of a stationary vehicle is below [`WALKING_M_S`].
const STATIONARY_SIGMAS: f64 = 2.0;
/// Standard deviations from zero beyond which a speed has a direction.
const MOVING_SIGMAS: f64 = 3.0;
/// Views of a vehicle's tracks at which those outside the window are dropped.
const MAX_VIEWS: usize = 200;

/// Contact points of a vehicle.
pub(super) type Positions = BTreeMap<FrameId, GroundPosition>;

/// A vehicle in a frame.
struct Seen<'a> {
    frame: &'a Frame,
    rect: Rect,
    /// When the frame was decoded.
    decoded: Option<Instant>,
}

/// A vehicle in the window.
#[derive(Default)]
struct Vehicle {
    identity: Option<Identity>,
    rects: BTreeMap<FrameId, Rect>,
    /// In the frame of the last map.
    positions: Positions,
    /// True if the local frame has a model of it.
    has_model: bool,
    /// Tracks of its points.
    points: Option<VideoFrontEnd>,
    /// Id of the lost vehicle whose track it continues; decided when it is confirmed.
    merged: Option<ObjectId>,
}

/// All vehicles of the window.
#[derive(Default)]
pub(super) struct Vehicles {
    vehicles: BTreeMap<ObjectId, Vehicle>,
    outlines: Outlines,
    frames: BTreeMap<FrameId, Frame>,
    /// When each frame was decoded.
    decoded: BTreeMap<FrameId, Instant>,
    /// The last final frame.
    last_final: Option<FrameId>,
}

impl Vehicles {
    /// Adds the observations of a frame.
    pub(super) fn push(
        &mut self,
        frame: &Frame,
        decoded: Instant,
        seen: Vec<Outlined>,
        mut identities: BTreeMap<ObjectId, Identity>,
    ) {
        self.frames.insert(frame.id, frame.clone());
        self.decoded.insert(frame.id, decoded);
        for Outlined { object, frame, rect, outline } in seen {
            if !self.frames.contains_key(&frame) {
                continue;
            }
            self.vehicles.entry(object).or_default().rects.insert(frame, rect);
            let outlines = self.outlines.entry(object).or_default();
            match outline {
                Some(outline) => drop(outlines.insert(frame, outline)),
                None => drop(outlines.remove(&frame)),
            }
        }
        let objects: Vec<ObjectId> = self.vehicles.keys().copied().collect();
        for object in objects {
            let Some(identity) = identities.remove(&object) else { continue };
            let is_new = self.vehicles.get(&object).is_some_and(|vehicle| vehicle.identity.is_none());
            let merged = if is_new { self.continued(object, &identity) } else { None };
            let Some(vehicle) = self.vehicles.get_mut(&object) else { continue };
            vehicle.merged = vehicle.merged.or(merged);
            vehicle.identity = Some(Identity { id: vehicle.merged.unwrap_or(identity.id), ..identity });
        }
        self.forget(frame.time_s - WINDOW_S - SPARE_S);
    }

    /// Id of the lost vehicle that a new one continues, by the track merging rules of a run.
    fn continued(&self, object: ObjectId, identity: &Identity) -> Option<ObjectId> {
        let after = identity.after?;
        let lost = self.vehicles.get(&after.provisional)?;
        let time_s = |frame: &FrameId| self.frames.get(frame).map(|frame| frame.time_s);
        let first_s = time_s(self.vehicles.get(&object)?.rects.keys().next()?)?;
        let gap_s =
            first_s - time_s(lost.rects.keys().rev().find(|frame| time_s(frame).is_some_and(|s| s < first_s))?)?;
        let pair = Pair { before: 0, after: 1, gap_s, evidence: after.evidence, is_turned: false };
        identity_score(&pair).ok().and(lost.identity.as_ref()).map(|lost| lost.id)
    }

    /// Tracks points of the vehicles inside their masks.
    pub(super) fn track_points(
        &mut self,
        frame: &Frame,
        picture: &RgbImage,
        masks: &[TrackedMask],
        camera: Camera,
    ) -> Result<(), PipelineError> {
        let picture = Picture::new(picture);
        for TrackedMask { object, mask, .. } in masks {
            let Some(vehicle) = self.vehicles.get_mut(object) else { continue };
            let new = || VideoFrontEnd::new(VideoOptions::object(), camera).only_across_breaks();
            let points = vehicle.points.get_or_insert_with(new);
            points.push(frame, &picture, mask)?;
            if points.table().views.len() >= MAX_VIEWS {
                let first = self.frames.keys().next().copied().unwrap_or(frame.id);
                points.retain_views(|_, view| view.image.frame() >= first);
            }
        }
        Ok(())
    }

    /// Input of the models of the vehicles in a map.
    pub(super) fn request(&self, map: &Arc<WorldMap>) -> Request {
        let subject = |(&object, vehicle): (&ObjectId, &Vehicle)| {
            let (Identity { class, confidence, .. }, points) = (vehicle.identity.clone()?, vehicle.points.as_ref()?);
            Some(Subject { object, class, confidence, table: points.table().clone() })
        };
        Request {
            map: map.clone(),
            subjects: self.vehicles.iter().filter(|_| !map.hovers()).filter_map(subject).collect(),
            outlines: self.outlines.clone(),
            frames: self.frames.values().cloned().collect(),
        }
    }

    fn forget(&mut self, before_s: f64) {
        let Some((&first, _)) = self.frames.iter().find(|(_, frame)| frame.time_s >= before_s) else { return };
        self.frames = self.frames.split_off(&first);
        self.decoded = self.decoded.split_off(&first);
        for vehicle in self.vehicles.values_mut() {
            vehicle.rects = vehicle.rects.split_off(&first);
            vehicle.positions = vehicle.positions.split_off(&first);
        }
        self.vehicles.retain(|_, vehicle| !vehicle.rects.is_empty());
        for outlines in self.outlines.values_mut() {
            *outlines = outlines.split_off(&first);
        }
        self.outlines.retain(|object, _| self.vehicles.contains_key(object));
    }

    /// The confirmed vehicles of the newest frame.
    ///
    /// * `image` – the frame in the map; `None` where it has no pose.
    pub(super) fn provisional(
        &mut self,
        map: Option<&WorldMap>,
        image: Option<(ImageId, Image)>,
        options: &Options,
    ) -> Vec<VehicleLine> {
        let Some(frame) = self.frames.values().next_back().cloned() else { return Vec::new() };
        let mut found = BTreeMap::new();
        if let (Some(map), Some((id, image))) = (map, image) {
            // A model of the one frame: the map's points, without its other images.
            let model = Reconstruction { images: [(id, image)].into(), ..map.local.clone() };
            for &object in self.vehicles.keys() {
                found.insert(object, self.contacts(object, map, &model, &[&frame], options));
            }
        }
        let mut lines = Vec::new();
        for (object, vehicle) in &mut self.vehicles {
            let mut contacts = found.remove(object).unwrap_or_default();
            let position = contacts.positions.pop();
            vehicle.positions.extend(position.map(|position| (frame.id, position)));
            let Some(&rect) = vehicle.rects.get(&frame.id) else { continue };
            let reason = contacts.omitted.keys().next().copied();
            let motion = map.and_then(|map| motions(map, vehicle.past(frame.time_s).into_iter()).remove(&frame.id));
            let seen = Seen { frame: &frame, rect, decoded: self.decoded.get(&frame.id).copied() };
            lines.extend(vehicle.line(seen, map.map(|map| (map, &vehicle.positions)), reason, motion));
        }
        lines
    }

    /// Takes a new map: revises the contact points of all frames.
    pub(super) fn take_map(&mut self, map: &WorldMap, options: &Options) {
        let frames: Vec<&Frame> = self.frames.values().filter(|frame| frame.time_s <= map.time_s).collect();
        let objects: Vec<ObjectId> = self.vehicles.keys().copied().collect();
        let found: BTreeMap<ObjectId, Contacts> =
            objects.into_iter().map(|id| (id, self.contacts(id, map, &map.model, &frames, options))).collect();
        for (id, contacts) in found {
            let Some(vehicle) = self.vehicles.get_mut(&id) else { continue };
            if !map.is_continued {
                vehicle.positions.clear();
                vehicle.has_model = false;
            }
            vehicle.positions.extend(contacts.positions.into_iter().map(|position| (position.frame, position)));
        }
    }

    /// Image boxes of the vehicles that are not truncated.
    pub(super) fn images(&self, camera: &Camera) -> Vec<BTreeMap<FrameId, Rect>> {
        let is_whole = |rect: &Rect| {
            rect.x0 > 0.0 && rect.y0 > 0.0 && rect.x1 < f64::from(camera.width) && rect.y1 < f64::from(camera.height)
        };
        let of_vehicle = |vehicle: &Vehicle| {
            vehicle.rects.iter().filter(|(_, rect)| is_whole(rect)).map(|(&id, rect)| (id, *rect)).collect()
        };
        self.vehicles.values().filter(|vehicle| vehicle.identity.is_some()).map(of_vehicle).collect()
    }

    /// Contact points of all vehicles, in the frame of the last map.
    pub(super) fn positions(&self) -> BTreeMap<ObjectId, Positions> {
        self.vehicles.iter().map(|(&id, vehicle)| (id, vehicle.positions.clone())).collect()
    }

    /// Number of vehicles with a model in the local frame.
    pub(super) fn num_models(&self) -> usize {
        self.vehicles.values().filter(|vehicle| vehicle.has_model).count()
    }

    /// Removes and returns the frames that become final with a map, and their positions.
    ///
    /// * `until_s` – time of the last of these frames, seconds.
    /// * `positions` – contact points in this map.
    /// * `models` – in this map, by provisional ids.
    pub(super) fn finalize(
        &mut self,
        map: &WorldMap,
        until_s: f64,
        positions: &BTreeMap<ObjectId, Positions>,
        models: &BTreeMap<ObjectId, Model>,
    ) -> (Vec<Frame>, Vec<VehicleLine>) {
        let begin = self.last_final;
        let leaving: Vec<Frame> = self
            .frames
            .values()
            .filter(|frame| begin.is_none_or(|last| frame.id > last) && frame.time_s <= until_s)
            .cloned()
            .collect();
        self.last_final = leaving.last().map(|frame| frame.id).or(begin);
        let mut lines = Vec::new();
        for (id, vehicle) in &mut self.vehicles {
            let Some(positions) = positions.get(id) else { continue };
            let model = models.get(id);
            vehicle.has_model |= model.is_some();
            let by_contact = motions(map, positions.values());
            let by_model = model.map(|model| model_motions(map, model)).unwrap_or_default();
            for frame in &leaving {
                let Some(&rect) = vehicle.rects.get(&frame.id) else { continue };
                let motion = by_model.get(&frame.id).or(by_contact.get(&frame.id)).copied();
                let seen = Seen { frame, rect, decoded: self.decoded.get(&frame.id).copied() };
                let line = vehicle.line(seen, Some((map, positions)), None, motion);
                let Some(line) = line.map(|line| VehicleLine { state: State::Final, ..line }) else { continue };
                lines.push(match model.and_then(|model| placed_model(map, model, frame.id)) {
                    Some(found) => line.at(found, PositionMethod::Model, map),
                    None => line,
                });
            }
        }
        lines.sort_by_key(|line| line.frame);
        (leaving, lines)
    }

    fn contacts(
        &self,
        id: ObjectId,
        map: &WorldMap,
        model: &Reconstruction,
        frames: &[&Frame],
        options: &Options,
    ) -> Contacts {
        let seen =
            |frame: &&&Frame| self.vehicles.get(&id).is_some_and(|vehicle| vehicle.rects.contains_key(&frame.id));
        let frames: Vec<&Frame> = frames.iter().filter(seen).copied().collect();
        let planes = map.ground.planes(model, &self.outlines, id, options);
        let evidence = ContactEvidence {
            background: model,
            planes: &planes,
            outlines: &self.outlines,
            frames: &frames,
            focal: FocalError { std: map.focal_std.unwrap_or(0.0), turns: None },
        };
        contacts(id, &evidence)
    }
}

impl Vehicle {
    /// Recent positions that determine the current velocity.
    fn past(&self, now_s: f64) -> Vec<&GroundPosition> {
        let mut next_s = f64::INFINITY;
        let chosen = self.positions.values().rev().take_while(|position| now_s - position.time_s <= PAST_S);
        let chosen = chosen.filter(|position| {
            let is_due = position.time_s <= next_s;
            if is_due {
                next_s = position.time_s - PAST_STEP_S;
            }
            is_due
        });
        let mut chosen: Vec<&GroundPosition> = chosen.collect();
        chosen.reverse();
        chosen
    }

    /// The line of a confirmed vehicle.
    ///
    /// * `contacts` – a map, and the contact points in it.
    fn line(
        &self,
        seen: Seen,
        contacts: Option<(&WorldMap, &Positions)>,
        reason: Option<NoContact>,
        motion: Option<Motion>,
    ) -> Option<VehicleLine> {
        let Seen { frame, rect, decoded } = seen;
        let Identity { id, class, confidence, .. } = self.identity.clone()?;
        let map = contacts.map(|(map, _)| map);
        let placed = contacts.and_then(|(map, positions)| placed(map, positions.get(&frame.id)?));
        let moves = motion.filter(|motion| motion.speed_m_s.abs() > MOVING_SIGMAS * motion.speed_std_m_s);
        let heading = moves.and_then(|motion| motion.heading_deg);
        let velocity = motion.map(|motion| {
            let heading = motion.heading_deg.unwrap_or(0.0).to_radians();
            [motion.speed_m_s * heading.sin(), motion.speed_m_s * heading.cos(), 0.0]
        });
        let is_metric = map.is_some_and(|map| map.is_metric);
        let line = VehicleLine {
            t: frame.time_s,
            utc: map.and_then(|map| map.georeference.as_ref()?.utc(frame.time_s)),
            frame: frame.id.0,
            id,
            class,
            confidence: rounded(confidence),
            state: State::Provisional,
            revision: map.map_or(0, |map| map.revision),
            rect: [rect.x0, rect.y0, rect.x1, rect.y1],
            unit: if is_metric { LengthUnit::M } else { LengthUnit::Arbitrary },
            method: None,
            reason: Some(reason.unwrap_or(NoContact::NoCamera)),
            position: None,
            covariance: None,
            motion: motion.and_then(|motion| motion_state(&motion, is_metric)),
            geo: None,
            velocity: velocity.map(|velocity| velocity.map(rounded)),
            speed_std: motion.map(|motion| rounded(motion.speed_std_m_s)),
            heading_deg: heading.map(rounded),
            heading_std_deg: moves.and_then(|motion| motion.heading_std_deg).map(rounded),
            lag_s: decoded.map_or(0.0, |decoded| rounded(decoded.elapsed().as_secs_f64())),
        };
        Some(match placed.zip(map) {
            Some((found, map)) => line.at(found, PositionMethod::GroundContact, map),
            None => line,
        })
    }
}

impl VehicleLine {
    /// The same with a position.
    fn at(self, placed: Placed, method: PositionMethod, map: &WorldMap) -> Self {
        let (position, covariance) = (Some(placed.position.map(rounded)), Some(placed.covariance));
        let geo = placed.geo.map(|geo| match (map.georeference.as_ref(), self.velocity, self.speed_std) {
            (Some(georeference), Some(velocity), Some(std)) => {
                georeference.moving(geo, &map.frame, velocity, std, self.heading_std_deg)
            }
            _ => geo,
        });
        Self { position, covariance, geo: geo.map(Box::new), method: Some(method), reason: None, ..self }
    }
}

/// Motion state by a speed and its standard deviation; stationary only if the unit is known.
fn motion_state(motion: &Motion, is_metric: bool) -> Option<MotionState> {
    let (speed, std) = (motion.speed_m_s.abs(), motion.speed_std_m_s);
    let rests = is_metric && speed + STATIONARY_SIGMAS * std < WALKING_M_S;
    let moves = speed > MOVING_SIGMAS * std;
    match (rests, moves) {
        (true, _) => Some(MotionState::Stationary),
        (false, true) => Some(MotionState::Moving),
        (false, false) => None,
    }
}

/// Position of a vehicle.
struct Placed {
    /// In the local frame.
    position: [f64; 3],
    /// Upper triangle of its covariance.
    covariance: [f64; 6],
    geo: Option<GeoPosition>,
}

/// Position in the local frame, and its covariance: that of the point relative to the camera, of the scale along the
/// line of sight, and of the alignments since the first map.
fn placed_at(
    map: &WorldMap,
    frame: FrameId,
    point: Point3<f64>,
    covariance: &Matrix3<f64>,
    log_ratio_std: f64,
) -> Option<Placed> {
    let metric_from_world = map.frame.metric_from_world();
    let center = center(map, frame)?;
    let found = metric_from_world * point;
    let drift = map.line.drift_std * found.coords.norm();
    let observed = ObservedPoint { point, center, log_ratio_std, direction_std: 0.0, pose_covariance: *covariance };
    let covariance = observed.covariance_m(&map.frame) + Matrix3::identity() * drift.powi(2);
    let upper = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|at| covariance[at]);
    let is_finite = found.coords.iter().chain(&upper).all(|x| x.is_finite());
    is_finite.then(|| Placed { position: found.coords.into(), covariance: upper, geo: map.geo(&observed) })
}

fn placed(map: &WorldMap, position: &GroundPosition) -> Option<Placed> {
    placed_at(map, position.frame, position.position.into(), &position.error.covariance(), 0.0)
}

fn placed_model(map: &WorldMap, model: &Model, frame: FrameId) -> Option<Placed> {
    let covariance = model.covariance(frame) + model.body_covariance(frame);
    placed_at(map, frame, model.position(frame)?, &covariance, model.trajectory.log_ratio_std())
}

/// The camera's center in a frame, or in the last one of the map for a frame that came after it.
fn center(map: &WorldMap, frame: FrameId) -> Option<Point3<f64>> {
    let images = &map.model.images;
    let image = images.get(&ImageId::from(frame)).or_else(|| images.values().next_back())?;
    Some(image.cam_from_world.center())
}

/// Smooths the contact points of a vehicle.
fn motions<'a>(map: &WorldMap, positions: impl Iterator<Item = &'a GroundPosition>) -> BTreeMap<FrameId, Motion> {
    let metric_from_world = map.frame.metric_from_world();
    let measured = positions.filter_map(|position| {
        let error = PositionError::Contact(position.error.transformed(&metric_from_world));
        Some((position.frame, measurement(map, position.frame, position.time_s, position.position.into(), error)?))
    });
    smoothed(map, measured, 0.0)
}

/// Smooths the positions of a model.
fn model_motions(map: &WorldMap, model: &Model) -> BTreeMap<FrameId, Motion> {
    let measured = model.trajectory.poses.iter().filter_map(|pose| {
        let error = PositionError::Model { pose: in_metres(&map.frame, &model.covariance(pose.frame)) };
        Some((pose.frame, measurement(map, pose.frame, pose.time_s, pose.position.into(), error)?))
    });
    smoothed(map, measured, model.trajectory.log_ratio_std())
}

fn measurement(
    map: &WorldMap,
    frame: FrameId,
    time_s: f64,
    position: Point3<f64>,
    error: PositionError,
) -> Option<PositionMeasurement> {
    let metric_from_world = map.frame.metric_from_world();
    let position_m = (metric_from_world * position).coords;
    let camera_m = (metric_from_world * center(map, frame)?).coords;
    Some(PositionMeasurement { time_s, position_m, camera_m, forward: None, error })
}

fn smoothed(
    map: &WorldMap,
    measured: impl Iterator<Item = (FrameId, PositionMeasurement)>,
    ratio: f64,
) -> BTreeMap<FrameId, Motion> {
    let (frames, measured): (Vec<FrameId>, Vec<PositionMeasurement>) = measured.unzip();
    let common = CommonStd { ratio, scale: map.frame.log_scale_std() };
    let found = smooth(&measured, &common, Movement::Undetermined);
    found.map(|found| frames.into_iter().zip(found.motions).collect()).unwrap_or_default()
}
