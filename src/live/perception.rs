//! Vehicles in the image: detector, masks, optical flow and tracker, one frame at a time, on a thread of their own.
//!
//! The thread is up to two frames ahead of points and positions: one frame is queued between them, so that a slow frame
//! on either side does not delay the others. Frames are dropped in one place only, before this thread.

use std::collections::BTreeMap;
use std::io;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::sync::{Arc, Mutex, Weak};
use std::thread;
use std::time::{Duration, Instant};

use ::image::RgbImage;

use super::frames::{Arrived, Input, Newest, Next};
use super::load::Load;
use super::{PATIENCE, lock};
use crate::networks::{
    BoxSegmenter, FlowEstimator, GrabCut, Yolox, default_models, load_box_segmenter, load_detector, load_flow,
    load_small_box_segmenter,
};
use crate::pipeline::{DetectorChoice, MaskChoice, MaskingOptions, Options, PipelineError};
use crate::scene::{BoxDetection, Frame, FrameId, Mask, ObjectId, Rect, Topic};
use crate::tracking::{BoxSource, ConfirmedObject, FrameInput, Predecessor, TrackedMask, Tracker};
use crate::trajectory::Silhouette;

/// Tracked object.
#[derive(Clone, Debug)]
pub(super) struct Identity {
    pub(super) id: ObjectId,
    pub(super) class: String,
    pub(super) confidence: f64,
    /// Lost object that this one may continue.
    pub(super) after: Option<Predecessor>,
}

/// Outline of an object's mask in a frame.
pub(super) struct Outlined {
    /// Provisional id of the tracker.
    pub(super) object: ObjectId,
    pub(super) frame: FrameId,
    pub(super) rect: Rect,
    /// `None` for a truncated or tiny mask.
    pub(super) outline: Option<Silhouette>,
}

impl Outlined {
    fn of(object: ObjectId, frame: FrameId, mask: &Mask) -> Option<Self> {
        Some(Self { object, frame, rect: mask.bounding_box()?.into(), outline: Silhouette::of(mask) })
    }
}

/// A frame with its tracked vehicles.
pub(super) struct Perceived {
    pub(super) frame: Frame,
    pub(super) picture: RgbImage,
    /// When it was decoded.
    pub(super) at: Instant,
    /// Masks of this frame, and revised ones of earlier frames.
    pub(super) seen: Vec<Outlined>,
    pub(super) masks: Vec<TrackedMask>,
    pub(super) identities: BTreeMap<ObjectId, Identity>,
    /// Mask of the background.
    pub(super) background: Mask,
    /// Duration of perception.
    pub(super) busy: Duration,
    /// Frames dropped and skipped so far.
    pub(super) num_dropped: u64,
    pub(super) num_skipped: u64,
}

/// The thread of perception.
pub(super) struct PerceptionThread {
    input: Sender<Input>,
    perceived: Receiver<Result<Box<Perceived>, PipelineError>>,
}

impl PerceptionThread {
    /// Starts the thread, which loads the networks.
    ///
    /// * `load` – sets the workload per frame; the thread ends when its owner has dropped it.
    ///
    /// # Errors
    /// [`PipelineError::Perception`] where a network is missing, [`PipelineError::Thread`].
    pub(super) fn start(options: &Options, load: &Arc<Mutex<Load>>) -> Result<Self, PipelineError> {
        let (input, source) = channel();
        let (sender, perceived) = sync_channel(1);
        let (ready, loaded) = channel();
        let (options, load) = (options.clone(), Arc::downgrade(load));
        let work = move || match Perception::new(&options) {
            Err(error) => drop(ready.send(Err(error))),
            Ok(perception) => {
                drop(ready.send(Ok(())));
                if let Ok(input) = source.recv() {
                    perceive(perception, input, &load, &sender);
                }
            }
        };
        thread::Builder::new().name("perception".into()).spawn(work).map_err(PipelineError::Thread)?;
        loaded.recv().map_err(|_| ended())??;
        Ok(Self { input, perceived })
    }

