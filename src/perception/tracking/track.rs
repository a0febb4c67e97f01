//! One track: what is known of an object while it is followed.

use std::collections::BTreeMap;

use super::appearance::Appearance;
use super::carry::Carried;
use super::region::Region;
use super::{TrackSummary, TrackerOptions};
use crate::scene::{BoundingBox, FrameId, ObjectId};

/// Share of the way that velocity and looks move towards each new measurement.
const LEARNING_RATE: f64 = 0.4;
/// A tentative track ends after so many frames without a detection.
const MAX_TENTATIVE_GAP: usize = 2;
/// Share by which the size of an object shrinks per detection when less of it is seen: it went further away, or is
/// partly hidden.
const SHRINK_RATE: f64 = 0.03;

/// How an object was last seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Presence {
    /// Detected in the last frame.
    Detected,
    /// Carried for so many frames.
    Carried(usize),
    /// Lost since this time, seconds.
    Lost(f64),
}

/// A detection of one frame, as the tracker uses it.
#[derive(Clone, Debug)]
pub(super) struct Candidate {
    pub(super) class: String,
    pub(super) confidence: f64,
    pub(super) region: Region,
    pub(super) appearance: Option<Appearance>,
}

/// Frame number (how many frames the tracker has seen), id and time of a frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    pub(super) count: usize,
    pub(super) frame: FrameId,
    pub(super) time_s: f64,
}

/// Where a track should be in the current frame.
#[derive(Clone, Debug, Default)]
pub(super) struct Prediction {
    /// Its mask by optical flow.
    pub(super) carried: Option<Carried>,
    /// Its mask moved by the background's flow and its own velocity.
    pub(super) moved: Option<Region>,
    /// How the background moved at its place, pixels.
    pub(super) background: [f64; 2],
}

impl Prediction {
    /// The best overlap with a region that either prediction has.
    pub(super) fn overlap(&self, region: &Region) -> f64 {
        let carried = self.carried.as_ref().map_or(0.0, |c| c.region.iou(region));
        carried.max(self.moved.as_ref().map_or(0.0, |moved| moved.iou(region)))
    }
}

/// One object while it is followed.
#[derive(Clone, Debug)]
pub(super) struct Track {
    pub(super) provisional: ObjectId,
    /// Its lasting id, once confirmed.
    pub(super) id: Option<ObjectId>,
    pub(super) presence: Presence,
    /// Its mask in the last frame; while lost, the last one, moved to where it should be.
    pub(super) region: Region,
    pub(super) appearance: Option<Appearance>,
    /// Side of a square as large as the object's box while all of it was seen, pixels.
    size: f64,
    /// Pixels per second relative to the background.
    pub(super) velocity: [f64; 2],
    /// Last moment at which the object was detected.
    pub(super) last_detected: Moment,
    first: FrameId,
    /// Counts of the latest detections, as many as confirmation asks for.
    recent: Vec<usize>,
    class_votes: BTreeMap<String, f64>,
    sum_confidence: f64,
    sum_area: f64,
    num_detected: usize,
    num_carried: usize,
    /// Carried frames since the last detection, which count once there is another detection.
    carried_since: usize,
}

impl Track {
    /// A new track from its first detection.
    pub(super) fn start(provisional: ObjectId, candidate: &Candidate, now: Moment) -> Self {
        let mut track = Self {
            provisional,
            id: None,
            presence: Presence::Detected,
            region: candidate.region.clone(),
            appearance: candidate.appearance.clone(),
            size: candidate.region.size(),
            velocity: [0.0; 2],
            last_detected: now,
            first: now.frame,
            recent: Vec::new(),
            class_votes: BTreeMap::new(),
            sum_confidence: 0.0,
            sum_area: 0.0,
            num_detected: 0,
            num_carried: 0,
            carried_since: 0,
        };
        track.count(candidate, now);
        track
    }

    fn count(&mut self, candidate: &Candidate, now: Moment) {
        self.recent.push(now.count);
        *self.class_votes.entry(candidate.class.clone()).or_default() += candidate.confidence;
        self.sum_confidence += candidate.confidence;
        self.sum_area += candidate.region.area() as f64;
        self.num_detected += 1;
        self.num_carried += self.carried_since;
        self.carried_since = 0;
        self.last_detected = now;
    }

    /// Continues the track with a detection.
    pub(super) fn detect(&mut self, candidate: &Candidate, prediction: &Prediction, now: Moment, elapsed_s: f64) {
        if self.presence == Presence::Detected {
            // Flow follows the object's pixels; the centre of what is visible lags while something hides a part of it.
            let by_centre = || difference(candidate.region.centre(), self.region.centre());
            let displacement = prediction.carried.as_ref().map_or_else(by_centre, |c| c.displacement);
            self.learn_velocity(displacement, prediction.background, elapsed_s);
        }
        self.size = candidate.region.size().max(self.size * (1.0 - SHRINK_RATE));
        self.region = candidate.region.clone();
        match (&mut self.appearance, &candidate.appearance) {
            (Some(look), Some(newer)) => look.blend(newer, LEARNING_RATE as f32),
            (look @ None, newer) => look.clone_from(newer),
            (Some(_), None) => {}
        }
        self.presence = Presence::Detected;
        self.count(candidate, now);
    }

