//! Re-detections: continuations of tracks after gaps.

use std::ops::Range;

use super::{Map, Slot, View, slots_of_view};
use crate::bundle::Whitening;
use crate::features::tracks::Feature;

impl Map<'_> {
    /// Splits wrong re-detections from their tracks; returns the number of split tracks.
    ///
    /// A part of a track between gaps becomes a track of its own if it has two registered views or more, and is an
    /// observation of the point in less than half of them.
    pub fn split_wrong_redetections(&mut self) -> usize {
        let mut split: Vec<(usize, Vec<Range<usize>>)> = Vec::new();
        for track in 0..self.points.len() {
            let wrong: Vec<_> = self.parts(track).into_iter().filter(|part| !self.is_consistent(track, part)).collect();
            if !wrong.is_empty() {
                split.push((track, wrong));
            }
        }
        for (track, parts) in &split {
            let features = std::mem::take(&mut self.tracks.to_mut()[*track]);
            let is_split = |slot: usize| parts.iter().any(|part| part.contains(&slot));
            let kept = |slot: &usize| !is_split(*slot);
            let tracks = self.tracks.to_mut();
            tracks[*track] = (0..features.len()).filter(kept).map(|slot| features[slot]).collect();
            tracks.extend(parts.iter().map(|part| features[part.clone()].to_vec()));
            if let Some(point) = &mut self.points[*track] {
                point.active = (0..features.len()).filter(kept).map(|slot| point.active[slot]).collect();
            }
        }
        self.points.resize(self.tracks.len(), None);
        self.slots_of_view = slots_of_view(self.poses.len(), &self.tracks);
        self.num_visible = (0..self.poses.len()).map(|view| self.visible(view).len()).collect();
        split.len()
    }

    /// Parts of a track between its gaps, as slots; none without a gap or a known point.
    fn parts(&self, track: usize) -> Vec<Range<usize>> {
        let features = &self.tracks[track];
        let gaps = (1..features.len()).filter(|&slot| features[slot].view > features[slot - 1].view + 1);
        let ends: Vec<usize> = std::iter::once(0).chain(gaps).chain([features.len()]).collect();
        if ends.len() == 2 || self.points[track].is_none() {
            return Vec::new();
        }
        ends.windows(2).map(|end| end[0]..end[1]).collect()
    }

    fn is_consistent(&self, track: usize, part: &Range<usize>) -> bool {
        let Some(point) = &self.points[track] else { return true };
        let registered = part.clone().filter(|&slot| self.pose_at(track, slot).is_some()).count();
        let active = part.clone().filter(|&slot| point.active[slot]).count();
        registered < 2 || 2 * active >= registered
    }

    /// Features of points that were lost for more than `min_gap` views, near the projections but not observations.
    ///
    /// They are features of registered views within `max_error_px` of the projections of known points.
    pub fn open_loop_closures(&self, max_error_px: f64, min_gap: usize) -> Vec<Slot> {
        let max_sq = max_error_px * max_error_px;
        let gap = |pair: &[Feature]| (pair[1].view - pair[0].view) as usize;
        let has_gap = |track: usize| self.tracks[track].windows(2).any(|pair| gap(pair) > min_gap);
        let open = |track: usize| {
            let point = self.points[track].as_ref()?;
            let fits = |slot: &usize| {
                let error_sq = self.view_at(track, *slot).map(|seen| View { whitening: Whitening::IDENTITY, ..seen });
                !point.active[*slot] && error_sq.is_some_and(|seen| seen.error_sq(point.position) <= max_sq)
            };
            let slots: Vec<usize> = (0..point.active.len()).filter(fits).collect();
            Some(slots.into_iter().map(move |slot| Slot { track: track as u32, slot: slot as u32 }))
        };
        (0..self.points.len()).filter(|&track| has_gap(track)).filter_map(open).flatten().collect()
    }
}
