//! Vehicles while the camera records: one pass through the frames of a recording that still grows.
//!
//! The newest frame is taken (`frames.rs`); vehicles are detected and tracked on a thread (`perception.rs`), while
//! points of the frame before are tracked on another (`window.rs`), by the objects that a run uses. A worker
//! reconstructs the window of the last ten seconds with the batch mapper, in the frame of the maps before (`map`);
//! another places models of the vehicles in every third of these maps (`models.rs`).
//! Between two maps every frame is registered by resection, and the lower edges of the masks give provisional positions
//! on the local ground planes; a frame that leaves the window gets its final ones (`vehicles.rs`). Under overload the
//! work is reduced in a fixed order (`load.rs`). `docs/live.md` has limits and figures.
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

use std::collections::BTreeMap;
use std::io;
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, channel, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use ::image::RgbImage;

pub use line::{
    CameraLine, EndLine, GeoPosition, LengthUnit, Line, LoadLine, MapLine, MotionState, NoMapLine, PositionMethod,
    State, VehicleLine,
};
pub use telemetry::TelemetryFeed;

use crate::camera::Camera;
use crate::ffi::{memory, priority};
use crate::files::Growth;
use crate::io::interchange::colmap;
use crate::mapper::Intrinsics;
use crate::pipeline::{IntrinsicsSource, Options, PipelineError};
use crate::scene::{Frame, ObjectId};
use crate::video::Source;
use frames::{Input, Next};
use load::Load;
use map::{MIN_KEYFRAMES, Mapper, NoMap, WorldMap};
use models::{Model, Request};
use perception::{Perceived, PerceptionThread};
use vehicles::{Positions, Vehicles};
use window::{Snapshot, Window};

/// Length of the window, seconds.
const WINDOW_S: f64 = 10.0;
/// Minimum time between two maps, seconds.
const MAP_S: f64 = 1.0;
/// Minimum time between two maps that make frames final, seconds. Models of the vehicles are placed in them, which
/// takes up to this time.
const FINAL_EVERY_S: f64 = 3.0;
/// Age at which a frame becomes final, seconds: at most ten after it, with those three.
const FINAL_S: f64 = 6.5;
/// Time after which a camera without keyframes may hover, seconds: a first map of one that moves takes as long.
const HOVER_S: f64 = 2.0;
/// Minimum time between two attempts at a map, seconds.
const RETRY_S: f64 = 0.5;
/// Minimum time between two attempts at a map without enough keyframes, seconds: these take longer.
const HOVER_RETRY_S: f64 = 2.0;
/// Time without a map after which its absence is reported, seconds: a camera that moves has the first after two.
const NO_MAP_S: f64 = 5.0;
/// Maximum wait for a frame before signals are checked.
const PATIENCE: Duration = Duration::from_millis(50);

/// Callback for each processed frame.
pub type Watch = dyn Fn(&Frame, &RgbImage);

/// A recording to be processed while it grows.
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

/// Request to a live run from outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Continue to the end of the source.
    Continue,
    /// End the recording here, and complete the results.
    EndRecording,
    /// End the recording here, without completing the results.
    Stop,
}

/// Processes a recording to its end.
///
/// * `sink` – takes each line at once.
/// * `order` – called between frames.
///
/// # Errors
/// [`PipelineError`]; the recording is not affected.
pub fn run(
    job: &Job,
    sink: &mut dyn FnMut(&Line) -> io::Result<()>,
    order: &dyn Fn() -> Order,
) -> Result<EndLine, PipelineError> {
    let options = job.options;
    let load = Arc::<Mutex<Load>>::default();
    let perception = PerceptionThread::start(options, &load)?;
    let source = Source::open_growing(job.recording, &options.video, job.growth.clone())?;
    let (camera, known) = camera(&source, options)?;
    let (is_paced, growth) = (job.is_paced, job.growth.clone());
    perception.begin(Input { frames: source.frames()?, is_paced, growth })?;
    let (mut mapper, of_models) = (Mapper::new(options, camera, known, job.telemetry.clone()), options.clone());
    let mut live = Live {
        options,
        sink,
        window: Window::new(camera),
        vehicles: Vehicles::default(),
        load,
        mapper: Worker::start("mapper", move |snapshot| mapper.update(&snapshot))?,
        modeler: Worker::start("modeler", move |request| models::place_all(&request, &of_models))?,
        leaving: None,
        telemetry: job.telemetry.as_deref(),
        watch: job.watch,
        map: None,
        mapped_s: None,
        no_map: None,
        requested_s: f64::NEG_INFINITY,
        final_s: f64::NEG_INFINITY,
        end: EndLine::default(),
        spent: [Duration::ZERO; 3],
    };
    loop {
        if order() != Order::Continue {
            job.growth.finish();
            break;
        }
        match perception.take(PATIENCE)? {
            Next::Frame(perceived) => live.step(*perceived)?,
            Next::Nothing => live.take_results(Wait::No)?,
            Next::Over => break,
        }
    }
    // The thread of perception may wait to hand a frame over.
    drop(perception);
    live.finish(order)
}

