//! The tracker: one step per frame.

use std::cmp::Ordering;

use ::image::RgbImage;

use super::appearance::Appearance;
use super::box_groups::BoxGroup;
use super::boxes::FrameView;
use super::occlusion::ImagePair;
use super::propagation::{PreviousObject, background_displacement, propagate_object};
use super::region::Region;
use super::retrace::{Correction, Reported};
use super::track::{Moment, Prediction, Recognized, Track};
use super::{ConfirmedObject, Evidence, FrameInput, IgnoredBoxes, TrackSummary, TrackedMask, TrackerOptions};
use crate::networks::PerceptionError;
use crate::scene::{Flow, Frame, FrameId, Mask, ObjectId, Rect};

/// Maximum share of a new mask inside a tracked object; above it, the mask starts no track of its own.
pub(super) const MAX_COVERED: f64 = 0.6;

/// Tracks objects from frame to frame; see the module.
#[derive(Clone, Debug, Default)]
pub struct Tracker {
    pub(super) options: TrackerOptions,
    pub(super) tracks: Vec<Track>,
    /// Unassociated boxes that wait for the next frame with segmentation.
    pub(super) pending: Vec<BoxGroup>,
    pub(super) num_started: u32,
    finished: Vec<TrackSummary>,
    num_confirmed: u32,
    num_frames: usize,
    pub(super) last_frame: Option<(FrameId, f64, (u32, u32))>,
    /// Image of the last frame.
    pub(super) last_image: Option<RgbImage>,
    /// Masks reported for the latest frames.
    pub(super) reported: Reported,
    /// Masks of this frame's objects in earlier frames, propagated back from new ones.
    pub(super) retraced: Vec<(FrameId, ObjectId, Region)>,
    corrections: Vec<Correction>,
    pub(super) ignored: IgnoredBoxes,
}

/// Observation of a track in the current frame.
pub(super) struct TrackObservation {
    pub(super) track_idx: usize,
    pub(super) evidence: Evidence,
    pub(super) region: Region,
}

impl Tracker {
    /// Creates a tracker without tracks.
    pub fn new(options: TrackerOptions) -> Self {
        Self { options, ..Self::default() }
    }

    /// Processes the next frame.
    ///
    /// * `image` – the frame's pixels, for appearance and occlusion.
    /// * `input` – its detections.
    /// * `flow` – from the frame given before to this one; without it objects are predicted by their velocity alone.
    ///
    /// Returns the masks of this frame, ascending by provisional id; they do not overlap.
    ///
    /// # Errors
    /// [`PerceptionError::SizeMismatch`] if image, masks and flow differ in size, [`PerceptionError::FrameOrder`] if
    /// the frame is not later than the last one; errors of the segmenter.
    pub fn advance(
        &mut self,
        frame: &Frame,
        image: &RgbImage,
        input: FrameInput<'_>,
        flow: Option<&Flow>,
    ) -> Result<Vec<TrackedMask>, PerceptionError> {
        let elapsed_s = self.check(frame, image, flow, Ordering::Greater)?;
        let now = Moment { count: self.num_frames, frame: frame.id, time_s: frame.time_s };
        let view = FrameView { image, flow, now, elapsed_s };
        let FrameInput { found, by, segmenter } = input;
        self.num_frames += 1;
        self.tracks.iter_mut().for_each(|track| track.statistics.count_frame(by));
        let observations = self.advance_tracks(&view, found, segmenter)?;
        let masks = self.report(observations, frame.id, Vec::new(), image.dimensions());
        self.confirm_and_finish(now);
        self.last_frame = Some((frame.id, frame.time_s, image.dimensions()));
        self.last_image = Some(image.clone());
        Ok(masks)
    }

    /// Regions in which flow is needed: those of all tracks and pending boxes.
    pub fn flow_regions(&self) -> Vec<Rect> {
        let tracked = self.tracks.iter().map(|track| track.whole.rect());
        tracked.chain(self.pending.iter().map(|group| group.rect)).collect()
    }

