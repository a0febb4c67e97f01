//! Following objects of which boxes are known, and masks only where they are asked for.

use ::image::RgbImage;

use super::affine::Affine;
use super::appearance::Appearance;
use super::assignment::assign;
use super::box_groups::{self, BoxGroup, Finding, INSIDE};
use super::choice::{Expected, Fresh, MIN_SCORE, score, score_carried};
use super::merging::is_same_size;
use super::occlusion::Cover;
use super::propagation::{Propagated, carry_rect, displacement_outside};
use super::region::Region;
use super::track::{Moment, Prediction, Track};
use super::tracker::{MAX_COVERED, TrackObservation, Tracker};
use super::{DetectedBox, Evidence, MIN_AREA_PX2, MIN_SIMILARITY, TrackerOptions};
use crate::networks::{BoxSegmenter, PerceptionError};
use crate::scene::{Flow, ObjectId, Outline, Rect};

/// Overlap of boxes (intersection over union) that says as much as masks that overlap a little.
const MIN_BOX_OVERLAP: f64 = 0.4;
/// Share of a mask's pixels that must be carried by consistent flow for the carried mask to count.
const MIN_CARRIED_SHARE: f64 = 0.4;
/// A new mask that agrees so well with the outline of the whole object shows all of it.
const SAME_OUTLINE: f64 = 0.85;
/// A new mask that swallows a followed object by more than this share is no object of its own.
const SWALLOWED: f64 = 0.8;
/// The rest of a vehicle moves like a part of it but for this share of its motion against the background: it turns or
/// comes nearer. From 0.1 to 0.5 tracks differ little.
const MOVES_ALIKE: f64 = 0.25;

/// A frame as the tracker sees it.
pub(super) struct FrameView<'a> {
    pub(super) image: &'a RgbImage,
    pub(super) flow: Option<&'a Flow>,
    pub(super) now: Moment,
    pub(super) elapsed_s: f64,
}

/// Detections of a frame, and their association with tracks.
pub(super) struct Meeting {
    pub(super) predictions: Vec<Prediction>,
    /// Per track whether its carried mask serves without a new one, for the object stands.
    pub(super) is_at_rest: Vec<bool>,
    pub(super) sights: Vec<BoxGroup>,
    /// Per sight the mask in its box.
    pub(super) masks: Vec<Option<Fresh>>,
    /// Per track the masks in the box of its carried mask, and in that of its whole outline where a part is hidden.
    pub(super) own_masks: Vec<Vec<Fresh>>,
    /// Per track the sight that shows it.
    sight_of: Vec<Option<usize>>,
    /// Quality of the outlines of new masks.
    outline: Outline,
}

impl Meeting {
    pub(super) fn carried(&self, track: usize) -> Option<&Propagated> {
        self.predictions[track].carried.as_ref()
    }

    fn sight(&self, track: usize) -> Option<&BoxGroup> {
        self.sight_of[track].map(|sight| &self.sights[sight])
    }

    /// The sights that show no track.
    fn left(&self) -> Vec<usize> {
        (0..self.sights.len()).filter(|s| !self.sight_of.contains(&Some(*s))).collect()
    }
}

/// A mask that a track may have in a frame.
struct Choice {
    score: f64,
    /// `None` for the carried one.
    fresh: Option<Fresh>,
}

