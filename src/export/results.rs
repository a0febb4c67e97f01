//! Content of an output folder, for exports.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use nalgebra::{Matrix3, Point3, SMatrix, Vector3};
use serde::Deserialize;

use super::{Clock, ExportError, Units};
use crate::camera::Camera;
use crate::io::{IoError, RunFolder, json};
use crate::math::{Rigid3, Sim3, median};
use crate::scene::{
    Frame, FrameId, Ground, ImageId, MapOrigin, MapPlace, MetricAxes, MetricFrame, Motion, ObjectTrajectory, Position,
    Reconstruction, TimeBase, Trajectories, Trust, Unit,
};
use crate::telemetry::LocalFrame;

/// Nominal rate of an input without times, images per second.
pub(super) const FRAMES_PER_S: f64 = 25.0;

/// Smoothed motion of a vehicle by time, where it is known.
pub(super) fn motions(object: &ObjectTrajectory) -> impl Iterator<Item = (f64, Motion)> {
    object.poses.iter().filter_map(|pose| Some((pose.time_s, pose.metric.as_ref()?.motion?)))
}

/// A georeferenced position.
pub(super) struct Fix<'a> {
    pub(super) at: Position<'a>,
    pub(super) place: MapPlace,
}

/// A registered frame.
#[derive(Clone, Debug, PartialEq)]
pub struct RegisteredFrame {
    /// The frame.
    pub frame: Frame,
    /// Its image in the background's model.
    pub image: ImageId,
    /// Its intrinsics.
    pub camera: Camera,
    /// Transform from world (the background's frame) to camera.
    pub cam_from_world: Rigid3,
}

impl<'a> From<&'a RegisteredFrame> for Position<'a> {
    fn from(view: &'a RegisteredFrame) -> Self {
        let Frame { id, ref name, time_s } = view.frame;
        Self { frame: id, name, time_s, in_world: view.cam_from_world.center(), metric: None }
    }
}

/// Content of an output folder.
#[derive(Clone, Debug)]
pub struct Results {
    /// File or folder name of the input.
    pub title: String,
    /// File path of the input.
    pub input: PathBuf,
    /// Width and height of the frames, pixels.
    pub size: (u32, u32),
    /// Unit of the frames' times.
    pub time_base: TimeBase,
    /// The frames with a known camera, ascending.
    pub views: Vec<RegisteredFrame>,
    /// The trajectories of the vehicles.
    pub trajectories: Trajectories,
    /// The background.
    pub background: Reconstruction,
    /// Ground points and planes; `None` where none were estimated.
    pub ground: Option<Ground>,
    /// False for a folder of `tractrix sfm`, or of a run that did not reach the trajectories.
    pub has_trajectories: bool,
    /// Units of tables.
    pub units: Units,
}

/// Parts of `run.json` that exports use.
#[derive(Deserialize)]
struct RunJson {
    input: InputJson,
}

#[derive(Deserialize)]
struct InputJson {
    path: PathBuf,
    info: InfoJson,
    times: TimeBase,
}

#[derive(Deserialize)]
struct InfoJson {
    width: u32,
    height: u32,
    fps: Option<f64>,
}

impl Results {
    /// Removes trajectories with a verdict below `lowest`, those without one, and ground tracks.
    pub fn keep_trusted(&mut self, lowest: Trust) {
        let is_trusted = |object: &ObjectTrajectory| object.verdict.as_ref().is_some_and(|found| found.state <= lowest);
        self.trajectories.objects.retain(is_trusted);
        self.trajectories.ground_tracks.clear();
    }

    /// Reads an output folder.
    ///
    /// * `frames` – the frames of the run with their times, where they are known; else the times are those of the
    ///   trajectories, and other frames have times by the nominal rate.
    ///
    /// # Errors
    /// A folder without a background, or with a damaged file.
    pub fn read(folder: &RunFolder, frames: Option<&[Frame]>) -> Result<Self, ExportError> {
        let no_result = || ExportError::NoResult { path: folder.root().to_owned() };
        let trajectories = there(folder.read_trajectories())?;
        let RunJson { input } = json::read(&folder.run_json()).map_err(|error| absent_or(error, no_result))?;
        let background = folder.read_background().map_err(|error| absent_or(error, no_result))?;
        let has_trajectories = trajectories.is_some();
        let trajectories = trajectories.unwrap_or_else(Trajectories::empty);
        let times = Times::new(frames, &trajectories, &input);
        Ok(Self {
            views: views(&background, &times),
            ground: there(folder.read_ground())?,
            background,
            has_trajectories,
            ..Self::of_trajectories(input, trajectories)
        })
    }

