//! Backward tracking of objects from their first masks.
//!
//! A detector may find a vehicle late, and a track starts only in a frame with segmentation. After the last frame, the
//! frames are given again in reverse order. Every object is tracked from its first mask to earlier frames: by flow, and
//! by masks prompted with the box of the propagated one. Memory is one mask per object.
//!
//! The track of an object ends where the object leaves the image or becomes too small, where flow, colors or new masks
//! fail, or where another object has its pixels.

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

/// Maximum share of a mask inside another object; above it, the mask shows that object.
const MAX_FOREIGN_SHARE: f64 = 0.5;

/// Tracks objects backward in time from their first masks; see the module.
#[derive(Clone, Debug)]
pub struct BackwardTracker {
    tracker: Tracker,
    /// Per object its first frame so far and the mean quality of its masks.
    starts: BTreeMap<ObjectId, (FrameId, f64)>,
    finished: BTreeMap<ObjectId, FrameId>,
}

impl BackwardTracker {
    /// Creates a tracker of the objects of these summaries, under their final ids.
    pub fn new(options: TrackerOptions, objects: &[TrackSummary]) -> Self {
        let start = |object: &TrackSummary| (object.id, (object.first, object.mask_quality.unwrap_or(1.0)));
        Self { tracker: Tracker::new(options), starts: objects.iter().map(start).collect(), finished: BTreeMap::new() }
    }

    /// Returns true if any object is being tracked; otherwise flow and masks need not be computed.
    pub fn is_tracking(&self) -> bool {
        !self.tracker.tracks.is_empty()
    }

    /// Regions in which flow is needed.
    pub fn flow_regions(&self) -> Vec<Rect> {
        self.tracker.flow_regions()
    }

    /// As [`Tracker::take_corrections`]: masks of frames that were given before, which are later ones.
    pub fn take_corrections(&mut self) -> Vec<Correction> {
        self.tracker.take_corrections()
    }

    /// Processes the next earlier frame.
    ///
    /// * `known` – masks that objects have in this frame so far, by final id.
    /// * `segmenter` – is prompted for masks; `None` where they are only propagated.
    /// * `flow` – from the frame given before, which is the later one, to this one.
    ///
    /// Returns the new masks, ascending by final id; they overlap neither one another nor the known ones.
    ///
    /// # Errors
    /// [`PerceptionError::SizeMismatch`] if image, masks and flow differ in size, [`PerceptionError::FrameOrder`] if
    /// the frame is not earlier than the last one; errors of the segmenter.
    pub fn advance(
        &mut self,
        frame: &Frame,
        image: &RgbImage,
        known: &[(ObjectId, Mask)],
        segmenter: Option<&mut dyn BoxSegmenter>,
        flow: Option<&Flow>,
    ) -> Result<Vec<TrackedMask>, PerceptionError> {
        for (_, mask) in known {
            self.tracker.check_size("a known mask", frame, image, (mask.width(), mask.height()))?;
        }
        let elapsed_s = self.tracker.check(frame, image, flow, Ordering::Less)?;
        let now = Moment { count: 0, frame: frame.id, time_s: frame.time_s };
        let view = FrameView { image, flow, now, elapsed_s };
        let observations = self.tracker.advance_tracks(&view, Vec::new(), segmenter)?;
        let known: Vec<(ObjectId, Region)> =
            known.iter().filter_map(|(object, mask)| Some((*object, Region::from_mask(mask)?))).collect();
        let masks = self.without_known(&observations, frame.id, &known, image.dimensions());
        self.end_tracks(&observations, &known, frame.id);
        self.start(image, &known, now);
        self.tracker.last_frame = Some((frame.id, frame.time_s, image.dimensions()));
        self.tracker.last_image = Some(image.clone());
        Ok(masks)
    }

    /// First frame with a reliable mask of each object; drop the masks reported for earlier frames.
    ///
    /// Objects whose first frame was not given are omitted.
    pub fn finish(mut self) -> BTreeMap<ObjectId, FrameId> {
        self.finished.extend(self.tracker.tracks.iter().map(first_reliable));
        self.finished
    }

    /// Reports the masks of the frame without the pixels of known masks.
    fn without_known(
        &mut self,
        observations: &[TrackObservation],
        frame: FrameId,
        known: &[(ObjectId, Region)],
        size: (u32, u32),
    ) -> Vec<TrackedMask> {
        let is_free = |x: u32, y: u32| known.iter().all(|(_, region)| !region.contains(x, y));
        let without_known = |s: &TrackObservation| {
            let belongs_to_other = belongs_to_other(&self.tracker.tracks[s.track_idx], &s.region, known);
            let region = s.region.filtered(is_free).filter(|_| !belongs_to_other)?;
            Some(TrackObservation { region, ..*s })
        };
        let without_known = observations.iter().filter_map(without_known).collect();
        self.tracker.report(without_known, frame, known.to_vec(), size)
    }

    /// Ends the tracks without an observation, and those whose region belongs to another object.
    fn end_tracks(&mut self, observations: &[TrackObservation], known: &[(ObjectId, Region)], frame: FrameId) {
        let tracks = std::mem::take(&mut self.tracker.tracks);
        for (track_idx, track) in tracks.into_iter().enumerate() {
            let region = observations.iter().find(|s| s.track_idx == track_idx).map(|s| &s.region);
            let belongs_to_other = belongs_to_other(&track, region.unwrap_or(&track.region), known);
            let (object, first) = first_reliable(&track);
            match self.tracker.last_frame {
                _ if !belongs_to_other && region.is_some() => self.tracker.tracks.push(track),
                // The mask of this frame belongs to the other object.
                Some((later, ..)) if belongs_to_other && first == frame => self.finished.extend([(object, later)]),
                _ => self.finished.extend([(object, first)]),
            }
        }
    }

    /// Starts tracks of the objects whose first mask is in this frame.
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
fn belongs_to_other(track: &Track, region: &Region, known: &[(ObjectId, Region)]) -> bool {
    known.iter().any(|(object, other)| *object != track.provisional && region.covered_by(other) > MAX_FOREIGN_SHARE)
}
