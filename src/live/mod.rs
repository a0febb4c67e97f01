//! Vehicles while the camera records: one pass through the frames of a recording that still grows.
//!
//! The newest frame is taken (`frames.rs`); vehicles are detected and followed (`perception.rs`), points of the
//! background tracked (`window.rs`) by the objects that a run uses. A worker reconstructs the window of the last ten
//! seconds with the batch mapper, in the frame of the maps before (`map.rs`). Between two maps every frame is
//! registered by resection, and the lower edges of the masks give provisional positions on the local ground planes; a
//! frame that leaves the window gets its final ones (`vehicles.rs`). What does not keep up is reduced in a fixed order
//! (`load.rs`). `docs/live.md` has limits and figures.
//!
//! Nothing grows with the duration: the window is bounded, the queues have length one.

mod frames;
mod georeference;
mod line;
mod load;
mod map;
mod models;
mod perception;
mod telemetry;
mod vehicles;
mod window;

use std::io;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, channel, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use ::image::RgbImage;

pub use line::{
    CameraLine, EndLine, GeoPosition, LengthUnit, Line, LoadLine, MapLine, PositionMethod, State, VehicleLine,
};
pub use telemetry::TelemetryFeed;

use crate::camera::Camera;
use crate::features::FeatureError;
use crate::files::Growth;
use crate::io::IoError;
use crate::io::interchange::colmap;
use crate::mapper::{Intrinsics, MapperError};
use crate::networks::PerceptionError;
use crate::pipeline::{IntrinsicsSource, Options};
use crate::scene::{Frame, Topic};
use crate::video::{Source, VideoError};
use frames::{Arrived, Newest, Next};
use load::Load;
use map::{MIN_KEYS, Mapper, WorldMap};
use perception::Perception;
use vehicles::Vehicles;
use window::{Snapshot, Window};

/// Length of the window, seconds.
const WINDOW_S: f64 = 10.0;
/// Time between two maps at least, seconds.
const MAP_S: f64 = 1.0;
/// Time between two maps that make frames final, seconds. These maps have models of the vehicles, which take longer.
const FINAL_EVERY_S: f64 = 3.0;
/// Age at which a frame becomes final, seconds: at most ten after it, with those three.
const FINAL_S: f64 = 6.5;
/// Longest wait for a frame before signals are looked at.
const PATIENCE: Duration = Duration::from_millis(50);

