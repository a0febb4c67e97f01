//! One track: what is known of an object while it is followed.

use std::collections::BTreeMap;

use super::appearance::Appearance;
use super::box_groups::{BoxGroup, INSIDE};
use super::choice::Fresh;
use super::merging::is_same_size;
use super::occlusion::Cover;
use super::propagation::Propagated;
use super::region::Region;
use super::retrace::Way;
use super::support::MIN_FRAMES;
use super::track_statistics::Ledger;
use super::{BoxSource, ConfirmedObject, MIN_SIMILARITY, Predecessor, SURE_SIMILARITY, TrackSummary, TrackerOptions};
use crate::scene::{FrameId, Gap, IdentityEvidence, ObjectId, Outline, Rect};

/// Share of the way that velocity and looks move towards each new measurement.
const LEARNING_RATE: f64 = 0.4;
/// A tentative track whose mask a network renews again and again ends after so many looks without a box: a detector
/// that knows the object badly finds it in one frame of ten.
const MAX_UNBOXED_LOOKS: usize = 30;
/// Frames with masks asked for in which all may fail before a track that is carried counts as lost.
const MAX_FAILED_PROMPTS: usize = 2;
/// Frames for which a mask is carried without a detection. Frames in which nobody asks for a mask do not count.
const MAX_CARRIED: usize = 8;
/// Seconds for which a lost object may be taken up again, or a new one be linked to it.
const MAX_LOST_SECS: f64 = 3.0;
/// A mask that covers this share of the whole outline shows all of the object.
const MOSTLY_SEEN: f64 = 0.85;
/// Of an object whose flow failed this much must have been seen, and a mask must show as much, where it is looked for.
const LEAST_SEEN: f64 = 0.3;
/// A lost object that comes back within so many seconds is found again by place and colours alone, if nothing hid it:
/// no vehicle gets to the place of another of its size and colours in that time.
const BRIEFLY_S: f64 = 0.6;
/// Share by which the size of an object shrinks per detection when less of it is seen: it went further away, or is
/// partly hidden.
const SHRINK_RATE: f64 = 0.03;
/// Maximum speed of a stationary object against the background, in sides of its box per second.
const STANDING_SIDES_PER_S: f64 = 0.25;
/// Of a hundred boxes that show what stands so many may be those of motion, too.
const MOVING_PERCENT: usize = 10;
/// So many masks of what stands are asked for before one serves for longer.
const MIN_MASKS_AT_REST: usize = 2;

/// Presence of an object when it was last visible.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Presence {
    /// Detected in the last frame.
    Detected,
    /// Carried for so many frames.
    Carried(usize),
    /// Lost since this time, seconds.
    Lost(f64),
}

/// Number of looks before a frame (how many of the tracker's frames somebody looked at), its id and time.
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
    pub(super) carried: Option<Propagated>,
    /// Its mask moved by the background's flow and its own velocity.
    pub(super) moved: Option<Region>,
    /// Background motion at its position, pixels.
    pub(super) background: [f64; 2],
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
    /// The outline of all of it, whatever hides a part.
    pub(super) whole: Region,
    /// Occluded part.
    pub(super) cover: Cover,
    /// Its way since its last new mask.
    pub(super) way: Way,
    pub(super) appearance: Option<Appearance>,
    /// Side of a square as large as the object's box while all of it was seen, pixels.
    size: f64,
    /// Pixels per second relative to the background.
    pub(super) velocity: [f64; 2],
    /// Last moment at which the object was detected.
    pub(super) last_detected: Moment,
    first: FrameId,
    class_votes: BTreeMap<String, f64>,
    sum_confidence: f64,
    num_carried: usize,
    /// Carried frames since the last detection, which count once there is another detection.
    carried_since: usize,
    /// Masks asked for in vain since the last one that fitted.
    num_failed: usize,
    /// The last look at which a box showed the object.
    last_boxed: usize,
    /// Pixels of the object while all of it was seen.
    pub(super) area: f64,
    /// Quality of its latest mask when it was new, 0 to 1.
    pub(super) quality: f64,
    /// When that was, seconds.
    renewed_s: f64,
    pub(super) ledger: Ledger,
    gaps: Vec<Gap>,
    after: Option<Predecessor>,
    /// True if another track may be its continuation.
    is_succeeded: bool,
    /// Share of its outline that was seen when it was lost.
    seen_share: f64,
    /// Middle of its last new mask seen from that of the box that showed it then, pixels.
    anchor: Option<[f64; 2]>,
}

