//! State of one track.

use std::collections::BTreeMap;

use super::appearance::Appearance;
use super::box_groups::{BoxGroup, INSIDE};
use super::choice::NewMask;
use super::merging::is_same_size;
use super::occlusion::Occlusion;
use super::propagation::Propagated;
use super::region::Region;
use super::retrace::MaskHistory;
use super::support::MIN_FRAMES;
use super::track_statistics::TrackStatistics;
use super::{BoxSource, ConfirmedObject, MIN_SIMILARITY, Predecessor, SURE_SIMILARITY, TrackSummary, TrackerOptions};
use crate::scene::{FrameId, Gap, IdentityEvidence, ObjectId, Outline, Rect};

/// Weight of a new measurement in the running estimates of velocity and appearance.
const LEARNING_RATE: f64 = 0.4;
/// Maximum number of frames without a box for a tentative track whose masks are renewed: a detector to which the object
/// is unfamiliar finds it in one frame of ten.
const MAX_UNBOXED_FRAMES: usize = 30;
/// Maximum number of consecutive failed prompts before a propagated track counts as lost.
const MAX_FAILED_PROMPTS: usize = 2;
/// Number of frames for which a mask is propagated despite failed prompts. Frames without a prompt cannot fail.
const MAX_PROPAGATED_FRAMES: usize = 8;
/// Maximum time for which a lost object may be continued or linked to a new one, seconds.
const MAX_LOST_SECS: f64 = 3.0;
/// Share of the whole outline from which a mask shows all of the object.
const MOSTLY_VISIBLE: f64 = 0.85;
/// Minimum visible share of an object for a re-detection after its flow failed, and of the mask that re-detects it.
const MIN_VISIBLE_SHARE: f64 = 0.3;
/// Maximum time for a re-detection by position and colors alone, if nothing occluded the object, seconds: no vehicle
/// reaches the position of another of its size and colors in that time.
const MAX_BRIEF_LOSS_S: f64 = 0.6;
/// Maximum decrease of an object's size per detection, as a share: it moved away or is partly occluded.
const SHRINK_RATE: f64 = 0.03;
/// Maximum speed of a stationary object against the background, in sides of its box per second.
const MAX_STATIONARY_SIDES_PER_S: f64 = 0.25;
/// Maximum share of boxes of motion detection for a stationary object, percent.
const MOVING_PERCENT: usize = 10;
/// Minimum number of new masks of a stationary object before one is reused.
const MIN_MASKS_AT_REST: usize = 2;

/// Presence of an object in the last frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Presence {
    /// Its mask is new.
    Detected,
    /// Its mask was propagated for so many frames.
    Propagated(usize),
    /// Lost since this time, seconds.
    Lost(f64),
}

/// Number of frames that the tracker processed before a frame, its id and time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Moment {
    pub(super) count: usize,
    pub(super) frame: FrameId,
    pub(super) time_s: f64,
}

/// Predicted state of a track in the current frame.
#[derive(Clone, Debug, Default)]
pub(super) struct Prediction {
    /// Its mask by optical flow.
    pub(super) propagated: Option<Propagated>,
    /// Its whole outline moved by the background's flow and its own velocity.
    pub(super) moved: Option<Region>,
    /// Background motion at its position, pixels.
    pub(super) background: [f64; 2],
}

/// One object while it is tracked.
#[derive(Clone, Debug)]
pub(super) struct Track {
    pub(super) provisional: ObjectId,
    /// Final id, once confirmed.
    pub(super) id: Option<ObjectId>,
    pub(super) presence: Presence,
    /// Its mask in the last frame; while lost, the last outline moved to its predicted position.
    pub(super) region: Region,
    /// Its whole outline, including occluded parts.
    pub(super) whole: Region,
    /// Occluded part.
    pub(super) occlusion: Occlusion,
    /// Propagated masks since its last new one.
    pub(super) history: MaskHistory,
    pub(super) appearance: Option<Appearance>,
    /// Side of a square as large as the box of the fully visible object, pixels.
    size: f64,
    /// Velocity relative to the background, pixels per second.
    pub(super) velocity: [f64; 2],
    /// Moment of its last reliable mask.
    pub(super) last_detected: Moment,
    first: FrameId,
    class_votes: BTreeMap<String, f64>,
    sum_confidence: f64,
    num_carried: usize,
    /// Propagated frames since the last reliable mask; they count once another one follows.
    propagated_since: usize,
    /// Number of failed prompts since the last new mask.
    num_failed: usize,
    /// Count of the last frame in which a box showed the object.
    last_boxed: usize,
    /// Area of the fully visible object, pixels.
    pub(super) area: f64,
    /// Quality of its latest new mask, 0 to 1.
    pub(super) quality: f64,
    /// Time of that mask, seconds.
    renewed_s: f64,
    pub(super) statistics: TrackStatistics,
    gaps: Vec<Gap>,
    after: Option<Predecessor>,
    /// True if another track may be its continuation.
    is_succeeded: bool,
    /// Visible share of its outline when it was lost.
    visible_share: f64,
    /// Center of its last new mask relative to that of the box that showed it, pixels.
    anchor: Option<[f64; 2]>,
}

