//! Objects before they were found: their masks, followed back in time.
//!
//! A detector may see a vehicle late, and a track starts only where somebody asks for a mask. When all frames are
//! through, the frames are given again, the last one first, and every object is followed from its first mask to earlier
//! frames: by flow, and by masks asked for in the box of the carried one. Memory is one mask per object.
//!
//! An object is followed no further where it leaves the picture or becomes too small, where flow, colours or the new
//! masks fail, or where another object has its pixels.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use ::image::RgbImage;

use super::appearance::Appearance;
use super::boxes::FrameView;
use super::region::Region;
use super::track::{Moment, Track};
use super::tracker::{TrackObservation, Tracker};
use super::{Correction, TrackSummary, TrackedMask, TrackerOptions};
use crate::networks::{BoxSegmenter, PerceptionError};
use crate::scene::{Flow, Frame, FrameId, Mask, ObjectId, Rect};

/// A mask of which more than this share belongs to another object shows that one.
const MET: f64 = 0.5;

/// Follows objects back in time from their first masks; see the module.
#[derive(Clone, Debug)]
pub struct BackwardTracker {
    tracker: Tracker,
    /// Per object its first frame until now, and what its masks were worth.
    starts: BTreeMap<ObjectId, (FrameId, f64)>,
    finished: BTreeMap<ObjectId, FrameId>,
}

impl BackwardTracker {
    /// For the objects of these summaries, under their lasting ids.
    pub fn new(options: TrackerOptions, objects: &[TrackSummary]) -> Self {
        let start = |object: &TrackSummary| (object.id, (object.first, object.mask_quality.unwrap_or(1.0)));
        Self { tracker: Tracker::new(options), starts: objects.iter().map(start).collect(), finished: BTreeMap::new() }
    }

    /// Returns true if any object is being followed; otherwise flow and masks need not be computed.
    pub fn is_following(&self) -> bool {
        !self.tracker.tracks.is_empty()
    }

    /// The places in which flow is of use.
    pub fn places(&self) -> Vec<Rect> {
        self.tracker.places()
    }

    /// As [`Tracker::take_corrections`]: masks of frames that were given before, which are later ones.
    pub fn take_corrections(&mut self) -> Vec<Correction> {
        self.tracker.take_corrections()
    }

    /// Takes the next earlier frame.
    ///
    /// * `known` – the masks that objects have in this frame until now, by lasting id.
    /// * `prompter` – whom to ask for masks; `None` where they are carried.
    /// * `flow` – from the frame given before, which is the later one, to this one.
    ///
    /// Returns the new masks, ascending by lasting id; they overlap neither one another nor those that are known.
    ///
    /// # Errors
    /// [`PerceptionError::SizeMismatch`] if image, masks and flow differ in size, [`PerceptionError::FrameOrder`] if
    /// the frame is not earlier than the last one; whatever the prompter runs into.
    pub fn advance(
        &mut self,
        frame: &Frame,
        image: &RgbImage,
        known: &[(ObjectId, Mask)],
        prompter: Option<&mut dyn BoxSegmenter>,
        flow: Option<&Flow>,
    ) -> Result<Vec<TrackedMask>, PerceptionError> {
        for (_, mask) in known {
            self.tracker.same_size("a known mask", frame, image, (mask.width(), mask.height()))?;
        }
        let elapsed_s = self.tracker.check(frame, image, flow, Ordering::Less)?;
        let now = Moment { count: 0, frame: frame.id, time_s: frame.time_s };
        let view = FrameView { image, flow, now, elapsed_s };
        let seen = self.tracker.follow_boxes(&view, Vec::new(), prompter)?;
        let known: Vec<(ObjectId, Region)> =
            known.iter().filter_map(|(object, mask)| Some((*object, Region::from_mask(mask)?))).collect();
        let masks = self.cut(&seen, frame.id, &known, image.dimensions());
        self.end_tracks(&seen, &known, frame.id);
        self.start(image, &known, now);
        self.tracker.last_frame = Some((frame.id, frame.time_s, image.dimensions()));
        self.tracker.last_picture = Some(image.clone());
        Ok(masks)
    }

    /// First frame with a reliable mask of each object; drop the masks reported for earlier frames. Objects whose first
    /// frame never came are omitted.
    pub fn finish(mut self) -> BTreeMap<ObjectId, FrameId> {
        self.finished.extend(self.tracker.tracks.iter().map(first_reliable));
        self.finished
    }

    /// The masks of the frame, without the pixels that are known to be others'.
    fn cut(
        &mut self,
        seen: &[TrackObservation],
        frame: FrameId,
        known: &[(ObjectId, Region)],
        size: (u32, u32),
    ) -> Vec<TrackedMask> {
        let is_free = |x: u32, y: u32| known.iter().all(|(_, region)| !region.contains(x, y));
        let cut = |s: &TrackObservation| {
            let is_met = is_met(&self.tracker.tracks[s.track_idx], &s.region, known);
            let region = s.region.filtered(is_free).filter(|_| !is_met)?;
            Some(TrackObservation { region, ..*s })
        };
        let cut = seen.iter().filter_map(cut).collect();
        self.tracker.report(cut, frame, known.to_vec(), size)
    }

    /// Ends the tracks that were not seen, and those whose place is another's.
    fn end_tracks(&mut self, seen: &[TrackObservation], known: &[(ObjectId, Region)], frame: FrameId) {
        let tracks = std::mem::take(&mut self.tracker.tracks);
        for (track_idx, track) in tracks.into_iter().enumerate() {
            let region = seen.iter().find(|s| s.track_idx == track_idx).map(|s| &s.region);
            let is_met = is_met(&track, region.unwrap_or(&track.region), known);
            let (object, first) = first_reliable(&track);
            match self.tracker.last_frame {
                _ if !is_met && region.is_some() => self.tracker.tracks.push(track),
                // The mask of this frame is the other object's.
                Some((later, ..)) if is_met && first == frame => self.finished.extend([(object, later)]),
                _ => self.finished.extend([(object, first)]),
            }
        }
    }

    /// Begins with the objects whose first mask this frame has.
    fn start(&mut self, image: &RgbImage, known: &[(ObjectId, Region)], now: Moment) {
        for (object, region) in known {
            let Some(&(first, quality)) = self.starts.get(object) else { continue };
            if first == now.frame {
                let appearance = Appearance::of(image, region);
                self.tracker.tracks.push(Track::resume(*object, region.clone(), appearance, quality, now));
            }
        }
    }
}

fn first_reliable(track: &Track) -> (ObjectId, FrameId) {
    (track.provisional, track.last_detected.frame)
}

/// Returns true if most of a region belongs to one other object.
fn is_met(track: &Track, region: &Region, known: &[(ObjectId, Region)]) -> bool {
    known.iter().any(|(object, other)| *object != track.provisional && region.covered_by(other) > MET)
}