/// Why live processing ended.
#[derive(Debug, thiserror::Error)]
pub enum LiveError {
    /// The recording cannot be decoded.
    #[error(transparent)]
    Video(#[from] VideoError),
    /// Networks.
    #[error(transparent)]
    Perception(#[from] PerceptionError),
    /// Point tracking.
    #[error(transparent)]
    Features(#[from] FeatureError),
    /// The mapper.
    #[error(transparent)]
    Mapper(#[from] MapperError),
    /// A file of intrinsics.
    #[error(transparent)]
    Io(#[from] IoError),
    /// An option has no use here.
    #[error("{0}")]
    Options(String),
    /// No thread.
    #[error("thread cannot be started: {0}")]
    Thread(io::Error),
    /// A line cannot be written.
    #[error("result line cannot be written: {0}")]
    Sink(io::Error),
}

/// Looks at a frame that is processed.
pub type Watch = dyn Fn(&Frame, &RgbImage);

/// A recording to be followed.
pub struct Job<'a> {
    /// The file.
    pub recording: &'a Path,
    /// Its growth; a reader reaches the end when it is finished.
    pub growth: Arc<Growth>,
    /// True if frames come at the pace of their time stamps, false if the source sets the pace.
    pub is_paced: bool,
    /// Positions of the camera, received while it records.
    pub telemetry: Option<Arc<TelemetryFeed>>,
    /// Takes each frame before it is processed.
    pub watch: Option<&'a Watch>,
    /// Options of a run; those of networks, tracker, ground, intrinsics and meters are used.
    pub options: &'a Options,
}

/// Follows a recording to its end.
///
/// * `sink` – takes each line at once.
/// * `is_stopped` – asked between frames; true ends the recording here.
///
/// # Errors
/// [`LiveError`]; the recording is not affected.
pub fn run(
    job: &Job,
    sink: &mut dyn FnMut(&Line) -> io::Result<()>,
    is_stopped: &dyn Fn() -> bool,
) -> Result<EndLine, LiveError> {
    let options = job.options;
    let perception = Perception::new(options)?;
    let source = Source::open_growing(job.recording, &options.video, job.growth.clone())?;
    let (camera, known) = camera(&source, options)?;
    let newest = Newest::start(source.frames()?, job.is_paced)?;
    let mut live = Live {
        options,
        sink,
        perception,
        window: Window::new(camera),
        vehicles: Vehicles::default(),
        load: Load::default(),
        worker: Worker::start(Mapper::new(options, camera, known, job.telemetry.clone()))?,
        telemetry: job.telemetry.as_deref(),
        watch: job.watch,
        map: None,
        final_s: f64::NEG_INFINITY,
        end: EndLine::default(),
        spent: [Duration::ZERO; 3],
    };
    loop {
        if is_stopped() {
            job.growth.finish();
            break;
        }
        match newest.take(PATIENCE) {
            Next::Frame(arrived) => {
                live.end.dropped = newest.num_dropped();
                live.step(*arrived)?;
            }
            Next::Nothing => live.take_map(Wait::No)?,
            Next::Over => break,
        }
        if let Some(error) = newest.take_error() {
            tracing::warn!("{}", Topic::FrameNotDecoded.warning(error.to_string()));
        }
    }
    live.finish(is_stopped)
}

/// The camera before it is estimated, and prior knowledge of it.
fn camera(source: &Source, options: &Options) -> Result<(Camera, Intrinsics), LiveError> {
    let info = source.info();
    let prior = Camera::prior(info.source_width, info.source_height);
    let given = match &options.intrinsics {
        None => return Ok((prior.resized(info.width, info.height), Intrinsics::GUESSED)),
        Some(IntrinsicsSource::Given(values)) => prior.with_parameters(values),
        Some(IntrinsicsSource::File(path)) => match colmap::read_cameras(path)?.into_values().collect::<Vec<_>>()[..] {
            [only] => Some(only),
            _ => None,
        },
    };
    let given = given.ok_or_else(|| LiveError::Options("--intrinsics: expected those of one camera".to_owned()))?;
    Ok((given.resized(info.width, info.height), options.intrinsics_std))
}

/// State of a live run.
struct Live<'a> {
    options: &'a Options,
    sink: &'a mut dyn FnMut(&Line) -> io::Result<()>,
    perception: Perception,
    window: Window,
    vehicles: Vehicles,
    load: Load,
    worker: Worker,
    telemetry: Option<&'a TelemetryFeed>,
    watch: Option<&'a Watch>,
    map: Option<WorldMap>,
    /// Time of the last request of a map that makes frames final, seconds.
    final_s: f64,
    end: EndLine,
    /// Time of perception, points and positions.
    spent: [Duration; 3],
}

impl Live<'_> {
    /// Processes a frame.
    fn step(&mut self, arrived: Arrived) -> Result<(), LiveError> {
        let Arrived { frame, picture, at } = arrived;
        self.end.t = frame.time_s;
        if let Some(telemetry) = self.telemetry {
            telemetry.note_frame(frame.time_s, at);
        }
        if self.load.skips() {
            self.end.skipped += 1;
            return self.note_load(frame.time_s, Duration::ZERO);
        }
        let begin = Instant::now();
        if let Some(watch) = self.watch {
            watch(&frame, &picture);
        }
        self.take_map(Wait::No)?;
        let seen = self.perception.push(&frame, &picture, self.load.periods_s())?;
        self.vehicles.push(&frame, at, seen, self.perception.identities());
        self.vehicles.track_points(&frame, &picture, self.perception.masks(), self.window.camera())?;
        let perceived = Instant::now();
        let longer_px = f64::from(picture.width().max(picture.height()));
        let dilation_px = (self.options.masking.dilation * longer_px).round() as u32;
        let background = self.perception.background(picture.dimensions(), dilation_px);
        self.window.push(&frame, &picture, &background)?;
        let image = self.map.as_ref().and_then(|map| self.window.register(map));
        let tracked = Instant::now();
        self.end.registered += u64::from(image.is_some());
        self.end.frames += 1;
        if let Some((map, (_, image))) = self.map.as_ref().zip(image.as_ref()) {
            let camera = map.camera_line(&frame, &image.cam_from_world, State::Provisional);
            self.send(Line::Camera(camera))?;
        }
        let lines = self.vehicles.provisional(self.map.as_ref(), image, self.options);
        self.write(lines)?;
        self.request_map(frame.time_s);
        let done = Instant::now();
        let parts = [perceived - begin, tracked - perceived, done - tracked];
        self.spent.iter_mut().zip(parts).for_each(|(sum, part)| *sum += part);
        self.note_load(frame.time_s, done - begin)
    }

    fn note_load(&mut self, time_s: f64, busy: Duration) -> Result<(), LiveError> {
        let Some(reason) = self.load.note(time_s, busy.as_secs_f64(), self.end.dropped) else { return Ok(()) };
        let (level, reductions, dropped) = (self.load.level(), self.load.reductions(), self.end.dropped);
        self.send(Line::Load(LoadLine { t: time_s, level, reductions, reason, dropped }))
    }

    fn snapshot(&self, purpose: Purpose) -> Snapshot {
        let subjects = if purpose == Purpose::Revision { Vec::new() } else { self.vehicles.subjects() };
        self.window.snapshot(purpose, subjects, self.vehicles.outlines().clone())
    }

    /// Hands the window to the worker if it is idle and a map is due.
    fn request_map(&mut self, time_s: f64) {
        let is_due = match &self.map {
            Some(map) => time_s - map.time_s >= MAP_S,
            None => self.window.num_keys() >= MIN_KEYS,
        };
        if !is_due || self.worker.is_busy {
            return;
        }
        let is_final = self.map.is_some() && time_s - self.final_s >= FINAL_EVERY_S;
        if is_final {
            self.final_s = time_s;
        }
        self.worker.request(self.snapshot(if is_final { Purpose::Final } else { Purpose::Revision }));
    }

    /// Takes the map that was requested, if there is one.
    fn take_map(&mut self, wait: Wait) -> Result<(), LiveError> {
        let Some(map) = self.worker.poll(wait)? else { return Ok(()) };
        self.window.take_poses(&map);
        let (frames, lines) = self.vehicles.take_map(&map, self.options);
        self.end.maps += 1;
        self.send(Line::Map(map.line.clone()))?;
        for frame in frames {
            if let Some(image) = map.model.images.get(&frame.id.into()) {
                self.send(Line::Camera(map.camera_line(&frame, &image.cam_from_world, State::Final)))?;
            }
        }
        self.write(lines)?;
        self.map = Some(map);
        Ok(())
    }

    fn write(&mut self, lines: Vec<VehicleLine>) -> Result<(), LiveError> {
        lines.into_iter().try_for_each(|line| self.send(Line::Vehicle(line)))
    }

    fn send(&mut self, line: Line) -> Result<(), LiveError> {
        (self.sink)(&line).map_err(LiveError::Sink)
    }

    /// Makes the last map, unless a signal asks to end, and says what was done.
    fn finish(mut self, is_stopped: &dyn Fn() -> bool) -> Result<EndLine, LiveError> {
        if !is_stopped() {
            self.take_map(Wait::Yes)?;
            if self.window.num_keys() >= MIN_KEYS {
                self.worker.request(self.snapshot(Purpose::Last));
                self.take_map(Wait::Yes)?;
            }
        }
        let count = self.end.frames.max(1) as f64;
        self.end.mean_ms = self.spent.map(|spent| (1e4 * spent.as_secs_f64() / count).round() / 10.0);
        self.send(Line::End(self.end.clone()))?;
        Ok(self.end)
    }
}

/// Waiting for a map.
#[derive(Clone, Copy, PartialEq)]
enum Wait {
    No,
    Yes,
}

/// Purpose of a map.
#[derive(Clone, Copy, PartialEq)]
enum Purpose {
    /// For the frames to come.
    Revision,
    /// Old frames become final, too.
    Final,
    /// All frames become final.
    Last,
}

/// The thread that makes maps, one at a time.
struct Worker {
    jobs: SyncSender<Snapshot>,
    maps: Receiver<Result<Option<WorldMap>, LiveError>>,
    is_busy: bool,
}

impl Worker {
    /// Starts it. Its adjustments run on one thread, so that those of the frames come first.
    fn start(mut mapper: Mapper) -> Result<Self, LiveError> {
        let (jobs, requested) = sync_channel::<Snapshot>(1);
        let (finished, maps) = channel();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        let pool = pool.map_err(|error| LiveError::Thread(io::Error::other(error)))?;
        let work = move || {
            for snapshot in requested {
                if finished.send(pool.install(|| mapper.update(&snapshot))).is_err() {
                    return;
                }
            }
        };
        thread::Builder::new().name("mapper".into()).spawn(work).map_err(LiveError::Thread)?;
        Ok(Self { jobs, maps, is_busy: false })
    }

    fn request(&mut self, snapshot: Snapshot) {
        self.is_busy = self.jobs.try_send(snapshot).is_ok();
    }

    /// The map that was requested; `None` where it is not finished or there is none.
    fn poll(&mut self, wait: Wait) -> Result<Option<WorldMap>, LiveError> {
        if !self.is_busy {
            return Ok(None);
        }
        let found = match wait {
            Wait::No => self.maps.try_recv(),
            Wait::Yes => self.maps.recv().map_err(|_| TryRecvError::Disconnected),
        };
        match found {
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(LiveError::Thread(io::Error::other("the mapper has ended"))),
            Ok(map) => {
                self.is_busy = false;
                map
            }
        }
    }
}
