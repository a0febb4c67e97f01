//! Selection of box prompts: the mask network takes longer than everything else together.
//!
//! Prompted are boxes that may show a tracked or a recently lost object, or that are confident enough to start a track.
//! Tracked objects are prompted as well, with the box of their propagated mask, unless another box prompts for the
//! same. Stationary, fully visible objects are prompted at intervals: their masks hardly change, and a street of parked
//! cars would cost more than all moving objects.

use ::image::RgbImage;

use super::MIN_AREA_PX2;
use super::appearance::Appearance;
use super::box_groups::BoxGroup;
use super::boxes::{FrameAssociation, FrameView, may_start};
use super::choice::NewMask;
use super::region::Region;
use super::tracker::Tracker;
use crate::networks::{BoxMask, BoxSegmenter, PerceptionError};
use crate::scene::Rect;

/// Overlap (intersection over union) from which a box prompts for the same mask as that of a propagated mask.
const SAME_PROMPT: f64 = 0.85;
/// Overlap from which a box confirms the mask of a stationary object, so that no prompt is needed.
const SAME_POSITION: f64 = 0.7;

impl Tracker {
    /// Prompts for the masks of relevant boxes, and of propagated masks that no box repeats.
    pub(super) fn segment(
        &self,
        view: &FrameView,
        segmenter: &mut dyn BoxSegmenter,
        association: &mut FrameAssociation,
    ) -> Result<(), PerceptionError> {
        let prompted: Vec<usize> = (0..association.groups.len())
            .filter(|&s| self.needs_prompt(&association.groups[s], association, view))
            .collect();
        let mut rects: Vec<Rect> = prompted.iter().map(|&s| association.groups[s].rect).collect();
        let own = self.own_boxes(view, association, &rects);
        rects.extend(own.iter().map(|(_, rect)| *rect));
        let mut masks = segment_boxes(view.image, segmenter, &rects)?;
        let own_masks = masks.split_off(prompted.len());
        association.masks = vec![None; association.groups.len()];
        prompted.into_iter().zip(masks).for_each(|(s, new_mask)| association.masks[s] = new_mask);
        own.into_iter().zip(own_masks).for_each(|((track, _), new_mask)| association.own_masks[track].extend(new_mask));
        Ok(())
    }

    /// Finds the tracks whose propagated mask is reused without a prompt.
    ///
    /// Such an object is stationary, not occluded and not truncated, and every box that touches it confirms its
    /// position. Returns one entry per track.
    pub(super) fn at_rest(&self, view: &FrameView, association: &FrameAssociation) -> Vec<bool> {
        let (width, height) = view.image.dimensions();
        let is_at_rest = |track: usize| {
            let Some(propagated) = association.propagated(track) else { return false };
            let (bounds, rect) = (propagated.region.bounds(), propagated.region.rect());
            let is_inside = !bounds.is_truncated(width, height);
            let agrees = |group: &BoxGroup| {
                let overlap = group.rect.iou(&rect);
                overlap <= 0.0 || overlap >= SAME_POSITION
            };
            let is_whole = is_inside && !propagated.is_partly_occluded();
            is_whole && self.tracks[track].is_at_rest(view.now, &self.options) && association.groups.iter().all(agrees)
        };
        (0..self.tracks.len()).map(is_at_rest).collect()
    }

    /// Returns true if the mask in a box may belong to a tracked, a lost or a new object.
    fn needs_prompt(&self, group: &BoxGroup, association: &FrameAssociation, view: &FrameView) -> bool {
        let shows =
            |track: usize| association.propagated(track).is_some_and(|c| c.region.rect().iou(&group.rect) > 0.0);
        if (0..self.tracks.len()).any(|track| association.is_at_rest[track] && shows(track)) {
            return false;
        }
        let may_return = |t: usize| {
            let track = &self.tracks[t];
            association.propagated(t).is_none() && (!track.is_lost() || track.is_briefly_lost(view.now))
        };
        may_start(group, &self.options) || (0..self.tracks.len()).any(|t| shows(t) || may_return(t))
    }

    /// Boxes of propagated masks, and of whole outlines where a part is occluded, by track.
    ///
    /// Boxes that repeat one of `prompted` are skipped. Tracks whose flow has just failed have their predicted boxes.
    fn own_boxes(&self, view: &FrameView, association: &FrameAssociation, prompted: &[Rect]) -> Vec<(usize, Rect)> {
        let mut own = Vec::new();
        for track in (0..self.tracks.len()).filter(|track| !association.is_at_rest[*track]) {
            let Some(propagated) = association.propagated(track) else {
                let place = association.predictions[track].moved.as_ref();
                let place = place.filter(|_| self.tracks[track].may_be_redetected(view.now));
                own.extend(place.map(|place| (track, place.rect())));
                continue;
            };
            let whole = propagated.is_partly_occluded().then(|| propagated.whole.rect());
            let mut known = prompted.to_vec();
            for rect in [Some(propagated.region.rect()), whole].into_iter().flatten() {
                if known.iter().all(|known| known.iou(&rect) < SAME_PROMPT) {
                    own.push((track, rect));
                    known.push(rect);
                }
            }
        }
        own
    }
}

/// Masks of a segmenter for boxes, one entry per box.
pub(super) fn segment_boxes(
    image: &RgbImage,
    segmenter: &mut dyn BoxSegmenter,
    rects: &[Rect],
) -> Result<Vec<Option<NewMask>>, PerceptionError> {
    let mut answers = if rects.is_empty() { Vec::new() } else { segmenter.masks(image, rects)? };
    answers.resize(rects.len(), None);
    let new_mask = |answer: Option<BoxMask>| {
        let Some(BoxMask { mask, quality }) = answer else { return Ok(None) };
        let (found, expected) = ((mask.width(), mask.height()), image.dimensions());
        if found != expected {
            return Err(PerceptionError::SizeMismatch { what: "the mask of a box".to_owned(), expected, found });
        }
        let region = Region::from_mask(&mask).filter(|region| region.area() >= MIN_AREA_PX2);
        Ok(region.map(|region| NewMask { appearance: Appearance::of(image, &region), quality, region }))
    };
    answers.into_iter().map(new_mask).collect()
}