impl Tracker {
    /// Follows all tracks into a frame of which boxes are known. Masks are asked of the prompter, if there is one;
    /// otherwise they are carried, and boxes that show nothing that is followed wait.
    pub(super) fn follow_boxes(
        &mut self,
        view: &FrameView,
        found: Vec<DetectedBox>,
        prompter: Option<&mut dyn BoxSegmenter>,
    ) -> Result<Vec<TrackObservation>, PerceptionError> {
        let mut meeting = self.meet(view, found);
        let waiting = self.waiting_now(view.flow);
        let Some(prompter) = prompter else {
            self.associate_boxes(view, &mut meeting);
            let left = meeting.left().into_iter().map(|s| meeting.sights[s].clone()).collect();
            self.waiting = box_groups::wait(waiting, left);
            return Ok(self.carry_all(view, &meeting));
        };
        meeting.sights = box_groups::join(waiting, meeting.sights);
        meeting.is_at_rest = self.at_rest(view, &meeting);
        meeting.outline = if prompter.is_coarse() { Outline::Coarse } else { Outline::Network };
        self.segment(view, prompter, &mut meeting)?;
        self.waiting.clear();
        self.associate_boxes(view, &mut meeting);
        self.count_passed_over(&meeting);
        let mut seen = self.choose(view, &meeting);
        self.look_for(view, &meeting, &mut seen);
        seen.extend(self.find_again(view, &mut meeting, &seen));
        self.lose_others(view, &meeting, &seen);
        seen.extend(self.start_boxes(view, &meeting, &seen));
        Ok(seen)
    }

    /// Counts the boxes that would start a track if they did not stand.
    fn count_passed_over(&mut self, meeting: &Meeting) {
        for sight in meeting.left().into_iter().map(|s| &meeting.sights[s]) {
            if sight.stands() && !may_start(sight, &self.options) && sight.confidence() >= self.options.start_confidence
            {
                self.passed_over.num_boxes += 1;
                self.passed_over.max_confidence = self.passed_over.max_confidence.max(sight.confidence());
            }
        }
    }

    /// Where all tracks should be, and what boxes show.
    fn meet(&self, view: &FrameView, found: Vec<DetectedBox>) -> Meeting {
        let mut predictions = self.predict(view.flow, view.image, view.elapsed_s);
        let is_trusted = |track: &Track, carried: &Propagated| is_trusted(track, carried, view.image);
        for (track, prediction) in self.tracks.iter().zip(&mut predictions) {
            prediction.carried = prediction.carried.take().filter(|carried| is_trusted(track, carried));
        }
        let rects: Vec<Rect> = predictions.iter().filter_map(|p| Some(p.carried.as_ref()?.region.rect())).collect();
        let sights = box_groups::merge(found, &rects, &self.options, view.image.dimensions());
        for (track, prediction) in self.tracks.iter().zip(&mut predictions) {
            if prediction.carried.is_none() && !track.is_lost() {
                let carried = carried_by_box(track, prediction, &sights);
                prediction.carried = carried.filter(|carried| is_trusted(track, carried));
            }
        }
        let (num_tracks, num_sights) = (self.tracks.len(), sights.len());
        Meeting {
            predictions,
            is_at_rest: vec![false; num_tracks],
            sights,
            masks: vec![None; num_sights],
            own_masks: vec![Vec::new(); num_tracks],
            sight_of: vec![None; num_tracks],
            outline: Outline::default(),
        }
    }

    /// The boxes that wait, moved to where they are in this frame.
    fn waiting_now(&self, flow: Option<&Flow>) -> Vec<BoxGroup> {
        let moved = |sight: &BoxGroup| {
            let rect = flow.map_or(Some(sight.rect), |flow| carry_rect(&sight.rect, flow))?;
            Some(sight.at(rect))
        };
        self.waiting.iter().filter_map(moved).collect()
    }

    /// Joins boxes and the tracks in sight, by their boxes and, where they are known, by their masks. An object that is
    /// partly hidden may show all of itself again: its whole outline counts as well as what was seen of it.
    fn associate_boxes(&self, view: &FrameView, meeting: &mut Meeting) {
        let rows: Vec<usize> = (0..self.tracks.len()).filter(|t| meeting.carried(*t).is_some()).collect();
        let pairs = assign(rows.len(), meeting.sights.len(), |row, s| {
            let (track, sight) = (&self.tracks[rows[row]], &meeting.sights[s]);
            let carried = meeting.carried(rows[row])?;
            let best = |overlap: &dyn Fn(&Region) -> f64| overlap(&carried.region).max(overlap(&carried.whole));
            let by_box = best(&|region| region.rect().iou(&sight.rect));
            // The mask of a car is not the road on which it is, whatever was taken for a vehicle there.
            let alike = |a: &Region, b: &Region| is_same_size(a.area() as f64 / b.area() as f64);
            let overlap = |a: &Region, b: &Region| if alike(a, b) { a.iou(b) } else { 0.0 };
            let by_mask = meeting.masks[s].as_ref().map_or(0.0, |fresh| best(&|region| overlap(&fresh.region, region)));
            let meets = by_mask >= self.options.min_overlap
                || by_box >= MIN_BOX_OVERLAP
                || self.is_part(rows[row], s, meeting, view);
            (meets && track.may_be(sight.class())).then_some(0.5 * (by_box + by_mask))
        });
        for (row, sight) in pairs {
            meeting.sight_of[rows[row]] = Some(sight);
        }
    }

