//! Tracks from the detections of the frames: masks of a user's network, or boxes with prompted masks.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use ::image::RgbImage;

use super::cached_prompts::{CachedSegmenter, Pass};
use crate::io::{IoError, RunFolder, atomic, masks};
use crate::math::rounding::counted;
use crate::networks::{BoxSegmenter, KnownMasks};
use crate::pipeline::driver::run::{Outcome, Run};
use crate::pipeline::inputs::images;
use crate::pipeline::inputs::networks::Networks;
use crate::pipeline::stages::motion::stationary_boxes;
use crate::pipeline::stages::segment::detections::FrameFolder;
use crate::pipeline::stages::segment::schedule::Schedule;
use crate::pipeline::stages::{motion, segment};
use crate::pipeline::{Result, Stage};
use crate::scene::{BoxDetection, Frame, FrameId, ObjectId, Topic, TrackedObject, UnmergedTrack};
use crate::tracking::{
    BoxSource, Correction, DetectedBox, FrameInput, IgnoredBoxes, TrackSummary, TrackedMask, Tracker, TrackerOptions,
};

/// Detections of a run, with the segmenter of their masks.
pub(super) enum Detections {
    /// Masks of a user's segmentation network, which ran on every frame.
    Masks {
        folder: segment::DetectionFolder,
        /// Masks of the current frame.
        known: KnownMasks,
    },
    /// Boxes of the detector and of motion detection; masks are prompted in some frames.
    Boxes {
        detected: segment::BoxFolder,
        moving: FrameFolder<BoxDetection>,
        segmenter: CachedSegmenter,
        schedule: Schedule,
    },
}

impl Detections {
    /// Detections of a user's network; the stage `segment` must be done.
    pub(super) fn masks(run: &Run) -> Self {
        Self::Masks { folder: segment::finished(run), known: KnownMasks::default() }
    }

    /// Boxes of the detector and of motion detection, whose stages must be done.
    ///
    /// * `answers` – folder for prompted masks.
    pub(super) fn boxes(run: &Run, answers: PathBuf, outcome: &mut Outcome) -> Result<Self> {
        let segmenter = CachedSegmenter::new(Networks::of(run)?.load_box_segmenter(run)?, answers);
        if segmenter.is_coarse() {
            outcome.warn(
                Topic::MasksCoarse.warning("masks are coarse, by color only: no mask network; run `tractrix doctor`"),
            );
        }
        let (detected, moving) = (segment::finished_boxes(run), motion::boxes(run));
        Ok(Self::Boxes { detected, moving, segmenter, schedule: Schedule::of(run)? })
    }

    /// Options of the tracker.
    ///
    /// Known masks cost nothing: even those of stationary objects are all used.
    pub(super) fn tracker_options(&self, run: &Run) -> TrackerOptions {
        let options = run.options.tracker.clone();
        match self {
            Self::Masks { .. } => TrackerOptions { max_rest_secs: 0.0, ..options },
            Self::Boxes { .. } => options,
        }
    }

    /// Segmenter for a frame of the backward pass; `None` in frames without segmentation.
    pub(super) fn segmenter_backward(&mut self, run: &Run, frame: &Frame) -> Result<Option<&mut dyn BoxSegmenter>> {
        Ok(match self {
            Self::Masks { folder, known } => {
                *known = KnownMasks::new(folder.read_masks(frame.id, run.size(), |found| &found.mask)?);
                Some(known)
            }
            Self::Boxes { segmenter, schedule, .. } => {
                segmenter.begin(frame.id, Pass::Backward);
                (frame.id.0 as usize).is_multiple_of(schedule.masks).then_some(segmenter as &mut dyn BoxSegmenter)
            }
        })
    }

    /// Input of the tracker for the `index`-th frame.
    fn input(&mut self, run: &Run, index: usize, frame: &Frame) -> Result<FrameInput<'_>> {
        Ok(match self {
            Self::Masks { folder, known } => {
                let detections = folder.read_masks(frame.id, run.size(), |found| &found.mask)?;
                let found = DetectedBox::of_masks(&detections);
                *known = KnownMasks::new(detections);
                FrameInput { found, by: BoxSource::Detector, segmenter: Some(known) }
            }
            Self::Boxes { detected, moving, segmenter, schedule } => {
                let mut found = stationary_boxes::boxes(run, detected, frame.id)?;
                found.extend(moving.read(frame.id)?.into_iter().map(DetectedBox::from));
                segmenter.begin(frame.id, Pass::Forward);
                let by = if schedule.is_detected(index) { BoxSource::Detector } else { BoxSource::Motion };
                FrameInput { found, by, segmenter: if schedule.is_segmented(index) { Some(segmenter) } else { None } }
            }
        })
    }
}

