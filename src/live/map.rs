//! The map of the window: the batch mapper on its keyframes, in the frame of the maps before.
//!
//! Every update reconstructs the keyframes of the window from their tracks, starting from the poses of the last map.
//! Points that both maps have align the new one with the last (Umeyama). Nothing else is carried over, so that memory
//! and time do not grow; what is lost is that the standard deviation of lengths grows with every alignment.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::georeference::{self, Georeference, Georeferencer};
use super::line::{CameraLine, GeoPosition, LengthUnit, MapLine, State};
use super::telemetry::TelemetryFeed;
use super::window::{LIMITS, Snapshot, keyframes, known_points, resected, sub_table};
use super::{LiveError, Purpose, hovering};
use crate::camera::Camera;
use crate::features::TrackTable;
use crate::features::tracks::View;
use crate::ground::{
    BodyShape, CameraHeight, DominantPlane, GroundChain, HoveringGround, Mount, SLOPE_STD, camera_height,
    dominant_plane_points, find_mount, hovering_ground,
};
use crate::mapper::{self, HoveringCamera, Intrinsics, PosePriors, RotatingCamera};
use crate::math::{Rigid3, Sim3, median, umeyama};
use crate::metric::{Fused, Gravity, Kind, Level, Measured, ObservedPoint, Source, frame_on_ground, fuse};
use crate::pipeline::{Options, Station, camera_by_map_points, on_map_points, stated_tilts};
use crate::scene::{
    Frame, FrameId, GroundPlane, Image, MetricFrame, MetricVerdict, ObjectId, Observation, Point3d, Reconstruction,
};
use crate::trajectory::{Outlines, outline_pixels};

/// Fewest keyframes of a first map: two seconds of a camera that moves.
pub(super) const MIN_KEYS: usize = 6;
/// Fewest points of a map, and fewest that two maps must share to be aligned.
const MIN_POINTS: usize = 60;
const MIN_SHARED: usize = 20;
/// Share of the tracks that must become points: of a wrong map hardly any do.
const MIN_TRIANGULATED: f64 = 0.3;
/// Share of its keyframes that a map must register.
const MIN_REGISTERED: f64 = 0.7;
/// Views that must show a point: keyframes are far apart, and of two every match is consistent.
pub(super) const MIN_TRACK: usize = 3;
/// Views from which further points are triangulated, evenly spread: twice the keyframes. All views of a full window
/// take 0.7 s a map.
pub(super) const DENSE_VIEWS: usize = 60;
/// Error of image positions by poses of the last map, pixels.
const PRIOR_PX: f64 = 4.0;
/// Standard deviation of the focal length, as a share, below which an estimate is not trusted: windows share views,
/// so that what they add is less than their number suggests.
const LEAST_FOCAL_STD: f64 = 0.01;
/// Number of points, of those that two maps share, that count as independent: errors of neighbors are alike.
const INDEPENDENT: f64 = 20.0;
/// Time from the first map on over which the camera's height is measured, seconds. Then the meters are held: a local
/// frame whose unit changes as the camera climbs would be of no use.
const HEIGHT_S: f64 = 3.0;
/// Error of tilt and focal length that is not improved further, radians: the slope of a street is as much.
const GOOD: f64 = 0.02;
/// Standard deviation of the tilt of a hovering camera's ground up to which a flight keeps its vertical, radians: two
/// slopes of roads.
const MAX_KEPT_TILT_STD: f64 = 2.0 * SLOPE_STD;
/// Angle by which a camera has turned away from its first view, radians: as precise as an inclination is stated.
const TURNED: f64 = 0.0175;
/// Share of the error to which it must improve to begin a new frame: every change moves all positions.
const BETTER: f64 = 0.5;
/// Distance from camera to ground that a unit of a frame without meters represents; as in the stage `metric`.
const NOMINAL_HEIGHT_M: f64 = 10.0;

/// Reason why a window gives no map.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(super) enum NoMap {
    /// The camera hardly moves, and does not only rotate.
    #[error("camera hardly moves: {found} of {MIN_KEYS} keyframes; fly sideways or forward")]
    Keyframes {
        /// Keyframes so far.
        found: usize,
    },
    /// Too few keyframes fit together.
    #[error(
        "{registered} of {keyframes} keyframes registered: too little parallax or texture; fly sideways or forward"
    )]
    Registration {
        /// Keyframes with a pose.
        registered: usize,
        /// All of them.
        keyframes: usize,
    },
    /// Too few points.
    #[error("{found} points reconstructed, {needed} needed: too little parallax or texture; fly sideways or forward")]
    Points {
        /// Points so far.
        found: usize,
        /// Fewest points.
        needed: usize,
    },
    /// The camera does not translate, and nothing shows how it looks down.
    #[error(
        "camera does not translate, and its inclination is unknown; give --camera-pitch, --map-points or telemetry \
         with gimbal angles, or fly sideways or forward"
    )]
    Inclination,
    /// Points of a map do not place the camera.
    #[error("{0}")]
    MapPoints(String),
}

/// A map, and what is derived from it.
pub(super) struct WorldMap {
    pub(super) revision: u32,
    /// Keyframes and all other frames of the window that could be registered.
    pub(super) model: Reconstruction,
    /// The same without images.
    pub(super) local: Reconstruction,
    pub(super) camera: Camera,
    pub(super) focal_std: Option<f64>,
    /// True if it is in the frame of the map before.
    pub(super) is_continued: bool,
    pub(super) ground: Ground,
    /// Meters, or lengths of an arbitrary unit.
    pub(super) frame: MetricFrame,
    pub(super) is_metric: bool,
    /// Latitude and longitude, where telemetry gives them.
    pub(super) georeference: Option<Arc<Georeference>>,
    /// Time of the last frame, seconds.
    pub(super) time_s: f64,
    pub(super) purpose: Purpose,
    pub(super) line: MapLine,
}

