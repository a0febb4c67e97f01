//! Joints: where a track goes on that was lost and found again.

use std::ops::Range;

use super::{Map, Slot, View, slots_of_view};
use crate::bundle::Whitening;
use crate::features::tracks::Feature;

impl Map<'_> {
    /// Makes tracks of their own of what was found again and does not fit what was seen before: of every part of a
    /// track behind a gap that has two registered views or more, and is an observation of the point in less than half
    /// of them. Returns how many.
    pub fn take_joints_apart(&mut self) -> usize {
        let mut apart: Vec<(usize, Vec<Range<usize>>)> = Vec::new();
        for track in 0..self.points.len() {
            let wrong: Vec<_> = self.parts(track).into_iter().filter(|part| !self.is_right(track, part)).collect();
            if !wrong.is_empty() {
                apart.push((track, wrong));
            }
        }
        for (track, parts) in &apart {
            let features = std::mem::take(&mut self.tracks.to_mut()[*track]);
            let is_apart = |slot: usize| parts.iter().any(|part| part.contains(&slot));
            let kept = |slot: &usize| !is_apart(*slot);
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
        apart.len()
    }

    /// The parts of a track between its gaps, as slots; none where it has no gap or no known point.
    fn parts(&self, track: usize) -> Vec<Range<usize>> {
        let features = &self.tracks[track];
        let gaps = (1..features.len()).filter(|&slot| features[slot].view > features[slot - 1].view + 1);
        let ends: Vec<usize> = std::iter::once(0).chain(gaps).chain([features.len()]).collect();
        if ends.len() == 2 || self.points[track].is_none() {
            return Vec::new();
        }
        ends.windows(2).map(|end| end[0]..end[1]).collect()
    }

    fn is_right(&self, track: usize, part: &Range<usize>) -> bool {
        let Some(point) = &self.points[track] else { return true };
        let registered = part.clone().filter(|&slot| self.pose_at(track, slot).is_some()).count();
        let active = part.clone().filter(|&slot| point.active[slot]).count();
        registered < 2 || 2 * active >= registered
    }

    /// Features of registered views that belong to known points, do not count as observations of them, and lie within
    /// `max_error_px` of where the points project; only those of tracks that were lost for more than `min_gap` views.
    pub fn open_joints(&self, max_error_px: f64, min_gap: usize) -> Vec<Slot> {
        let max_sq = max_error_px * max_error_px;
        let gap = |pair: &[Feature]| (pair[1].view - pair[0].view) as usize;
        let is_joined = |track: usize| self.tracks[track].windows(2).any(|pair| gap(pair) > min_gap);
        let open = |track: usize| {
            let point = self.points[track].as_ref()?;
            let fits = |slot: &usize| {
                let error_sq = self.view_at(track, *slot).map(|seen| View { whitening: Whitening::IDENTITY, ..seen });
                !point.active[*slot] && error_sq.is_some_and(|seen| seen.error_sq(point.position) <= max_sq)
            };
            let slots: Vec<usize> = (0..point.active.len()).filter(fits).collect();
            Some(slots.into_iter().map(move |slot| Slot { track: track as u32, slot: slot as u32 }))
        };
        (0..self.points.len()).filter(|&track| is_joined(track)).filter_map(open).flatten().collect()
    }
}