/// Track of an object.
#[derive(Clone)]
pub(super) struct ObjectTrack {
    pub(super) summary: TrackSummary,
    /// Frames in which it has a mask, ascending.
    pub(super) frames: Vec<FrameId>,
    /// Objects that appear later and might be this one.
    pub(super) apart: Vec<UnmergedTrack>,
}

impl ObjectTrack {
    /// The object, before its motion is known.
    pub(super) fn object(&self) -> TrackedObject {
        TrackedObject {
            id: self.summary.id,
            class: self.summary.class.clone(),
            confidence: self.summary.confidence,
            found_in: self.summary.found,
            outline: self.summary.outline,
            mask_quality: self.summary.mask_quality,
            movement: super::movement::unknown(),
            left_out: None,
            frames: self.frames.clone(),
            gaps: self.summary.gaps.clone(),
            apart: self.apart.clone(),
        }
    }
}

/// Tracks the detections from frame to frame by optical flow; writes the masks into `folder`.
pub(super) fn track_forward(
    run: &Run,
    detections: &mut Detections,
    folder: &Path,
    outcome: &mut Outcome,
) -> Result<Vec<ObjectTrack>> {
    let frames = run.frames()?;
    let names: BTreeMap<FrameId, &Frame> = frames.iter().map(|frame| (frame.id, frame)).collect();
    let mut flow = super::load_flow_estimator(run)?;
    let mut tracker = Tracker::new(detections.tracker_options(run));
    let mut previous: Option<RgbImage> = None;
    let mut frames_of: BTreeMap<ObjectId, BTreeSet<FrameId>> = BTreeMap::new();
    let mut index = 0;
    let wanted = names.keys().copied().collect();
    images::for_each(run, Stage::Track, wanted, outcome, |frame, image| {
        let flow_from = |previous| flow.flow(previous, &image, &tracker.flow_regions());
        let flow = previous.as_ref().map(flow_from).transpose()?;
        let input = detections.input(run, index, &frame)?;
        for TrackedMask { object, mask, .. } in tracker.advance(&frame, &image, input, flow.as_ref())? {
            masks::write_mask(&provisional(folder, object).join(RunFolder::mask_name(&frame)), &mask)?;
            frames_of.entry(object).or_default().insert(frame.id);
        }
        for Correction { frame, object, mask } in tracker.take_corrections() {
            if let Some(frame) = names.get(&frame) {
                masks::write_mask(&provisional(folder, object).join(RunFolder::mask_name(frame)), &mask)?;
            }
        }
        previous = Some(image);
        index += 1;
        Ok(())
    })?;
    report_ignored(tracker.ignored_boxes(), run, outcome);
    let summaries = tracker.finish();
    let objects = summaries
        .into_iter()
        .map(|summary| finalize(folder, summary, &mut frames_of, &names))
        .collect::<Result<_, _>>()?;
    for dropped in frames_of.into_keys() {
        atomic::remove_folder(&provisional(folder, dropped))?;
    }
    Ok(objects)
}

/// Reports the detections that were ignored because they are stationary.
fn report_ignored(IgnoredBoxes { num_boxes, max_confidence }: IgnoredBoxes, run: &Run, outcome: &mut Outcome) {
    if num_boxes > 0 {
        outcome.figure("num_standing_boxes", num_boxes);
        let detections = counted(num_boxes, "detection");
        outcome.warn(Topic::DetectionsIgnored.warning(format!(
            "{detections} ignored: stationary, detector score at most {max_confidence:.2} (threshold \
             tracker.start_standing = {})",
            run.options.tracker.start_standing
        )));
    }
}

fn provisional(folder: &Path, id: ObjectId) -> PathBuf {
    folder.join(format!("provisional-{id}"))
}

/// Renames the masks of a confirmed object to its final id, without the unconfirmed ones.
fn finalize(
    folder: &Path,
    summary: TrackSummary,
    frames_of: &mut BTreeMap<ObjectId, BTreeSet<FrameId>>,
    names: &BTreeMap<FrameId, &Frame>,
) -> Result<ObjectTrack> {
    let from = provisional(folder, summary.provisional);
    let mut frames = frames_of.remove(&summary.provisional).unwrap_or_default();
    let confirmed = summary.first..=summary.last;
    for frame in frames.extract_if(.., |frame| !confirmed.contains(frame)) {
        if let Some(frame) = names.get(&frame) {
            let mask = from.join(RunFolder::mask_name(frame));
            std::fs::remove_file(&mask).map_err(IoError::system("remove", &mask))?;
        }
    }
    let to = folder.join(summary.id.to_string());
    std::fs::rename(&from, &to).map_err(IoError::system("rename", &from))?;
    Ok(ObjectTrack { summary, frames: frames.into_iter().collect(), apart: Vec::new() })
}