impl WorldMap {
    /// A pose in the local frame.
    pub(super) fn camera_line(&self, frame: &Frame, cam_from_world: &Rigid3, state: State) -> CameraLine {
        let pose = self.frame.metric_from_world().transform_camera(cam_from_world);
        let q = pose.rotation.into_inner();
        CameraLine {
            t: frame.time_s,
            frame: frame.id.0,
            state,
            revision: self.revision,
            unit: if self.is_metric { LengthUnit::M } else { LengthUnit::Arbitrary },
            position: pose.center().coords.into(),
            geo: self.geo(&georeference::camera(cam_from_world.center())),
            rotation_wxyz: [q.w, q.i, q.j, q.k],
        }
    }

    /// A point of the map on the ellipsoid.
    pub(super) fn geo(&self, observed: &ObservedPoint) -> Option<GeoPosition> {
        Some(self.georeference.as_ref()?.position(observed, self.line.drift_std.powi(2)))
    }
}

/// Sources of ground planes.
#[derive(Default)]
pub(super) struct Ground {
    dominant: Option<DominantPlane>,
    mount: Option<Mount>,
    hovering: Option<HoveringGround>,
}

impl Ground {
    /// The planes below an object in the images of a model.
    pub(super) fn planes(
        &self,
        model: &Reconstruction,
        outlines: &Outlines,
        id: ObjectId,
        options: &Options,
    ) -> BTreeMap<FrameId, GroundPlane> {
        let pixels = outlines.get(&id).map(outline_pixels).unwrap_or_default();
        self.chain(model, options).planes_below(id, &pixels, &options.ground, options.seed).planes
    }

    /// All sources in order.
    pub(super) fn chain<'a>(&'a self, model: &'a Reconstruction, options: &Options) -> GroundChain<'a> {
        let contact = &options.scale.joint.contact;
        GroundChain {
            background: model,
            labelled: &[],
            dominant: self.dominant.as_ref(),
            mount: self.mount.as_ref(),
            hovering: self.hovering.as_ref(),
            shape: BodyShape { clearance: contact.lowest[0], max_deviation: contact.max_deviation },
        }
    }
}

/// A reconstruction of a window, in the frame of the maps.
struct Found {
    model: Reconstruction,
    focal_std: Option<f64>,
    is_continued: bool,
}

/// A camera that does not translate, in a frame of its own.
struct Hover {
    model: Reconstruction,
    focal_std: f64,
    ground: HoveringGround,
    on_map: Option<Arc<Georeference>>,
}

impl Hover {
    /// Standard deviation of the tilt, radians, with that of the focal length as a share: both are errors of distances.
    fn error(&self) -> f64 {
        self.ground.tilt_std.hypot(self.focal_std)
    }
}

/// Use of the sway of the camera, whose adjustment takes time.
#[derive(Clone, Copy)]
enum Sway {
    Used,
    Ignored,
}

/// State of a local frame while the camera does not translate.
struct Hovering {
    ground: HoveringGround,
    /// As of [`Hover::error`].
    error: f64,
    /// Standard deviation of the focal length as a share before it began.
    focal_std_before: f64,
    /// True if the frame began with it, and has its origin at the camera.
    is_own: bool,
}

/// State that is held from the first map of a local frame on.
#[derive(Default)]
struct Held {
    /// The vertical and origin.
    level: Option<Level>,
    /// Height of the camera above the ground in the first maps, units: the mean, and of how many.
    height: Option<(Measured, f64)>,
    /// Meters per unit where nothing gives them.
    nominal: Option<f64>,
    /// Variance of the logarithm of lengths by the alignments so far.
    drift: f64,
    /// By points of a map.
    on_map: Option<Arc<Georeference>>,
    /// The dominant plane of the last map of a camera that moved.
    plane: Option<HoveringGround>,
    /// Rotation of the first camera.
    rotation: Option<UnitQuaternion<f64>>,
}

/// Makes one map after the other.
pub(super) struct Mapper {
    options: Options,
    camera: Camera,
    known: Intrinsics,
    revision: u32,
    last: Option<Reconstruction>,
    /// Set while the camera does not translate.
    hovering: Option<Hovering>,
    held: Held,
    /// Time of the first map of this frame, seconds.
    begin_s: f64,
    /// The first frame, to which `--camera-pitch` and `--map-points` refer.
    first: Option<FrameId>,
    /// True if the camera has turned since.
    has_turned: bool,
    georeferencer: Option<Georeferencer>,
}

impl Mapper {
    /// * `telemetry` – positions of the camera.
    pub(super) fn new(
        options: &Options,
        camera: Camera,
        known: Intrinsics,
        telemetry: Option<Arc<TelemetryFeed>>,
    ) -> Self {
        Self {
            options: options.clone(),
            camera,
            known,
            revision: 0,
            last: None,
            hovering: None,
            held: Held::default(),
            begin_s: f64::NEG_INFINITY,
            first: None,
            has_turned: false,
            georeferencer: telemetry.map(Georeferencer::new),
        }
    }