    /// Returns true if a moving track has been following a part of the vehicle that the mask in a box shows: no other
    /// track has anything in the box, which may start one, and the rest of the box moves like the part.
    fn is_part(&self, track_idx: usize, sight: usize, meeting: &Meeting, view: &FrameView) -> bool {
        let (track, sight, fresh) = (&self.tracks[track_idx], &meeting.sights[sight], &meeting.masks[sight]);
        let (Some(carried), Some(fresh), Some(flow)) = (meeting.carried(track_idx), fresh, view.flow) else {
            return false;
        };
        let is_swallowed = carried.region.covered_by(&fresh.region) > SWALLOWED;
        if !is_swallowed || track.stands() || !may_start(sight, &self.options) {
            return false;
        }
        let is_in_it = |other: usize| {
            let carried = meeting.carried(other);
            carried.is_some_and(|other| box_groups::inside(&other.region.rect(), &sight.rect) > 1.0 - INSIDE)
        };
        if (0..self.tracks.len()).any(|other| other != track_idx && is_in_it(other)) {
            return false;
        }
        let [x, y] = carried.displacement;
        let [back_x, back_y] = meeting.predictions[track_idx].background;
        let tolerance_px = MOVES_ALIKE * (x - back_x).hypot(y - back_y);
        let rest = displacement_outside(&track.region, &sight.rect.moved([-x, -y]), flow);
        rest.is_some_and(|[rest_x, rest_y]| (rest_x - x).hypot(rest_y - y) <= tolerance_px)
    }

    /// Carries all masks on in a frame in which none is asked for.
    fn carry_all(&mut self, view: &FrameView, meeting: &Meeting) -> Vec<TrackObservation> {
        let mut seen = Vec::new();
        for track_idx in 0..self.tracks.len() {
            match meeting.carried(track_idx) {
                Some(carried) => {
                    let evidence = self.keep_carried(track_idx, meeting, false, view);
                    seen.push(TrackObservation { track_idx, evidence, region: carried.region.clone() });
                }
                None => self.lose(track_idx, meeting, view.now),
            }
        }
        seen
    }

    fn keep_carried(&mut self, track_idx: usize, meeting: &Meeting, in_vain: bool, view: &FrameView) -> Evidence {
        let track = &mut self.tracks[track_idx];
        track.note_look(meeting.sight(track_idx), false, view.now);
        track.carry(&meeting.predictions[track_idx], in_vain, view.now, view.elapsed_s);
        meeting.sight(track_idx).map_or(Evidence::Carried, detected)
    }

    fn lose(&mut self, track_idx: usize, meeting: &Meeting, now: Moment) {
        let track = &mut self.tracks[track_idx];
        let moved = meeting.predictions[track_idx].moved.clone().unwrap_or_else(|| track.region.clone());
        track.lose(moved, now);
    }