/// Agreement of a mask with the one expected of a lost object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Recognized {
    /// 0 to 1.
    pub(super) score: f64,
    pub(super) evidence: IdentityEvidence,
}

impl Track {
    /// Starts a track from its first box and the mask in it.
    pub(super) fn start_from_box(
        provisional: ObjectId,
        group: &BoxGroup,
        new_mask: &NewMask,
        outline: Outline,
        now: Moment,
    ) -> Self {
        let region = new_mask.region.clone();
        let mut track = Self::bare(provisional, region, new_mask.appearance.clone(), now);
        // Its life begins with the first pending box: those frames count as well.
        (0..=group.earlier.len()).for_each(|_| track.statistics.count_frame(BoxSource::Detector));
        track.count_boxes(group, now);
        track.confirm_mask(new_mask, outline, now);
        track.anchor(Some(group));
        track
    }

    /// Starts a track of an object whose mask is known from elsewhere.
    pub(super) fn resume(
        provisional: ObjectId,
        region: Region,
        appearance: Option<Appearance>,
        quality: f64,
        now: Moment,
    ) -> Self {
        Self { quality, ..Self::bare(provisional, region, appearance, now) }
    }

    fn bare(provisional: ObjectId, region: Region, appearance: Option<Appearance>, now: Moment) -> Self {
        let (size, area) = (region.size(), region.area() as f64);
        let mut history = MaskHistory::default();
        history.restart(Some(&region));
        Self {
            provisional,
            id: None,
            presence: Presence::Detected,
            whole: region.clone(),
            occlusion: Occlusion::default(),
            history,
            region,
            appearance,
            size,
            velocity: [0.0; 2],
            last_detected: now,
            first: now.frame,
            class_votes: BTreeMap::new(),
            sum_confidence: 0.0,
            num_carried: 0,
            propagated_since: 0,
            num_failed: 0,
            last_boxed: now.count,
            area,
            quality: 0.0,
            renewed_s: now.time_s,
            statistics: TrackStatistics::default(),
            gaps: Vec::new(),
            after: None,
            is_succeeded: false,
            visible_share: 1.0,
            anchor: None,
        }
    }

    /// Accepts the masks that were propagated since the last reliable one.
    fn accept(&mut self, now: Moment) {
        self.num_carried += self.propagated_since;
        self.propagated_since = 0;
        self.last_detected = now;
        self.statistics.accept();
    }

    /// Counts the evidence for the object in this frame: boxes, or else its mask alone, which is new or propagated.
    pub(super) fn count_evidence(&mut self, group: Option<&BoxGroup>, is_new: bool, now: Moment) {
        match group {
            Some(group) => self.count_boxes(group, now),
            None => self.statistics.count_unboxed(is_new),
        }
    }

    /// Counts the boxes that show the object; a class of the detector outweighs motion, which has none.
    fn count_boxes(&mut self, group: &BoxGroup, now: Moment) {
        for detection in group.detections() {
            *self.class_votes.entry(detection.class.clone()).or_default() += detection.detector.unwrap_or(0.0);
            self.sum_confidence += detection.confidence();
            self.statistics.count_detection(detection);
        }
        self.last_boxed = now.count;
    }

    /// Continues the track with a new mask.
    pub(super) fn renew(
        &mut self,
        new_mask: &NewMask,
        outline: Outline,
        prediction: &Prediction,
        now: Moment,
        elapsed_s: f64,
    ) {
        if let Some(propagated) = prediction.propagated.as_ref().filter(|_| !self.is_lost()) {
            self.update_velocity(propagated.displacement, prediction.background, elapsed_s);
        }
        self.history.restart(Some(&new_mask.region));
        self.size = new_mask.region.size().max(self.size * (1.0 - SHRINK_RATE));
        self.region = new_mask.region.clone();
        self.update_outline(prediction.propagated.as_ref());
        self.update_appearance(new_mask.appearance.as_ref());
        self.presence = Presence::Detected;
        self.confirm_mask(new_mask, outline, now);
    }