    /// Makes the map of a window, or tells why its frames do not give one.
    ///
    /// # Errors
    /// [`LiveError::Mapper`], which would be a bug.
    pub(super) fn update(&mut self, snapshot: &Snapshot) -> Result<Result<WorldMap, NoMap>, LiveError> {
        let begin = Instant::now();
        self.first = self.first.or_else(|| Some(snapshot.frames.first()?.id));
        let Found { mut model, focal_std, is_continued } = match self.reconstruct(snapshot)? {
            Ok(found) => found,
            Err(why) => return Ok(Err(why)),
        };
        let camera = model.cameras.values().next().copied().unwrap_or(self.camera);
        let seed = self.options.seed;
        (self.camera, self.revision) = (camera, self.revision + 1);
        if let Some(std) = focal_std {
            self.known = Intrinsics { focal: self.known.focal.min(std.max(LEAST_FOCAL_STD)), ..self.known };
        }
        let (keyframes, points) = (model.images.len(), model.points.len());
        register_others(&mut model, snapshot, &camera);
        self.last = Some(model.clone());
        self.note_turns(&model);
        let (ground, problem) = match &self.hovering {
            Some(hovering) => (Ground { hovering: Some(hovering.ground.clone()), ..Ground::default() }, None),
            None => {
                if snapshot.purpose != Purpose::Revision {
                    model = self.with_more_points(model, snapshot, &camera)?;
                }
                let dominant = dominant_plane_points(&model, &self.options.ground, seed);
                self.held.plane = dominant.as_ref().ok().and_then(|plane| hovering::ground_of_map(plane, &model));
                let mount = find_mount(&model, None, &self.options.ground, seed).ok();
                let problem = dominant.as_ref().err().map(ToString::to_string);
                (Ground { dominant: dominant.ok(), mount, hovering: None }, problem)
            }
        };
        let time_s = snapshot.frames.last().map_or(0.0, |frame| frame.time_s);
        if !is_continued {
            self.begin_s = time_s;
        }
        let (frame, is_metric) = self.metric(&model, &ground, focal_std.unwrap_or(0.0), &snapshot.frames);
        let line = MapLine {
            t: time_s,
            revision: self.revision,
            keyframes,
            points,
            focal_px: camera.mean_focal(),
            focal_std,
            is_continued,
            is_hovering: self.hovering.is_some(),
            drift_std: self.held.drift.sqrt(),
            scale: is_metric.then_some(frame.scale),
            scale_std: is_metric.then_some(frame.std.scale),
            models: 0,
            problem,
            telemetry_problem: self.georeferencer.as_ref().and_then(Georeferencer::problem),
            seconds: 0.0,
        };
        let revision = self.revision;
        let local = Reconstruction { images: BTreeMap::new(), ..model.clone() };
        Ok(Ok(WorldMap {
            revision,
            model,
            local,
            camera,
            focal_std,
            is_continued,
            ground,
            frame,
            is_metric,
            georeference: self.georeference(),
            time_s,
            purpose: snapshot.purpose,
            line: MapLine { seconds: begin.elapsed().as_secs_f64(), ..line },
        }))
    }

    /// The map of a window in the frame of the last one, if they share enough.
    fn reconstruct(&mut self, snapshot: &Snapshot) -> Result<Result<Found, NoMap>, LiveError> {
        let table = hovering::views(snapshot);
        if self.hovering.is_some()
            && let Some(rotations) = mapper::rotating_camera(&table, &self.camera)
        {
            let lost = NoMap::Points { found: 0, needed: MIN_POINTS };
            let found = self.still_hovering(snapshot, &table, &rotations);
            return Ok(found.map_or_else(|| self.begin_hovering(snapshot, &table, lost), Ok));
        }
        match self.of_keyframes(snapshot)? {
            Ok((mut model, report)) => {
                let was = self.hovering.take();
                if was.is_some_and(|was| was.is_own && was.ground.tilt_std > MAX_KEPT_TILT_STD) {
                    self.restart();
                    self.last = None;
                }
                let is_continued = self.align(&mut model);
                let focal_std = report.focal_deviations.first().copied().flatten();
                Ok(Ok(Found { model, focal_std, is_continued }))
            }
            Err(why) if self.hovering.is_some() => Ok(Err(why)),
            Err(why) => Ok(self.begin_hovering(snapshot, &table, why)),
        }
    }

    /// The keyframes by the batch mapper, or why they give no map.
    fn of_keyframes(&self, snapshot: &Snapshot) -> Result<Result<(Reconstruction, mapper::Report), NoMap>, LiveError> {
        let keys = keyframes(snapshot);
        if keys.len() < MIN_KEYS {
            return Ok(Err(NoMap::Keyframes { found: keys.len() }));
        }
        let table = sub_table(&snapshot.table, &keys, MIN_TRACK);
        let pose = |&view: &usize| snapshot.poses.get(&snapshot.frames[view].id).copied();
        let poses: Vec<Option<Rigid3>> = keys.iter().map(pose).collect();
        let priors = self.last.as_ref().map(|_| PosePriors { poses, error_px: PRIOR_PX });
        let found = self.of_table(&table, priors.as_ref())?;
        // The last map may be wrong: its poses would spoil all that follow.
        if priors.is_some() && found.is_err() { self.of_table(&table, None) } else { Ok(found) }
    }