    /// Continues the track with its carried mask.
    pub(super) fn carry(&mut self, carried: &Carried, background: [f64; 2], elapsed_s: f64) {
        self.learn_velocity(carried.displacement, background, elapsed_s);
        self.region = carried.region.clone();
        self.carried_since += 1;
        self.presence = Presence::Carried(match self.presence {
            Presence::Carried(frames) => frames + 1,
            _ => 1,
        });
    }

    /// Continues the track without any sight of it; `moved` is where it should be.
    pub(super) fn lose(&mut self, moved: Region, now: Moment) {
        self.region = moved;
        if !matches!(self.presence, Presence::Lost(_)) {
            self.presence = Presence::Lost(now.time_s);
        }
    }

    fn learn_velocity(&mut self, displacement: [f64; 2], background: [f64; 2], elapsed_s: f64) {
        if elapsed_s <= 0.0 {
            return;
        }
        for c in 0..2 {
            let measured = (displacement[c] - background[c]) / elapsed_s;
            let rate = if self.num_detected < 2 { 1.0 } else { LEARNING_RATE };
            self.velocity[c] += rate * (measured - self.velocity[c]);
        }
    }

    /// Displacement to expect over a time while the background moves by `background`.
    pub(super) fn expected(&self, background: [f64; 2], elapsed_s: f64) -> [f64; 2] {
        [background[0] + self.velocity[0] * elapsed_s, background[1] + self.velocity[1] * elapsed_s]
    }

    /// Whether enough detections lie close together for a lasting id.
    pub(super) fn earns_id(&self, options: &TrackerOptions) -> bool {
        let latest = self.recent.len().checked_sub(options.min_detections).map(|start| &self.recent[start..]);
        let close =
            |counts: &[usize]| counts.last().zip(counts.first()).is_some_and(|(l, f)| l - f < options.confirm_window);
        self.id.is_none() && latest.is_some_and(close)
    }

    /// Whether the track is over: a tentative one that was not confirmed soon, a lost one that stays away.
    pub(super) fn is_over(&self, now: Moment, options: &TrackerOptions) -> bool {
        let gap = now.count - self.last_detected.count;
        match self.presence {
            _ if self.id.is_none() => gap > MAX_TENTATIVE_GAP,
            Presence::Lost(since) => now.time_s - since > options.max_lost_secs,
            _ => false,
        }
    }

    /// Whether a detection may be this lost object by its place, size and looks; the score if so, 0 to 1.
    pub(super) fn recognise(&self, candidate: &Candidate, now: Moment, min_similarity: f64) -> Option<f64> {
        let (Some(mine), Some(theirs)) = (&self.appearance, &candidate.appearance) else { return None };
        let similarity = mine.similarity(theirs);
        let lost_s = (now.time_s - self.last_detected.time_s).max(0.0);
        // Uncertain by one length at once and one more for every second.
        let reach = self.size.max(candidate.region.size()) * (1.0 + lost_s);
        let [dx, dy] = difference(candidate.region.centre(), self.region.centre());
        let nearness = 1.0 - dx.hypot(dy) / reach;
        let ratio = candidate.region.area() as f64 / (self.sum_area / self.num_detected as f64).max(1.0);
        let fits = similarity >= min_similarity && nearness > 0.0 && (0.25..=4.0).contains(&ratio);
        fits.then_some(0.5 * similarity + 0.5 * nearness)
    }

    /// The class that detections name most; the alphabet breaks ties.
    pub(super) fn class(&self) -> &str {
        let best = self.class_votes.iter().max_by(|a, b| a.1.total_cmp(b.1).then_with(|| b.0.cmp(a.0)));
        best.map_or("", |(class, _)| class)
    }

    /// The result for a confirmed track; `None` for any other.
    pub(super) fn summary(&self) -> Option<TrackSummary> {
        Some(TrackSummary {
            id: self.id?,
            provisional: self.provisional,
            class: self.class().to_owned(),
            confidence: self.sum_confidence / self.num_detected as f64,
            first: self.first,
            last: self.last_detected.frame,
            num_detected: self.num_detected,
            num_carried: self.num_carried,
            mean_area_px2: self.sum_area / self.num_detected as f64,
        })
    }
}

fn difference(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

/// Whether a box moved by a displacement has its centre outside the frame: the object is leaving.
pub(super) fn leaves(bounds: BoundingBox, displacement: [f64; 2], width: u32, height: u32) -> bool {
    let x = f64::from(bounds.x0 + bounds.x1) / 2.0 + displacement[0];
    let y = f64::from(bounds.y0 + bounds.y1) / 2.0 + displacement[1];
    x < 0.0 || y < 0.0 || x > f64::from(width) || y > f64::from(height)
}