    /// Gives every track in sight the mask that fits it best. No two tracks get the same: the one for which more
    /// speaks comes first, the other takes what is left, or is lost.
    fn choose(&mut self, view: &FrameView, meeting: &Meeting) -> Vec<TrackObservation> {
        let mut order: Vec<usize> = (0..self.tracks.len()).filter(|t| meeting.carried(*t).is_some()).collect();
        let rank = |t: usize| (meeting.sight_of[t].is_some(), self.tracks[t].rank());
        order.sort_by(|&a, &b| rank(b).cmp(&rank(a)).then(a.cmp(&b)));
        let mut seen: Vec<TrackObservation> = Vec::new();
        for track_idx in order {
            let Some(carried) = meeting.carried(track_idx) else { continue };
            let region_of = |choice: &Choice| match &choice.fresh {
                Some(fresh) => fresh.region.clone(),
                None => carried.region.clone(),
            };
            let choices = choices(&self.tracks[track_idx], meeting, track_idx, carried);
            let Some(choice) = choices.into_iter().find(|choice| !is_taken(&region_of(choice), &seen)) else {
                continue;
            };
            let region = region_of(&choice);
            if let Some(evidence) = self.take(track_idx, choice.fresh, meeting, view) {
                seen.push(TrackObservation { track_idx, evidence, region });
            }
        }
        seen
    }

    /// Continues a track with a new mask, or with the carried one; `None` if that is worn out.
    fn take(
        &mut self,
        track_idx: usize,
        fresh: Option<Fresh>,
        meeting: &Meeting,
        view: &FrameView,
    ) -> Option<Evidence> {
        let Some(fresh) = fresh else {
            let is_worn_out = self.tracks[track_idx].is_worn_out();
            return (!is_worn_out).then(|| self.keep_carried(track_idx, meeting, !meeting.is_at_rest[track_idx], view));
        };
        let (track, sight) = (&mut self.tracks[track_idx], meeting.sight(track_idx));
        if let Some(carried) = meeting.carried(track_idx) {
            let retraced = track.way.retraced(&fresh.region, carried, view.image.dimensions());
            self.retraced.extend(retraced.into_iter().map(|(frame, region)| (frame, track.provisional, region)));
        }
        track.note_look(sight, true, view.now);
        track.renew(&fresh, meeting.outline, &meeting.predictions[track_idx], view.now, view.elapsed_s);
        track.anchor(sight);
        Some(sight.map_or(Evidence::Prompted { quality: fresh.quality }, detected))
    }

    /// Continues tracks whose flow failed just now by the masks where they should be.
    fn look_for(&mut self, view: &FrameView, meeting: &Meeting, seen: &mut Vec<TrackObservation>) {
        for track_idx in (0..self.tracks.len()).filter(|t| meeting.carried(*t).is_none()) {
            let Some(place) = &meeting.predictions[track_idx].moved else { continue };
            let is_shown = |fresh: &&Fresh| self.tracks[track_idx].is_shown_by(fresh, place);
            let shown = meeting.own_masks[track_idx].iter().find(is_shown);
            let Some(fresh) = shown.filter(|fresh| !is_explained(&fresh.region, seen)).cloned() else { continue };
            self.lose(track_idx, meeting, view.now);
            seen.extend(self.take_again(track_idx, fresh, meeting, view));
        }
    }

    /// Continues a track that was lost with a mask that shows it again.
    fn take_again(
        &mut self,
        track_idx: usize,
        fresh: Fresh,
        meeting: &Meeting,
        view: &FrameView,
    ) -> Option<TrackObservation> {
        self.tracks[track_idx].note_gap(&fresh, view.now);
        let region = fresh.region.clone();
        let evidence = self.take(track_idx, Some(fresh), meeting, view)?;
        Some(TrackObservation { track_idx, evidence, region })
    }

