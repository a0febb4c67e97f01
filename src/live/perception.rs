//! Vehicles in the image: detector, masks, optical flow and tracker, one frame at a time.

use std::collections::BTreeMap;

use ::image::RgbImage;

use super::LiveError;
use crate::ffi::onnx::Resources;
use crate::memory::MemoryLimit;
use crate::networks::{
    BoxSegmenter, Detector, FlowEstimator, GrabCut, default_models, load_box_segmenter, load_detector, load_flow,
    load_small_box_segmenter,
};
use crate::pipeline::{DetectorChoice, MaskChoice, Options};
use crate::scene::{BoxDetection, Frame, FrameId, Mask, ObjectId, Rect};
use crate::tracking::{BoxSource, FrameInput, TrackedMask, Tracker};
use crate::trajectory::Silhouette;

/// Object that is followed.
#[derive(Clone, Debug)]
pub(super) struct Identity {
    pub(super) id: ObjectId,
    pub(super) class: String,
    pub(super) confidence: f64,
}

/// Mask of an object in a frame, as its outline.
pub(super) struct Outlined {
    /// Provisional id of the tracker.
    pub(super) object: ObjectId,
    pub(super) frame: FrameId,
    pub(super) rect: Rect,
    /// `None` for one that the border cuts, or that is tiny.
    pub(super) outline: Option<Silhouette>,
}

impl Outlined {
    fn of(object: ObjectId, frame: FrameId, mask: &Mask) -> Option<Self> {
        Some(Self { object, frame, rect: mask.bounding_box()?.into(), outline: Silhouette::of(mask) })
    }
}

/// Finds and follows vehicles.
pub(super) struct Perception {
    detector: Option<Box<dyn Detector>>,
    segmenter: Box<dyn BoxSegmenter>,
    flow: Box<dyn FlowEstimator>,
    tracker: Tracker,
    previous: Option<RgbImage>,
    /// Boxes of the last look of the detector, also of objects that are not followed.
    boxes: Vec<BoxDetection>,
    /// Masks of the last frame.
    masks: Vec<TrackedMask>,
    /// Times of the last looks of the detector and of the mask network, seconds.
    looked_s: [f64; 2],
}

/// Part of the time between two looks by which one may come early: time stamps are rounded.
const EARLY: f64 = 0.1;

impl Perception {
    /// Loads the networks.
    ///
    /// # Errors
    /// [`LiveError::Perception`] where a network is missing: nothing else detects vehicles here.
    pub(super) fn new(options: &Options) -> Result<Self, LiveError> {
        let memory = options.memory_limit.unwrap_or_else(MemoryLimit::of_machine);
        let resources = Resources { num_threads: options.threads.unwrap_or(0), memory, provider: options.provider };
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
            flow: load_flow(options.flow_model.as_deref(), &options.flow, resources)?,
            tracker: Tracker::new(options.tracker.clone()),
            previous: None,
            boxes: Vec::new(),
            masks: Vec::new(),
            looked_s: [f64::NEG_INFINITY; 2],
        })
    }

    /// Takes the next frame; gives the masks of its objects, and better ones of frames before.
    ///
    /// * `periods_s` – time between looks of the detector, and of the mask network, seconds.
    pub(super) fn push(
        &mut self,
        frame: &Frame,
        picture: &RgbImage,
        periods_s: [f64; 2],
    ) -> Result<Vec<Outlined>, LiveError> {
        let is_due = |k: usize| frame.time_s - self.looked_s[k] >= (1.0 - EARLY) * periods_s[k];
        let [detects, segments] = [is_due(0), is_due(1)];
        let flow = match &self.previous {
            Some(previous) => Some(self.flow.flow_near(previous, picture, &self.tracker.places())?),
            None => None,
        };
        let mut by = BoxSource::Motion;
        let mut found = Vec::new();
        if let Some(detector) = self.detector.as_mut().filter(|_| detects) {
            self.boxes = detector.detect(picture)?;
            (self.looked_s[0], by) = (frame.time_s, BoxSource::Detector);
            found = self.boxes.iter().cloned().map(Into::into).collect();
        }
        // Masks are worth the most where the detector looks as well.
        let segments = segments && (detects || self.detector.is_none());
        if segments {
            self.looked_s[1] = frame.time_s;
        }
        let prompter = if segments { Some(&mut *self.segmenter as &mut dyn BoxSegmenter) } else { None };
        let input = FrameInput::Boxes { found, by, prompter };
        self.masks = self.tracker.advance(frame, picture, input, flow.as_ref())?;
        self.previous = Some(picture.clone());
        self.tracker.take_finished();
        let corrected = self.tracker.take_corrections();
        let corrected = corrected.iter().filter_map(|c| Outlined::of(c.object, c.frame, &c.mask));
        let new = self.masks.iter().filter_map(|m| Outlined::of(m.object, frame.id, &m.mask));
        Ok(new.chain(corrected).collect())
    }

    /// Masks of the last frame.
    pub(super) fn masks(&self) -> &[TrackedMask] {
        &self.masks
    }

    /// The pixels that show background: neither near the detector's last boxes nor near what is followed.
    pub(super) fn background(&self, (width, height): (u32, u32), dilation_px: u32) -> Mask {
        let mut mask = Mask::full(width, height);
        let margin = f64::from(dilation_px);
        for rect in self.boxes.iter().map(|found| found.rect).chain(self.tracker.places()) {
            let rect = Rect { x0: rect.x0 - margin, y0: rect.y0 - margin, x1: rect.x1 + margin, y1: rect.y1 + margin };
            let rect = rect.clipped(width, height);
            for y in rect.y0.floor() as u32..rect.y1.ceil() as u32 {
                let row = (y * width) as usize;
                let (first, end) = (row + rect.x0.floor() as usize, row + rect.x1.ceil() as usize);
                if first < end {
                    mask.pixels_mut()[first..end].fill(false);
                }
            }
        }
        mask
    }

    /// Confirmed objects by their provisional ids.
    pub(super) fn identities(&self) -> BTreeMap<ObjectId, Identity> {
        let identity = |found: crate::tracking::ConfirmedObject<'_>| {
            let (id, class, confidence) = (found.id, found.class.to_owned(), found.confidence);
            (found.provisional, Identity { id, class, confidence })
        };
        self.tracker.confirmed().map(identity).collect()
    }
}
