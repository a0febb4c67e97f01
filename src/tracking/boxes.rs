//! Tracking step of one frame: boxes in every frame, masks in frames with segmentation.

use ::image::RgbImage;

use super::affine::Affine;
use super::appearance::Appearance;
use super::assignment::assign;
use super::box_groups::{self, BoxGroup, FrameDetection, INSIDE};
use super::choice::{Expected, MIN_SCORE, NewMask, score, score_propagated};
use super::merging::is_same_size;
use super::occlusion::Occlusion;
use super::propagation::{Propagated, displacement_outside, propagate_rect};
use super::region::Region;
use super::track::{Moment, Prediction, Track};
use super::tracker::{MAX_COVERED, TrackObservation, Tracker};
use super::{DetectedBox, Evidence, MIN_AREA_PX2, MIN_SIMILARITY, TrackerOptions};
use crate::networks::{BoxSegmenter, PerceptionError};
use crate::scene::{Flow, ObjectId, Outline, Rect};

/// Overlap of boxes (intersection over union) that suffices for an association, as a small overlap of masks does.
const MIN_BOX_OVERLAP: f64 = 0.4;
/// Minimum inlier ratio of the flow in a mask for the propagated mask to count.
const MIN_INLIER_RATIO: f64 = 0.4;
/// Overlap with the outline of the whole object from which a new mask shows all of it.
const SAME_OUTLINE: f64 = 0.85;
/// Share of a tracked object above which a new mask contains it; such a mask is no object of its own.
const CONTAINED: f64 = 0.8;
/// Maximum difference between the motions of a vehicle's part and of its rest, as a share of the part's motion against
/// the background: the vehicle turns or approaches. From 0.1 to 0.5 tracks differ little.
const MAX_MOTION_DIFFERENCE: f64 = 0.25;

/// Image, flow and time of the current frame.
pub(super) struct FrameView<'a> {
    pub(super) image: &'a RgbImage,
    pub(super) flow: Option<&'a Flow>,
    pub(super) now: Moment,
    pub(super) elapsed_s: f64,
}

/// Detections of a frame, and their association with tracks.
pub(super) struct FrameAssociation {
    pub(super) predictions: Vec<Prediction>,
    /// Per track, true if its propagated mask is reused without a prompt, because the object is stationary.
    pub(super) is_at_rest: Vec<bool>,
    pub(super) groups: Vec<BoxGroup>,
    /// Per group the new mask in its box.
    pub(super) masks: Vec<Option<NewMask>>,
    /// Per track the new masks in the box of its propagated or predicted mask and, where a part is occluded, in that of
    /// its whole outline.
    pub(super) own_masks: Vec<Vec<NewMask>>,
    /// Per track the group that shows it.
    group_of: Vec<Option<usize>>,
    /// Quality of the outlines of new masks.
    outline: Outline,
}

impl FrameAssociation {
    pub(super) fn propagated(&self, track: usize) -> Option<&Propagated> {
        self.predictions[track].propagated.as_ref()
    }

    fn group(&self, track: usize) -> Option<&BoxGroup> {
        self.group_of[track].map(|group| &self.groups[group])
    }

    /// Groups without a track.
    fn unassociated(&self) -> Vec<usize> {
        (0..self.groups.len()).filter(|s| !self.group_of.contains(&Some(*s))).collect()
    }
}

/// Candidate mask of a track in a frame.
struct Candidate {
    score: f64,
    /// `None` for the propagated one.
    new_mask: Option<NewMask>,
}

