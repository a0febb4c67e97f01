//! Positions of vehicles: contact points with the ground, provisional in the newest frame, final when it leaves the
//! window.

use std::collections::BTreeMap;
use std::time::Instant;

use ::image::RgbImage;
use nalgebra::{Matrix3, Point3};

use super::LiveError;
use super::line::{GeoPosition, LengthUnit, PositionMethod, State, VehicleLine};
use super::map::WorldMap;
use super::models::{Model, Subject};
use super::perception::{Identity, Outlined};
use super::{FINAL_S, Purpose, WINDOW_S};
use crate::camera::Camera;
use crate::features::video_front_end::{VideoFrontEnd, VideoOptions};
use crate::metric::{ObservedPoint, in_metres};
use crate::pipeline::Options;
use crate::scene::{
    Frame, FrameId, GroundPosition, Image, ImageId, Motion, Movement, NoContact, ObjectId, Reconstruction, Rect,
};
use crate::tracking::TrackedMask;
use crate::trajectory::{
    CommonStd, ContactEvidence, Contacts, Outlines, PositionError, PositionMeasurement, contacts, smooth,
};

/// Time of the positions before a provisional one that its velocity rests on, seconds.
const PAST_S: f64 = 3.0;
/// Standard deviations from zero beyond which a speed has a direction.
const MOVES: f64 = 3.0;
/// Views of a vehicle's tracks at which those outside the window are dropped.
const MAX_VIEWS: usize = 200;
/// Time beyond the window for which observations are kept, seconds; as those of the background.
const SPARE_S: f64 = 4.0;