    fn of_table(
        &self,
        table: &TrackTable,
        priors: Option<&PosePriors>,
    ) -> Result<Result<(Reconstruction, mapper::Report), NoMap>, LiveError> {
        let options = mapper::Options { max_starts: 1, ..self.options.background.mapper.clone() };
        let (cameras, seed) = ([self.camera], self.options.seed);
        let (model, report) =
            mapper::reconstruct_watched(table, &cameras, self.known, &options, seed, priors, &mut |_| {})?;
        let (registered, keyframes, found) = (model.images.len(), table.views.len(), model.points.len());
        let needed = MIN_POINTS.max((MIN_TRIANGULATED * table.tracks.len() as f64) as usize);
        Ok(if (registered as f64) < MIN_REGISTERED * keyframes as f64 || model.cameras.is_empty() {
            Err(NoMap::Registration { registered, keyframes })
        } else if found < needed {
            Err(NoMap::Points { found, needed })
        } else {
            Ok((model, report))
        })
    }

    /// The next map of a camera that does not translate; `None` where no view has a pose in the last one.
    fn still_hovering(&mut self, snapshot: &Snapshot, table: &TrackTable, rotations: &RotatingCamera) -> Option<Found> {
        let Hovering { ground, error, .. } = self.hovering.as_ref()?;
        if snapshot.purpose != Purpose::Revision
            && *error > GOOD
            && let Ok(better) = self.hover(snapshot, table, Sway::Used)
            && better.error() < BETTER * error
        {
            return Some(self.take_up(better));
        }
        let known: Vec<Option<Rigid3>> =
            table.views.iter().map(|view| snapshot.poses.get(&view.image.frame()).copied()).collect();
        let poses = hovering::completed(&known, rotations);
        let model = hovering::on_plane(table, &self.camera, &poses, ground, self.last.as_ref());
        let is_enough = known.iter().any(Option::is_some) && model.points.len() >= MIN_POINTS;
        is_enough.then_some(Found { model, focal_std: self.focal_std(), is_continued: true })
    }

    /// The map of a camera that does not translate, on the plane of the last map or in a new frame.
    ///
    /// * `why` – reason why it is no other.
    fn begin_hovering(&mut self, snapshot: &Snapshot, table: &TrackTable, why: NoMap) -> Result<Found, NoMap> {
        let Some(rotations) = mapper::rotating_camera(table, &self.camera) else { return Err(why) };
        if let Some(ground) = self.held.plane.clone() {
            let focal_std_before = self.known.focal;
            self.hovering = Some(Hovering { ground, error: 0.0, focal_std_before, is_own: false });
            if let Some(found) = self.still_hovering(snapshot, table, &rotations) {
                return Ok(found);
            }
            self.hovering = None;
        }
        // Sources that are given serve at once.
        let found = self.hover(snapshot, table, Sway::Ignored).or_else(|_| self.hover(snapshot, table, Sway::Used))?;
        Ok(self.take_up(found))
    }

    /// The camera as one that does not translate, in a frame of its own.
    fn hover(&self, snapshot: &Snapshot, table: &TrackTable, sway: Sway) -> Result<Hover, NoMap> {
        let is_first = self.first == snapshot.frames.first().map(|frame| frame.id);
        let mut metric = self.options.metric.clone();
        if self.has_turned && !is_first {
            // They say nothing of the views of this window.
            (metric.camera_pitch, metric.map_points) = (None, None);
        }
        // The same points of the map are no new evidence.
        let before = self.hovering.as_ref().map_or(self.known.focal, |hovering| hovering.focal_std_before);
        let (camera, focal_std) = camera_by_map_points(&metric, table, &self.camera, before);
        let found = match sway {
            Sway::Used => mapper::hovering_camera(table, &camera, focal_std),
            Sway::Ignored => mapper::rotating_camera(table, &camera).map(|rotations| HoveringCamera {
                rotations,
                camera,
                focal_std,
                sway: None,
            }),
        };
        let HoveringCamera { rotations, camera, focal_std, sway } = found.ok_or(NoMap::Inclination)?;
        let poses = rotations.model(table, &camera);
        let on_map = on_map_points(&metric, &poses).map_err(|error| NoMap::MapPoints(error.to_string()))?;
        let log = self.georeferencer.as_ref();
        let station = log.and_then(|log| log.station(&poses, &snapshot.frames, &metric).ok());
        let vertical = station.as_ref().and_then(Station::vertical);
        let tilts = stated_tilts(&poses, &metric, sway.as_ref(), vertical, on_map.as_ref());
        // Where vehicles that stand point to is unknown.
        let vehicles: Vec<_> = snapshot.vehicles.iter().filter(|seen| hovering::moves(seen, &poses)).cloned().collect();
        let ground = hovering_ground(&poses, &vehicles, tilts).ok_or(NoMap::Inclination)?;
        let model = hovering::on_plane(table, &camera, &rotations.poses, &ground, None);
        let (found, needed) = (model.points.len(), MIN_POINTS);
        if found < needed {
            return Err(NoMap::Points { found, needed });
        }
        let utc_start_s = log.zip(station).and_then(|(log, station)| log.utc_start_s(&station, &metric));
        let on_map = on_map.map(|found| Arc::new(Georeference::on_map(found, utc_start_s)));
        Ok(Hover { model, focal_std, ground, on_map })
    }

    /// Notes whether the camera looks elsewhere than in the first frame.
    fn note_turns(&mut self, model: &Reconstruction) {
        let mut rotations = model.images.values().map(|image| image.cam_from_world.rotation);
        let Some(first) = self.held.rotation.or_else(|| rotations.next()) else { return };
        self.held.rotation = Some(first);
        self.has_turned |= rotations.any(|rotation| rotation.angle_to(&first) > TURNED);
    }

    /// Standard deviation of the focal length as a share; `None` where it is given.
    fn focal_std(&self) -> Option<f64> {
        (self.known.focal > 0.0).then_some(self.known.focal)
    }