impl Tracker {
    /// Advances all tracks to a frame with known boxes.
    ///
    /// With a segmenter, boxes are prompted for masks. Without one, masks are propagated, and unassociated boxes are
    /// pending.
    pub(super) fn advance_tracks(
        &mut self,
        view: &FrameView,
        found: Vec<DetectedBox>,
        segmenter: Option<&mut dyn BoxSegmenter>,
    ) -> Result<Vec<TrackObservation>, PerceptionError> {
        let mut association = self.predict_and_group(view, found);
        let pending = self.propagated_pending(view.flow);
        let Some(segmenter) = segmenter else {
            self.associate_boxes(view, &mut association);
            let unassociated = association.unassociated().into_iter().map(|s| association.groups[s].clone()).collect();
            self.pending = box_groups::postpone(pending, unassociated);
            return Ok(self.propagate_all(view, &association));
        };
        association.groups = box_groups::merge_pending(pending, association.groups);
        association.is_at_rest = self.at_rest(view, &association);
        association.outline = if segmenter.is_coarse() { Outline::Coarse } else { Outline::Network };
        self.segment(view, segmenter, &mut association)?;
        self.pending.clear();
        self.associate_boxes(view, &mut association);
        self.count_ignored(&association);
        let mut observations = self.assign_masks(view, &association);
        self.redetect_at_prediction(view, &association, &mut observations);
        observations.extend(self.redetect(view, &mut association, &observations));
        self.lose_unobserved(view, &association, &observations);
        observations.extend(self.start_boxes(view, &association, &observations));
        Ok(observations)
    }

    /// Counts the boxes that start no track only because they are stationary.
    fn count_ignored(&mut self, association: &FrameAssociation) {
        for group in association.unassociated().into_iter().map(|s| &association.groups[s]) {
            if group.is_stationary()
                && !may_start(group, &self.options)
                && group.confidence() >= self.options.start_confidence
            {
                self.ignored.num_boxes += 1;
                self.ignored.max_confidence = self.ignored.max_confidence.max(group.confidence());
            }
        }
    }

    /// Predicts all tracks and groups the boxes.
    fn predict_and_group(&self, view: &FrameView, found: Vec<DetectedBox>) -> FrameAssociation {
        let mut predictions = self.predict(view.flow, view.image, view.elapsed_s);
        let is_plausible = |track: &Track, propagated: &Propagated| is_plausible(track, propagated, view.image);
        for (track, prediction) in self.tracks.iter().zip(&mut predictions) {
            prediction.propagated = prediction.propagated.take().filter(|propagated| is_plausible(track, propagated));
        }
        let rects: Vec<Rect> = predictions.iter().filter_map(|p| Some(p.propagated.as_ref()?.region.rect())).collect();
        let groups = box_groups::merge(found, &rects, &self.options, view.image.dimensions());
        for (track, prediction) in self.tracks.iter().zip(&mut predictions) {
            if prediction.propagated.is_none() && !track.is_lost() {
                let propagated = propagated_by_box(track, prediction, &groups);
                prediction.propagated = propagated.filter(|propagated| is_plausible(track, propagated));
            }
        }
        let (num_tracks, num_groups) = (self.tracks.len(), groups.len());
        FrameAssociation {
            predictions,
            is_at_rest: vec![false; num_tracks],
            groups,
            masks: vec![None; num_groups],
            own_masks: vec![Vec::new(); num_tracks],
            group_of: vec![None; num_tracks],
            outline: Outline::default(),
        }
    }

    /// Pending groups, propagated to this frame.
    fn propagated_pending(&self, flow: Option<&Flow>) -> Vec<BoxGroup> {
        let moved = |group: &BoxGroup| {
            let rect = flow.map_or(Some(group.rect), |flow| propagate_rect(&group.rect, flow))?;
            Some(group.at(rect))
        };
        self.pending.iter().filter_map(moved).collect()
    }

    /// Associates boxes with propagated tracks, by box overlap and, where masks are known, by mask overlap.
    ///
    /// A partly occluded object may become fully visible again: its whole outline counts as well as its visible part.
    fn associate_boxes(&self, view: &FrameView, association: &mut FrameAssociation) {
        let rows: Vec<usize> = (0..self.tracks.len()).filter(|t| association.propagated(*t).is_some()).collect();
        let pairs = assign(rows.len(), association.groups.len(), |row, s| {
            let (track, group) = (&self.tracks[rows[row]], &association.groups[s]);
            let propagated = association.propagated(rows[row])?;
            let best = |overlap: &dyn Fn(&Region) -> f64| overlap(&propagated.region).max(overlap(&propagated.whole));
            let by_box = best(&|region| region.rect().iou(&group.rect));
            // The mask of a car does not match the patch of road around it that was taken for a vehicle.
            let alike = |a: &Region, b: &Region| is_same_size(a.area() as f64 / b.area() as f64);
            let overlap = |a: &Region, b: &Region| if alike(a, b) { a.iou(b) } else { 0.0 };
            let by_mask =
                association.masks[s].as_ref().map_or(0.0, |new_mask| best(&|region| overlap(&new_mask.region, region)));
            let is_match = by_mask >= self.options.min_overlap
                || by_box >= MIN_BOX_OVERLAP
                || self.is_part(rows[row], s, association, view);
            (is_match && track.is_compatible(group.class())).then_some(0.5 * (by_box + by_mask))
        });
        for (row, group) in pairs {
            association.group_of[rows[row]] = Some(group);
        }
    }

