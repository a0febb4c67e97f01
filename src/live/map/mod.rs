//! The map of the window: the batch mapper on its keyframes, in the frame of the maps before.
//!
//! Every update reconstructs the keyframes of the window from their tracks, starting from the poses of the last map.
//! Common points align the new map with the last (Umeyama). Nothing else is kept, so that memory and time do not grow;
//! the cost is that the standard deviation of lengths grows with every alignment.

mod alignment;
mod hovering;
mod metric;
mod on_plane;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

use nalgebra::UnitQuaternion;

use super::Purpose;
use super::georeference::{self, Georeference, Georeferencer};
use super::line::{CameraLine, GeoPosition, LengthUnit, MapLine, State};
use super::telemetry::TelemetryFeed;
use super::window::{LIMITS, Snapshot, evenly, keyframes, known_points, register, sub_table};
use crate::camera::{Camera, SLOPE_STD};
use crate::features::TrackTable;
use crate::features::tracks::View;
use crate::ground::{BodyShape, DominantPlane, GroundChain, HoveringGround, Mount, dominant_plane_points, find_mount};
use crate::mapper::{self, Intrinsics, PosePriors};
use crate::math::Rigid3;
use crate::metric::{Level, Measured, ObservedPoint};
use crate::pipeline::{Options, PipelineError};
use crate::scene::{Frame, FrameId, GroundPlane, Image, MetricFrame, ObjectId, Observation, Reconstruction};
use crate::trajectory::{Outlines, outline_pixels};
use hovering::Hovering;

/// Minimum number of keyframes of a first map: two seconds of a camera that moves.
pub(super) const MIN_KEYFRAMES: usize = 6;
/// Fewest points of a map.
const MIN_POINTS: usize = 60;
/// Minimum share of triangulated tracks: in a wrong map hardly any are.
const MIN_TRIANGULATED: f64 = 0.3;
/// Minimum share of registered keyframes of a map.
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
/// Standard deviation of the tilt of a hovering camera's ground up to which a flight keeps its vertical, radians: two
/// slopes of roads.
const MAX_KEPT_TILT_STD: f64 = 2.0 * SLOPE_STD;

/// Reason why a window gives no map.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub(super) enum NoMap {
    /// The camera hardly moves, and does not only rotate.
    #[error("camera hardly moves: {found} of {MIN_KEYFRAMES} keyframes; fly sideways or forward")]
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
    /// The camera does not translate, and its inclination is undetermined.
    #[error(
        "camera does not translate, and its inclination is unknown; give --camera-pitch, --map-points or telemetry \
         with gimbal angles, or fly sideways or forward"
    )]
    Inclination,
    /// Points of a map do not determine the camera's pose.
    #[error("{0}")]
    MapPoints(String),
}

/// A map, and data derived from it.
pub(super) struct WorldMap {
    pub(super) revision: u32,
    /// Keyframes and all other frames of the window that could be registered.
    pub(super) model: Reconstruction,
    /// The same without images.
    pub(super) local: Reconstruction,
    pub(super) camera: Camera,
    /// Standard deviation of the focal length as a share of it; `None` where positions do not depend on it.
    pub(super) focal_std: Option<f64>,
    /// True if it is in the frame of the map before.
    pub(super) is_continued: bool,
    pub(super) ground: Ground,
    /// Meters, or lengths of an arbitrary unit.
    pub(super) frame: MetricFrame,
    pub(super) is_metric: bool,
    /// Latitude and longitude, if known.
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