/// Similarity of a mask to that expected of a lost object.
#[derive(Clone, Copy, Debug)]
pub(super) struct Recognised {
    /// 0 to 1.
    pub(super) score: f64,
    pub(super) evidence: IdentityEvidence,
}

impl Track {
    /// A new track from its first box and the mask in it.
    pub(super) fn start_from_box(
        provisional: ObjectId,
        sight: &BoxGroup,
        fresh: &Fresh,
        outline: Outline,
        now: Moment,
    ) -> Self {
        let region = fresh.region.clone();
        let mut track = Self::bare(provisional, region, fresh.appearance.clone(), now);
        // Its life begins with the first of the boxes that waited: those frames were looked at as well.
        (0..=sight.earlier.len()).for_each(|_| track.ledger.look(BoxSource::Detector));
        track.note(sight, now);
        track.confirm_mask(fresh, outline, now);
        track.anchor(Some(sight));
        track
    }

    /// A track of an object whose mask is known from elsewhere.
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
        let mut way = Way::default();
        way.begin(Some(&region));
        Self {
            provisional,
            id: None,
            presence: Presence::Detected,
            whole: region.clone(),
            cover: Cover::default(),
            way,
            region,
            appearance,
            size,
            velocity: [0.0; 2],
            last_detected: now,
            first: now.frame,
            class_votes: BTreeMap::new(),
            sum_confidence: 0.0,
            num_carried: 0,
            carried_since: 0,
            num_failed: 0,
            last_boxed: now.count,
            area,
            quality: 0.0,
            renewed_s: now.time_s,
            ledger: Ledger::default(),
            gaps: Vec::new(),
            after: None,
            is_succeeded: false,
            seen_share: 1.0,
            anchor: None,
        }
    }

    /// Accepts the masks that were propagated since the last reliable one.
    fn trust(&mut self, now: Moment) {
        self.num_carried += self.carried_since;
        self.carried_since = 0;
        self.last_detected = now;
        self.ledger.trust();
    }

    /// Counts what shows the object in this frame: boxes, or else its mask alone, which is new or carried.
    pub(super) fn note_look(&mut self, sight: Option<&BoxGroup>, is_new: bool, now: Moment) {
        match sight {
            Some(sight) => self.note(sight, now),
            None => self.ledger.count_unboxed(is_new),
        }
    }

    /// Counts the boxes that show the object; a class of the detector beats motion, which knows none.
    fn note(&mut self, sight: &BoxGroup, now: Moment) {
        for finding in sight.findings() {
            *self.class_votes.entry(finding.class.clone()).or_default() += finding.detector.unwrap_or(0.0);
            self.sum_confidence += finding.confidence();
            self.ledger.note(finding);
        }
        self.last_boxed = now.count;
    }

    /// Continues the track with a new mask.
    pub(super) fn renew(
        &mut self,
        fresh: &Fresh,
        outline: Outline,
        prediction: &Prediction,
        now: Moment,
        elapsed_s: f64,
    ) {
        if let Some(carried) = prediction.carried.as_ref().filter(|_| !self.is_lost()) {
            self.learn_velocity(carried.displacement, prediction.background, elapsed_s);
        }
        self.way.begin(Some(&fresh.region));
        self.size = fresh.region.size().max(self.size * (1.0 - SHRINK_RATE));
        self.region = fresh.region.clone();
        self.learn_whole(prediction.carried.as_ref());
        self.learn_look(fresh.appearance.as_ref());
        self.presence = Presence::Detected;
        self.confirm_mask(fresh, outline, now);
    }

    /// Remembers where a new mask lies in the box that shows the object.
    pub(super) fn anchor(&mut self, sight: Option<&BoxGroup>) {
        let [x, y] = self.region.rect().center();
        self.anchor = sight.map(|sight| sight.rect.center()).map(|[box_x, box_y]| [x - box_x, y - box_y]);
    }

    /// Displacement of the mask to a box that shows the object; `None` where it is not known how it lies in its boxes.
    pub(super) fn displacement_to(&self, rect: &Rect) -> Option<[f64; 2]> {
        let ([x, y], [box_x, box_y], [dx, dy]) = (self.region.rect().center(), rect.center(), self.anchor?);
        Some([box_x + dx - x, box_y + dy - y])
    }

    /// The outline is that of the new mask, unless that shows a part of an object that is partly hidden.
    fn learn_whole(&mut self, carried: Option<&Propagated>) {
        let hidden = carried.filter(|c| !self.is_lost() && c.is_partly_hidden());
        match hidden {
            Some(c) if (self.region.area() as f64) < MOSTLY_SEEN * c.whole.area() as f64 => {
                (self.whole, self.cover) = (c.whole.clone(), c.cover.clone());
            }
            _ => (self.whole, self.cover) = (self.region.clone(), Cover::default()),
        }
    }

    fn confirm_mask(&mut self, fresh: &Fresh, outline: Outline, now: Moment) {
        self.area = (fresh.region.area() as f64).max(self.area * (1.0 - SHRINK_RATE));
        self.quality = fresh.quality;
        self.renewed_s = now.time_s;
        self.num_failed = 0;
        self.ledger.add_mask(fresh, outline);
        self.trust(now);
    }

    /// Continues the track with its carried mask, in a frame in which no new one fits, though one was asked for
    /// (`in_vain`), or none was asked for.
    pub(super) fn carry(&mut self, prediction: &Prediction, in_vain: bool, now: Moment, elapsed_s: f64) {
        let Some(carried) = &prediction.carried else { return };
        self.learn_velocity(carried.displacement, prediction.background, elapsed_s);
        self.region = carried.region.clone();
        (self.whole, self.cover) = (carried.whole.clone(), carried.cover.clone());
        self.carried_since += 1;
        self.presence = Presence::Carried(self.frames_carried() + 1);
        self.way.go(now.frame, carried);
        self.num_failed += usize::from(in_vain);
        if self.num_failed == 0 {
            self.trust(now);
        }
    }

    /// Returns true if so many masks failed that the propagated one is unusable.
    pub(super) fn is_worn_out(&self) -> bool {
        let frames = self.frames_carried();
        self.num_failed > MAX_FAILED_PROMPTS && frames >= MAX_CARRIED
    }

    /// Frames since the mask was new.
    pub(super) fn frames_carried(&self) -> usize {
        if let Presence::Carried(frames) = self.presence { frames } else { 0 }
    }

    /// Returns true if its mask may be segmented less often: the object is stationary by its flow and its boxes, and
    /// its last mask is recent.
    pub(super) fn is_at_rest(&self, now: Moment, options: &TrackerOptions) -> bool {
        let found = &self.ledger.found;
        let is_seen_to_move = 100 * (found.motion + found.both) > MOVING_PERCENT * found.detected();
        let is_known = self.id.is_some() && self.num_failed == 0 && self.ledger.num_masks >= MIN_MASKS_AT_REST;
        is_known && self.stands() && !is_seen_to_move && now.time_s - self.renewed_s < options.max_rest_secs
    }

    /// Returns true if it is stationary by its flow.
    pub(super) fn stands(&self) -> bool {
        self.velocity[0].hypot(self.velocity[1]) <= STANDING_SIDES_PER_S * self.size
    }

    pub(super) fn is_lost(&self) -> bool {
        matches!(self.presence, Presence::Lost(_))
    }

    fn learn_look(&mut self, newer: Option<&Appearance>) {
        match (&mut self.appearance, newer) {
            (Some(look), Some(newer)) => look.blend(newer, LEARNING_RATE as f32),
            (look @ None, newer) => *look = newer.cloned(),
            (Some(_), None) => {}
        }
    }

    /// Continues the track without any sight of it; `moved` is where it should be.
    pub(super) fn lose(&mut self, moved: Region, now: Moment) {
        if !self.is_lost() {
            self.seen_share = self.share_of_whole();
            self.presence = Presence::Lost(now.time_s);
        }
        (self.whole, self.cover) = (moved.clone(), Cover::default());
        self.way.begin(None);
        self.region = moved;
    }

    fn learn_velocity(&mut self, displacement: [f64; 2], background: [f64; 2], elapsed_s: f64) {
        if elapsed_s <= 0.0 {
            return;
        }
        for c in 0..2 {
            let measured = (displacement[c] - background[c]) / elapsed_s;
            let rate = if self.ledger.found.detected() < 2 { 1.0 } else { LEARNING_RATE };
            self.velocity[c] += rate * (measured - self.velocity[c]);
        }
    }

    /// Displacement to expect over a time while the background moves by `background`.
    pub(super) fn expected(&self, background: [f64; 2], elapsed_s: f64) -> [f64; 2] {
        [background[0] + self.velocity[0] * elapsed_s, background[1] + self.velocity[1] * elapsed_s]
    }

    /// Returns true if enough detections confirm the track. Boxes need not be close together in time: the masks between
    /// them, each propagated from the one before, tie them together.
    pub(super) fn earns_id(&self, options: &TrackerOptions) -> bool {
        self.id.is_none() && self.ledger.found.detected() >= options.min_detections
    }

    /// Returns true if the track ends: a tentative one that was not confirmed in time, a lost one that did not return.
    pub(super) fn is_over(&self, now: Moment) -> bool {
        match self.presence {
            _ if self.id.is_none() => self.is_lost() || now.count - self.last_boxed > MAX_UNBOXED_LOOKS,
            Presence::Lost(since) => self.is_succeeded || now.time_s - since > MAX_LOST_SECS,
            _ => false,
        }
    }

    /// Score of a detection being this lost object by its position, size and appearance, 0 to 1; `None` if it is not.
    pub(super) fn recognise(
        &self,
        region: &Region,
        appearance: Option<&Appearance>,
        now: Moment,
    ) -> Option<Recognised> {
        let similarity = self.appearance.as_ref()?.similarity(appearance?);
        let lost_s = (now.time_s - self.last_detected.time_s).max(0.0);
        // Uncertain by one length at once and one more for every second.
        let reach = self.size.max(region.size()) * (1.0 + lost_s);
        let ([x, y], [own_x, own_y]) = (region.rect().center(), self.region.rect().center());
        let nearness = 1.0 - (x - own_x).hypot(y - own_y) / reach;
        let ratio = region.area() as f64 / self.ledger.mean_area().max(1.0);
        let fits = similarity >= MIN_SIMILARITY && nearness > 0.0 && is_same_size(ratio);
        let evidence = IdentityEvidence {
            place: Some(1.0 - nearness),
            colours: Some(similarity.min(1.0)),
            size: Some(ratio),
            num_points: None,
            num_matches: None,
        };
        fits.then_some(Recognised { score: 0.5 * similarity + 0.5 * nearness, evidence })
    }

    /// Returns true if it has been lost too briefly for another object to have taken its position.
    pub(super) fn is_briefly_lost(&self, now: Moment) -> bool {
        let is_brief = now.time_s - self.last_detected.time_s <= BRIEFLY_S;
        self.is_lost() && is_brief && self.seen_share >= MOSTLY_SEEN
    }

    /// Returns true if the predicted position may be segmented, because its flow has just failed. Where most of it is
    /// occluded, the mask would show the occluder.
    pub(super) fn may_be_looked_for(&self, now: Moment) -> bool {
        let seen_share = if self.is_lost() { self.seen_share } else { self.share_of_whole() };
        seen_share >= LEAST_SEEN && now.time_s - self.last_detected.time_s <= BRIEFLY_S
    }

    /// Share of the whole outline that is seen.
    fn share_of_whole(&self) -> f64 {
        (self.region.area() as f64 / self.whole.area().max(1) as f64).min(1.0)
    }

    /// Returns true if a mask at the predicted position shows the object.
    ///
    /// * `place` – its whole outline there.
    pub(super) fn is_shown_by(&self, fresh: &Fresh, place: &Region) -> bool {
        let looks = self.appearance.as_ref().zip(fresh.appearance.as_ref());
        let is_alike = looks.is_some_and(|(before, now)| before.similarity(now) >= SURE_SIMILARITY);
        let is_large = fresh.region.area() as f64 >= LEAST_SEEN * place.area() as f64;
        is_alike && is_large && fresh.region.covered_by(place) >= INSIDE
    }

    /// Returns true if a new object may be this one, which was lost for longer.
    pub(super) fn may_be_succeeded(&self, now: Moment) -> bool {
        self.id.is_some() && self.is_lost() && !self.is_succeeded && !self.is_briefly_lost(now)
    }

    /// Remembers that it was lost, if it was, when it is about to be found again.
    pub(super) fn note_gap(&mut self, fresh: &Fresh, now: Moment) {
        let recognised = self.recognise(&fresh.region, fresh.appearance.as_ref(), now);
        if let Some(Recognised { evidence, .. }) = recognised.filter(|_| self.is_lost()) {
            self.gaps.push(Gap { last: self.last_detected.frame, first: now.frame, evidence });
        }
    }

    /// Says which lost object this one may be.
    pub(super) fn follow_after(&mut self, lost: &mut Self, evidence: IdentityEvidence) {
        self.after = Some(Predecessor { provisional: lost.provisional, evidence });
        lost.is_succeeded = true;
    }

    /// Rank of the track: confirmed ones first, then by number of boxes.
    pub(super) fn rank(&self) -> (bool, usize) {
        (self.id.is_some(), self.ledger.found.detected())
    }

    /// Returns true if a box may show this object by its class. Motion has no class, and a detector that classified the
    /// object once or twice may have been wrong.
    pub(super) fn may_be(&self, class: Option<&str>) -> bool {
        let is_named = self.ledger.found.by_detector() >= MIN_FRAMES;
        class.is_none_or(|class| !is_named || compatible(self.class(), class))
    }

    /// The class that detections name most; the alphabet breaks ties.
    pub(super) fn class(&self) -> &str {
        let best = self.class_votes.iter().max_by(|a, b| a.1.total_cmp(b.1).then_with(|| b.0.cmp(a.0)));
        best.map_or("", |(class, _)| class)
    }

    /// Mean confidence of its detections.
    fn confidence(&self) -> f64 {
        self.sum_confidence / self.ledger.found.detected() as f64
    }

    /// The object of a confirmed track; `None` for any other.
    pub(super) fn confirmed(&self) -> Option<ConfirmedObject<'_>> {
        let (id, provisional, class) = (self.id?, self.provisional, self.class());
        Some(ConfirmedObject { id, provisional, class, confidence: self.confidence(), after: self.after })
    }

    /// The result for a confirmed track; `None` for any other.
    pub(super) fn summary(&self) -> Option<TrackSummary> {
        Some(TrackSummary {
            id: self.id?,
            provisional: self.provisional,
            class: self.class().to_owned(),
            confidence: self.confidence(),
            first: self.first,
            last: self.last_detected.frame,
            num_carried: self.num_carried,
            found: self.ledger.found,
            num_looks: self.ledger.num_looks(),
            num_detector_looks: self.ledger.num_detector_looks(),
            class_confidence: self.ledger.class_confidence(),
            mask_quality: self.ledger.mask_quality(),
            outline: self.ledger.outline,
            gaps: self.gaps.clone(),
            after: self.after,
        })
    }
}

/// Classes that a network may confuse for one object; only one of a group is tracked per place.
const TWO_WHEELERS: [&str; 6] = ["motorcycle", "motor", "motorbike", "bicycle", "rider", "person"];

/// Returns true if two class names may belong to one object: networks confuse cars, vans, trucks and buses with one
/// another, and motorcycles with bicycles, but not one group with the other.
pub(super) fn compatible(a: &str, b: &str) -> bool {
    TWO_WHEELERS.contains(&a) == TWO_WHEELERS.contains(&b)
}