    /// Returns true if a moving track covers only a part of the vehicle that the mask in a box shows.
    ///
    /// The box must be able to start a track and contain no other one, and its rest must move like the part.
    fn is_part(&self, track_idx: usize, group: usize, association: &FrameAssociation, view: &FrameView) -> bool {
        let (track, group, new_mask) = (&self.tracks[track_idx], &association.groups[group], &association.masks[group]);
        let (Some(propagated), Some(new_mask), Some(flow)) = (association.propagated(track_idx), new_mask, view.flow)
        else {
            return false;
        };
        let is_contained = propagated.region.covered_by(&new_mask.region) > CONTAINED;
        if !is_contained || track.is_stationary() || !may_start(group, &self.options) {
            return false;
        }
        let is_in_it = |other: usize| {
            let propagated = association.propagated(other);
            propagated.is_some_and(|other| box_groups::inside(&other.region.rect(), &group.rect) > 1.0 - INSIDE)
        };
        if (0..self.tracks.len()).any(|other| other != track_idx && is_in_it(other)) {
            return false;
        }
        let [x, y] = propagated.displacement;
        let [back_x, back_y] = association.predictions[track_idx].background;
        let tolerance_px = MAX_MOTION_DIFFERENCE * (x - back_x).hypot(y - back_y);
        let rest = displacement_outside(&track.region, &group.rect.moved([-x, -y]), flow);
        rest.is_some_and(|[rest_x, rest_y]| (rest_x - x).hypot(rest_y - y) <= tolerance_px)
    }

    /// Propagates all masks in a frame without segmentation.
    fn propagate_all(&mut self, view: &FrameView, association: &FrameAssociation) -> Vec<TrackObservation> {
        let mut observations = Vec::new();
        for track_idx in 0..self.tracks.len() {
            match association.propagated(track_idx) {
                Some(propagated) => {
                    let evidence = self.keep_propagated(track_idx, association, false, view);
                    observations.push(TrackObservation { track_idx, evidence, region: propagated.region.clone() });
                }
                None => self.lose(track_idx, association, view.now),
            }
        }
        observations
    }

    fn keep_propagated(
        &mut self,
        track_idx: usize,
        association: &FrameAssociation,
        has_failed: bool,
        view: &FrameView,
    ) -> Evidence {
        let track = &mut self.tracks[track_idx];
        track.count_evidence(association.group(track_idx), false, view.now);
        track.propagate(&association.predictions[track_idx], has_failed, view.now, view.elapsed_s);
        association.group(track_idx).map_or(Evidence::Carried, detected)
    }

    fn lose(&mut self, track_idx: usize, association: &FrameAssociation, now: Moment) {
        let track = &mut self.tracks[track_idx];
        let moved = association.predictions[track_idx].moved.clone().unwrap_or_else(|| track.region.clone());
        track.lose(moved, now);
    }