    /// Begins the frame of a camera that does not translate.
    fn take_up(&mut self, found: Hover) -> Found {
        let error = found.error();
        let Hover { model, focal_std, ground, on_map } = found;
        self.restart();
        self.held.on_map = on_map;
        let focal_std_before = self.hovering.as_ref().map_or(self.known.focal, |hovering| hovering.focal_std_before);
        self.hovering = Some(Hovering { ground, error, focal_std_before, is_own: true });
        self.known.focal = focal_std;
        Found { model, focal_std: self.focal_std(), is_continued: false }
    }

    /// A map with points that keyframes alone do not show, from the poses that it has: those near the camera are seen
    /// for less than a second, and local ground planes rest on them.
    fn with_more_points(
        &self,
        model: Reconstruction,
        snapshot: &Snapshot,
        camera: &Camera,
    ) -> Result<Reconstruction, LiveError> {
        let views = &snapshot.table.views;
        let registered: Vec<usize> =
            (0..views.len()).filter(|&view| model.images.contains_key(&views[view].image)).collect();
        let stride = registered.len().div_ceil(DENSE_VIEWS).max(1);
        let chosen: Vec<usize> = registered.iter().copied().step_by(stride).collect();
        let table = sub_table(&snapshot.table, &chosen, MIN_TRACK);
        let pose = |view: &View| Some(model.images.get(&view.image)?.cam_from_world);
        let poses: Vec<Option<Rigid3>> = table.views.iter().map(pose).collect();
        let (mut found, ..) = mapper::triangulate(&table, &[*camera], &poses, &self.options.background.mapper)?;
        tracing::debug!("{} points, {} with those of more views", model.points.len(), found.points.len());
        if found.points.len() <= model.points.len() {
            return Ok(model);
        }
        let others: Vec<usize> =
            registered.into_iter().filter(|&view| !found.images.contains_key(&views[view].image)).collect();
        for (&view, points) in others.iter().zip(known_points(&snapshot.table, &found, &others)) {
            let View { image: id, pixels, .. } = &views[view];
            let observations = pixels.iter().zip(points).map(|(&pixel, point)| Observation { pixel, point }).collect();
            found.images.extend(model.images.get(id).map(|image| (*id, Image { observations, ..image.clone() })));
        }
        Ok(found)
    }

    /// Brings a map into the frame of the last one; a map that shares too little begins a new frame.
    fn align(&mut self, model: &mut Reconstruction) -> bool {
        let found = self.last.as_ref().and_then(|last| alignment(model, last));
        match found {
            Some((last_from_model, variance)) => {
                model.transform(&last_from_model);
                self.held.drift += variance;
                true
            }
            None => {
                self.restart();
                false
            }
        }
    }

    /// Begins a new local frame.
    fn restart(&mut self) {
        self.held = Held::default();
        self.georeferencer.iter_mut().for_each(Georeferencer::restart);
    }

    /// Latitude and longitude by points of a map, otherwise by telemetry.
    fn georeference(&self) -> Option<Arc<Georeference>> {
        self.held.on_map.clone().or_else(|| self.georeferencer.as_ref()?.found())
    }

    /// The metric frame, and whether its meters are known.
    fn metric(
        &mut self,
        model: &Reconstruction,
        ground: &Ground,
        focal_std: f64,
        frames: &[Frame],
    ) -> (MetricFrame, bool) {
        let time_s = frames.last().map_or(0.0, |frame| frame.time_s);
        let none = Vec::new();
        let points = ground.dominant.as_ref().map_or(&none, |dominant| &dominant.point_ids);
        let below = match &ground.hovering {
            Some(hovering) => Some(hovering.camera_height(model)),
            None => camera_height(model, points, &self.options.ground, self.options.seed).ok(),
        };
        let mount = ground.mount.as_ref().and_then(|mount| Measured::new(mount.height, mount.height_std));
        let found = mount.or_else(|| below.as_ref().and_then(|below| Measured::new(below.mean, below.std)));
        if let Some(found) = found.filter(|_| self.held.height.is_none() || time_s - self.begin_s <= HEIGHT_S) {
            let (mean, count) = self.held.height.map_or((0.0, 0.0), |(mean, count)| (mean.value, count));
            let value = (mean * count + found.value) / (count + 1.0);
            // Maps share their frames: their errors do not average out. The focal length is that of these maps.
            let mean = Measured { value, std: (found.std / found.value).hypot(focal_std) * value };
            self.held.height = Some((mean, count + 1.0));
        }
        let height = self.held.height.map(|(mean, _)| mean);
        let drift = self.held.drift;
        let surveyed = |name: &str, (log_scale, std): (f64, f64)| {
            let std = std.hypot(drift.sqrt());
            Source { name: name.to_owned(), kind: Kind::Surveyed, log_scale, std }
        };
        let metric = &self.options.metric;
        let of_scale = metric.scale.map(|scale| surveyed("given scale", scale.log()));
        let of_height = metric.camera_height.zip(height);
        let of_height = of_height.map(|(given, units)| surveyed("camera height", given.log_ratio(&units)));
        let of_map = self.held.on_map.as_ref().map(|map| map.of_map_points());
        let of_map = of_map.map(|source| Source { std: source.std.hypot(drift.sqrt()), ..source });
        let mut sources: Vec<Source> = of_scale.into_iter().chain(of_height).chain(of_map).collect();
        if let Some(georeferencer) = &mut self.georeferencer {
            let options = metric;
            let gravity = below.as_ref().map(|below| Gravity { up_in_world: below.up_in_world, std: tilt_std(below) });
            // Only a frame that began with the hovering camera has its origin there.
            let hovering = self.hovering.as_ref().filter(|hovering| hovering.is_own).and(height);
            let update = georeference::Update { model, frames, gravity, drift, sources: &sources, options, hovering };
            georeferencer.update(&update);
            sources.extend(georeferencer.scale(drift));
        }
        let level = *self.held.level.get_or_insert_with(|| level(model, below.as_ref()));
        let known = fuse(&sources);
        let is_metric = known.is_some();
        let nominal = *self.held.nominal.get_or_insert(height.map_or(1.0, |height| NOMINAL_HEIGHT_M / height.value));
        let verdict = MetricVerdict::Unknown;
        let unit = || Fused { scale: nominal, std: 0.0, verdict, shares: Vec::new(), contradictions: Vec::new() };
        let fused = known.unwrap_or_else(unit);
        (frame_on_ground(&fused, &level), is_metric)
    }
}