/// The camera before it is estimated, and prior knowledge of it.
fn camera(source: &Source, options: &Options) -> Result<(Camera, Intrinsics), PipelineError> {
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
    let given = given.ok_or_else(|| PipelineError::Options("--intrinsics: expected those of one camera".to_owned()))?;
    Ok((given.resized(info.width, info.height), options.intrinsics_std))
}

/// State of a live run.
struct Live<'a> {
    options: &'a Options,
    sink: &'a mut dyn FnMut(&Line) -> io::Result<()>,
    window: Window,
    vehicles: Vehicles,
    load: Arc<Mutex<Load>>,
    mapper: Worker<Snapshot, Result<WorldMap, NoMap>>,
    modeler: Worker<Request, BTreeMap<ObjectId, Model>>,
    /// Results that become final when the models are made.
    leaving: Option<Leaving>,
    telemetry: Option<&'a TelemetryFeed>,
    watch: Option<&'a Watch>,
    map: Option<Arc<WorldMap>>,
    /// Time from which the absence of a map counts, seconds; infinite once it was reported.
    mapped_s: Option<f64>,
    /// Reason why the last window gave no map.
    no_map: Option<NoMap>,
    /// Time of the last request of a map, and of one that makes frames final, seconds.
    requested_s: f64,
    final_s: f64,
    end: EndLine,
    /// Time of perception, points and positions.
    spent: [Duration; 3],
}