    /// Returns true for a camera that does not translate: vehicles are tracked on the ground, without a model.
    pub(super) fn hovers(&self) -> bool {
        self.ground.hovering.is_some()
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
    fn is_mapped(&self) -> bool {
        self.hovering.as_ref().is_some_and(HoveringGround::is_mapped)
    }

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
            labeled: &[],
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

/// State fixed from the first map of a local frame on.
#[derive(Default)]
struct Held {
    /// The vertical and origin.
    level: Option<Level>,
    /// Height of the camera above the ground in the first maps, units: the mean, and the number of maps.
    height: Option<(Measured, f64)>,
    /// Nominal meters per unit, without a source of scale.
    nominal: Option<f64>,
    /// Variance of the logarithm of lengths by the alignments so far.
    drift: f64,
    /// Georeference by points of a map.
    on_map: Option<Arc<Georeference>>,
    /// The dominant plane of the last map of a camera that moved.
    plane: Option<HoveringGround>,
    /// Rotation of the first camera.
    rotation: Option<UnitQuaternion<f64>>,
}

/// Mapper of consecutive windows.
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

    /// Makes the map of a window, or returns the reason why its frames do not give one.
    ///
    /// # Errors
    /// [`PipelineError::Mapper`], which would be a bug.
    pub(super) fn update(&mut self, snapshot: &Snapshot) -> Result<Result<WorldMap, NoMap>, PipelineError> {
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
        register(&mut model, &snapshot.table, 0..snapshot.frames.len(), &camera, &LIMITS);
        self.last = Some(model.clone());
        self.note_turns(&model);
        let (ground, problem) = match &self.hovering {
            Some(hovering) => (Ground { hovering: Some(hovering.ground.clone()), ..Ground::default() }, None),
            None => {
                if snapshot.purpose != Purpose::Revision {
                    model = self.with_more_points(model, snapshot, &camera)?;
                }
                let dominant = dominant_plane_points(&model, &self.options.ground, seed);
                self.held.plane = dominant.as_ref().ok().and_then(|plane| on_plane::ground_of_map(plane, &model));
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
            focal_std: focal_std.filter(|_| !ground.is_mapped()),
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
    fn reconstruct(&mut self, snapshot: &Snapshot) -> Result<Result<Found, NoMap>, PipelineError> {
        let table = on_plane::views(snapshot);
        let rotations = || mapper::rotating_camera(&table, &self.camera);
        if self.hovering.is_some()
            && let Some(rotations) = rotations()
        {
            let found = self.still_hovering(snapshot, &table, &rotations);
            return Ok(found.map_or_else(|| self.begin_hovering(snapshot, &table, &rotations), Ok));
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
            Err(why) => match rotations() {
                Some(rotations) => Ok(self.begin_hovering(snapshot, &table, &rotations)),
                None => Ok(Err(why)),
            },
        }
    }

    /// Reconstructs the keyframes by the batch mapper, or returns the reason why they give no map.
    fn of_keyframes(
        &self,
        snapshot: &Snapshot,
    ) -> Result<Result<(Reconstruction, mapper::Report), NoMap>, PipelineError> {
        let keys = keyframes(snapshot);
        if keys.len() < MIN_KEYFRAMES {
            return Ok(Err(NoMap::Keyframes { found: keys.len() }));
        }
        let table = sub_table(&snapshot.table, &keys, MIN_TRACK);
        let pose = |&view: &usize| snapshot.poses.get(&snapshot.frames[view].id).copied();
        let poses: Vec<Option<Rigid3>> = keys.iter().map(pose).collect();
        let priors = self.last.as_ref().map(|_| PosePriors { poses, error_px: PRIOR_PX });
        let found = self.of_table(&table, priors.as_ref())?;
        // The last map may be wrong: its poses would corrupt all following maps.
        if priors.is_some() && found.is_err() { self.of_table(&table, None) } else { Ok(found) }
    }

    fn of_table(
        &self,
        table: &TrackTable,
        priors: Option<&PosePriors>,
    ) -> Result<Result<(Reconstruction, mapper::Report), NoMap>, PipelineError> {
        let options = mapper::Options { max_starts: 1, ..self.options.background.mapper.clone() };
        let (cameras, seed) = ([self.camera], self.options.seed);
        let (keyframes, num_tracks) = (table.views.len(), table.tracks.len());
        let (model, report) =
            mapper::reconstruct_watched(table.clone(), &cameras, self.known, &options, seed, priors, &mut |_| {})?;
        let (registered, found) = (model.images.len(), model.points.len());
        let needed = MIN_POINTS.max((MIN_TRIANGULATED * num_tracks as f64) as usize);
        Ok(if (registered as f64) < MIN_REGISTERED * keyframes as f64 || model.cameras.is_empty() {
            Err(NoMap::Registration { registered, keyframes })
        } else if found < needed {
            Err(NoMap::Points { found, needed })
        } else {
            Ok((model, report))
        })
    }

    /// Standard deviation of the focal length as a share; `None` where it is given.
    fn focal_std(&self) -> Option<f64> {
        (self.known.focal > 0.0).then_some(self.known.focal)
    }

    /// Triangulates points that keyframes alone do not determine, from the map's poses: those near the camera are
    /// observed for less than a second, and local ground planes depend on them.
    fn with_more_points(
        &self,
        model: Reconstruction,
        snapshot: &Snapshot,
        camera: &Camera,
    ) -> Result<Reconstruction, PipelineError> {
        let views = &snapshot.table.views;
        let registered: Vec<usize> =
            (0..views.len()).filter(|&view| model.images.contains_key(&views[view].image)).collect();
        let chosen: Vec<usize> = evenly(&registered, DENSE_VIEWS).collect();
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

    /// Begins a new local frame.
    fn restart(&mut self) {
        self.held = Held::default();
        self.georeferencer.iter_mut().for_each(Georeferencer::restart);
    }

    /// Latitude and longitude by points of a map, otherwise by telemetry.
    fn georeference(&self) -> Option<Arc<Georeference>> {
        self.held.on_map.clone().or_else(|| self.georeferencer.as_ref()?.found())
    }
}