    /// Reads an output folder without its models, cameras and ground.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub(super) fn read_trajectories(folder: &RunFolder) -> Result<Self, ExportError> {
        let no_result = || ExportError::NoResult { path: folder.root().to_owned() };
        let trajectories = folder.read_trajectories().map_err(|error| absent_or(error, no_result))?;
        let RunJson { input } = json::read(&folder.run_json()).map_err(|error| absent_or(error, no_result))?;
        Ok(Self::of_trajectories(input, trajectories))
    }

    fn of_trajectories(input: InputJson, trajectories: Trajectories) -> Self {
        Self {
            title: name_of(&input.path),
            size: (input.info.width, input.info.height),
            time_base: input.times,
            views: Vec::new(),
            trajectories,
            background: Reconstruction::default(),
            ground: None,
            has_trajectories: true,
            units: Units::default(),
            input: input.path,
        }
    }

    /// The clock for the times of other programs.
    pub fn clock(&self) -> Clock {
        Clock::of(self.trajectories.metric.as_ref(), self.time_base)
    }

    /// Metric frame; `None` if unknown.
    pub fn metric_frame(&self) -> Option<&MetricFrame> {
        self.trajectories.metric.as_ref()?.frame.as_ref()
    }

    /// Transform from the background's frame to that of the exports: meters, z up, where they are known, else the
    /// background's own.
    pub fn export_from_world(&self) -> Sim3 {
        self.metric_frame().map_or_else(Sim3::identity, MetricFrame::metric_from_world)
    }

    /// The unit of the exports' lengths, in words.
    pub fn unit(&self) -> &'static str {
        match (self.metric_frame(), self.trajectories.unit) {
            (Some(_), _) | (_, Unit::Metre) => "metres",
            (None, Unit::Background) => "units of the background model",
        }
    }

    /// Axes of the exports, in words.
    pub fn axes(&self) -> &'static str {
        match self.metric_frame().map(|frame| frame.axes) {
            Some(MetricAxes::EastNorthUp) => "x east, y north, z up",
            Some(MetricAxes::Up) => "z up, x and y arbitrary",
            None => "those of the background model",
        }
    }

    /// The metric frame and its origin on the map; `None` where the map is not known.
    pub fn map(&self) -> Option<(&MetricFrame, MapOrigin)> {
        let frame = self.metric_frame().filter(|frame| frame.axes == MetricAxes::EastNorthUp)?;
        Some((frame, frame.origin?))
    }

    /// Returns true if heights on the map are absolute.
    pub fn knows_height(&self) -> bool {
        self.map().is_some_and(|(_, origin)| origin.knows_height)
    }

    /// Reason why there is no georeference, for users.
    pub fn why_no_map(&self) -> String {
        let metric = self.trajectories.metric.as_ref();
        let reason = metric.filter(|metric| metric.frame.is_none()).and_then(|metric| metric.reason.clone());
        reason.unwrap_or_else(|| match metric {
            Some(metric) if metric.frame.is_some() => "the georeference of the metric frame is unknown".to_owned(),
            _ => "the scale in meters is unknown".to_owned(),
        })
    }

    /// Georeferenced position of a point of the background; `None` where the map is unknown.
    pub fn place(&self, point_in_world: Point3<f64>) -> Option<MapPlace> {
        let (frame, origin) = self.map()?;
        let found = LocalFrame { origin }.to_geodetic(frame.metric_from_world() * point_in_world);
        let numbers = [found.longitude_deg, found.latitude_deg, found.height_m];
        numbers.iter().all(|number| number.is_finite()).then(|| MapPlace {
            longitude: found.longitude_deg,
            latitude: found.latitude_deg,
            height_m: found.height_m,
            place_std_m: place_std_m(frame, point_in_world),
        })
    }

    /// A time of the input in seconds; inputs without times use [`FRAMES_PER_S`].
    pub(super) fn seconds(&self, time_s: f64) -> f64 {
        match self.time_base {
            TimeBase::Seconds => time_s,
            TimeBase::Frames => time_s / FRAMES_PER_S,
        }
    }

    /// Median time between two registered frames, seconds.
    pub(super) fn median_step(&self) -> Option<f64> {
        median(self.views.windows(2).map(|pair| pair[1].frame.time_s - pair[0].frame.time_s).collect())
    }

    /// Georeferenced positions of a vehicle or the camera.
    pub(super) fn fixes<'a, T>(&self, positions: &'a [T]) -> Vec<Fix<'a>>
    where
        Position<'a>: From<&'a T>,
    {
        let fix = |at: Position<'a>| Some(Fix { place: self.place_of(at)?, at });
        positions.iter().map(Position::from).filter_map(fix).collect()
    }

    /// Georeferenced position in one frame: that of the results, else computed from the position.
    pub fn place_of<'a>(&self, at: impl Into<Position<'a>>) -> Option<MapPlace> {
        let Position { metric, in_world, .. } = at.into();
        metric.and_then(|metric| metric.place).or_else(|| self.place(in_world))
    }
}

