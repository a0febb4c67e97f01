//! The tracker: one step per frame.

use std::cmp::Ordering;

use ::image::RgbImage;

use super::appearance::Appearance;
use super::box_groups::BoxGroup;
use super::boxes::FrameView;
use super::occlusion::Pictures;
use super::propagation::{PreviousObject, background_displacement, carry_whole};
use super::region::Region;
use super::retrace::{Correction, Reported};
use super::track::{Moment, Prediction, Recognised, Track};
use super::{ConfirmedObject, Evidence, FrameInput, IgnoredBoxes, TrackSummary, TrackedMask, TrackerOptions};
use crate::networks::PerceptionError;
use crate::scene::{Flow, Frame, FrameId, Mask, ObjectId, Rect};

/// A detection of which more than this share lies in an object that is already followed starts no track of its own.
pub(super) const MAX_COVERED: f64 = 0.6;

/// Follows objects from frame to frame; see the module.
#[derive(Clone, Debug, Default)]
pub struct Tracker {
    pub(super) options: TrackerOptions,
    pub(super) tracks: Vec<Track>,
    /// Boxes that show nothing that is followed and whose masks nobody asked for yet.
    pub(super) waiting: Vec<BoxGroup>,
    pub(super) num_started: u32,
    finished: Vec<TrackSummary>,
    num_confirmed: u32,
    num_looks: usize,
    pub(super) last_frame: Option<(FrameId, f64, (u32, u32))>,
    /// The picture of the last frame.
    pub(super) last_picture: Option<RgbImage>,
    /// Masks reported for the latest frames.
    pub(super) reported: Reported,
    /// Masks of this frame's objects in earlier frames, carried back from new ones.
    pub(super) retraced: Vec<(FrameId, ObjectId, Region)>,
    corrections: Vec<Correction>,
    pub(super) passed_over: IgnoredBoxes,
}

/// Outcome of a track in the current frame.
pub(super) struct TrackObservation {
    pub(super) track_idx: usize,
    pub(super) evidence: Evidence,
    pub(super) region: Region,
}

impl Tracker {
    /// A tracker that has seen nothing yet.
    pub fn new(options: TrackerOptions) -> Self {
        Self { options, ..Self::default() }
    }

    /// Takes the next frame.
    ///
    /// * `image` – the frame's pixels, for appearance.
    /// * `look` – what was found in it.
    /// * `flow` – from the frame given before to this one; without it objects are followed by their velocity alone.
    ///
    /// Returns the masks of this frame, ascending by provisional id; they do not overlap.
    ///
    /// # Errors
    /// [`PerceptionError::SizeMismatch`] if image, masks and flow differ in size, [`PerceptionError::FrameOrder`] if
    /// the frame is not later than the last one; whatever the prompter runs into.
    pub fn advance(
        &mut self,
        frame: &Frame,
        image: &RgbImage,
        look: FrameInput<'_>,
        flow: Option<&Flow>,
    ) -> Result<Vec<TrackedMask>, PerceptionError> {
        let elapsed_s = self.check(frame, image, flow, Ordering::Greater)?;
        let now = Moment { count: self.num_looks, frame: frame.id, time_s: frame.time_s };
        let view = FrameView { image, flow, now, elapsed_s };
        let FrameInput { found, by, prompter } = look;
        self.num_looks += 1;
        self.tracks.iter_mut().for_each(|track| track.ledger.look(by));
        let sightings = self.follow_boxes(&view, found, prompter)?;
        let masks = self.report(sightings, frame.id, Vec::new(), image.dimensions());
        self.settle(now);
        self.last_frame = Some((frame.id, frame.time_s, image.dimensions()));
        self.last_picture = Some(image.clone());
        Ok(masks)
    }

    /// The places in which flow is of use: those of all that is followed or waits.
    pub fn places(&self) -> Vec<Rect> {
        let followed = self.tracks.iter().map(|track| track.whole.rect());
        followed.chain(self.waiting.iter().map(|sight| sight.rect)).collect()
    }