impl Live<'_> {
    /// Processes a frame.
    fn step(&mut self, perceived: Perceived) -> Result<(), PipelineError> {
        let Perceived { frame, picture, at, seen, masks, identities, background, busy, num_dropped, num_skipped } =
            perceived;
        let begin = Instant::now();
        self.end.t = frame.time_s;
        (self.end.dropped, self.end.skipped) = (num_dropped, num_skipped);
        if let Some(telemetry) = self.telemetry {
            telemetry.note_frame(frame.time_s, at);
        }
        if let Some(watch) = self.watch {
            watch(&frame, &picture);
        }
        self.take_results(Wait::No)?;
        self.vehicles.push(&frame, at, seen, identities);
        if !self.map.as_ref().is_some_and(|map| map.hovers()) {
            self.vehicles.track_points(&frame, &picture, &masks, self.window.camera())?;
        }
        self.window.push(&frame, &picture, &background)?;
        let image = self.map.as_deref().and_then(|map| self.window.register(map));
        let tracked = Instant::now();
        self.end.registered += u64::from(image.is_some());
        self.end.frames += 1;
        if let Some((map, (_, image))) = self.map.as_ref().zip(image.as_ref()) {
            let camera = map.camera_line(&frame, &image.cam_from_world, State::Provisional);
            self.send(Line::Camera(camera))?;
        }
        let lines = self.vehicles.provisional(self.map.as_deref(), image, self.options);
        self.write(lines)?;
        self.request_map(frame.time_s);
        self.note_absence(frame.time_s)?;
        let done = Instant::now();
        let parts = [busy, tracked - begin, done - tracked];
        self.spent.iter_mut().zip(parts).for_each(|(sum, part)| *sum += part);
        self.note_load(frame.time_s, busy.max(done - begin))
    }

    fn note_load(&mut self, time_s: f64, busy: Duration) -> Result<(), PipelineError> {
        let dropped = self.end.dropped;
        let mut load = lock(&self.load);
        let Some(reason) = load.note(time_s, busy.as_secs_f64(), dropped) else { return Ok(()) };
        let (level, reductions) = (load.level(), load.reductions());
        drop(load);
        self.send(Line::Load(LoadLine { t: time_s, level, reductions, reason, dropped }))
    }

    /// Reports once why there has been no map for a while.
    fn note_absence(&mut self, time_s: f64) -> Result<(), PipelineError> {
        let since_s = *self.mapped_s.get_or_insert(time_s);
        if time_s - since_s < NO_MAP_S {
            return Ok(());
        }
        let keyframes = self.window.num_keys();
        let too_few = NoMap::Keyframes { found: keyframes };
        let why = self.no_map.clone().or((keyframes < MIN_KEYFRAMES).then_some(too_few));
        let Some(why) = why else { return Ok(()) };
        self.mapped_s = Some(f64::INFINITY);
        self.send(Line::NoMap(NoMapLine { t: time_s, reason: why.to_string() }))
    }

    /// Hands the window to the mapper if it is idle and a map is due.
    fn request_map(&mut self, time_s: f64) {
        let is_due = match &self.map {
            Some(map) => time_s - map.time_s >= MAP_S,
            // A camera that hovers gives no keyframes.
            None => self.window.num_keys() >= MIN_KEYFRAMES || self.window.span_s() >= HOVER_S,
        };
        let retry_s = if self.window.num_keys() < MIN_KEYFRAMES { HOVER_RETRY_S } else { RETRY_S };
        let wait_s = if self.map.is_some() { 0.0 } else { retry_s };
        if !is_due || self.mapper.is_busy || time_s - self.requested_s < wait_s {
            return;
        }
        self.requested_s = time_s;
        let is_final = self.map.is_some() && !self.modeler.is_busy && time_s - self.final_s >= FINAL_EVERY_S;
        if is_final {
            self.final_s = time_s;
        }
        self.mapper.request(self.snapshot(if is_final { Purpose::Final } else { Purpose::Revision }));
    }

    fn snapshot(&self, purpose: Purpose) -> Snapshot {
        self.window.snapshot(purpose, self.vehicles.images(&self.window.camera()))
    }

    /// Takes the finished results of the workers.
    fn take_results(&mut self, wait: Wait) -> Result<(), PipelineError> {
        self.take_map(wait)?;
        self.take_models(wait)
    }

    /// Takes the map that was requested, if there is one, and requests the models of a final one.
    fn take_map(&mut self, wait: Wait) -> Result<(), PipelineError> {
        let map = match self.mapper.poll(wait)? {
            None => return Ok(()),
            Some(Err(why)) => {
                self.no_map = Some(why);
                return Ok(());
            }
            Some(Ok(map)) => Arc::new(map),
        };
        (self.mapped_s, self.no_map) = (Some(self.end.t), None);
        if !map.is_continued {
            // Models of the previous local frame are too late: its frames become final without them.
            self.finalize(&BTreeMap::new())?;
        }
        self.window.take_poses(&map);
        self.vehicles.take_map(&map, self.options);
        self.end.maps += 1;
        self.send(Line::Map(MapLine { models: self.vehicles.num_models(), ..map.line.clone() }))?;
        let until_s = match map.purpose {
            Purpose::Revision => None,
            Purpose::Final => Some(map.time_s - FINAL_S),
            Purpose::Last => Some(map.time_s),
        };
        if let Some(until_s) = until_s {
            self.modeler.request(self.vehicles.request(&map));
            self.leaving = Some(Leaving { map: map.clone(), until_s, positions: self.vehicles.positions() });
        }
        self.map = Some(map);
        Ok(())
    }

    /// Takes the models that were requested, if they are made.
    fn take_models(&mut self, wait: Wait) -> Result<(), PipelineError> {
        match self.modeler.poll(wait)? {
            Some(models) => self.finalize(&models),
            None => Ok(()),
        }
    }

    /// Writes the poses and positions that are final.
    fn finalize(&mut self, models: &BTreeMap<ObjectId, Model>) -> Result<(), PipelineError> {
        let Some(Leaving { map, until_s, positions }) = self.leaving.take() else { return Ok(()) };
        let (frames, lines) = self.vehicles.finalize(&map, until_s, &positions, models);
        for frame in frames {
            if let Some(image) = map.model.images.get(&frame.id.into()) {
                self.send(Line::Camera(map.camera_line(&frame, &image.cam_from_world, State::Final)))?;
            }
        }
        self.write(lines)?;
        // Five threads allocate and free frames, points and maps: without this, unused memory grows for hours.
        memory::give_back();
        Ok(())
    }

    fn write(&mut self, lines: Vec<VehicleLine>) -> Result<(), PipelineError> {
        lines.into_iter().try_for_each(|line| self.send(Line::Vehicle(line)))
    }

    fn send(&mut self, line: Line) -> Result<(), PipelineError> {
        (self.sink)(&line).map_err(PipelineError::Sink)
    }

    /// Makes the last map, unless the run is to stop, and returns the totals.
    fn finish(mut self, order: &dyn Fn() -> Order) -> Result<EndLine, PipelineError> {
        if order() != Order::Stop {
            self.take_results(Wait::Yes)?;
            if self.map.is_some() || self.window.num_keys() >= MIN_KEYFRAMES {
                self.mapper.request(self.snapshot(Purpose::Last));
                self.take_results(Wait::Yes)?;
            }
            // If the last frames give no map, the previous one is used.
            if let (Some(_), Some(map)) = (&self.no_map, self.map.clone()) {
                self.leaving = Some(Leaving { map, until_s: self.end.t, positions: self.vehicles.positions() });
                self.finalize(&BTreeMap::new())?;
            }
        }
        let count = self.end.frames.max(1) as f64;
        self.end.mean_ms = self.spent.map(|spent| (1e4 * spent.as_secs_f64() / count).round() / 10.0);
        self.send(Line::End(self.end.clone()))?;
        Ok(self.end)
    }
}

