//! For which boxes masks are asked: the mask network takes longer than everything else together.
//!
//! Of the boxes of a frame those that may come to something: that may be a followed object or one that was just lost,
//! or that are sure enough to start a track. Of the followed objects all, in the box of their carried masks, where no
//! other box asks the same. Of those that stand and are seen as a whole it is asked now and then only: their masks
//! hardly change, and a street of parked cars would cost more than all that moves.

use ::image::RgbImage;

use super::MIN_AREA_PX2;
use super::appearance::Appearance;
use super::box_groups::BoxGroup;
use super::boxes::{FrameView, Meeting, may_start};
use super::choice::Fresh;
use super::region::Region;
use super::tracker::Tracker;
use crate::networks::{BoxMask, BoxSegmenter, PerceptionError};
use crate::scene::Rect;

/// A box that agrees this well with that of the carried mask asks for the same mask.
const SAME_PROMPT: f64 = 0.85;
/// A box that agrees this well with that of the mask of what stands gives no reason to ask.
const SAME_PLACE: f64 = 0.7;

impl Tracker {
    /// Asks for the masks of boxes that may come to something, and of carried masks that no box repeats.
    pub(super) fn segment(
        &self,
        view: &FrameView,
        prompter: &mut dyn BoxSegmenter,
        meeting: &mut Meeting,
    ) -> Result<(), PerceptionError> {
        let asked: Vec<usize> =
            (0..meeting.sights.len()).filter(|&s| self.is_worth_asking(&meeting.sights[s], meeting, view)).collect();
        let mut rects: Vec<Rect> = asked.iter().map(|&s| meeting.sights[s].rect).collect();
        let own = self.own_boxes(view, meeting, &rects);
        rects.extend(own.iter().map(|(_, rect)| *rect));
        let mut masks = fresh_masks(view.image, prompter, &rects)?;
        let own_masks = masks.split_off(asked.len());
        meeting.masks = vec![None; meeting.sights.len()];
        asked.into_iter().zip(masks).for_each(|(s, fresh)| meeting.masks[s] = fresh);
        own.into_iter().zip(own_masks).for_each(|((track, _), fresh)| meeting.own_masks[track].extend(fresh));
        Ok(())
    }

    /// Per track whether its carried mask serves without a new one: the object stands, nothing hides it, it does not
    /// enter or leave the picture, and every box that touches it says the same of where it is.
    pub(super) fn at_rest(&self, view: &FrameView, meeting: &Meeting) -> Vec<bool> {
        let (width, height) = view.image.dimensions();
        let is_at_rest = |track: usize| {
            let Some(carried) = meeting.carried(track) else { return false };
            let (bounds, rect) = (carried.region.bounds(), carried.region.rect());
            let is_inside = !bounds.is_truncated(width, height);
            let agrees = |sight: &BoxGroup| {
                let overlap = sight.rect.iou(&rect);
                overlap <= 0.0 || overlap >= SAME_PLACE
            };
            let is_whole = is_inside && !carried.is_partly_hidden();
            is_whole && self.tracks[track].is_at_rest(view.now, &self.options) && meeting.sights.iter().all(agrees)
        };
        (0..self.tracks.len()).map(is_at_rest).collect()
    }

    /// Returns true if the mask in a box could belong to a followed, a lost or a new object.
    fn is_worth_asking(&self, sight: &BoxGroup, meeting: &Meeting, view: &FrameView) -> bool {
        let shows = |track: usize| meeting.carried(track).is_some_and(|c| c.region.rect().iou(&sight.rect) > 0.0);
        if (0..self.tracks.len()).any(|track| meeting.is_at_rest[track] && shows(track)) {
            return false;
        }
        let may_return = |t: usize| {
            let track = &self.tracks[t];
            meeting.carried(t).is_none() && (!track.is_lost() || track.is_briefly_lost(view.now))
        };
        may_start(sight, &self.options) || (0..self.tracks.len()).any(|t| shows(t) || may_return(t))
    }

    /// The boxes of carried masks, and of whole outlines where a part is hidden, by track; those that agree with one of
    /// `asked` are left out. Of tracks whose flow failed just now the boxes where they should be.
    fn own_boxes(&self, view: &FrameView, meeting: &Meeting, asked: &[Rect]) -> Vec<(usize, Rect)> {
        let mut own = Vec::new();
        for track in (0..self.tracks.len()).filter(|track| !meeting.is_at_rest[*track]) {
            let Some(carried) = meeting.carried(track) else {
                let place = meeting.predictions[track].moved.as_ref();
                let place = place.filter(|_| self.tracks[track].may_be_looked_for(view.now));
                own.extend(place.map(|place| (track, place.rect())));
                continue;
            };
            let whole = carried.is_partly_hidden().then(|| carried.whole.rect());
            let mut known = asked.to_vec();
            for rect in [Some(carried.region.rect()), whole].into_iter().flatten() {
                if known.iter().all(|known| known.iou(&rect) < SAME_PROMPT) {
                    own.push((track, rect));
                    known.push(rect);
                }
            }
        }
        own
    }
}

/// The masks that a prompter gives for boxes, one entry per box.
pub(super) fn fresh_masks(
    image: &RgbImage,
    prompter: &mut dyn BoxSegmenter,
    rects: &[Rect],
) -> Result<Vec<Option<Fresh>>, PerceptionError> {
    let mut answers = if rects.is_empty() { Vec::new() } else { prompter.masks(image, rects)? };
    answers.resize(rects.len(), None);
    let fresh = |answer: Option<BoxMask>| {
        let Some(BoxMask { mask, quality }) = answer else { return Ok(None) };
        let (found, expected) = ((mask.width(), mask.height()), image.dimensions());
        if found != expected {
            return Err(PerceptionError::SizeMismatch { what: "the mask of a box".to_owned(), expected, found });
        }
        let region = Region::from_mask(&mask).filter(|region| region.area() >= MIN_AREA_PX2);
        Ok(region.map(|region| Fresh { appearance: Appearance::of(image, &region), quality, region }))
    };
    answers.into_iter().map(fresh).collect()
}