/// Standard deviation of the normal of the ground as the vertical, radians; as in the stage `metric`.
fn tilt_std(below: &CameraHeight) -> f64 {
    SLOPE_STD.hypot(0.5 * below.tilt_spread)
}

/// The vertical and the origin; as in the stage `metric`.
fn level(model: &Reconstruction, below: Option<&CameraHeight>) -> Level {
    /// Standard deviation of a camera's tilt where no ground is visible, radians.
    const CAMERA_TILT_STD: f64 = 0.5;
    let poses = || model.images.values().map(|image| image.cam_from_world);
    let of_cameras = || poses().map(|pose| pose.rotation.inverse() * -Vector3::y()).sum::<Vector3<f64>>();
    let (up, tilt_std) =
        below.map_or_else(|| (of_cameras(), CAMERA_TILT_STD), |below| (below.up_in_world, tilt_std(below)));
    let up_in_world = up.try_normalize(f64::EPSILON).unwrap_or_else(|| -Vector3::y());
    let first = poses().next().unwrap_or_else(Rigid3::identity);
    let (forward, upper) = (first.rotation.inverse() * Vector3::z(), first.rotation.inverse() * -Vector3::y());
    // Straight down the upper edge of the image points ahead.
    let ahead_in_world = if forward.angle(&-up_in_world) < 0.3 { upper } else { forward };
    let origin_in_world = below.map_or_else(|| first.center(), |below| below.foot_in_world);
    Level { up_in_world, tilt_std, ahead_in_world, origin_in_world }
}

/// The similarity between two maps by the points that they share, and the variance of its logarithmic scale.
fn alignment(model: &Reconstruction, last: &Reconstruction) -> Option<(Sim3, f64)> {
    let shared = |point: &Point3d| {
        let before = point.track.iter().find_map(|element| {
            last.images.get(&element.image)?.observations.get(element.observation_idx as usize)?.point
        })?;
        Some((point.position, last.points.get(&before)?.position))
    };
    let mut pairs: Vec<(Point3<f64>, Point3<f64>)> = model.points.values().filter_map(shared).collect();
    let mut found = None;
    // Points far away have large errors: those within three times the median residual decide.
    for _ in 0..4 {
        if pairs.len() < MIN_SHARED {
            return None;
        }
        let (from, to): (Vec<_>, Vec<_>) = pairs.iter().copied().unzip();
        let similarity = umeyama(&from, &to)?;
        let residual = |(from, to): &(Point3<f64>, Point3<f64>)| (similarity * *from - to).norm();
        let typical = median(pairs.iter().map(residual).collect())?;
        let center = Point3::from(to.iter().map(|p| p.coords).sum::<Vector3<f64>>() / to.len() as f64);
        let spread = median(to.iter().map(|p| (p - center).norm()).collect())?;
        let count = (pairs.len() as f64).min(INDEPENDENT);
        found = Some((similarity, (typical / spread).powi(2) / count));
        pairs.retain(|pair| residual(pair) <= 3.0 * typical);
    }
    found.filter(|(similarity, variance)| similarity.scale.is_finite() && variance.is_finite())
}

