//! Tracks from what was found in the frames: masks of a network of the user's, or boxes whose masks are asked for.

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

/// Detections of a run, and whom to ask for their masks.
pub(super) enum Finds {
    /// Of a segmentation network of the user's, which looked at every frame.
    Masks {
        folder: segment::DetectionFolder,
        /// Those of the current frame.
        known: KnownMasks,
    },
    /// Of the detector and of motion; masks are asked for in some frames.
    Boxes {
        detected: segment::BoxFolder,
        moving: FrameFolder<BoxDetection>,
        prompter: CachedSegmenter,
        rhythm: Schedule,
    },
}

impl Finds {
    /// Of a network of the user's; the stage `segment` must be done.
    pub(super) fn masks(run: &Run) -> Self {
        Self::Masks { folder: segment::finished(run), known: KnownMasks::default() }
    }

    /// Of the detector and of motion, whose stages must be done.
    ///
    /// * `answers` – folder for the masks that were asked for.
    pub(super) fn boxes(run: &Run, answers: PathBuf, outcome: &mut Outcome) -> Result<Self> {
        let prompter = CachedSegmenter::new(Networks::of(run)?.load_box_segmenter(run)?, answers);
        if prompter.is_coarse() {
            outcome.warn(
                Topic::MasksCoarse.warning("masks are coarse, by color only: no mask network; run `tractrix doctor`"),
            );
        }
        let (detected, moving) = (segment::finished_boxes(run), motion::boxes(run));
        Ok(Self::Boxes { detected, moving, prompter, rhythm: Schedule::of(run)? })
    }

    /// Options of the tracker. Masks that are known already cost nothing: even those of what stands are all taken.
    pub(super) fn tracker_options(&self, run: &Run) -> TrackerOptions {
        let options = run.options.tracker.clone();
        match self {
            Self::Masks { .. } => TrackerOptions { max_rest_secs: 0.0, ..options },
            Self::Boxes { .. } => options,
        }
    }

    /// Whom to ask for masks in a frame that is looked at again, from the end on; nobody in frames between.
    pub(super) fn prompter_backward(&mut self, run: &Run, frame: &Frame) -> Result<Option<&mut dyn BoxSegmenter>> {
        Ok(match self {
            Self::Masks { folder, known } => {
                *known = KnownMasks::new(folder.read_masks(frame.id, run.size(), |found| &found.mask)?);
                Some(known)
            }
            Self::Boxes { prompter, rhythm, .. } => {
                prompter.begin(frame.id, Pass::Backward);
                (frame.id.0 as usize).is_multiple_of(rhythm.masks).then_some(prompter as &mut dyn BoxSegmenter)
            }
        })
    }

    /// Input of the tracker for the `index`-th frame.
    fn look(&mut self, run: &Run, index: usize, frame: &Frame) -> Result<FrameInput<'_>> {
        Ok(match self {
            Self::Masks { folder, known } => {
                let detections = folder.read_masks(frame.id, run.size(), |found| &found.mask)?;
                let found = DetectedBox::of_masks(&detections);
                *known = KnownMasks::new(detections);
                FrameInput { found, by: BoxSource::Detector, prompter: Some(known) }
            }
            Self::Boxes { detected, moving, prompter, rhythm } => {
                let mut found = stationary_boxes::boxes(run, detected, frame.id)?;
                found.extend(moving.read(frame.id)?.into_iter().map(DetectedBox::from));
                prompter.begin(frame.id, Pass::Forward);
                let by = if rhythm.is_detected(index) { BoxSource::Detector } else { BoxSource::Motion };
                FrameInput { found, by, prompter: if rhythm.is_asked(index) { Some(prompter) } else { None } }
            }
        })
    }
}

/// An object that was followed.
#[derive(Clone)]
pub(super) struct Followed {
    pub(super) summary: TrackSummary,
    /// Frames in which it has a mask, ascending.
    pub(super) frames: Vec<FrameId>,
    /// Objects seen later that might be this one.
    pub(super) apart: Vec<UnmergedTrack>,
}

impl Followed {
    /// The object, before anything is known of its motion.
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

/// Follows what was found from frame to frame by optical flow; writes the masks into `folder`.
pub(super) fn follow(run: &Run, finds: &mut Finds, folder: &Path, outcome: &mut Outcome) -> Result<Vec<Followed>> {
    let frames = run.frames()?;
    let names: BTreeMap<FrameId, &Frame> = frames.iter().map(|frame| (frame.id, frame)).collect();
    let mut flow = super::load_flow_estimator(run)?;
    let mut tracker = Tracker::new(finds.tracker_options(run));
    let mut previous: Option<RgbImage> = None;
    let mut seen: BTreeMap<ObjectId, BTreeSet<FrameId>> = BTreeMap::new();
    let mut index = 0;
    let wanted = names.keys().copied().collect();
    images::for_each(run, Stage::Track, wanted, outcome, |frame, picture| {
        let near = |previous| flow.flow(previous, &picture, &tracker.places());
        let carried = previous.as_ref().map(near).transpose()?;
        let look = finds.look(run, index, &frame)?;
        for TrackedMask { object, mask, .. } in tracker.advance(&frame, &picture, look, carried.as_ref())? {
            masks::write_mask(&provisional(folder, object).join(RunFolder::mask_name(&frame)), &mask)?;
            seen.entry(object).or_default().insert(frame.id);
        }
        for Correction { frame, object, mask } in tracker.take_corrections() {
            if let Some(frame) = names.get(&frame) {
                masks::write_mask(&provisional(folder, object).join(RunFolder::mask_name(frame)), &mask)?;
            }
        }
        previous = Some(picture);
        index += 1;
        Ok(())
    })?;
    say_passed_over(tracker.passed_over(), run, outcome);
    let summaries = tracker.finish();
    let objects =
        summaries.into_iter().map(|summary| settle(folder, summary, &mut seen, &names)).collect::<Result<_, _>>()?;
    for dropped in seen.into_keys() {
        atomic::remove_folder(&provisional(folder, dropped))?;
    }
    Ok(objects)
}

/// Says what is not followed although a detector names it.
fn say_passed_over(IgnoredBoxes { num_boxes, max_confidence }: IgnoredBoxes, run: &Run, outcome: &mut Outcome) {
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

/// Gives a confirmed object its lasting id, without the masks that nothing confirms.
fn settle(
    folder: &Path,
    summary: TrackSummary,
    seen: &mut BTreeMap<ObjectId, BTreeSet<FrameId>>,
    names: &BTreeMap<FrameId, &Frame>,
) -> Result<Followed> {
    let from = provisional(folder, summary.provisional);
    let mut frames = seen.remove(&summary.provisional).unwrap_or_default();
    let confirmed = summary.first..=summary.last;
    for frame in frames.extract_if(.., |frame| !confirmed.contains(frame)) {
        if let Some(frame) = names.get(&frame) {
            let mask = from.join(RunFolder::mask_name(frame));
            std::fs::remove_file(&mask).map_err(IoError::system("remove", &mask))?;
        }
    }
    let to = folder.join(summary.id.to_string());
    std::fs::rename(&from, &to).map_err(IoError::system("rename", &from))?;
    Ok(Followed { summary, frames: frames.into_iter().collect(), apart: Vec::new() })
}