    /// Objects that have a lasting id and are not over.
    pub fn confirmed(&self) -> impl Iterator<Item = ConfirmedObject<'_>> {
        self.tracks.iter().filter_map(Track::confirmed)
    }

    /// Summaries of the objects that are over, since the last call; [`Tracker::finish`] does not give them again.
    pub fn take_finished(&mut self) -> Vec<TrackSummary> {
        std::mem::take(&mut self.finished)
    }

    /// Masks of earlier frames that are better known since the last call; they take the place of those reported then.
    pub fn take_corrections(&mut self) -> Vec<Correction> {
        std::mem::take(&mut self.corrections)
    }

    /// Stationary objects that were not followed so far.
    pub fn passed_over(&self) -> IgnoredBoxes {
        self.passed_over
    }

    /// Ends all tracks. Returns the confirmed ones, ascending by lasting id.
    pub fn finish(mut self) -> Vec<TrackSummary> {
        self.finished.extend(self.tracks.iter().filter_map(Track::summary));
        self.finished.sort_by_key(|summary| summary.id);
        self.finished
    }

    /// Checks order and sizes; gives the seconds between the frame and the one given before, 0 for the first.
    ///
    /// * `order` – of this frame and the one before.
    pub(super) fn check(
        &self,
        frame: &Frame,
        image: &RgbImage,
        flow: Option<&Flow>,
        order: Ordering,
    ) -> Result<f64, PerceptionError> {
        self.options.check()?;
        self.same_size("the image", frame, image, image.dimensions())?;
        flow.map_or(Ok(()), |flow| self.same_size("the flow", frame, image, (flow.width, flow.height)))?;
        match self.last_frame {
            Some((previous, ..)) if frame.id.cmp(&previous) != order => {
                Err(PerceptionError::FrameOrder { previous, found: frame.id })
            }
            Some((_, time_s, _)) if order == Ordering::Greater => Ok((frame.time_s - time_s).max(0.0)),
            Some((_, time_s, _)) => Ok((time_s - frame.time_s).max(0.0)),
            None => Ok(0.0),
        }
    }

    /// Refuses what has not the size of the frames, which is that of the first one.
    pub(super) fn same_size(
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

    /// Where each track should be now.
    pub(super) fn predict(&self, flow: Option<&Flow>, image: &RgbImage, elapsed_s: f64) -> Vec<Prediction> {
        let size = image.dimensions();
        let pictures = self.last_picture.as_ref().map(|before| Pictures { before, now: image });
        let mut occupied = Mask::empty(size.0, size.1);
        self.tracks.iter().for_each(|track| occupied.union_with(track.region.mask()));
        let predict_one = |track: &Track| {
            let background = flow.and_then(|f| background_displacement(f, track.region.bounds(), &occupied));
            let background = background.unwrap_or_default();
            let seen = PreviousObject { region: &track.region, whole: &track.whole, cover: &track.cover };
            let carried = flow.filter(|_| !track.is_lost()).and_then(|flow| carry_whole(&seen, flow, pictures));
            let moved = track.whole.moved(track.expected(background, elapsed_s));
            Prediction { carried, moved, background }
        };
        self.tracks.iter().map(predict_one).collect()
    }

    /// Adds a new track; where a lost object may have come up again, it remembers which.
    pub(super) fn add(&mut self, mut track: Track, appearance: Option<&Appearance>, now: Moment) {
        let recognised = |lost: &Track| {
            let may_be = lost.may_be_succeeded(now) && lost.may_be(Some(track.class()));
            let found = lost.recognise(&track.region, appearance, now);
            found.filter(|_| may_be)
        };
        let lost = self.tracks.iter().enumerate().filter_map(|(idx, lost)| Some((idx, recognised(lost)?)));
        let best = lost.max_by(|a, b| a.1.score.total_cmp(&b.1.score).then(b.0.cmp(&a.0)));
        if let Some((idx, Recognised { evidence, .. })) = best {
            track.follow_after(&mut self.tracks[idx], evidence);
        }
        self.tracks.push(track);
    }

    /// The masks of the frame: each pixel goes to one object, to a detected one before a prompted one before a carried
    /// one, and to the surer first. Masks that were carried back to earlier frames become corrections.
    ///
    /// * `known` – what else has pixels in the frame.
    pub(super) fn report(
        &mut self,
        mut sightings: Vec<TrackObservation>,
        frame: FrameId,
        known: Vec<(ObjectId, Region)>,
        (width, height): (u32, u32),
    ) -> Vec<TrackedMask> {
        let rank = |s: &TrackObservation| match s.evidence {
            Evidence::Detected { confidence } => confidence,
            Evidence::Prompted { quality } => quality - 1.0,
            Evidence::Carried => -1.0,
        };
        sightings.sort_by(|a, b| rank(b).total_cmp(&rank(a)).then(a.track_idx.cmp(&b.track_idx)));
        let mut taken = Mask::empty(width, height);
        let mut masks = Vec::with_capacity(sightings.len());
        let mut reported = known;
        for sighting in sightings {
            let free = |x: u32, y: u32| !taken.get(i64::from(x), i64::from(y));
            let Some(region) = sighting.region.filtered(free) else { continue };
            let mask = region.mask().clone();
            taken.union_with(&mask);
            let object = self.tracks[sighting.track_idx].provisional;
            reported.push((object, region));
            masks.push(TrackedMask { object, mask, evidence: sighting.evidence });
        }
        masks.sort_by_key(|m| m.object);
        self.reported.remember(frame, reported);
        for (frame, object, region) in std::mem::take(&mut self.retraced) {
            self.corrections.extend(self.reported.correct(frame, object, &region));
        }
        masks
    }

    /// Gives lasting ids and ends what is over.
    fn settle(&mut self, now: Moment) {
        for track in &mut self.tracks {
            if track.earns_id(&self.options) {
                self.num_confirmed += 1;
                track.id = Some(ObjectId(self.num_confirmed));
            }
        }
        let finished = &mut self.finished;
        self.tracks.retain(|track| {
            let over = track.is_over(now);
            if over {
                finished.extend(track.summary());
            }
            !over
        });
    }
}