/// A vehicle in the window.
#[derive(Default)]
struct Vehicle {
    identity: Option<Identity>,
    rects: BTreeMap<FrameId, Rect>,
    /// In the frame of the last map.
    positions: BTreeMap<FrameId, GroundPosition>,
    /// Tracks of its points.
    points: Option<VideoFrontEnd>,
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
    /// Takes what was seen in a frame.
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
        for (object, vehicle) in &mut self.vehicles {
            vehicle.identity = identities.remove(object).or(vehicle.identity.take());
        }
        self.forget(frame.time_s - WINDOW_S - SPARE_S);
    }

    /// Tracks points of the vehicles inside their masks.
    pub(super) fn track_points(
        &mut self,
        frame: &Frame,
        picture: &RgbImage,
        masks: &[TrackedMask],
        camera: Camera,
    ) -> Result<(), LiveError> {
        for TrackedMask { object, mask, .. } in masks {
            let Some(vehicle) = self.vehicles.get_mut(object) else { continue };
            let new = || VideoFrontEnd::new(VideoOptions::object(), camera);
            let points = vehicle.points.get_or_insert_with(new);
            points.push(frame, picture, mask)?;
            if points.table().views.len() >= MAX_VIEWS {
                let first = self.frames.keys().next().copied().unwrap_or(frame.id);
                points.retain_views(|_, view| view.image.frame() >= first);
            }
        }
        Ok(())
    }

    /// Vehicles whose points are tracked.
    pub(super) fn subjects(&self) -> Vec<Subject> {
        let subject = |(&object, vehicle): (&ObjectId, &Vehicle)| {
            let (Identity { class, confidence, .. }, points) = (vehicle.identity.clone()?, vehicle.points.as_ref()?);
            Some(Subject { object, class, confidence, table: points.table().clone() })
        };
        self.vehicles.iter().filter_map(subject).collect()
    }

    /// Outlines of all vehicles in the window.
    pub(super) fn outlines(&self) -> &Outlines {
        &self.outlines
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
            let motion = map.and_then(|map| {
                let past = vehicle.positions.values().filter(|position| frame.time_s - position.time_s <= PAST_S);
                motions(map, past).remove(&frame.id)
            });
            let decoded = self.decoded.get(&frame.id).copied();
            lines.extend(vehicle.line(&frame, rect, map, reason, motion, decoded));
        }
        lines
    }

    /// Takes a new map: gives the frames that become final and their positions, and revises the others.
    pub(super) fn take_map(&mut self, map: &WorldMap, options: &Options) -> (Vec<Frame>, Vec<VehicleLine>) {
        let frames: Vec<&Frame> = self.frames.values().filter(|frame| frame.time_s <= map.time_s).collect();
        let objects: Vec<ObjectId> = self.vehicles.keys().copied().collect();
        let found: BTreeMap<ObjectId, Contacts> =
            objects.into_iter().map(|id| (id, self.contacts(id, map, &map.model, &frames, options))).collect();
        let final_until_s = match map.purpose {
            Purpose::Revision => f64::NEG_INFINITY,
            Purpose::Final => map.time_s - FINAL_S,
            Purpose::Last => map.time_s,
        };
        let begin = self.last_final;
        let leaving: Vec<Frame> = self
            .frames
            .values()
            .filter(|frame| begin.is_none_or(|last| frame.id > last) && frame.time_s <= final_until_s)
            .cloned()
            .collect();
        self.last_final = leaving.last().map(|frame| frame.id).or(begin);
        let mut lines = Vec::new();
        for (id, contacts) in found {
            let Some(vehicle) = self.vehicles.get_mut(&id) else { continue };
            if !map.is_continued {
                vehicle.positions.clear();
            }
            vehicle.positions.extend(contacts.positions.into_iter().map(|position| (position.frame, position)));
            let model = map.models.get(&id);
            let by_contact = motions(map, vehicle.positions.values());
            let by_model = model.map(|model| model_motions(map, model)).unwrap_or_default();
            for frame in &leaving {
                let Some(&rect) = vehicle.rects.get(&frame.id) else { continue };
                let decoded = self.decoded.get(&frame.id).copied();
                let of_model = model.and_then(|model| placed_model(map, model, frame.id));
                let motion = by_model.get(&frame.id).or(by_contact.get(&frame.id)).copied();
                let line = vehicle.line(frame, rect, Some(map), None, motion, decoded);
                let Some(line) = line.map(|line| VehicleLine { state: State::Final, ..line }) else { continue };
                lines.push(match of_model {
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
            focal_std: map.focal_std,
        };
        contacts(id, &evidence)
    }
}

impl Vehicle {
    /// The line of a confirmed vehicle.
    fn line(
        &self,
        frame: &Frame,
        rect: Rect,
        map: Option<&WorldMap>,
        reason: Option<NoContact>,
        motion: Option<Motion>,
        decoded: Option<Instant>,
    ) -> Option<VehicleLine> {
        let Identity { id, class, confidence } = self.identity.clone()?;
        let placed = map.and_then(|map| self.positions.get(&frame.id).and_then(|position| placed(map, position)));
        let moves = motion.filter(|motion| motion.speed_m_s.abs() > MOVES * motion.speed_std_m_s);
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

/// Four digits after the point: a tenth of a millimeter.
fn rounded(value: f64) -> f64 {
    (1e4 * value).round() / 1e4
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
    let ray = metric_from_world.rotation * (point - center) * metric_from_world.scale;
    let log_std = map.frame.log_scale_std().hypot(log_ratio_std);
    let found = metric_from_world * point;
    let drift = map.line.drift_std * found.coords.norm();
    let observed = ObservedPoint { point, center, log_ratio_std, direction_std: 0.0, pose_covariance: *covariance };
    let covariance: Matrix3<f64> = in_metres(&map.frame, covariance)
        + ray * ray.transpose() * log_std.powi(2)
        + Matrix3::identity() * drift.powi(2);
    let upper = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)].map(|at| covariance[at]);
    let is_finite = found.coords.iter().chain(&upper).all(|x| x.is_finite());
    is_finite.then(|| Placed { position: found.coords.into(), covariance: upper, geo: map.geo(&observed) })
}

fn placed(map: &WorldMap, position: &GroundPosition) -> Option<Placed> {
    placed_at(map, position.frame, position.position.into(), &position.error.covariance(), 0.0)
}

fn placed_model(map: &WorldMap, model: &Model, frame: FrameId) -> Option<Placed> {
    placed_at(map, frame, model.position(frame)?, &model.covariance(frame), model.log_ratio_std())
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
    smoothed(map, measured, model.log_ratio_std())
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