    /// Confirmed objects whose tracks have not ended.
    pub fn confirmed(&self) -> impl Iterator<Item = ConfirmedObject<'_>> {
        self.tracks.iter().filter_map(Track::confirmed)
    }

    /// Summaries of confirmed objects whose tracks ended since the last call; [`Tracker::finish`] does not repeat them.
    pub fn take_finished(&mut self) -> Vec<TrackSummary> {
        std::mem::take(&mut self.finished)
    }

    /// Improved masks of earlier frames since the last call; they replace those reported before.
    pub fn take_corrections(&mut self) -> Vec<Correction> {
        std::mem::take(&mut self.corrections)
    }

    /// Boxes of stationary objects that were ignored so far.
    pub fn ignored_boxes(&self) -> IgnoredBoxes {
        self.ignored
    }

    /// Ends all tracks; returns the summaries of confirmed objects, ascending by final id.
    pub fn finish(mut self) -> Vec<TrackSummary> {
        self.finished.extend(self.tracks.iter().filter_map(Track::summary));
        self.finished.sort_by_key(|summary| summary.id);
        self.finished
    }

    /// Checks order and sizes; returns the seconds between the frame and the one given before, 0 for the first.
    ///
    /// * `order` – of this frame relative to the one before.
    pub(super) fn check(
        &self,
        frame: &Frame,
        image: &RgbImage,
        flow: Option<&Flow>,
        order: Ordering,
    ) -> Result<f64, PerceptionError> {
        self.options.check()?;
        self.check_size("the image", frame, image, image.dimensions())?;
        flow.map_or(Ok(()), |flow| self.check_size("the flow", frame, image, (flow.width, flow.height)))?;
        match self.last_frame {
            Some((previous, ..)) if frame.id.cmp(&previous) != order => {
                Err(PerceptionError::FrameOrder { previous, found: frame.id })
            }
            Some((_, time_s, _)) if order == Ordering::Greater => Ok((frame.time_s - time_s).max(0.0)),
            Some((_, time_s, _)) => Ok((time_s - frame.time_s).max(0.0)),
            None => Ok(0.0),
        }
    }

    /// Checks that an input has the size of the frames, which is that of the first one.
    pub(super) fn check_size(
        &self,
        what: &str,
        frame: &Frame,
        image: &RgbImage,
        found: (u32, u32),
    ) -> Result<(), PerceptionError> {
        let expected = self.last_frame.map_or(image.dimensions(), |(_, _, size)| size);
        if found == expected {
            return Ok(());
        }
        Err(PerceptionError::SizeMismatch { what: format!("{what} of {}", frame.name), expected, found })
    }

    /// Predicts all tracks.
    pub(super) fn predict(&self, flow: Option<&Flow>, image: &RgbImage, elapsed_s: f64) -> Vec<Prediction> {
        let size = image.dimensions();
        let images = self.last_image.as_ref().map(|before| ImagePair { before, now: image });
        let mut occupied = Mask::empty(size.0, size.1);
        self.tracks.iter().for_each(|track| occupied.union_with(track.region.mask()));
        let predict_one = |track: &Track| {
            let background = flow.and_then(|f| background_displacement(f, track.region.bounds(), &occupied));
            let background = background.unwrap_or_default();
            let previous = PreviousObject { region: &track.region, whole: &track.whole, occlusion: &track.occlusion };
            let propagated =
                flow.filter(|_| !track.is_lost()).and_then(|flow| propagate_object(&previous, flow, images));
            let moved = track.whole.moved(track.expected(background, elapsed_s));
            Prediction { propagated, moved, background }
        };
        self.tracks.iter().map(predict_one).collect()
    }

    /// Adds a new track and links it to the lost object that it may continue.
    pub(super) fn add(&mut self, mut track: Track, appearance: Option<&Appearance>, now: Moment) {
        let recognized = |lost: &Track| {
            let is_compatible = lost.may_be_succeeded(now) && lost.is_compatible(Some(track.class()));
            let found = lost.recognize(&track.region, appearance, now);
            found.filter(|_| is_compatible)
        };
        let lost = self.tracks.iter().enumerate().filter_map(|(idx, lost)| Some((idx, recognized(lost)?)));
        let best = lost.max_by(|a, b| a.1.score.total_cmp(&b.1.score).then(b.0.cmp(&a.0)));
        if let Some((idx, Recognized { evidence, .. })) = best {
            track.link_after(&mut self.tracks[idx], evidence);
        }
        self.tracks.push(track);
    }

    /// Resolves the masks of the frame, so that they do not overlap.
    ///
    /// Each pixel goes to one object: to a detected one before a prompted one before a propagated one, then by
    /// confidence. Masks that were propagated back to earlier frames become corrections.
    ///
    /// * `known` – other objects with pixels in the frame.
    pub(super) fn report(
        &mut self,
        mut observations: Vec<TrackObservation>,
        frame: FrameId,
        known: Vec<(ObjectId, Region)>,
        (width, height): (u32, u32),
    ) -> Vec<TrackedMask> {
        let rank = |s: &TrackObservation| match s.evidence {
            Evidence::Detected { confidence } => confidence,
            Evidence::Prompted { quality } => quality - 1.0,
            Evidence::Carried => -1.0,
        };
        observations.sort_by(|a, b| rank(b).total_cmp(&rank(a)).then(a.track_idx.cmp(&b.track_idx)));
        let mut taken = Mask::empty(width, height);
        let mut masks = Vec::with_capacity(observations.len());
        let mut reported = known;
        for observation in observations {
            let free = |x: u32, y: u32| !taken.get(i64::from(x), i64::from(y));
            let Some(region) = observation.region.filtered(free) else { continue };
            let mask = region.mask().clone();
            taken.union_with(&mask);
            let object = self.tracks[observation.track_idx].provisional;
            reported.push((object, region));
            masks.push(TrackedMask { object, mask, evidence: observation.evidence });
        }
        masks.sort_by_key(|m| m.object);
        self.reported.remember(frame, reported);
        for (frame, object, region) in std::mem::take(&mut self.retraced) {
            self.corrections.extend(self.reported.correct(frame, object, &region));
        }
        masks
    }

    /// Assigns final ids and ends finished tracks.
    fn confirm_and_finish(&mut self, now: Moment) {
        for track in &mut self.tracks {
            if track.is_confirmable(&self.options) {
                self.num_confirmed += 1;
                track.id = Some(ObjectId(self.num_confirmed));
            }
        }
        let finished = &mut self.finished;
        self.tracks.retain(|track| {
            let is_finished = track.is_finished(now);
            if is_finished {
                finished.extend(track.summary());
            }
            !is_finished
        });
    }
}