    /// Begins with the frames of a video.
    ///
    /// # Errors
    /// [`PipelineError::Thread`].
    pub(super) fn begin(&self, input: Input) -> Result<(), PipelineError> {
        self.input.send(input).map_err(|_| ended())
    }

    /// Takes the next frame; waits for one up to `patience`.
    ///
    /// # Errors
    /// Those of the thread, which ends with the first.
    pub(super) fn take(&self, patience: Duration) -> Result<Next<Box<Perceived>>, PipelineError> {
        match self.perceived.recv_timeout(patience) {
            Ok(perceived) => perceived.map(Next::Frame),
            Err(RecvTimeoutError::Timeout) => Ok(Next::Nothing),
            Err(RecvTimeoutError::Disconnected) => Ok(Next::Over),
        }
    }
}

fn ended() -> PipelineError {
    PipelineError::Thread(io::Error::other("perception has ended"))
}

/// Processes frames until the end of the recording, or until the receiver is dropped.
fn perceive(
    mut perception: Perception,
    input: Input,
    load: &Weak<Mutex<Load>>,
    sender: &SyncSender<Result<Box<Perceived>, PipelineError>>,
) {
    let newest = match Newest::start(input) {
        Ok(newest) => newest,
        Err(error) => return drop(sender.send(Err(error))),
    };
    let mut num_skipped = 0;
    loop {
        let next = newest.take(PATIENCE);
        if let Some(error) = newest.take_error() {
            tracing::warn!("{}", Topic::FrameNotDecoded.warning(error.to_string()));
        }
        let Some(load) = load.upgrade() else { return };
        let arrived = match next {
            Next::Frame(arrived) => *arrived,
            Next::Nothing => continue,
            Next::Over => return,
        };
        let periods_s = {
            let mut load = lock(&load);
            if load.skips() {
                num_skipped += 1;
                continue;
            }
            load.periods_s()
        };
        // The owner must have the only strong reference while this thread waits to hand the frame over.
        drop(load);
        let found = perception.perceive(arrived, periods_s);
        let found = found.map(|found| Box::new(Perceived { num_dropped: newest.num_dropped(), num_skipped, ..found }));
        let is_over = found.is_err();
        if sender.send(found).is_err() || is_over {
            return;
        }
    }
}

/// Detects and tracks vehicles.
struct Perception {
    detector: Option<Yolox>,
    segmenter: Box<dyn BoxSegmenter>,
    flow: Box<dyn FlowEstimator>,
    tracker: Tracker,
    previous: Option<RgbImage>,
    /// Boxes of the last run of the detector, including those of untracked objects.
    boxes: Vec<BoxDetection>,
    /// Masks of the last frame.
    masks: Vec<TrackedMask>,
    /// Times of the last runs of the detector and of the mask network, seconds.
    last_run_s: [f64; 2],
    /// Margin of vehicles in the background.
    masking: MaskingOptions,
}

/// Share of the time between two runs by which one may be early: time stamps are rounded.
const EARLY: f64 = 0.1;

impl Perception {
    /// Loads the networks.
    ///
    /// # Errors
    /// [`PipelineError::Perception`] where a network is missing: there is no other detector here.
    fn new(options: &Options) -> Result<Self, PipelineError> {
        let resources = options.resources();
        let detector = match &options.vehicles.detector {
            DetectorChoice::None => None,
            DetectorChoice::File(path) => Some(load_detector(path, &options.detector, resources)?),
            DetectorChoice::Default => Some(load_detector(&default_models()?.detector, &options.detector, resources)?),
        };
        let segmenter: Box<dyn BoxSegmenter> = match options.vehicles.mask_network {
            MaskChoice::Small => load_small_box_segmenter(&default_models()?.small_masks, &options.prompt, resources)?,
            MaskChoice::Default => {
                let models = default_models()?;
                load_box_segmenter(&models.mask_encoder, &models.mask_decoder, &options.prompt, resources)?
            }
            MaskChoice::None => Box::new(GrabCut::new(&options.prompt)),
        };
        Ok(Self {
            detector,
            segmenter,
            flow: load_flow(options.flow_model.as_deref(), resources)?,
            tracker: Tracker::new(options.tracker.clone()),
            previous: None,
            boxes: Vec::new(),
            masks: Vec::new(),
            last_run_s: [f64::NEG_INFINITY; 2],
            masking: options.masking.clone(),
        })
    }