    /// Continues tracks that were lost a moment ago by masks at about their place, of about their size and like
    /// colours.
    fn find_again(
        &mut self,
        view: &FrameView,
        meeting: &mut Meeting,
        seen: &[TrackObservation],
    ) -> Vec<TrackObservation> {
        let may_return = |t: &usize| {
            meeting.carried(*t).is_none()
                && seen.iter().all(|s| s.track_idx != *t)
                && (!self.tracks[*t].is_lost() || self.tracks[*t].is_briefly_lost(view.now))
        };
        let rows: Vec<usize> = (0..self.tracks.len()).filter(may_return).collect();
        let columns = meeting.left();
        let pairs = assign(rows.len(), columns.len(), |row, column| {
            let (track, sight) = (&self.tracks[rows[row]], &meeting.sights[columns[column]]);
            let fresh = meeting.masks[columns[column]].as_ref().filter(|fresh| !is_explained(&fresh.region, seen))?;
            let recognised = track.recognise(&fresh.region, fresh.appearance.as_ref(), view.now)?;
            track.may_be(sight.class()).then_some(recognised.score)
        });
        let mut again: Vec<TrackObservation> = Vec::new();
        for (row, column) in pairs {
            let (track_idx, sight_idx) = (rows[row], columns[column]);
            let Some(fresh) = meeting.masks[sight_idx].clone() else { continue };
            if is_taken(&fresh.region, &again) {
                continue;
            }
            meeting.sight_of[track_idx] = Some(sight_idx);
            again.extend(self.take_again(track_idx, fresh, meeting, view));
        }
        again
    }

    fn lose_others(&mut self, view: &FrameView, meeting: &Meeting, seen: &[TrackObservation]) {
        for track_idx in 0..self.tracks.len() {
            if seen.iter().all(|s| s.track_idx != track_idx) {
                self.lose(track_idx, meeting, view.now);
            }
        }
    }

    /// Starts tracks from boxes that are sure enough and show nothing that is followed, by the surest first.
    fn start_boxes(&mut self, view: &FrameView, meeting: &Meeting, seen: &[TrackObservation]) -> Vec<TrackObservation> {
        let mut left = meeting.left();
        left.sort_by(|&a, &b| {
            meeting.sights[b].confidence().total_cmp(&meeting.sights[a].confidence()).then(a.cmp(&b))
        });
        let mut started: Vec<TrackObservation> = Vec::new();
        for (sight, fresh) in left.into_iter().filter_map(|s| Some((&meeting.sights[s], meeting.masks[s].as_ref()?))) {
            let is_old = is_explained(&fresh.region, seen) || is_explained(&fresh.region, &started);
            if is_old || !may_start(sight, &self.options) {
                continue;
            }
            self.num_started += 1;
            let track = Track::start_from_box(ObjectId(self.num_started), sight, fresh, meeting.outline, view.now);
            self.add(track, fresh.appearance.as_ref(), view.now);
            let (track_idx, region) = (self.tracks.len() - 1, fresh.region.clone());
            started.push(TrackObservation { track_idx, evidence: detected(sight), region });
        }
        started
    }
}

/// Returns true if a box is reliable enough to start a track: by its class, by its motion, or by both. A stationary
/// object has only its class.
pub(super) fn may_start(sight: &BoxGroup, options: &TrackerOptions) -> bool {
    let least =
        if sight.stands() { options.start_standing.max(options.start_confidence) } else { options.start_confidence };
    let surest = |of: fn(&Finding) -> Option<f64>| sight.findings().filter_map(of).fold(0.0, f64::max);
    let (detector, motion) = (surest(|found| found.detector), surest(|found| found.motion));
    let is_both = detector > 0.0 && motion >= options.start_confidence;
    is_both || detector >= least || motion >= options.start_motion
}

/// The mask of an object in which flow is of no use, as of a dark car of 15 pixels, carried with the box that shows the
/// object; `None` where no box does.
fn carried_by_box(track: &Track, prediction: &Prediction, sights: &[BoxGroup]) -> Option<Propagated> {
    let place = prediction.moved.as_ref()?.rect();
    let overlaps = sights.iter().map(|sight| (sight.rect.iou(&place), sight));
    let (_, sight) = overlaps.filter(|(iou, _)| *iou >= MIN_BOX_OVERLAP).max_by(|a, b| a.0.total_cmp(&b.0))?;
    let displacement = track.displacement_to(&sight.rect)?;
    let (region, whole) = (&track.region, &track.whole);
    Some(Propagated {
        region: region.moved(displacement)?,
        whole: whole.moved(displacement)?,
        cover: Cover::default(),
        displacement,
        share: 1.0,
        motion: Affine::shift(displacement),
    })
}