    /// Assigns each propagated track its best mask; no two tracks get the same.
    ///
    /// Tracks with a box come first, then those of higher rank. The others take a remaining mask, or are lost.
    fn assign_masks(&mut self, view: &FrameView, association: &FrameAssociation) -> Vec<TrackObservation> {
        let mut order: Vec<usize> = (0..self.tracks.len()).filter(|t| association.propagated(*t).is_some()).collect();
        let rank = |t: usize| (association.group_of[t].is_some(), self.tracks[t].rank());
        order.sort_by(|&a, &b| rank(b).cmp(&rank(a)).then(a.cmp(&b)));
        let mut observations: Vec<TrackObservation> = Vec::new();
        for track_idx in order {
            let Some(propagated) = association.propagated(track_idx) else { continue };
            let region_of = |candidate: &Candidate| match &candidate.new_mask {
                Some(new_mask) => new_mask.region.clone(),
                None => propagated.region.clone(),
            };
            let candidates = candidates(&self.tracks[track_idx], association, track_idx, propagated);
            let Some(candidate) =
                candidates.into_iter().find(|candidate| !is_taken(&region_of(candidate), &observations))
            else {
                continue;
            };
            let region = region_of(&candidate);
            if let Some(evidence) = self.update_track(track_idx, candidate.new_mask, association, view) {
                observations.push(TrackObservation { track_idx, evidence, region });
            }
        }
        observations
    }

    /// Continues a track with a new mask, or with the propagated one; `None` if that is unusable.
    fn update_track(
        &mut self,
        track_idx: usize,
        new_mask: Option<NewMask>,
        association: &FrameAssociation,
        view: &FrameView,
    ) -> Option<Evidence> {
        let Some(new_mask) = new_mask else {
            let is_worn_out = self.tracks[track_idx].is_worn_out();
            return (!is_worn_out)
                .then(|| self.keep_propagated(track_idx, association, !association.is_at_rest[track_idx], view));
        };
        let (track, group) = (&mut self.tracks[track_idx], association.group(track_idx));
        if let Some(propagated) = association.propagated(track_idx) {
            let retraced = track.history.retraced(&new_mask.region, propagated, view.image.dimensions());
            self.retraced.extend(retraced.into_iter().map(|(frame, region)| (frame, track.provisional, region)));
        }
        track.count_evidence(group, true, view.now);
        track.renew(&new_mask, association.outline, &association.predictions[track_idx], view.now, view.elapsed_s);
        track.anchor(group);
        Some(group.map_or(Evidence::Prompted { quality: new_mask.quality }, detected))
    }

    /// Re-detects tracks whose flow has just failed by new masks at their predicted positions.
    fn redetect_at_prediction(
        &mut self,
        view: &FrameView,
        association: &FrameAssociation,
        observations: &mut Vec<TrackObservation>,
    ) {
        for track_idx in (0..self.tracks.len()).filter(|t| association.propagated(*t).is_none()) {
            let Some(place) = &association.predictions[track_idx].moved else { continue };
            let is_shown = |new_mask: &&NewMask| self.tracks[track_idx].is_shown_by(new_mask, place);
            let shown = association.own_masks[track_idx].iter().find(is_shown);
            let Some(new_mask) = shown.filter(|new_mask| !is_explained(&new_mask.region, observations)).cloned() else {
                continue;
            };
            self.lose(track_idx, association, view.now);
            observations.extend(self.resume_lost(track_idx, new_mask, association, view));
        }
    }

    /// Continues a lost track with a mask that shows it again.
    fn resume_lost(
        &mut self,
        track_idx: usize,
        new_mask: NewMask,
        association: &FrameAssociation,
        view: &FrameView,
    ) -> Option<TrackObservation> {
        self.tracks[track_idx].record_gap(&new_mask, view.now);
        let region = new_mask.region.clone();
        let evidence = self.update_track(track_idx, Some(new_mask), association, view)?;
        Some(TrackObservation { track_idx, evidence, region })
    }