    /// Records the position of a new mask in the box that shows the object.
    pub(super) fn anchor(&mut self, group: Option<&BoxGroup>) {
        let [x, y] = self.region.rect().center();
        self.anchor = group.map(|group| group.rect.center()).map(|[box_x, box_y]| [x - box_x, y - box_y]);
    }

    /// Displacement of the mask to a box that shows the object; `None` if its position in its boxes is unknown.
    pub(super) fn displacement_to(&self, rect: &Rect) -> Option<[f64; 2]> {
        let ([x, y], [box_x, box_y], [dx, dy]) = (self.region.rect().center(), rect.center(), self.anchor?);
        Some([box_x + dx - x, box_y + dy - y])
    }

    /// Sets the outline to the new mask, unless that shows a part of a partly occluded object.
    fn update_outline(&mut self, propagated: Option<&Propagated>) {
        let occluded = propagated.filter(|c| !self.is_lost() && c.is_partly_occluded());
        match occluded {
            Some(c) if (self.region.area() as f64) < MOSTLY_VISIBLE * c.whole.area() as f64 => {
                (self.whole, self.occlusion) = (c.whole.clone(), c.occlusion.clone());
            }
            _ => (self.whole, self.occlusion) = (self.region.clone(), Occlusion::default()),
        }
    }

    fn confirm_mask(&mut self, new_mask: &NewMask, outline: Outline, now: Moment) {
        self.area = (new_mask.region.area() as f64).max(self.area * (1.0 - SHRINK_RATE));
        self.quality = new_mask.quality;
        self.renewed_s = now.time_s;
        self.num_failed = 0;
        self.statistics.add_mask(new_mask, outline);
        self.accept(now);
    }

    /// Continues the track with its propagated mask.
    ///
    /// * `has_failed` – true if a mask was prompted in this frame and none fits.
    pub(super) fn propagate(&mut self, prediction: &Prediction, has_failed: bool, now: Moment, elapsed_s: f64) {
        let Some(propagated) = &prediction.propagated else { return };
        self.update_velocity(propagated.displacement, prediction.background, elapsed_s);
        self.region = propagated.region.clone();
        (self.whole, self.occlusion) = (propagated.whole.clone(), propagated.occlusion.clone());
        self.propagated_since += 1;
        self.presence = Presence::Propagated(self.frames_propagated() + 1);
        self.history.push(now.frame, propagated);
        self.num_failed += usize::from(has_failed);
        if self.num_failed == 0 {
            self.accept(now);
        }
    }

    /// Returns true if so many prompts failed that the propagated mask is unusable.
    pub(super) fn is_worn_out(&self) -> bool {
        let frames = self.frames_propagated();
        self.num_failed > MAX_FAILED_PROMPTS && frames >= MAX_PROPAGATED_FRAMES
    }

    /// Number of frames since the last new mask.
    pub(super) fn frames_propagated(&self) -> usize {
        if let Presence::Propagated(frames) = self.presence { frames } else { 0 }
    }

    /// Returns true if its mask may be segmented less often.
    ///
    /// The object is stationary by its flow and its boxes, and its last mask is recent.
    pub(super) fn is_at_rest(&self, now: Moment, options: &TrackerOptions) -> bool {
        let found = &self.statistics.found;
        let is_seen_to_move = 100 * (found.motion + found.both) > MOVING_PERCENT * found.detected();
        let is_known = self.id.is_some() && self.num_failed == 0 && self.statistics.num_masks >= MIN_MASKS_AT_REST;
        is_known && self.is_stationary() && !is_seen_to_move && now.time_s - self.renewed_s < options.max_rest_secs
    }

    /// Returns true if it is stationary by its flow.
    pub(super) fn is_stationary(&self) -> bool {
        self.velocity[0].hypot(self.velocity[1]) <= MAX_STATIONARY_SIDES_PER_S * self.size
    }

    pub(super) fn is_lost(&self) -> bool {
        matches!(self.presence, Presence::Lost(_))
    }