/// A lock, also of a thread that has panicked.
fn lock<T>(state: &Mutex<T>) -> MutexGuard<'_, T> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Results that become final with a map.
struct Leaving {
    map: Arc<WorldMap>,
    /// Time of the last frame that becomes final, seconds.
    until_s: f64,
    /// Contact points in it.
    positions: BTreeMap<ObjectId, Positions>,
}

/// Waiting for a worker.
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

/// Low-priority thread for one job at a time.
struct Worker<Job, Found> {
    jobs: SyncSender<Job>,
    found: Receiver<Result<Found, PipelineError>>,
    is_busy: bool,
}

impl<Job: Send + 'static, Found: Send + 'static> Worker<Job, Found> {
    /// Starts it. Its adjustments run on this thread, too.
    fn start(
        name: &'static str,
        mut work: impl FnMut(Job) -> Result<Found, PipelineError> + Send + 'static,
    ) -> Result<Self, PipelineError> {
        let (jobs, requested) = sync_channel::<Job>(1);
        let (finished, found) = channel();
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .thread_name(move |_| name.into())
            .start_handler(|_| priority::lower())
            .build();
        let pool = pool.map_err(|error| PipelineError::Thread(io::Error::other(error)))?;
        let work = move || {
            for job in requested {
                if finished.send(pool.install(|| work(job))).is_err() {
                    return;
                }
            }
        };
        thread::Builder::new().name(name.into()).spawn(work).map_err(PipelineError::Thread)?;
        Ok(Self { jobs, found, is_busy: false })
    }

    fn request(&mut self, job: Job) {
        self.is_busy = self.jobs.try_send(job).is_ok();
    }

    /// The result of the job; `None` where it is not finished.
    fn poll(&mut self, wait: Wait) -> Result<Option<Found>, PipelineError> {
        if !self.is_busy {
            return Ok(None);
        }
        let found = match wait {
            Wait::No => self.found.try_recv(),
            Wait::Yes => self.found.recv().map_err(|_| TryRecvError::Disconnected),
        };
        match found {
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => Err(PipelineError::Thread(io::Error::other("a worker has ended"))),
            Ok(found) => {
                self.is_busy = false;
                found.map(Some)
            }
        }
    }
}