    /// Re-detects briefly lost tracks by unassociated masks of similar position, size and color.
    fn redetect(
        &mut self,
        view: &FrameView,
        association: &mut FrameAssociation,
        observations: &[TrackObservation],
    ) -> Vec<TrackObservation> {
        let may_return = |t: &usize| {
            association.propagated(*t).is_none()
                && observations.iter().all(|s| s.track_idx != *t)
                && (!self.tracks[*t].is_lost() || self.tracks[*t].is_briefly_lost(view.now))
        };
        let rows: Vec<usize> = (0..self.tracks.len()).filter(may_return).collect();
        let columns = association.unassociated();
        let pairs = assign(rows.len(), columns.len(), |row, column| {
            let (track, group) = (&self.tracks[rows[row]], &association.groups[columns[column]]);
            let new_mask = association.masks[columns[column]]
                .as_ref()
                .filter(|new_mask| !is_explained(&new_mask.region, observations))?;
            let recognized = track.recognize(&new_mask.region, new_mask.appearance.as_ref(), view.now)?;
            track.is_compatible(group.class()).then_some(recognized.score)
        });
        let mut redetected: Vec<TrackObservation> = Vec::new();
        for (row, column) in pairs {
            let (track_idx, group_idx) = (rows[row], columns[column]);
            let Some(new_mask) = association.masks[group_idx].clone() else { continue };
            if is_taken(&new_mask.region, &redetected) {
                continue;
            }
            association.group_of[track_idx] = Some(group_idx);
            redetected.extend(self.resume_lost(track_idx, new_mask, association, view));
        }
        redetected
    }

    fn lose_unobserved(&mut self, view: &FrameView, association: &FrameAssociation, observations: &[TrackObservation]) {
        for track_idx in 0..self.tracks.len() {
            if observations.iter().all(|s| s.track_idx != track_idx) {
                self.lose(track_idx, association, view.now);
            }
        }
    }

    /// Starts tracks from unassociated boxes, the most confident first.
    fn start_boxes(
        &mut self,
        view: &FrameView,
        association: &FrameAssociation,
        observations: &[TrackObservation],
    ) -> Vec<TrackObservation> {
        let mut unassociated = association.unassociated();
        unassociated.sort_by(|&a, &b| {
            association.groups[b].confidence().total_cmp(&association.groups[a].confidence()).then(a.cmp(&b))
        });
        let mut started: Vec<TrackObservation> = Vec::new();
        for (group, new_mask) in
            unassociated.into_iter().filter_map(|s| Some((&association.groups[s], association.masks[s].as_ref()?)))
        {
            let is_old = is_explained(&new_mask.region, observations) || is_explained(&new_mask.region, &started);
            if is_old || !may_start(group, &self.options) {
                continue;
            }
            self.num_started += 1;
            let track =
                Track::start_from_box(ObjectId(self.num_started), group, new_mask, association.outline, view.now);
            self.add(track, new_mask.appearance.as_ref(), view.now);
            let (track_idx, region) = (self.tracks.len() - 1, new_mask.region.clone());
            started.push(TrackObservation { track_idx, evidence: detected(group), region });
        }
        started
    }
}

/// Returns true if a box is reliable enough to start a track: by its class, by its motion, or by both.
///
/// A stationary object has only its class.
pub(super) fn may_start(group: &BoxGroup, options: &TrackerOptions) -> bool {
    let least = if group.is_stationary() {
        options.start_standing.max(options.start_confidence)
    } else {
        options.start_confidence
    };
    let surest = |of: fn(&FrameDetection) -> Option<f64>| group.detections().filter_map(of).fold(0.0, f64::max);
    let (detector, motion) = (surest(|found| found.detector), surest(|found| found.motion));
    let is_both = detector > 0.0 && motion >= options.start_confidence;
    is_both || detector >= least || motion >= options.start_motion
}

/// Propagates a mask with the box that shows the object, where flow is unusable, as in a dark car of 15 pixels.
///
/// `None` without such a box.
fn propagated_by_box(track: &Track, prediction: &Prediction, groups: &[BoxGroup]) -> Option<Propagated> {
    let place = prediction.moved.as_ref()?.rect();
    let overlaps = groups.iter().map(|group| (group.rect.iou(&place), group));
    let (_, group) = overlaps.filter(|(iou, _)| *iou >= MIN_BOX_OVERLAP).max_by(|a, b| a.0.total_cmp(&b.0))?;
    let displacement = track.displacement_to(&group.rect)?;
    let (region, whole) = (&track.region, &track.whole);
    Some(Propagated {
        region: region.moved(displacement)?,
        whole: whole.moved(displacement)?,
        occlusion: Occlusion::default(),
        displacement,
        inlier_ratio: 1.0,
        motion: Affine::shift(displacement),
    })
}