    fn update_appearance(&mut self, newer: Option<&Appearance>) {
        match (&mut self.appearance, newer) {
            (Some(appearance), Some(newer)) => appearance.blend(newer, LEARNING_RATE as f32),
            (appearance @ None, newer) => *appearance = newer.cloned(),
            (Some(_), None) => {}
        }
    }

    /// Continues the track without an observation; `moved` is its predicted outline.
    pub(super) fn lose(&mut self, moved: Region, now: Moment) {
        if !self.is_lost() {
            self.visible_share = self.current_visible_share();
            self.presence = Presence::Lost(now.time_s);
        }
        (self.whole, self.occlusion) = (moved.clone(), Occlusion::default());
        self.history.restart(None);
        self.region = moved;
    }

    fn update_velocity(&mut self, displacement: [f64; 2], background: [f64; 2], elapsed_s: f64) {
        if elapsed_s <= 0.0 {
            return;
        }
        for c in 0..2 {
            let measured = (displacement[c] - background[c]) / elapsed_s;
            let rate = if self.statistics.found.detected() < 2 { 1.0 } else { LEARNING_RATE };
            self.velocity[c] += rate * (measured - self.velocity[c]);
        }
    }

    /// Expected displacement over a time in which the background moves by `background`.
    pub(super) fn expected(&self, background: [f64; 2], elapsed_s: f64) -> [f64; 2] {
        [background[0] + self.velocity[0] * elapsed_s, background[1] + self.velocity[1] * elapsed_s]
    }

    /// Returns true if enough detections confirm the track.
    ///
    /// Boxes need not be close together in time: the masks between them, each propagated from the one before, link
    /// them.
    pub(super) fn is_confirmable(&self, options: &TrackerOptions) -> bool {
        self.id.is_none() && self.statistics.found.detected() >= options.min_detections
    }

    /// Returns true if the track ends.
    ///
    /// A tentative one ends if it is lost or not confirmed in time, a lost one if another continues it or if it was not
    /// re-detected in time.
    pub(super) fn is_finished(&self, now: Moment) -> bool {
        match self.presence {
            _ if self.id.is_none() => self.is_lost() || now.count - self.last_boxed > MAX_UNBOXED_FRAMES,
            Presence::Lost(since) => self.is_succeeded || now.time_s - since > MAX_LOST_SECS,
            _ => false,
        }
    }

    /// Score of a detection being this lost object by its position, size and appearance, 0 to 1; `None` if it is not.
    pub(super) fn recognize(
        &self,
        region: &Region,
        appearance: Option<&Appearance>,
        now: Moment,
    ) -> Option<Recognized> {
        let similarity = self.appearance.as_ref()?.similarity(appearance?);
        let lost_s = (now.time_s - self.last_detected.time_s).max(0.0);
        // The uncertainty of the position is one length, plus one for every second.
        let reach = self.size.max(region.size()) * (1.0 + lost_s);
        let ([x, y], [own_x, own_y]) = (region.rect().center(), self.region.rect().center());
        let nearness = 1.0 - (x - own_x).hypot(y - own_y) / reach;
        let ratio = region.area() as f64 / self.statistics.mean_area().max(1.0);
        let fits = similarity >= MIN_SIMILARITY && nearness > 0.0 && is_same_size(ratio);
        let evidence = IdentityEvidence {
            place: Some(1.0 - nearness),
            colours: Some(similarity.min(1.0)),
            size: Some(ratio),
            num_points: None,
            num_matches: None,
        };
        fits.then_some(Recognized { score: 0.5 * similarity + 0.5 * nearness, evidence })
    }

    /// Returns true if it has been lost too briefly for another object to have taken its position.
    pub(super) fn is_briefly_lost(&self, now: Moment) -> bool {
        let is_brief = now.time_s - self.last_detected.time_s <= MAX_BRIEF_LOSS_S;
        self.is_lost() && is_brief && self.visible_share >= MOSTLY_VISIBLE
    }

    /// Returns true if the predicted position may be prompted, because flow has just failed.
    ///
    /// Where most of the object is occluded, the mask would show the occluder.
    pub(super) fn may_be_redetected(&self, now: Moment) -> bool {
        let visible_share = if self.is_lost() { self.visible_share } else { self.current_visible_share() };
        visible_share >= MIN_VISIBLE_SHARE && now.time_s - self.last_detected.time_s <= MAX_BRIEF_LOSS_S
    }