    /// Processes the next frame.
    ///
    /// * `periods_s` – time between runs of the detector, and of the mask network, seconds.
    fn perceive(&mut self, arrived: Arrived, periods_s: [f64; 2]) -> Result<Perceived, PipelineError> {
        let begin = Instant::now();
        let Arrived { frame, picture, at } = arrived;
        let seen = self.push(&frame, &picture, periods_s)?;
        let background = self.background(picture.dimensions());
        let (masks, identities) = (std::mem::take(&mut self.masks), self.identities());
        let (num_dropped, num_skipped) = (0, 0);
        let busy = begin.elapsed();
        Ok(Perceived { frame, picture, at, seen, masks, identities, background, busy, num_dropped, num_skipped })
    }

    /// Processes the next frame; returns the masks of its objects, and revised ones of earlier frames.
    ///
    /// * `periods_s` – time between runs of the detector, and of the mask network, seconds.
    fn push(&mut self, frame: &Frame, picture: &RgbImage, periods_s: [f64; 2]) -> Result<Vec<Outlined>, PipelineError> {
        let is_due = |k: usize| frame.time_s - self.last_run_s[k] >= (1.0 - EARLY) * periods_s[k];
        let [detects, segments] = [is_due(0), is_due(1)];
        let flow = match &self.previous {
            Some(previous) => Some(self.flow.flow(previous, picture, &self.tracker.flow_regions())?),
            None => None,
        };
        let mut by = BoxSource::Motion;
        let mut found = Vec::new();
        if let Some(detector) = self.detector.as_mut().filter(|_| detects) {
            self.boxes = detector.detect(picture)?;
            (self.last_run_s[0], by) = (frame.time_s, BoxSource::Detector);
            found = self.boxes.iter().cloned().map(Into::into).collect();
        }
        // Masks are most useful in frames in which the detector runs, too.
        let segments = segments && (detects || self.detector.is_none());
        if segments {
            self.last_run_s[1] = frame.time_s;
        }
        let segmenter = if segments { Some(&mut *self.segmenter as &mut dyn BoxSegmenter) } else { None };
        let input = FrameInput { found, by, segmenter };
        self.masks = self.tracker.advance(frame, picture, input, flow.as_ref())?;
        self.previous = Some(picture.clone());
        self.tracker.take_finished();
        let corrected = self.tracker.take_corrections();
        let corrected = corrected.iter().filter_map(|c| Outlined::of(c.object, c.frame, &c.mask));
        let new = self.masks.iter().filter_map(|m| Outlined::of(m.object, frame.id, &m.mask));
        Ok(new.chain(corrected).collect())
    }

    /// Mask of the background: pixels near neither the detector's last boxes nor tracked objects.
    fn background(&self, size: (u32, u32)) -> Mask {
        let mut mask = Mask::full(size.0, size.1);
        let margin = f64::from(self.masking.dilation_px(size));
        for rect in self.boxes.iter().map(|found| found.rect).chain(self.tracker.flow_regions()) {
            let rect = Rect { x0: rect.x0 - margin, y0: rect.y0 - margin, x1: rect.x1 + margin, y1: rect.y1 + margin };
            mask.fill_rect(&rect, false);
        }
        mask
    }

    /// Confirmed objects by their provisional ids.
    fn identities(&self) -> BTreeMap<ObjectId, Identity> {
        let identity = |found: ConfirmedObject<'_>| {
            let ConfirmedObject { id, confidence, after, .. } = found;
            (found.provisional, Identity { id, class: found.class.to_owned(), confidence, after })
        };
        self.tracker.confirmed().map(identity).collect()
    }
}