/// Standard deviations of a background point's position along the metric axes, meters: the similarity's covariance C
/// propagated to the point, J C Jᵀ with J = [d, −[d]×, I] and d the vector from the anchor.
fn place_std_m(frame: &MetricFrame, point_in_world: Point3<f64>) -> [f64; 3] {
    let metric_from_world = frame.metric_from_world();
    let d = metric_from_world * point_in_world - metric_from_world * Point3::from(frame.anchor);
    let mut jacobian = SMatrix::<f64, 3, 7>::zeros();
    jacobian.set_column(0, &d);
    jacobian.fixed_view_mut::<3, 3>(0, 1).copy_from(&-d.cross_matrix());
    jacobian.fixed_view_mut::<3, 3>(0, 4).copy_from(&Matrix3::identity());
    let covariance = SMatrix::<f64, 7, 7>::from_fn(|row, column| frame.covariance[row][column]);
    let variances: Vector3<f64> = (jacobian * covariance * jacobian.transpose()).diagonal();
    variances.map(|variance| variance.max(0.0).sqrt()).into()
}

/// The times of frames by image name.
struct Times<'a> {
    known: HashMap<&'a str, (FrameId, f64)>,
    fps: Option<f64>,
}

impl<'a> Times<'a> {
    fn new(frames: Option<&'a [Frame]>, trajectories: &'a Trajectories, input: &InputJson) -> Self {
        let poses = trajectories.objects.iter().flat_map(|object| &object.poses).map(Position::from);
        let contacts = trajectories.ground_tracks.iter().flat_map(|track| &track.positions).map(Position::from);
        let mut known: HashMap<_, _> = poses.chain(contacts).map(|at| (at.name, (at.frame, at.time_s))).collect();
        let frames = frames.unwrap_or_default().iter();
        known.extend(frames.map(|frame| (frame.name.as_str(), (frame.id, frame.time_s))));
        Self { known, fps: input.info.fps.filter(|fps| *fps > 0.0 && input.times == TimeBase::Seconds) }
    }

    fn frame(&self, name: &str, image: ImageId) -> Frame {
        let by_rate = || {
            let index = f64::from(image.frame().0);
            (image.frame(), self.fps.map_or(index, |fps| index / fps))
        };
        let (id, time_s) = self.known.get(name).copied().unwrap_or_else(by_rate);
        Frame { id, name: name.to_owned(), time_s }
    }
}

/// The registered images whose intrinsics are known, in order of their frames.
fn views(background: &Reconstruction, times: &Times) -> Vec<RegisteredFrame> {
    let view = |(id, image): (&ImageId, &crate::scene::Image)| {
        let camera = *background.projecting_camera(image)?;
        let frame = times.frame(&image.name, *id);
        Some((frame.id, RegisteredFrame { frame, image: *id, camera, cam_from_world: image.cam_from_world }))
    };
    let by_frame: BTreeMap<FrameId, RegisteredFrame> = background.images.iter().filter_map(view).collect();
    by_frame.into_values().collect()
}

fn absent_or(error: IoError, absent: impl FnOnce() -> ExportError) -> ExportError {
    if error.is_not_found() { absent() } else { error.into() }
}

/// Content of a file, if it exists.
pub(super) fn there<T>(read: Result<T, IoError>) -> Result<Option<T>, IoError> {
    match read {
        Err(error) if error.is_not_found() => Ok(None),
        read => read.map(Some),
    }
}

fn name_of(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}