    /// Visible share of the whole outline.
    fn current_visible_share(&self) -> f64 {
        (self.region.area() as f64 / self.whole.area().max(1) as f64).min(1.0)
    }

    /// Returns true if a mask at the predicted position shows the object.
    ///
    /// * `place` – its whole outline there.
    pub(super) fn is_shown_by(&self, new_mask: &NewMask, place: &Region) -> bool {
        let appearances = self.appearance.as_ref().zip(new_mask.appearance.as_ref());
        let is_alike = appearances.is_some_and(|(before, now)| before.similarity(now) >= SURE_SIMILARITY);
        let is_large = new_mask.region.area() as f64 >= MIN_VISIBLE_SHARE * place.area() as f64;
        is_alike && is_large && new_mask.region.covered_by(place) >= INSIDE
    }

    /// Returns true if a new object may be this one, which was lost for longer.
    pub(super) fn may_be_succeeded(&self, now: Moment) -> bool {
        self.id.is_some() && self.is_lost() && !self.is_succeeded && !self.is_briefly_lost(now)
    }

    /// Records a gap if the track was lost, when it is about to be re-detected.
    pub(super) fn record_gap(&mut self, new_mask: &NewMask, now: Moment) {
        let recognized = self.recognize(&new_mask.region, new_mask.appearance.as_ref(), now);
        if let Some(Recognized { evidence, .. }) = recognized.filter(|_| self.is_lost()) {
            self.gaps.push(Gap { last: self.last_detected.frame, first: now.frame, evidence });
        }
    }

    /// Links the track to the lost one that it may continue.
    pub(super) fn link_after(&mut self, lost: &mut Self, evidence: IdentityEvidence) {
        self.after = Some(Predecessor { provisional: lost.provisional, evidence });
        lost.is_succeeded = true;
    }

    /// Rank of the track: confirmed ones first, then by number of boxes.
    pub(super) fn rank(&self) -> (bool, usize) {
        (self.id.is_some(), self.statistics.found.detected())
    }

    /// Returns true if a box may show this object by its class.
    ///
    /// Motion has no class, and a class that the detector gave once or twice may be wrong.
    pub(super) fn is_compatible(&self, class: Option<&str>) -> bool {
        let is_named = self.statistics.found.by_detector() >= MIN_FRAMES;
        class.is_none_or(|class| !is_named || compatible(self.class(), class))
    }

    /// Class with the most votes; the alphabet breaks ties.
    pub(super) fn class(&self) -> &str {
        let best = self.class_votes.iter().max_by(|a, b| a.1.total_cmp(b.1).then_with(|| b.0.cmp(a.0)));
        best.map_or("", |(class, _)| class)
    }

    /// Mean confidence of its detections.
    fn confidence(&self) -> f64 {
        self.sum_confidence / self.statistics.found.detected() as f64
    }

    /// The object of a confirmed track; `None` for any other.
    pub(super) fn confirmed(&self) -> Option<ConfirmedObject<'_>> {
        let (id, provisional, class) = (self.id?, self.provisional, self.class());
        Some(ConfirmedObject { id, provisional, class, confidence: self.confidence(), after: self.after })
    }

    /// Summary of a confirmed track; `None` for any other.
    pub(super) fn summary(&self) -> Option<TrackSummary> {
        Some(TrackSummary {
            id: self.id?,
            provisional: self.provisional,
            class: self.class().to_owned(),
            confidence: self.confidence(),
            first: self.first,
            last: self.last_detected.frame,
            num_carried: self.num_carried,
            found: self.statistics.found,
            num_looks: self.statistics.num_frames(),
            num_detector_looks: self.statistics.num_detector_frames(),
            class_confidence: self.statistics.class_confidence(),
            mask_quality: self.statistics.mask_quality(),
            outline: self.statistics.outline,
            gaps: self.gaps.clone(),
            after: self.after,
        })
    }
}

/// Classes that a network may confuse for one object.
const TWO_WHEELERS: [&str; 6] = ["motorcycle", "motor", "motorbike", "bicycle", "rider", "person"];

/// Returns true if two class names may belong to one object: networks confuse cars, vans, trucks and buses with one
/// another, and motorcycles with bicycles, but not one group with the other.
pub(super) fn compatible(a: &str, b: &str) -> bool {
    TWO_WHEELERS.contains(&a) == TWO_WHEELERS.contains(&b)
}