/// Returns true if a propagated mask may be the object's.
fn is_plausible(track: &Track, propagated: &Propagated, image: &RgbImage) -> bool {
    propagated.inlier_ratio >= MIN_INLIER_RATIO
        && propagated.region.area() >= MIN_AREA_PX2
        && !propagated.is_nearly_occluded()
        && is_similar(track, image, &propagated.region)
}

fn detected(group: &BoxGroup) -> Evidence {
    Evidence::Detected { confidence: group.confidence() }
}

/// Candidate masks of a track, best first.
fn candidates(
    track: &Track,
    association: &FrameAssociation,
    track_idx: usize,
    propagated: &Propagated,
) -> Vec<Candidate> {
    let expected = Expected {
        propagated: Some(&propagated.region),
        whole: propagated.is_partly_occluded().then_some(&propagated.whole),
        rect: association.group(track_idx).map(|group| group.rect),
        area: track.area,
        appearance: track.appearance.as_ref(),
    };
    let in_box = association.group_of[track_idx].and_then(|group| association.masks[group].clone());
    let new = in_box.into_iter().chain(association.own_masks[track_idx].clone());
    let new = new
        .filter_map(|new_mask| without_occluders(new_mask, propagated))
        .filter_map(|new_mask| without_others(new_mask, track_idx, association));
    let mut candidates: Vec<Candidate> = new
        .map(|new_mask| Candidate { score: score(&new_mask, &expected), new_mask: Some(new_mask) })
        .filter(|candidate| candidate.score >= MIN_SCORE)
        .collect();
    let old = score_propagated(&propagated.region, track.quality, track.frames_propagated() + 1, &expected);
    candidates.push(Candidate { score: old, new_mask: None });
    candidates.sort_by(|a, b| b.score.total_cmp(&a.score));
    candidates
}

/// Removes occluders from a new mask, unless it shows the whole object; `None` if at most half remains.
fn without_occluders(new_mask: NewMask, propagated: &Propagated) -> Option<NewMask> {
    if new_mask.region.iou(&propagated.whole) >= SAME_OUTLINE {
        return Some(new_mask);
    }
    let region = propagated.occlusion.cut(&new_mask.region)?;
    (2 * region.area() > new_mask.region.area()).then_some(NewMask { region, ..new_mask })
}

/// Removes pixels that only other tracks propagate here from a new mask; `None` if at most half remains.
///
/// The box of a car that passes a parked one contains both, and a network segments both.
fn without_others(new_mask: NewMask, track_idx: usize, association: &FrameAssociation) -> Option<NewMask> {
    let propagated = association.propagated(track_idx)?;
    let others = (0..association.predictions.len()).filter(|other| *other != track_idx);
    let touching: Vec<&Region> = others
        .filter_map(|other| Some(&association.propagated(other)?.region))
        .filter(|other| other.rect().iou(&new_mask.region.rect()) > 0.0)
        .collect();
    let is_others = |x: u32, y: u32| touching.iter().any(|other| other.contains(x, y));
    let region = new_mask.region.filtered(|x, y| propagated.region.contains(x, y) || !is_others(x, y))?;
    (2 * region.area() > new_mask.region.area()).then_some(NewMask { region, ..new_mask })
}

/// Returns true if the colors of a region match those of a track; unknown ones count as a match.
fn is_similar(track: &Track, image: &RgbImage, region: &Region) -> bool {
    let appearances = track.appearance.as_ref().zip(Appearance::of(image, region));
    appearances.is_none_or(|(before, now)| before.similarity(&now) >= MIN_SIMILARITY)
}

/// Returns true if another track has this mask.
fn is_taken(region: &Region, observations: &[TrackObservation]) -> bool {
    let same = |s: &TrackObservation| region.iou(&s.region) > 0.5 || region.covered_by(&s.region) > INSIDE;
    observations.iter().any(same)
}

/// Returns true if a mask shows part of a tracked object, or contains one.
fn is_explained(region: &Region, observations: &[TrackObservation]) -> bool {
    let known =
        |s: &TrackObservation| region.covered_by(&s.region) > MAX_COVERED || s.region.covered_by(region) > CONTAINED;
    observations.iter().any(known)
}