/// Adds the frames of the window that are no keyframes.
fn register_others(model: &mut Reconstruction, snapshot: &Snapshot, camera: &Camera) {
    let is_open = |view: &usize| !model.images.contains_key(&snapshot.table.views[*view].image);
    let views: Vec<usize> = (0..snapshot.frames.len()).filter(is_open).collect();
    let points = known_points(&snapshot.table, model, &views);
    for (&view, points) in views.iter().zip(points) {
        let seen = &snapshot.table.views[view];
        let before = model.images.range(..seen.image).next_back().map(|(_, image)| image.cam_from_world);
        if let Some(image) = resected(&seen.pixels, &seen.name, points, model, camera, before, &LIMITS) {
            model.images.insert(seen.image, image);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::tracks::{Feature, TrackTable, View};
    use crate::scene::{Image, ImageId, TrackElement};
    use crate::synthetic::scene::{self, CameraMotion, static_scene};
    use crate::telemetry::{Geodetic, LocalFrame};
    use nalgebra::Point2;

    /// Window of a scene: its images and tracks.
    fn snapshot(scene: &Reconstruction, views: std::ops::Range<u32>) -> Snapshot {
        let images: Vec<_> = views.map(|k| (ImageId(k + 1), &scene.images[&ImageId(k + 1)])).collect();
        let mut table = TrackTable::default();
        for (id, image) in &images {
            let pixels: Vec<_> = image.observations.iter().map(|seen| seen.pixel).collect();
            let (rgb, whitening) = (vec![[0; 3]; pixels.len()], Vec::new());
            table.views.push(View { image: *id, name: image.name.clone(), camera: 0, pixels, rgb, whitening });
        }
        for point in scene.points.values() {
            let place = |image: ImageId| images.iter().position(|(id, _)| *id == image);
            let feature = |e: &TrackElement| Some(Feature { view: place(e.image)? as u32, feature: e.observation_idx });
            table.tracks.push(point.track.iter().filter_map(feature).collect());
        }
        let frame = |(id, image): &(ImageId, &Image)| Frame {
            id: id.frame(),
            name: image.name.clone(),
            time_s: 0.1 * f64::from(id.0),
        };
        let frames: Vec<Frame> = images.iter().map(frame).collect();
        // Every third is a keyframe, in all windows.
        let is_key = frames.iter().map(|frame| frame.id.0 % 3 == 0).collect();
        Snapshot { table, frames, is_key, poses: BTreeMap::new(), vehicles: Vec::new(), purpose: Purpose::Final }
    }

    fn flight() -> scene::Options {
        let path = CameraMotion::Flight;
        scene::Options { num_images: 60, num_points: 4000, path, noise_px: 0.1, ..scene::Options::default() }
    }

    #[test]
    fn maps_continue_in_the_frame_of_the_first() {
        let options = flight();
        let scene = static_scene(&options);
        let mut mapper = Mapper::new(&Options::default(), options.camera, Intrinsics::FIXED, None);
        let mut maps: Vec<WorldMap> = Vec::new();
        for begin in [0, 10, 20] {
            let mut snapshot = snapshot(&scene, begin..begin + 40);
            let images = maps.iter().flat_map(|map| &map.model.images);
            snapshot.poses = images.map(|(id, image)| (id.frame(), image.cam_from_world)).collect();
            maps.push(mapper.update(&snapshot).unwrap().expect("a map"));
        }
        assert_eq!(maps.iter().map(|map| map.is_continued).collect::<Vec<_>>(), [false, true, true]);
        assert!(maps.iter().all(|map| map.model.images.len() == 40), "the others are registered");
        // From the true frame to that of the first map, by its cameras; the last ones were not among them.
        let center = |model: &Reconstruction, k: u32| model.images[&ImageId(k + 1)].cam_from_world.center();
        let (from, to): (Vec<_>, Vec<_>) = scene
            .points
            .values()
            .filter_map(|point| {
                let e = point.track.first()?;
                let seen = maps[0].model.images.get(&e.image)?.observations[e.observation_idx as usize].point?;
                Some((point.position, maps[0].model.points[&seen].position))
            })
            .unzip();
        let first_from_true = umeyama(&from, &to).unwrap();
        let error = (center(&maps[2].model, 59) - first_from_true * center(&scene, 59)).norm();
        let length = first_from_true.scale * (center(&scene, 59) - center(&scene, 0)).norm();
        assert!(error < 0.02 * length, "{error} of {length}");
        assert!(maps[2].line.drift_std > 0.0 && maps[0].line.drift_std == 0.0);
        let far = mapper.update(&snapshot(&static_scene(&scene::Options { seed: 5, ..options }), 0..3)).unwrap();
        assert!(far.is_err(), "three views are no map");
    }

    /// A window of the views of a camera over a plane, with the poses of earlier maps.
    fn window(table: &TrackTable, views: std::ops::Range<usize>, maps: &[&WorldMap]) -> Snapshot {
        let count = views.len();
        let mut table = sub_table(table, &views.collect::<Vec<_>>(), 1);
        table.views.iter_mut().for_each(|view| view.rgb = vec![[0; 3]; view.pixels.len()]);
        let frame = |view: &View| {
            let id = view.image.frame();
            Frame { id, name: view.name.clone(), time_s: 0.1 * f64::from(id.0) }
        };
        let frames: Vec<Frame> = table.views.iter().map(frame).collect();
        let is_key = (0..count).map(|view| view % 3 == 0).collect();
        let images = maps.iter().flat_map(|map| &map.model.images);
        let poses = images.map(|(id, image)| (id.frame(), image.cam_from_world)).collect();
        Snapshot { table, frames, is_key, poses, vehicles: Vec::new(), purpose: Purpose::Revision }
    }

    /// A camera 40 m above a plane looks down by 90° minus 0.5.
    const HEIGHT_M: f64 = 40.0;

    fn mapper_of(camera: Camera, pitch_std: Option<f64>) -> Mapper {
        let pitch = std::f64::consts::FRAC_PI_2 - 0.5;
        let mut options = Options::default();
        options.metric.camera_pitch = pitch_std.and_then(|std| Measured::new(pitch.to_degrees(), std));
        Mapper::new(&options, camera, Intrinsics::FIXED, None)
    }

    fn centers_m(map: &WorldMap) -> Vec<Vector3<f64>> {
        map.model.images.values().map(|image| image.cam_from_world.center().coords * HEIGHT_M).collect()
    }

    #[test]
    fn the_ground_is_the_map_of_a_camera_that_hovers() {
        let sway = |phase: f64| Vector3::new(phase.sin(), 0.0, 0.5 * phase.sin()) * 0.1;
        let (table, camera, rotations) = crate::mapper::views_along(sway);
        let mut mapper = mapper_of(camera, Some(0.5));
        let first = mapper.update(&window(&table, 0..30, &[])).unwrap().expect("a map");
        let second = mapper.update(&window(&table, 0..60, &[&first])).unwrap().expect("a map");
        assert!(first.line.is_hovering && second.line.is_hovering);
        assert_eq!((first.is_continued, second.is_continued), (false, true));
        assert_eq!((first.model.images.len(), second.model.images.len()), (30, 60));
        // Axes are those of the first camera.
        let centers = centers_m(&second);
        let off_m = |(view, center): (usize, &Vector3<f64>)| {
            let truth = rotations[0] * (sway(view as f64 / 10.0) - sway(0.0));
            (center - centers[0] - truth).norm()
        };
        let mean_m = centers.iter().enumerate().map(off_m).sum::<f64>() / 60.0;
        assert!(mean_m < 0.04, "{mean_m}");
        let up = rotations[0] * -Vector3::z();
        assert!(second.frame.metric_from_world().rotation.inverse().transform_vector(&Vector3::z()).angle(&up) < 0.01);
        // No view of the window has a pose.
        let new = mapper.update(&window(&table, 40..60, &[])).unwrap().expect("a map");
        assert!(new.line.is_hovering && !new.is_continued && new.model.images.len() == 20);
        let at_rest = crate::mapper::views_along(|_| Vector3::zeros()).0;
        let lost = mapper_of(camera, None).update(&window(&at_rest, 0..30, &[]));
        assert_eq!(lost.unwrap().err(), Some(NoMap::Inclination));
    }

    /// A camera that hovers for three seconds, then flies, to the side of its view.
    fn departure(phase: f64) -> Vector3<f64> {
        Vector3::new(0.0, -8.0 * (phase - 3.0).max(0.0), 0.0)
    }

    /// The last map of a camera that departs.
    fn departed(mapper: &mut Mapper, table: &TrackTable) -> WorldMap {
        let mut last = mapper.update(&window(table, 0..30, &[])).unwrap().expect("a map");
        assert!(last.line.is_hovering);
        for until in [36, 42, 48, 54, 60] {
            if let Ok(map) = mapper.update(&window(table, 0..until, &[&last])).unwrap() {
                assert!(map.is_continued, "{until}");
                last = map;
            }
        }
        assert!(!last.line.is_hovering);
        last
    }

    #[test]
    fn a_camera_that_departs_stays_in_its_local_frame() {
        let (table, camera, rotations) = crate::mapper::views_along(departure);
        let last = departed(&mut mapper_of(camera, Some(0.5)), &table);
        let (_, image) = last.model.images.last_key_value().unwrap();
        let (found, truth) = (image.cam_from_world.center().coords * HEIGHT_M, rotations[0] * departure(5.9));
        assert!((found - truth).norm() < 0.03 * truth.norm(), "{found} {truth}");
    }

    #[test]
    fn points_of_a_map_hold_when_the_camera_departs() {
        let (table, camera, rotations) = crate::mapper::views_along(departure);
        let map = LocalFrame::at(Geodetic { longitude_deg: 9.0, latitude_deg: 48.0, height_m: 0.0 });
        let picked = [[200.0, 200.0], [1100.0, 180.0], [1000.0, 600.0], [250.0, 650.0], [600.0, 400.0]];
        let features = picked.map(|[x, y]| {
            let ray = rotations[0].inverse() * camera.ray_from_pixel(Point2::new(x, y));
            // Axes of the scene point right, back and down.
            let place = map.to_geodetic(Point3::new(ray.x, -ray.y, 0.0) * (HEIGHT_M / ray.z));
            serde_json::json!({
                "type": "Feature",
                "geometry": { "type": "Point", "coordinates": [place.longitude_deg, place.latitude_deg] },
                "properties": { "x": x, "y": y },
            })
        });
        let file = tempfile::NamedTempFile::new().unwrap();
        let content = serde_json::json!({ "type": "FeatureCollection", "features": features });
        std::fs::write(file.path(), content.to_string()).unwrap();
        let mut mapper = mapper_of(camera, None);
        mapper.options.metric.map_points = Some(file.path().to_owned());
        let last = departed(&mut mapper, &table);
        assert!(last.is_metric && (last.frame.scale / HEIGHT_M).ln().abs() < 0.05, "{}", last.frame.scale);
        let center = last.model.images.last_key_value().unwrap().1.cam_from_world.center();
        let geo = last.geo(&georeference::camera(center)).expect("a position on the map");
        let (longitude_deg, latitude_deg) = (geo.longitude, geo.latitude);
        let found = map.from_geodetic(Geodetic { longitude_deg, latitude_deg, height_m: 0.0 });
        let (truth, off_m) = (departure(5.9), 3.0 * geo.horizontal_std);
        assert!((found.x - truth.x).hypot(found.y + truth.y) < off_m && off_m < 5.0, "{found} {truth} {off_m}");
    }

    #[test]
    fn a_camera_that_stops_stays_in_its_local_frame() {
        let path = |phase: f64| Vector3::new(0.0, 8.0 * (3.0 - phase).max(0.0), 0.0);
        let (table, camera, rotations) = crate::mapper::views_along(path);
        let mut mapper = mapper_of(camera, None);
        let first = mapper.update(&window(&table, 0..40, &[])).unwrap().expect("a map");
        assert!(!first.line.is_hovering);
        let second = mapper.update(&window(&table, 31..60, &[&first])).unwrap().expect("a map");
        assert!(second.line.is_hovering && second.is_continued && second.model.images.len() == 29);
        let up = rotations[0] * -Vector3::z();
        let found = second.frame.metric_from_world().rotation.inverse().transform_vector(&Vector3::z());
        assert!(found.angle(&up) < 0.02, "{}", found.angle(&up));
    }
}