/// Returns true if a propagated mask may be the object's.
fn is_trusted(track: &Track, carried: &Propagated, image: &RgbImage) -> bool {
    carried.share >= MIN_CARRIED_SHARE
        && carried.region.area() >= MIN_AREA_PX2
        && !carried.is_nearly_hidden()
        && looks_like(track, image, &carried.region)
}

fn detected(sight: &BoxGroup) -> Evidence {
    Evidence::Detected { confidence: sight.confidence() }
}

/// The masks that a track may have, best first.
fn choices(track: &Track, meeting: &Meeting, track_idx: usize, carried: &Propagated) -> Vec<Choice> {
    let expected = Expected {
        carried: Some(&carried.region),
        whole: carried.is_partly_hidden().then_some(&carried.whole),
        rect: meeting.sight(track_idx).map(|sight| sight.rect),
        area: track.area,
        appearance: track.appearance.as_ref(),
    };
    let in_sight = meeting.sight_of[track_idx].and_then(|sight| meeting.masks[sight].clone());
    let new = in_sight.into_iter().chain(meeting.own_masks[track_idx].clone());
    let new = new.filter_map(|fresh| uncovered(fresh, carried)).filter_map(|fresh| own(fresh, track_idx, meeting));
    let mut choices: Vec<Choice> = new
        .map(|fresh| Choice { score: score(&fresh, &expected), fresh: Some(fresh) })
        .filter(|choice| choice.score >= MIN_SCORE)
        .collect();
    let old = score_carried(&carried.region, track.quality, track.frames_carried() + 1, &expected);
    choices.push(Choice { score: old, fresh: None });
    choices.sort_by(|a, b| b.score.total_cmp(&a.score));
    choices
}

/// A new mask without what comes before the object, unless it shows that nothing does any more; `None` if that is most
/// of it.
fn uncovered(fresh: Fresh, carried: &Propagated) -> Option<Fresh> {
    if fresh.region.iou(&carried.whole) >= SAME_OUTLINE {
        return Some(fresh);
    }
    let region = carried.cover.cut(&fresh.region)?;
    (2 * region.area() > fresh.region.area()).then_some(Fresh { region, ..fresh })
}

/// A new mask without what only another track carried here: the box of a car that passes a parked one holds both, and a
/// network answers with both. `None` if that is most of it.
fn own(fresh: Fresh, track_idx: usize, meeting: &Meeting) -> Option<Fresh> {
    let carried = meeting.carried(track_idx)?;
    let others = (0..meeting.predictions.len()).filter(|other| *other != track_idx);
    let touching: Vec<&Region> = others
        .filter_map(|other| Some(&meeting.carried(other)?.region))
        .filter(|other| other.rect().iou(&fresh.region.rect()) > 0.0)
        .collect();
    let is_others = |x: u32, y: u32| touching.iter().any(|other| other.contains(x, y));
    let region = fresh.region.filtered(|x, y| carried.region.contains(x, y) || !is_others(x, y))?;
    (2 * region.area() > fresh.region.area()).then_some(Fresh { region, ..fresh })
}

/// Returns true if the colors of a region match those of a track; unknown ones count as a match.
fn looks_like(track: &Track, image: &RgbImage, region: &Region) -> bool {
    let looks = track.appearance.as_ref().zip(Appearance::of(image, region));
    looks.is_none_or(|(before, now)| before.similarity(&now) >= MIN_SIMILARITY)
}

/// Returns true if a mask shows the object of another track.
fn is_taken(region: &Region, seen: &[TrackObservation]) -> bool {
    let same = |s: &TrackObservation| region.iou(&s.region) > 0.5 || region.covered_by(&s.region) > INSIDE;
    seen.iter().any(same)
}

/// Returns true if a mask shows part of a followed object, or contains one.
fn is_explained(region: &Region, seen: &[TrackObservation]) -> bool {
    let known =
        |s: &TrackObservation| region.covered_by(&s.region) > MAX_COVERED || s.region.covered_by(region) > SWALLOWED;
    seen.iter().any(known)
}
